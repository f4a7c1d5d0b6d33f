"""The torque band without a robot: what is normal stays within it, what comes suddenly leaves it. Rows of stepped simulated replays."""

import base64
import pickle
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from excitations import short
from learnt_arms import NORMAL, SETTINGS, Learnt, arm_of, first_outside, learnt_arm, shipped
from simulated_arm import known_gains

from monitor.acquire.child import PIPE_BYTES
from monitor.acquire.replay import first_pass_key, slowed
from monitor.acquire.safety.torque_band import TorqueBand, band_for, learn_profile, phases, recorded_rows
from monitor.acquire.safety.torque_basis import BandBasis, TorqueProfile
from monitor.acquire.settings import Installation
from monitor.acquire.ur.rtde import COLUMN, WIDTH
from monitor.design.cell import plain_cell
from monitor.errors import MotionRefused
from monitor.model.robot import Mounting, load_robot
from monitor.reason import joint_text
from monitor.recording import Context, Recording
from monitor.simulate.arm.physics import Arm
from monitor.simulate.controller.controller import Controller
from monitor.simulate.stepped import play, stepped_replay

UR5 = load_robot("ur5")
CONTEXT = Context(robot="ur5", payload_kg=0.0, mounting_rad=(0.0, 0.0, 0.0), tool="none")
SEEN_ROWS = 200  # of a replay after the row at which an obstacle comes
WITHIN_HARDEST = ("worn, friction doubled", "worn, dry friction doubled", "cold, 15 K below")  # each is a part of the first
OTHERS = [pytest.param(name, marks=pytest.mark.soak) for name in NORMAL if name not in ("cold and worn", *WITHIN_HARDEST)]
SIZES = ("ur20-ground", *(pytest.param(name, marks=pytest.mark.soak) for name in ("ur3-wall", "ur5-ground", "ur3e-wall", "ur10-ceiling")))
pytestmark = pytest.mark.xdist_group("learnt arms")  # one worker learns each arm once


@pytest.fixture(scope="module")
def ur5() -> Learnt:
    return learnt_arm("ur5-ground")


# --- what is normal -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", ["cold and worn", *OTHERS])
def test_what_is_normal_never_leaves_the_band(ur5, normal):
    """By the manufacturer's parameters, by the model, and with the profile of earlier replays: an aged or cold arm is recorded.

    Every arm in every circumstance is in the soak tests.
    """
    recording = free_replay(normal)
    for basis in (BandBasis(), ur5.basis, ur5.with_profile):
        band = ur5.band(basis)
        assert first_outside(band, recording, ur5.excitation.pass_s) is None, basis.description
        assert band.largest_share < 0.95, basis.description  # there is room


@pytest.mark.parametrize("name", SIZES)
def test_a_first_pass_and_a_replay_of_an_arm_that_nobody_knows_stay_within_the_manufacturers_band(name):
    """A large one, new and worn, at a quarter of the pace and at full pace; small ones and the other generation are in the soak tests."""
    excitation = shipped(name)
    robot = load_robot(excitation.robot)
    for played, normal in ((slowed(excitation, SETTINGS), "as learnt"), (excitation, "cold and worn")):
        band = TorqueBand(robot, excitation.mounting, SETTINGS, known_gains(robot.name), BandBasis())
        recording = stepped_replay(arm_of(excitation, normal), played)
        assert first_outside(band, recording) is None
        assert band.largest_share < 0.98


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.05), (0.06, -0.05, 0.12)])
def test_a_declared_payload_stays_within_the_band_wherever_its_centre_is(centre):
    """Its centre is reported or unknown; the allowance for an unknown one is that of 0.15 m."""
    excitation = shipped("ur5-ground")
    recording = stepped_replay(arm_of(excitation, payload_kg=3.0, payload_com_m=centre), excitation)
    for known in (centre, None):
        band = TorqueBand(UR5, Mounting(), SETTINGS, Installation(), BandBasis(), payload_kg=3.0, payload_com_m=known)
        assert first_outside(band, recording) is None, known


@pytest.mark.parametrize("spike_rows", [1, 4])
def test_a_spike_is_no_collision(ur5, spike_rows):
    """Four rows far outside have no effect, in any joint and at any time; five have."""
    recording = ur5.recordings[1]
    current = recording.current.copy()
    for i, begin in enumerate(range(100, 1100, 100)):
        current[begin : begin + spike_rows, i % 6] += 100.0
    assert first_outside(ur5.band(), replace(recording, current=current), ur5.excitation.pass_s) is None
    current[1100:1105, 2] += 100.0
    assert (
        first_outside(ur5.band(), replace(recording, current=current), ur5.excitation.pass_s)[0] == 1106
    )  # the band looks at the row before the last two


# --- what is not ----------------------------------------------------------------------------------------------


