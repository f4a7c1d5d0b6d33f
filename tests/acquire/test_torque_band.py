"""The torque band of a first pass, without a robot: what leaves the band, after which time, and how the band is computed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitations import short
from synthetic_arm import Arm as LearntArm
from synthetic_arm import History

from monitor.acquire.rows import COLUMN, WIDTH
from monitor.acquire.safety.first_pass import band_for, first_pass_key, slowed
from monitor.acquire.settings import ReplaySettings
from monitor.assess import assess
from monitor.config.files import find_excitation
from monitor.design.cell import plain_cell
from monitor.judge.torque.predictor import predict_torque
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context, Recording
from monitor.simulate.arm.physics import Arm
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

UR5 = load_robot("ur5")
SETTINGS = ReplaySettings(host="127.0.0.1")
CONTEXT = Context(robot="ur5", payload_kg=0.0, mounting_rad=(0.0, 0.0, 0.0), tool="none")


def rows(arm: Arm, q, qd, qdd):
    """Rows (N, WIDTH) that the controller of a simulated arm would report along a motion, by the simulator's physics and friction."""
    rigid, load = arm.rigid_torque(q, qd, qdd)
    torque = rigid + arm.friction_torque(qd, load)
    table = np.full((len(q), WIDTH), np.nan)
    for name, value in (
        ("actual_q", q),
        ("actual_qd", qd),
        ("target_qdd", qdd),
        ("actual_current", torque / arm.gain_nm_per_a),
        ("target_current", rigid / arm.gain_nm_per_a),
        ("target_moment", rigid),
    ):
        table[:, COLUMN[name]] = value
    table[:, COLUMN["joint_temperatures"]] = 25.0
    return table


def reported(r: Recording) -> np.ndarray:
    """Rows (N, WIDTH) of a recording."""
    table = np.full((r.samples, WIDTH), np.nan)
    signals = ("actual_q", r.q), ("actual_qd", r.qd), ("target_qdd", r.target_qdd), ("actual_current", r.current)
    for name, value in (*signals, ("joint_temperatures", r.temperature_c)):
        table[:, COLUMN[name]] = value
    return table


def first_outside(band, rows):
    return next((outside for row in rows if (outside := band.outside(row))), None)


@pytest.mark.parametrize("mounting", ["ground", "wall"])
@pytest.mark.parametrize("robot", ["ur3", "ur5", "ur10"])
def test_a_healthy_arm_stays_in_the_band_of_the_manufacturers_parameters(robot, mounting):
    """The torque includes friction, which the manufacturer does not publish; the speed is a quarter."""
    arm_model, hung = load_robot(robot), Mounting.parse(mounting)
    excitation = replace(slowed(short(robot=robot, period_s=6.0), SETTINGS), mounting=hung)
    band = band_for(arm_model, excitation, SETTINGS, CONTEXT, gains=None, model=None)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    arm = Arm(arm_model, q=q[0], mounting=hung)
    assert first_outside(band, rows(arm, q, qd, qdd)) is None
    assert 0.1 < band.largest_share < 0.9  # friction is seen, and there is room


@pytest.mark.parametrize(
    ("arm", "word"),
    [
        (Arm(UR5, q=np.zeros(6), payload_kg=8.0), "joint"),  # more than the 5 kg that it may carry
        (Arm(UR5, q=np.zeros(6), mounting=Mounting.parse("0,90,0")), "joint 2"),
    ],
)
def test_an_undeclared_load_or_mounting_leaves_the_band(arm, word):
    """The text names the joint, the measured torque and the expected torque."""
    excitation = slowed(short(period_s=6.0), SETTINGS)
    band = band_for(UR5, excitation, SETTINGS, CONTEXT, gains=None, model=None)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    outside = first_outside(band, rows(arm, q, qd, qdd))
    assert outside is not None
    cause, text = outside
    assert cause == "torque_band"
    assert word in text
    assert "N·m" in text


