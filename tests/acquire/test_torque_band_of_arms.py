"""The torque band on real recordings, after late targets, and on every trajectory of the package."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from learnt_arms import NORMAL, SETTINGS, SHIPPED_NAMES, arm_of, first_outside, learnt_arm

from monitor.acquire.safety.torque_band import TorqueBand
from monitor.acquire.safety.torque_basis import BandBasis
from monitor.acquire.safety.way import joint_path
from monitor.acquire.settings import Installation
from monitor.acquire.ur.rtde import COLUMN, WIDTH
from monitor.judge.assess import assess
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array, Context, Recording
from monitor.simulate.controller.controller import Controller
from monitor.simulate.stepped import GAIN, LOOKAHEAD_S, stepped_replay
from monitor.store.formats.recordings import read_recording

UR10E_COLUMNS = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
UR10E = Installation(gains_nm_per_a=(14.87, 13.26, 11.13, 10.62, 11.03, 11.47))
pytestmark = pytest.mark.xdist_group("learnt arms")  # one worker learns each arm once, and does not learn those of the other module again
SHORTEST_RUN = "ur-20_02_10-30sec_12harm"
FOURIER_RUNS = {"ur-20_02_12-50sec_12harm": 0.0, "ur-20_02_10-30sec_12harm": 0.0, "ur-20_02_19_14harm50sec": 0.0}


@pytest.fixture(scope="module")
def ur10e(real_data):
    """The real Fourier runs by name, with target accelerations, which they lack, from smoothed speeds."""
    from scipy.signal import savgol_filter

    def read(name: str) -> Recording:
        seen = read_recording(real_data / "ur10e" / f"{name}.csv", UR10E_COLUMNS)
        whole = np.all(np.abs(np.hstack([seen.q, seen.qd])) < 10.0, axis=1)  # torn rows are left out
        t_s, qd = seen.t_s[whole], seen.qd[whole]
        qdd = np.gradient(savgol_filter(qd, 11, 3, axis=0), t_s, axis=0)
        return Recording(t_s=t_s, q=seen.q[whole], qd=qd, current=seen.current[whole], target_qdd=qdd)

    return {name: read(name) for name in (*FOURIER_RUNS, "ur-20_02_19_14harm50secLoad")}


@pytest.mark.parametrize(
    "name",
    [
        SHORTEST_RUN,
        "ur-20_02_19_14harm50secLoad",
        *(pytest.param(name, marks=pytest.mark.soak) for name in FOURIER_RUNS if name != SHORTEST_RUN),
    ],
)
def test_no_real_fourier_run_leaves_the_manufacturers_band(ur10e, name):
    """Three runs without load, and one with 2.6 kg whose centre of mass nobody gives."""
    payload_kg = 2.6 if name.endswith("Load") else 0.0
    settings = replace(SETTINGS, rate_hz=100.0)
    band = TorqueBand(load_robot("ur10e"), Mounting(), settings, UR10E, BandBasis(), payload_kg=payload_kg)
    assert first_outside(band, ur10e[name]) is None
    assert band.largest_share < 0.95


@pytest.mark.parametrize(
    "learnt_on", [SHORTEST_RUN, *(pytest.param(name, marks=pytest.mark.soak) for name in FOURIER_RUNS if name != SHORTEST_RUN)]
)
def test_no_real_fourier_run_leaves_the_band_that_was_learnt_on_another(ur10e, learnt_on):
    """The model of one run, also at other speeds; and a payload of 2.6 kg that this model does not know leaves its band."""
    robot, settings = load_robot("ur10e"), replace(SETTINGS, rate_hz=100.0)
    seen = replace(ur10e[learnt_on], target_qdd=None, context=Context(recorded_at_unix_s=1.75e9))
    learnt = assess(seen, robot=robot, mounting=Mounting(), belief=None, health=None, gains=np.array(UR10E.gains_nm_per_a))
    basis = BandBasis(model=learnt.model.as_document())
    for name, recording in ur10e.items():
        band = TorqueBand(robot, Mounting(), settings, UR10E, basis)
        found = first_outside(band, recording)
        assert (found is None) == (name in FOURIER_RUNS), (name, found)
        assert name not in FOURIER_RUNS or band.largest_share < 0.8


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_nothing_normal_leaves_the_band_on_any_shipped_trajectory(soak_row):
    """Every arm and mounting, every normal circumstance, each kind of basis."""
    left, largest, count = [], 0.0, 0
    for name in SHIPPED_NAMES:
        learnt = learnt_arm(name)
        for normal in NORMAL:
            recording = stepped_replay(arm_of(learnt.excitation, normal, seed=23), learnt.excitation)
            for basis in (BandBasis(), learnt.basis, learnt.with_profile):
                band = learnt.band(basis)
                found = first_outside(band, recording, learnt.excitation.pass_s)
                count, largest = count + 1, max(largest, band.largest_share)
                if found:
                    left.append((name, normal, basis.description, found))
    soak_row("torque of sound replays in the band", f"{len(left)} of {count} left it, at most {largest:.2f} of it", "0")
    assert left == []


# --- whole motions, late targets ---------------------------------------------------------------------------------------------


def streamed(
    arm: Controller, position: Callable[[float], Array], duration_s: float, *, share: float = 0.0, longest_ticks: int = 2
) -> list[tuple[Array, float]]:
    """Rows and phases of a stream of targets position(τ) that come late in this share of the cycles, by up to so many ticks of 8 ms."""
    dice, tick_s, found, tau_s = np.random.default_rng(4), 1.0 / SETTINGS.rate_hz, [], 0.0
    while tau_s < duration_s:
        arm.reference.follow([position(tau_s).tolist()], tick_s, LOOKAHEAD_S, GAIN)
        ticks = int(dice.integers(2, longest_ticks + 1)) if dice.random() < share else 1
        for _ in range(ticks * round(tick_s / arm.clock.tick_s)):
            arm.step()
        tau_s += min(ticks, 2) * tick_s
        row, measured = np.full(WIDTH, np.nan), arm.measurements.latest
        for name, value in (
            ("timestamp", arm.clock.now_s),
            ("actual_q", measured.q),
            ("actual_qd", measured.qd),
            ("actual_current", measured.current),
            ("joint_temperatures", measured.temperature_c),
            ("target_qdd", arm.reference.qdd),
        ):
            row[COLUMN[name]] = value
        found.append((row, tau_s))
    return found


def along(excitation: Excitation) -> Callable[[float], Array]:
    return lambda tau_s: excitation.at(np.array([tau_s])).q[0]


@pytest.mark.parametrize(
    ("name", "normal"),
    [
        ("ur5-ground", "cold and worn"),
        pytest.param("ur5-ground", "as learnt", marks=pytest.mark.soak),
        pytest.param("ur16e-wall", "as learnt", marks=pytest.mark.soak),
        pytest.param("ur16e-wall", "cold and worn", marks=pytest.mark.soak),
    ],
)
def test_the_ways_to_the_start_and_back_stay_within_the_band(name, normal):
    """A filter that knows nothing of today's friction yet, from a standing arm, with rests between the phases and at the end."""
    learnt = learnt_arm(name)
    excitation = learnt.excitation
    arm = arm_of(excitation, normal, seed=9)
    home, start = arm.reference.q.copy(), excitation.at(np.zeros(1)).q[0]
    there, back = (joint_path(*ends, speed_rad_s=0.5, acceleration_rad_s2=1.5) for ends in ((home, start), (start, home)))
    rows: list[tuple[Array, float | None]] = []
    for position, duration_s, played in (
        (there.at, there.duration_s, False),
        (lambda _: start, 0.5, False),
        (along(excitation), excitation.duration_s, True),
        (back.at, back.duration_s, False),
        (lambda _: home, 0.5, False),
    ):
        rows += [(row, phase_s if played else None) for row, phase_s in streamed(arm, position, duration_s)]
    for basis in (BandBasis(), learnt.with_profile):
        band = learnt.band(basis)
        assert [band.outside(*row) for row in rows] == [None] * len(rows), basis.description
        assert 0.0 < band.largest_share < 0.95


@pytest.mark.parametrize(
    ("share", "longest_ticks"), [(0.05, 6), *(pytest.param(*late, marks=pytest.mark.soak) for late in ((0.3, 3), (0.02, 11)))]
)
def test_late_targets_jolt_the_arm_and_do_not_leave_the_band(share, longest_ticks):
    """Up to 88 ms late; the stream itself ends at 0.1 s. A busy machine must not look like a collision."""
    learnt = learnt_arm("ur5-ground")
    arm, excitation = arm_of(learnt.excitation, seed=5, home_rad=tuple(learnt.excitation.at(np.zeros(1)).q[0])), learnt.excitation
    rows = streamed(arm, along(excitation), excitation.duration_s, share=share, longest_ticks=longest_ticks)
    for basis in (BandBasis(), learnt.basis, learnt.with_profile):
        band = learnt.band(basis)
        assert all(band.outside(row, phase_s) is None for row, phase_s in rows), basis.description
        assert band.largest_share < 0.9