def pressed(learnt: Learnt, at_row: int, normal: str, **obstacle) -> tuple[Recording, int]:
    """The rows of a replay until an obstacle has come, at about this row and by the simulator's own physics; and the row when it came."""
    arm = arm_of(learnt.excitation, normal, seed=11)
    playing = play(arm, learnt.excitation, until_row=at_row + SEEN_ROWS)
    begun, came = None, None
    while True:
        try:
            next(playing)
        except StopIteration as done:
            return done.value, came
        if arm.reference.q is not None and begun is None and _begun(arm, learnt):
            begun = arm.clock.now_s
        if begun is not None and came is None and arm.clock.now_s - begun >= at_row / 125.0:
            arm.inject("obstacle", {"seconds": 0.4, **obstacle})
            came = round((arm.clock.now_s - begun) * 125.0)


@lru_cache
def free_replay(normal: str) -> Recording:
    """A replay of the UR5, and what those of `pressed` are without an obstacle."""
    excitation = shipped("ur5-ground")
    return stepped_replay(arm_of(excitation, normal, seed=11), excitation)


def _begun(arm: Controller, learnt: Learnt) -> bool:
    """Whether the play has begun: the arm moves faster than on its way to the start."""
    return float(np.max(np.abs(arm.arm.qd))) > 0.6


@pytest.mark.parametrize("normal", [pytest.param("as learnt", marks=pytest.mark.soak), "cold and worn"])
def test_a_collision_in_an_ordinary_replay_is_found_within_a_tenth_of_a_second(ur5, normal):
    """A fifth of a joint's largest torque against its motion, at any joint, by the simulator's physics: also in a worn, cold arm."""
    free = free_replay(normal)
    for joint in range(1, 7):
        torque = 0.2 * float(UR5.max_torque_nm[joint - 1])
        recording, _ = pressed(ur5, 300 + 60 * joint, normal, joint=joint, torque=torque)
        found = first_outside(ur5.band(), recording, ur5.excitation.pass_s)
        began = int(
            np.flatnonzero(np.any(np.abs(free.current[: recording.samples] - recording.current) > 1e-9, axis=1))[0]
        )  # the first row that differs
        assert found is not None, joint
        assert found[1].startswith(f"{joint_text(joint)} needs")
        assert (found[0] - began) / 125.0 <= 0.1


def test_a_wall_is_found_before_it_takes_the_joints_largest_torque(ur5):
    """An elastic wall before joint 2, 300 N·m/rad: the torque rises as the joint goes on, and the band ends it below half of 150 N·m."""
    recording, _ = pressed(ur5, 420, "as learnt", joint=2, stiffness=300.0, seconds=0.2)
    free = free_replay("as learnt")
    i, text = first_outside(ur5.band(), recording, ur5.excitation.pass_s)
    assert "joint 2" in text
    pushed = np.abs(recording.current[i] - free.current[i])[1] * UR5.drive_gain_nm_per_a[1]
    assert pushed < 75.0


@pytest.mark.parametrize(
    ("arm", "word"),
    [
        ({"payload_kg": 8.0}, "joint"),  # more than the 5 kg that it may carry
        ({"mounting": Mounting.parse("0,90,0")}, "joint 2"),
    ],
)
def test_an_undeclared_load_or_mounting_leaves_the_band_of_a_first_pass(arm, word):
    """The text names the joint, the measured torque and the expected torque."""
    excitation = slowed(short(period_s=6.0), SETTINGS)
    _, (q, qd, qdd) = excitation.sampled(125.0)
    simulated = Arm(UR5, q=q[0], **arm)
    rigid, load = simulated.rigid_torque(q, qd, qdd)
    torque = rigid + simulated.friction_torque(qd, load)
    seen = Recording(t_s=np.arange(len(q)) / 125.0, q=q, qd=qd, target_qdd=qdd, current=torque / simulated.gain_nm_per_a)
    found = first_outside(TorqueBand(UR5, Mounting(), SETTINGS, Installation(), BandBasis()), seen)
    assert found is not None
    assert word in found[1]
    assert "N·m where" in found[1]


@pytest.mark.parametrize("variable", ["actual_current", "actual_q", "actual_qd"])
@pytest.mark.parametrize("learnt", [False, True])
def test_what_is_no_number_is_not_within_the_band(ur5, variable, learnt):
    """Without measured torque the band would be no protection; one such row has no effect on what follows."""
    table = recorded_rows(ur5.recordings[1])
    band = ur5.band(ur5.with_profile if learnt else BandBasis())
    table[50, COLUMN[variable]] = np.nan
    assert [band.outside(row) for row in table[:100]] == [None] * 100
    table[100:, COLUMN[variable]] = np.nan
    ends = [band.outside(row) is not None for row in table[100:110]].index(True)
    assert 4 <= ends <= 6


