"""A robust fit beside plain ones, where part of the data is wrong."""

from dataclasses import replace

import numpy as np
from oracle_arm import COULOMB_NM, GROUND, VISCOUS, exact_motion, recording, truth

from monitor.identify.identify import IdentifyOptions, identify, identify_motions
from monitor.model.robot import load_robot

UR5 = load_robot("ur5")


def off(found):
    """Largest relative error of F(0.4 rad/s)."""
    return float(np.max(np.abs(found.friction_at(0.4)[0] / (COULOMB_NM + 0.4 * VISCOUS) - 1.0)))


def test_five_percent_of_gross_outliers_do_not_move_a_robust_fit():
    """Outliers of ten times friction in 5 % of the rows, all one way: robust stays within 1 %, WLS is off by more than 5 %."""
    known = truth(UR5)
    rng = np.random.default_rng(3)
    torque = known.torque + 0.3 * rng.normal(size=known.torque.shape)
    wrong = rng.random(torque.shape) < 0.05
    torque = np.where(wrong, torque + 10.0 * (COULOMB_NM + VISCOUS) * np.sign(known.qd), torque)
    found = identify_motions([exact_motion(known)], [torque], UR5, GROUND, IdentifyOptions(method="robust"))
    assert off(found) < 0.01
    assert off(identify_motions([exact_motion(known)], [torque], UR5, GROUND)) > 0.05
    texts = [warning.text for warning in found.warnings if warning.code == "outliers"]
    assert len(texts) == 6  # each joint has outliers
    assert all("5." in text or "4." in text for text in texts)  # the text gives the share


def test_spikes_and_a_push_in_a_recording_hardly_change_the_result():
    """2 % of the current samples read 50 A, and somebody leans on joint 3 for 1 s (3 %): F within 3 %; plain WLS is off by over 10 %."""
    sound = recording(truth(UR5))
    rng = np.random.default_rng(4)
    current = np.where(rng.random(sound.current.shape) < 0.02, 50.0, sound.current)
    current[1000:1125, 2] += 5.0
    hurt = replace(sound, current=current)
    found = identify([hurt], UR5, GROUND, method="robust")
    assert off(found) < 0.03
    assert off(identify([hurt], UR5, GROUND)) > 0.10
    assert "repaired_spikes" in {warning.code for warning in found.warnings}


def test_without_outliers_robust_agrees_with_wls():
    """F(0.4) agrees within half of its standard deviation, and that within 40 %: Student's t has 6 % less efficiency."""
    sound = recording(truth(UR5))
    robust, wls = identify([sound], UR5, GROUND, method="robust"), identify([sound], UR5, GROUND)
    (F, std), (F_wls, std_wls) = robust.friction_at(0.4), wls.friction_at(0.4)
    assert np.all(np.abs(F - F_wls) < 0.5 * std_wls)
    assert np.all(np.abs(std / std_wls - 1.0) < 0.4)
    assert "repaired_spikes" not in {warning.code for warning in robust.warnings}
    assert "outliers" not in {warning.code for warning in robust.warnings}