def test_a_spike_is_no_collision_and_an_obstacle_is():
    """Four rows outside have no effect, five in succession have."""
    excitation = slowed(short(), SETTINGS)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    table = rows(Arm(UR5, q=q[0]), q, qd, qdd)[:40]
    blocked = table.copy()
    blocked[10:, COLUMN["actual_current"].start + 1] += 100.0 / 12.5  # N·m over about A: far outside joint 2's 37 N·m
    band = band_for(UR5, excitation, SETTINGS, CONTEXT, gains=None, model=None)
    assert [bool(band.outside(row)) for row in blocked].index(True) == 14
    spiky = table.copy()
    for begin in (5, 15, 25):
        spiky[begin : begin + 4] = blocked[begin + 10 : begin + 14] if begin < 10 else blocked[begin : begin + 4]
    assert first_outside(band_for(UR5, excitation, SETTINGS, CONTEXT, gains=None, model=None), spiky) is None


def test_a_gain_that_is_not_published_is_taken_from_the_controllers_own_model():
    """The gain is target moment over target current; where both are missing, the joint is not watched."""
    excitation = slowed(short(), SETTINGS)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    table = rows(Arm(UR5, q=q[0]), q, qd, qdd)[:60]
    table[30:, COLUMN["actual_current"].start + 1] += 8.0
    unknown = np.full(6, np.nan)
    outside = first_outside(band_for(UR5, excitation, SETTINGS, CONTEXT, gains=unknown, model=None), table)
    assert outside is not None
    assert "joint 2" in outside[1]
    table[:, COLUMN["target_current"]] = 0.0
    assert first_outside(band_for(UR5, excitation, SETTINGS, CONTEXT, gains=unknown, model=None), table) is None


def test_a_first_pass_is_the_same_way_slower_and_once():
    """The proof of clearance stays valid, because it depends on the path alone."""
    excitation = replace(short(), repetitions=3)
    slow = slowed(excitation, SETTINGS)
    assert slow.path_digest == excitation.path_digest
    assert slow.duration_s == pytest.approx(excitation.period_s / 0.25)


@pytest.mark.parametrize(
    "changes",
    [
        {"excitation": short(period_s=4.0)},
        {"context": replace(CONTEXT, payload_kg=1.0)},
        {"context": replace(CONTEXT, tool="gripper")},
        {"context": replace(CONTEXT, mounting_rad=(0.1, 0.0, 0.0))},
        {"context": replace(CONTEXT, serial="2")},
        {"settings": replace(SETTINGS, cell=plain_cell(Mounting()))},
    ],
)
def test_every_change_asks_for_a_new_first_pass(changes):
    """Repetitions and a note do not ask for a first pass."""
    known = {"excitation": short(), "settings": SETTINGS, "context": CONTEXT}
    assert first_pass_key(**known) != first_pass_key(**{**known, **changes})
    same = {**known, "excitation": replace(short(), repetitions=2), "context": replace(CONTEXT, note="x", firmware="5.12")}
    assert first_pass_key(**known) == first_pass_key(**same)


@pytest.fixture(scope="module")
def learnt():
    """A model of 12 replays between 20 and 40 °C, wrong by 0.5 N·m; the measurement's noise is 1.2 N·m (big joints), 0.3 N·m (wrists)."""
    history, rng, arm = History(), np.random.default_rng(1), LearntArm(seed=1, noise=0.01)
    for day in range(12):
        history.add(day, arm.replay(rng.uniform(20, 40)))
    size = np.array([1.0, 1.0, 1.0, 0.25, 0.25, 0.25])
    return replace(history.last.model, error_rms_nm=0.5 * size, measured_rms_nm=1.3 * size)


