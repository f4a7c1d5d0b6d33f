"""Recordings that say too little alone, and long ones."""

import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
from oracle_arm import COULOMB_NM, GROUND, VISCOUS, Truth, friction, recording, rigid_torque

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.identify import identify
from monitor.model.robot import load_robot
from monitor.store import identify_files as files

ROBOT = load_robot("ur5")


def sweep(joint, seconds=12.0, rate_hz=50.0):
    """One joint to and fro with growing speed while the others stand still, in a posture that weighs on most joints."""
    t_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    q, qd, qdd = (np.zeros((len(t_s), 6)) for _ in range(3))
    q[:] = [0.3, -0.9, 0.8, -0.6, 0.7, 0.2]
    for amplitude, w in ((0.5, 1.1), (0.25, 2.9)):
        q[:, joint] += amplitude * np.sin(w * t_s)
        qd[:, joint] += amplitude * w * np.cos(w * t_s)
        qdd[:, joint] -= amplitude * w**2 * np.sin(w * t_s)
    return recording(Truth(t_s, q, qd, qdd, rigid_torque(ROBOT, GROUND, q, qd, qdd) + friction(qd)), noise=0.2, seed=joint)


@pytest.fixture(scope="module")
def sweeps():
    return [sweep(joint) for joint in range(6)]


def test_sweeps_of_single_joints_identify_the_friction_of_the_arm_together(sweeps):
    """Each alone is refused, since it moves one joint of six."""
    with pytest.raises(Unidentifiable, match="the joints that move are 1 of 6"):
        identify(sweeps[:1], ROBOT, GROUND)
    found = identify(sweeps, ROBOT, GROUND)
    at_0_4 = found.coulomb_nm + 0.4 * found.viscous_nm_s_per_rad
    np.testing.assert_allclose(at_0_4, COULOMB_NM + 0.4 * VISCOUS, rtol=0.03)


def test_sweeps_of_too_few_joints_are_refused_with_the_joints_that_are_missing(sweeps):
    with pytest.raises(Unidentifiable, match=r"together move 2 of 6 joints, not joints 2, 3, 5, 6"):
        identify([sweeps[0], sweeps[3]], ROBOT, GROUND)


@pytest.mark.parametrize("seen", [(0, 1, 2, 3, 4, 5), (1, 4, 5)])
def test_sweeps_that_are_sound_have_no_doubt_about_their_motion(sweeps, seen):
    """Each joint moves throughout its own sweep, which is a sixth of all samples. A joint without a sweep is told."""
    found = identify([sweeps[j] for j in seen], ROBOT, GROUND)
    hardly = [warning.text[:7] for warning in found.warnings if warning.code == "joint_hardly_moves"]
    assert hardly == [f"joint {j + 1}" for j in range(6) if j not in seen]
    assert {"poor_fit", "gain_doubtful", "torque_offset", "torque_delayed"}.isdisjoint(warning.code for warning in found.warnings)


def at_rest_but_for(recording, joint):
    """The recording with the other joints perfectly at rest, as some controllers report them."""
    q, qd, others = recording.q.copy(), recording.qd.copy(), np.arange(6) != joint
    q[:, others], qd[:, others] = q[0, others], 0.0
    return replace(recording, q=q, qd=qd)


BAD_CURRENTS = {
    "zero": lambda x: 0.0 * x,
    "constant": lambda x: 0.0 * x + 3.0,
    "stuck": lambda x: np.where(np.arange(len(x)) < len(x) // 3, x, x[len(x) // 3]),
    "tiny": lambda x: 1e-9 * x,
    "another's": lambda x: -x[::-1],
    "noise": lambda x: np.random.default_rng(0).normal(size=len(x)),
    "sign": lambda x: -x,
    "saturated": lambda x: np.clip(x, -0.5 * np.max(x), 0.5 * np.max(x)),
}
TOLD = {
    "likely_cause",
    "current_stuck",
    "current_held",
    "current_saturated",
    "gain_doubtful",
    "poor_fit",
    "unphysical_friction",
    "torque_offset",
}


@pytest.mark.parametrize("bad", BAD_CURRENTS)
@pytest.mark.parametrize("others_at_rest", [True, pytest.param(False, marks=pytest.mark.soak)])
@pytest.mark.slow
def test_a_joint_whose_current_is_bad_is_told_among_sweeps(sweeps, bad, others_at_rest):
    """Columns of one recording are zero in another one; nothing about that ends in a traceback."""
    recordings = [at_rest_but_for(sweeps[j], j) if others_at_rest else sweeps[j] for j in (1, 4, 5)]
    spoilt = recordings[1].current.copy()
    spoilt[:, 4] = BAD_CURRENTS[bad](spoilt[:, 4])
    found = identify([recordings[0], replace(recordings[1], current=spoilt), recordings[2]], ROBOT, GROUND)
    assert any(warning.code in TOLD and "joint 5" in warning.text for warning in found.warnings), found.warnings


def test_a_joint_whose_current_holds_no_number_is_named(sweeps):
    """Not as 600 torn rows."""
    spoilt = sweeps[1].current.copy()
    spoilt[:, 4] = np.nan
    with pytest.raises(Unidentifiable, match="current of joint 5 holds no number in any row"):
        identify([sweeps[0], replace(sweeps[1], current=spoilt), *sweeps[2:]], ROBOT, GROUND)


def test_a_recording_in_which_nothing_moves_is_refused_among_others_too(sweeps):
    still = sweep(0)
    still.q[:], still.qd[:] = still.q[0], 0.0
    with pytest.raises(Unidentifiable, match="the arm stands still"):
        identify([*sweeps, still], ROBOT, GROUND)


LONG = """
    import resource
    import numpy as np
    from monitor.identify.identify import identify
    from monitor.model.robot import Mounting, load_robot
    from monitor.recording import Recording

    def now_mb():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    N, rng = {rows}, np.random.default_rng(0)
    t = np.arange(N) / 500.0
    w = 2.0 * np.pi * np.array([0.11, 0.13, 0.17, 0.19, 0.23, 0.29])
    q, qd = np.sin(np.outer(t, w)), w * np.cos(np.outer(t, w))
    torque = 8.0 * np.sign(qd) + 6.0 * qd + rng.normal(size=q.shape)
    recording = Recording(t_s=t, q=q, qd=qd, torque=torque, source="long.csv")
    before = now_mb()
    identify([recording], load_robot("ur10e"), Mounting())
    print(now_mb() - before)
"""


def grown_mb(rows):
    """Memory that the identification of so many rows takes beside the recording [MB], in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(LONG.format(rows=rows))], capture_output=True, text=True, check=True, timeout=300
    )
    return float(done.stdout)


@pytest.mark.soak
def test_ten_minutes_at_500_hz_take_less_than_a_gigabyte():
    assert grown_mb(300_000) < 800.0


@pytest.mark.slow
def test_a_long_recording_takes_no_table_of_all_its_rows():
    """40 000 rows of 54 columns on six joints would be 104 MB, and five of them were held at once: 520 MB."""
    assert grown_mb(40_000) < 300.0


def test_a_recording_that_does_not_fit_into_the_memory_is_bad_input(tmp_path, monkeypatch):
    """The reader asks for more than any computer has, as three million rows may on a small one."""
    monkeypatch.setattr(files, "read_recording", lambda *_: np.empty(2**58))
    request = files.Request(files=[tmp_path / "hours.csv"], robot=ROBOT, mounting=GROUND)
    with pytest.raises(BadInput, match=r"hours\.csv: too long for the memory"):
        files.identify_files(request)