def test_the_controllers_own_ratio_of_moment_and_current_gives_no_gain():
    """Target current contains friction and target moment does not: their ratio made the band blind. Without gains there is no band."""
    with pytest.raises(MotionRefused, match="drive_gains"):
        TorqueBand(load_robot("ur5e"), Mounting(), SETTINGS, Installation(), BandBasis())


# --- what was learnt ------------------------------------------------------------------------------------------


def test_what_was_learnt_fits_the_pipe_to_the_process_that_moves_the_arm(ur5):
    """It is written before that process reads: an arm must not wait for it, and its watcher neither."""
    assert len(base64.b64encode(pickle.dumps(ur5.with_profile))) < PIPE_BYTES / 4


def test_the_profile_makes_the_band_narrower_at_every_place_and_wider_where_replays_needed_it(ur5):
    """A place where every earlier replay was rough for 0.1 s is allowed to be rough; the same elsewhere is outside."""
    rough = []
    for seen in ur5.recordings:
        current = seen.current.copy()
        current[600:613, 3] += np.array([1.0, -1.0])[seen.samples % 2] * 2.2 / UR5.drive_gain_nm_per_a[3]  # 0.08 of 28 N·m
        rough.append(replace(seen, current=current))
    profile = learn_profile(rough, UR5, ur5.excitation, SETTINGS, Installation(), ur5.basis)
    phase_s = 606 / 125.0
    assert profile.replays == 2
    assert abs(profile.at(phase_s)[0][3]) > 1.2
    learnt = ur5.band(replace(ur5.basis, profile=profile))
    assert first_outside(learnt, rough[0], ur5.excitation.pass_s) is None
    row = recorded_rows(ur5.recordings[0])[300]
    assert np.all(ur5.band().read(row, 300 / 125.0).narrow < ur5.band(ur5.basis).read(row).narrow)


def test_a_phase_is_counted_as_the_stream_counts_it():
    """A late cycle advances by two ticks at most; a repetition begins anew."""
    t_s = np.array([5.0, 5.008, 5.016, 5.056, 5.064])
    assert phases(t_s, 125.0, 10.0) == pytest.approx([0.0, 0.008, 0.016, 0.032, 0.04])
    assert phases(t_s, 125.0, 0.03) == pytest.approx([0.0, 0.008, 0.016, 0.002, 0.01])


def test_no_profile_comes_from_half_a_trajectory_or_from_none(ur5):
    """A replay must have covered nine tenths of it."""
    seen = ur5.recordings[0]
    half = replace(seen, **{name: values[:600] for name, values in seen.signals.items()})
    assert learn_profile([half], UR5, ur5.excitation, SETTINGS, Installation(), ur5.basis) is None
    assert learn_profile([], UR5, ur5.excitation, SETTINGS, Installation(), ur5.basis) is None


def test_a_profile_is_read_between_its_steps_and_beyond_its_end():
    """Linear between the middles of its steps of 0.04 s, and periodic."""
    ramp = np.arange(10.0)[:, None] * np.ones(6)
    profile = TorqueProfile(replays=1, pass_s=0.4, mean_nm=ramp, spread_nm=ramp)
    assert profile.at(0.06)[0] == pytest.approx(np.full(6, 1.0))
    assert profile.at(0.08)[0] == pytest.approx(np.full(6, 1.5))
    assert profile.at(0.46)[0] == pytest.approx(np.full(6, 1.0))
    assert profile.at(0.0)[0] == pytest.approx(np.full(6, 4.5))


def test_a_model_of_another_payload_is_not_used(ur5):
    """Where the payload is not configured, what the controller reports decides; its centre of mass is the reported one."""
    row = np.full(WIDTH, np.nan)
    row[COLUMN["payload"]], row[COLUMN["payload_cog"]] = 1.0, (0.0, 0.0, 0.1)
    known = {
        "robot": UR5,
        "excitation": ur5.excitation,
        "settings": SETTINGS,
        "installation": Installation(),
        "basis": replace(ur5.with_profile, payload_kg=1.0),
    }
    unconfigured = replace(CONTEXT, payload_kg=None)
    assert "the model of 2" in band_for(row, context=unconfigured, **known).description
    configured = known | {"installation": Installation(payload_cog_m=(0.1, 0.0, 0.1)), "basis": BandBasis()}
    at_rest = np.zeros(WIDTH)
    at_rest[COLUMN["payload"]], at_rest[COLUMN["payload_cog"]] = 1.0, (0.0, 0.0, 0.1)
    expected = [
        band_for(at_rest, context=unconfigured, **each).read(at_rest).expected for each in (known | {"basis": BandBasis()}, configured)
    ]
    assert abs(expected[0][1] - expected[1][1]) > 0.5  # 0.1 m · 1 kg · 9.81 m/s² about joint 2
    row[COLUMN["payload"]] = 2.0
    assert band_for(row, context=unconfigured, **known).description == "the manufacturer's parameters"


# --- first passes ---------------------------------------------------------------------------------------------


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