def moving(model, *, seed: int = 0, push_nm=0.0) -> np.ndarray:
    """Rows (N, WIDTH) of 2 s at up to 0.3 rad/s through a reversal, with the model's own torque, its noise, and an external torque (J,)."""
    t = np.arange(250) / 125.0
    qd = np.tile(0.3 * np.cos(np.pi * t)[:, None], (1, 6))
    q, qdd = np.array([0.1, -1.5, 0.5, 0.2, 0.1, 0.0]) + 0.1 * np.sin(np.pi * t)[:, None], -0.3 * np.pi * np.sin(np.pi * t)[:, None]
    qdd, T = np.broadcast_to(qdd, q.shape), np.full_like(q, 24.0)
    noise = np.sqrt(model.measured_rms_nm**2 - model.error_rms_nm**2) * np.random.default_rng(seed).normal(size=q.shape)
    torque = predict_torque(model, UR5, q, qd, qdd, T).torque + noise + push_nm
    return reported(Recording(t_s=t, q=q, qd=qd, target_qdd=qdd, current=torque / UR5.drive_gain_nm_per_a, temperature_c=T))


def band_of(model):
    return band_for(UR5, short(), SETTINGS, CONTEXT, gains=None, model=model)


def test_a_joint_that_stands_may_be_held_either_way_by_its_friction(learnt):
    """At rest the sign of friction depends on the past: 1.2 times sliding friction is no contact then, and is one in motion against it."""
    for way in (1.0, -1.0):
        table = moving(learnt)[:40].copy()
        still, T = np.zeros(6), np.full(6, 24.0)
        q = table[0, COLUMN["actual_q"]]
        drags = predict_torque(learnt, UR5, q, np.full(6, 0.02), still, T).friction[0]
        rigid = predict_torque(learnt, UR5, q, still, still, T).rigid[0]
        for name, value in (("actual_q", q), ("actual_qd", still), ("target_qdd", still)):
            table[:, COLUMN[name]] = value
        table[:, COLUMN["actual_current"]] = (rigid + way * 1.2 * drags) / UR5.drive_gain_nm_per_a
        assert first_outside(band_of(learnt), table) is None
        table[:, COLUMN["actual_qd"]] = -0.3 * way
        assert first_outside(band_of(learnt), table) is not None


@pytest.mark.parametrize("seed", range(5))
def test_a_healthy_arm_stays_in_the_band_of_its_model_and_a_pushed_one_does_not(learnt, seed):
    """Noise stays within six standard deviations; a tenth of a joint's largest torque is outside for five rows of the motion."""
    band = band_of(learnt)
    assert first_outside(band, moving(learnt, seed=seed)) is None
    assert band.largest_share < 1.0
    for j in range(6):
        outside = first_outside(band_of(learnt), moving(learnt, seed=seed, push_nm=0.1 * UR5.max_torque_nm * (np.arange(6) == j)))
        assert outside is not None
        assert f"joint {j + 1}" in outside[1]


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_no_healthy_replay_leaves_the_band_of_the_model_before_it(soak_row):
    """50 replays of the simulated arm at full speed, in a room of 4 to 34 °C, cold and warm: each predicted with the model before it."""
    arm, rng = Controller(SimulateSettings(seed=5)), np.random.default_rng(5)
    excitation = replace(find_excitation("ur5-ground", Path()), repetitions=1)
    last, shares = None, []
    for day in range(51):
        room = rng.uniform(4.0, 34.0)
        arm.pass_time(20.0, room, 0.0)
        arm.pass_time(rng.uniform(0.0, 1.0), room, rng.uniform(0.0, 1.0))
        seen = stepped_replay(arm, excitation)
        seen = replace(seen, context=replace(seen.context, recorded_at_unix_s=1.75e9 + day * 86_400.0))
        if last is not None:
            band = band_of(last.model)
            assert first_outside(band, reported(seen)) is None, (day, seen.mean_temperature_c)
            shares.append(band.largest_share)
        known = {} if last is None else {"model": last.model}
        belief, health = (None, None) if last is None else (last.belief, last.health)
        last = assess(seen, robot=UR5, mounting=Mounting(), belief=belief, health=health, **known)
    soak_row("torque of sound replays in the model's band", f"0 of {len(shares)} left it, at most {max(shares):.2f} of it", "0")
