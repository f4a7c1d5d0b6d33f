"""What bends friction is told, joint by joint, and a sound recording has no such warning."""

import re
from dataclasses import replace

import numpy as np
import pytest
from oracle_arm import GROUND
from own_physics import UR5, coupled_wrist, frozen, held, late, productioned_arm, with_current
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, sosfiltfilt

from monitor.errors import Unidentifiable
from monitor.identify.identify import identify
from monitor.identify.signals.motion import motion

HEALTHY = productioned_arm()


def told(recording):
    """Warnings by code, texts joined."""
    texts: dict[str, str] = {}
    for warning in identify([recording], UR5, GROUND).warnings:
        texts[warning.code] = texts.get(warning.code, "") + warning.text + "\n"
    return texts


def exchanged_currents(a, b):
    order = np.arange(6)
    order[[a, b]] = b, a
    return replace(HEALTHY, current=HEALTHY.current[:, order])


def filtered(recording, cutoff_hz):
    """With currents that a low-pass without delay has smoothed."""
    sections = butter(2, cutoff_hz, fs=125.0, output="sos")
    return replace(recording, current=sosfiltfilt(sections, recording.current, axis=0))


def averaged(recording, window_s):
    """With currents averaged over the readings around."""
    return replace(recording, current=uniform_filter1d(recording.current, round(125.0 * window_s), axis=0))


GROWING = np.linspace(1.0, 1.3, HEALTHY.samples)[:, None]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_sound_recording_has_no_warning(seed):
    """Friction that no law describes, ripple, correlated noise: nothing is told."""
    assert told(productioned_arm(seed)) == {}


FAULTS = {
    "currents 100 ms late": (late(HEALTHY, 0.1), "torque_delayed", "all joints comes about .* later"),
    "currents 40 ms late": (late(HEALTHY, 0.04), "torque_delayed", "all joints comes about (3|4). ms later"),
    "currents 50 ms early": (
        replace(HEALTHY, current=np.roll(HEALTHY.current, -6, axis=0)),
        "torque_delayed",
        "all joints comes about (3|4|5). ms earlier",
    ),
    "smoothed": (filtered(HEALTHY, 2.0), "torque_smoothed", "only (3|4)[0-9]% of what .* faster than 1.5 Hz is there"),
    "smoothed at 3 Hz": (filtered(HEALTHY, 3.0), "torque_smoothed", "only (1|2)[0-9]% of what"),
    "smoothed at 4 Hz": (filtered(HEALTHY, 4.0), "torque_smoothed", "only 3[0-9]% of what"),
    "averaged over 0.16 s": (averaged(HEALTHY, 0.16), "torque_smoothed", "only [23][0-9]% of"),
    "averaged over 0.3 s": (averaged(HEALTHY, 0.3), "torque_smoothed", "only (2|3|4)[0-9]% of"),
    "a gain that grows": (replace(HEALTHY, current=HEALTHY.current * GROWING), "torque_drifts", r"grows by (2|3)[0-9]% beside the motion"),
    "one current 60 ms late": (late(HEALTHY, 0.06, [1]), "torque_delayed", "joint 2 comes"),
    "saturated": (with_current(HEALTHY, 2, lambda x: np.clip(x, -0.7 * np.max(x), 0.7 * np.max(x))), "current_saturated", "joint 3 is cut"),
    "saturated one way": (with_current(HEALTHY, 1, lambda x: np.minimum(x, np.quantile(x, 0.8))), "current_saturated", "joint 2 is cut"),
    "stuck": (with_current(HEALTHY, 3, lambda x: frozen(x, 700, 900)), "current_stuck", "joint 4 stays at .* in 8%"),
    "lost": (with_current(HEALTHY, 0, lambda x: np.where(np.arange(len(x)) < 400, 0.0, x)), "current_stuck", "joint 1 stays at 0"),
    "held": (with_current(HEALTHY, 4, lambda x: held(x, 12)), "current_held", "joint 5 changes every (8|9). ms"),
    "gain of a motor": (with_current(HEALTHY, 1, lambda x: x / 101.0), "gain_doubtful", "joint 2: friction of .* of the 150 N·m"),
    "gain of a wrist": (with_current(HEALTHY, 5, lambda x: 20.0 * x), "gain_doubtful", "joint 6: friction of"),
    "gains of all motors": (replace(HEALTHY, current=HEALTHY.current / 101.0), "gain_doubtful", "joint 6"),
    "sign of a current": (with_current(HEALTHY, 1, lambda x: -x), "poor_fit", "joint 2: the model misses"),
    "offset": (with_current(HEALTHY, 2, lambda x: x + 0.5), "torque_offset", r"joint 3: .* offset of about \+"),
    "coupled wrists": (coupled_wrist(HEALTHY), "poor_fit", "joint (5|6): .* joint (5|6) explains most of it: coupled axes"),
    "exchanged currents": (exchanged_currents(3, 5), "poor_fit", "joint (4|6): "),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.slow
def test_what_bends_friction_is_told(fault):
    """Each fault has the warning that names it, and the joint."""
    recording, code, text = FAULTS[fault]
    found = told(recording)
    assert code in found, found
    assert re.search(text, found[code]), found[code]


def test_a_current_offset_is_not_told_as_mounting_alone():
    """Where gravity seems to have another direction, and an offset explains it as well, the warning says so."""
    found = told(with_current(HEALTHY, 0, lambda x: x + 3.0))
    assert "torque_offset" in found
    assert "offset" in found.get("mounting_contradiction", "offset")


def test_currents_in_milliamperes_are_refused_with_a_hint():
    """No drive of an arm has hundreds of amperes throughout."""
    with pytest.raises(Unidentifiable, match=r"worked: currents of .* are no amperes: expected \[A\]; if they are in mA, divide"):
        identify([replace(HEALTHY, current=1000.0 * HEALTHY.current)], UR5, GROUND)


def first_rows(count):
    """The beginning of the recording."""
    kept = ("t_s", "q", "qd", "current", "temperature_c")
    return replace(HEALTHY, **{name: None if getattr(HEALTHY, name) is None else getattr(HEALTHY, name)[:count] for name in kept})


def test_a_recording_without_rows_is_refused():
    """As a file whose program wrote its header and stopped."""
    with pytest.raises(Unidentifiable, match="worked: holds no rows; expected a recording"):
        identify([first_rows(0)], UR5, GROUND)


@pytest.mark.parametrize("count", range(1, 25))
def test_a_recording_of_few_rows_is_refused_with_the_reason(count):
    """As a file whose program stopped after its first rows, with fewer of them than a window of the checks."""
    with pytest.raises(Unidentifiable, match=r"^worked: .*expected"):
        motion(first_rows(count))
