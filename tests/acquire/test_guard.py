"""Which motions the conditions refuse, and with which words."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from excitations import short
from hypothesis import given
from hypothesis import strategies as st

from monitor.acquire.safety import conditions as guard
from monitor.acquire.safety.conditions import CONDITIONS, conditions
from monitor.acquire.safety.inputs import ConditionInputs, LastMotion, Permit
from monitor.acquire.safety.of_state import tilt_deg
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.acquire.state import ArmState, Identity, JointLimits, Services
from monitor.acquire.ur.driver import understood
from monitor.design.cell import plain_cell
from monitor.errors import BadInput, MotionRefused
from monitor.model.robot import Mounting, load_robot
from monitor.reason import reason_from, reason_of
from monitor.recording import Context

NOON = 1_767_614_400.0  # 2026-01-05 12:00 UTC
SIMULATED = ReplaySettings(host="127.0.0.1", allow_motion=True)


def test_a_valid_excitation_may_be_played_on_a_simulated_arm():
    """Without this, a guard that refuses everything would pass the tests below."""
    may_be_played(SIMULATED, short(), load_robot("ur5"))


def test_motion_is_off_by_default():
    """By default allow_motion is false, and every motion is refused."""
    with pytest.raises(MotionRefused, match="allow_motion is false"):
        may_be_played(ReplaySettings(host="127.0.0.1"), short(), load_robot("ur5"))


@pytest.mark.parametrize("truthy", ["yes", 1, "false"])
def test_only_true_itself_allows_motion(truthy):
    """A text or number that counts as true in Python, such as "false", does not move an arm."""
    with pytest.raises(MotionRefused, match="allow_motion"):
        guard.check_quick(inputs(settings=ReplaySettings(host="127.0.0.1", allow_motion=truthy)))


@pytest.mark.parametrize("host", ["localhost", "ur5.local", "0.0.0.0", "8.8.8.8", "127.0.0.1.example.org", "::1", "127.1", "", "224.0.0.1"])
def test_motion_is_allowed_only_at_a_literal_address_of_the_local_network(host):
    """A name may come to mean another machine, so even localhost is refused; public addresses are refused too."""
    with pytest.raises(MotionRefused, match=r"address: .*address"):
        guard.check_quick(inputs(settings=replace(SIMULATED, host=host, cell=plain_cell(Mounting()))))


def test_a_real_arm_moves_only_with_every_guard_on():
    """An address of another machine needs a described cell and slow first passes."""
    real = replace(SIMULATED, host="192.168.0.10", cell=plain_cell(Mounting()))
    guard.check_quick(inputs(settings=real))
    for changes, word in (({"first_pass": False}, "first_pass"), ({"cell": None}, "unchecked"), ({"allow_motion": False}, "allow_motion")):
        with pytest.raises(MotionRefused, match=word):
            guard.check_quick(inputs(settings=replace(real, **changes)))


@pytest.mark.parametrize(("robot", "rate_hz", "refused"), [("ur5", 500.0, True), ("ur5", 125.0, False), ("ur5e", 500.0, False)])
def test_a_rate_beyond_what_the_generation_sends_is_refused(robot, rate_hz, refused):
    """A CB3 sends 125 rows a second whatever it is asked for: the motion took twice its time."""
    settings = replace(SIMULATED, rate_hz=rate_hz)
    gains = Installation(gains_nm_per_a=(10.0,) * 6)
    known = ConditionInputs(settings=settings, excitation=short(robot=robot), robot=load_robot(robot), installation=gains)
    if refused:
        with pytest.raises(MotionRefused, match="expected at most 125"):
            guard.check_quick(known)
    else:
        guard.check_quick(known)


def test_an_excitation_of_another_robot_is_refused_by_name():
    """The message has both names."""
    with pytest.raises(MotionRefused, match=r"'ur3'.*'ur5'"):
        may_be_played(SIMULATED, short(robot="ur3"), load_robot("ur5"))


@pytest.mark.parametrize(
    ("excitation", "words"),
    [
        (short(amplitude_rad=7.0, joint=3, period_s=60.0), r"joint 4\): position 7 rad, at most 6\.283"),
        (short(amplitude_rad=1.5, joint=1, period_s=4.0), r"joint 2\): speed 3\.\d+ rad/s, at most 3\.142"),
        (short(period_s=0.7), r"joint 1\): acceleration \d+\.\d+ rad/s², at most 17\.28"),
        (short(start_speed_rad_s=0.2, joint=4), r"joint 5\): speed at the start 0\.2\d* rad/s"),
        (short(start_acceleration_rad_s2=0.5, joint=2), r"joint 3\): acceleration at the start 0\.5\d* rad/s²"),
    ],
)
def test_a_curve_beyond_a_limit_is_refused_with_joint_value_and_limit(excitation, words):
    """The limits are position, speed, acceleration, and rest at the ends."""
    with pytest.raises(MotionRefused, match=words):
        may_be_played(SIMULATED, excitation, load_robot("ur5"))


def test_settings_that_would_weaken_the_watchdog_are_refused():
    """With a watchdog slower than 10 Hz an arm would move on for too long after its client was killed."""
    with pytest.raises(BadInput, match=r"watchdog_hz = 2.*10 to 60"):
        ReplaySettings(host="127.0.0.1", watchdog_hz=2.0)


@cache
def kinematics_of_ur5():
    """Pinocchio's own model and its memory."""
    model = load_robot("ur5").pinocchio_model()
    return model, model.createData()


def flange_of(q):
    """Where the flange stands in the base's frame."""
    model, data = kinematics_of_ur5()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId("dh_6")]


def upright(q, mounting=None):
    """Reading (3,) of a flange's accelerometer at rest, computed with pinocchio's kinematics, not with ours."""
    return tuple(-flange_of(q).rotation.T @ (mounting or Mounting()).gravity_in_base)


def tcp_of(q, offset_m=(0.0, 0.0, 0.1)):
    """The TCP pose (6,) that a controller reports for a tool without rotation, computed with pinocchio's kinematics."""
    flange = flange_of(q)
    return (*(flange.translation + flange.rotation @ np.array(offset_m)), *pin.log3(flange.rotation))


def ready_state(**changes) -> ArmState:
    """The state of an arm that is in order and at rest at the start of `short()`."""
    start = short().at(np.zeros(1)).q[0]
    state = ArmState(
        robot_mode=7,
        safety_mode=1,
        safety_bits=1,
        runtime_state=1,
        q=start,
        qd=np.zeros(6),
        target_q=start,
        target_qd=np.zeros(6),
        temperature_c=np.full(6, 25.0),
        speed_scaling=0.0,  # as a real arm reports while no program plays
        speed_fraction=1.0,
        payload_kg=1.0,
        payload_cog_m=(0.0, 0.0, 0.05),
        tcp_pose=tcp_of(start),
        accelerometer_m_s2=upright(start),
        digital_inputs=0.0,
        status_bits=1.0,
        joint_modes=(253.0,) * 6,
        controller_s=10.1,  # soon after the rows of a scripted session
        host_s=20.1,
    )
    return replace(state, **changes)


def told(*known) -> Identity:
    """Who the controller says it is, as its driver understands it."""
    return understood(Identity(*known))


def may_be_played(settings, excitation, robot) -> None:
    """Raises MotionRefused unless this trajectory may be played on this robot at all."""
    names = ("motion_allowed", "address", "trajectory", "trajectory_clear")
    guard.refuse_unless(guard.named_conditions(ConditionInputs(settings=settings, excitation=excitation, robot=robot), names))


def inputs(state: ArmState | None = None, **changes) -> ConditionInputs:
    """What is known of that arm, which stands upright on the ground and carries 1 kg."""
    known = ConditionInputs(
        settings=SIMULATED,
        excitation=short(),
        robot=load_robot("ur5"),
        context=Context(robot="ur5", payload_kg=1.0, mounting_rad=(0.0, 0.0, 0.0)),
        now_unix_s=NOON,
        identity=told("UR5", "2016331234", "3.15.8.106339", True, JointLimits((-6.3,) * 6, (6.3,) * 6, (3.4,) * 6)),
        services=Services(("Primary Client Interface (30001)",)),
        state=state,
        installation=Installation(
            payload_cog_m=(0.0, 0.0, 0.05),
            tcp_offset=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0),
            tcp_speed_limit_m_s=4.0,
            safety_planes=((0.0, 0.0, -1.0, 1.0),),  # not deeper than 1 m below the base
        ),
    )
    return replace(known, **changes)


def displaced(joint, by):
    """The start (6,) of `short()`, with one joint elsewhere."""
    q = short().at(np.zeros(1)).q[0].copy()
    q[joint] += by
    return q


def test_an_arm_in_order_and_at_rest_may_begin():
    """As above: not every state is refused."""
    guard.check_state(inputs(ready_state()))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"safety_mode": 3, "safety_bits": 0x404}, "protective stop"),
        ({"safety_mode": 2, "safety_bits": 0b10}, "reduced"),
        ({"safety_bits": 0b101}, "bits 0x5"),
        ({"robot_mode": 5}, r"5 \(idle\)"),
        ({"runtime_state": 2}, "a program is playing"),
        ({"runtime_state": 4}, "a program is paused"),
        ({"qd": np.array([0, 0, 0.1, 0, 0, 0])}, r"joint 3\) at 0.100 rad/s"),
        ({"q": displaced(1, np.nan)}, "not finite"),
        ({"q": displaced(1, 0.2)}, r"joint 2\) is 0.200 rad from the controller's own target"),
        (
            {"q": displaced(5, 2.6), "target_q": displaced(5, 2.6), "accelerometer_m_s2": (np.nan,) * 3, "tcp_pose": ()},
            r"joint 6\) is 2.60 rad from the start",
        ),
        ({"temperature_c": np.array([25, 25, 25, 90, 25, 25.0])}, r"joint 4\) is at 90.0 °C"),
        ({"speed_fraction": 0.5}, "speed_scaling: the speed slider is at 50 %"),
        ({"speed_fraction": 0.5, "speed_scaling": 1.0}, "speed_scaling: the speed slider is at 50 %"),
        ({"status_bits": 0b101}, "teach_button: somebody holds the freedrive button"),
        ({"status_bits": np.inf}, "teach_button"),
        ({"joint_modes": (253.0, 253.0, 255.0, 253.0, 253.0, 253.0)}, r"joints_running: Elbow \(joint 3\) is in mode 255 \(idle\)"),
        ({"joint_modes": (253.0,) * 5 + (np.nan,)}, r"joints_running: Wrist 3 \(joint 6\)"),
        ({"payload_kg": 0.9}, r"payload: the controller reckons with 0\.900 kg, the configuration says 1\.000 kg"),
        ({"accelerometer_m_s2": (0.0, 0.0, 5.0)}, r"gravity: the tool's accelerometer reads 5\.00 m/s²"),
    ],
)
def test_an_arm_that_is_not_ready_is_not_moved_and_the_reason_given(changes, words):
    """One thing is wrong at a time."""
    with pytest.raises(MotionRefused, match=words):
        guard.check_state(inputs(ready_state(**changes)))


def test_every_condition_is_named_and_holds_for_an_arm_in_order():
    """The results have the names and the order that `check` prints; the two conditions on a cell are not checked where there is no cell."""
    found = conditions(inputs(ready_state()))
    assert [condition.name for condition in found] == [condition.name for condition in CONDITIONS]
    assert all(condition.holds for condition in found), [c for c in found if not c.holds]
    assert {condition.name for condition in found if not condition.checked} == {"trajectory_clear", "approach_clear"}  # no cell


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"settings": replace(SIMULATED, allow_motion=False)}, "motion_allowed"),
        ({"settings": replace(SIMULATED, host="ur5.local")}, "address"),
        ({"settings": replace(SIMULATED, windows_utc=("13:00-14:00",))}, "time_window"),
        ({"excitation": short(robot="ur3")}, "trajectory"),
        ({"settings": replace(SIMULATED, cell=plain_cell(Mounting()))}, "trajectory_clear"),  # `short` was never proved
        ({"last": LastMotion(stopped_before=reason_of("replay 7 ended by protective_stop"))}, "previous_stop"),
        ({"identity": None}, "robot_model"),
        ({"identity": told("UR10", "1", "3.15", None)}, "robot_model"),
        ({"identity": told("UR5", "1", "5.11.0.108249", True)}, "robot_model"),  # a UR5e, whose name has no e either
        ({"identity": told("UR5", "1", "3.15", False)}, "remote_control"),
        ({"context": Context(serial="2")}, "serial"),
        ({"state": None}, "safety_mode"),
        ({"state": ready_state(runtime_state=2)}, "no_other_program"),
        ({"settings": replace(SIMULATED, permit="digital_input:3")}, "permit"),
        ({"settings": replace(SIMULATED, permit="zenoh")}, "permit"),
        ({"settings": replace(SIMULATED, permit="zenoh"), "permit": Permit(False, reason_of("the press is open"))}, "permit"),
    ],
)
def test_each_condition_can_fail_and_is_the_one_that_is_named(changes, name):
    """One thing is wrong at a time, and its condition is the first that does not hold."""
    failed = [condition for condition in conditions(inputs(**{"state": ready_state(), **changes})) if not condition.holds]
    assert failed[0].name == name
    assert len(failed[0].text) > 10


@pytest.mark.parametrize("given", [{"permit": "digital_input:3"}, {"permit": "zenoh"}])
def test_a_permit_that_is_given_is_enough(given):
    """The digital input is on, or the program that was asked agrees."""
    known = inputs(
        ready_state(digital_inputs=8.0), settings=replace(SIMULATED, **given), permit=Permit(True, reason_of("the press is parked"))
    )
    assert all(condition.holds for condition in conditions(known))


def test_what_a_generation_does_not_report_is_named_and_does_not_crash():
    """An old controller reports no payload, accelerometer, slider or inputs; its dashboard knows neither model nor remote control."""
    nan = float("nan")
    silent = ready_state(
        speed_scaling=nan,
        speed_fraction=nan,
        payload_kg=nan,
        accelerometer_m_s2=(nan, nan, nan),
        digital_inputs=nan,
        status_bits=nan,
        joint_modes=(nan,) * 6,
        payload_cog_m=(nan,) * 3,
        tcp_pose=(nan,) * 6,
    )
    found = {c.name: c for c in conditions(inputs(silent, identity=told(None, None, "3.10", None)))}
    for name in (
        *("speed_scaling", "payload", "payload_cog", "tcp_offset", "gravity", "teach_button", "joints_running"),
        *("robot_model", "serial", "remote_control"),
    ):
        assert found[name].holds
        assert not found[name].checked
        assert "not reported" in found[name].text
    # an input that must be on and is not reported is no permit
    assert not {c.name: c for c in conditions(inputs(silent, settings=replace(SIMULATED, permit="digital_input:0")))}["permit"].holds
    # the manufacturer's own simulator reports an accelerometer of three zeros
    assert not {c.name: c for c in conditions(inputs(ready_state(accelerometer_m_s2=(0.0, 0.0, 0.0))))}["gravity"].checked


@given(q=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), tilt=st.floats(0.0, 3.1), about=st.floats(-3.1, 3.1))
def test_the_tilt_of_the_base_is_found_in_any_pose(q, tilt, about):
    """The accelerometer and forward kinematics give the angle between two mountings, whatever the joints' positions."""
    q = np.array(q)
    really = Mounting(roll_rad=tilt, yaw_rad=about)
    measured = np.array(upright(q, really))
    expected = np.degrees(tilt)  # a turn about the vertical cannot be seen, and does not matter
    # arccos loses half the digits at its ends
    assert tilt_deg(load_robot("ur5"), Mounting(yaw_rad=0.3), q, measured) == pytest.approx(expected, abs=1e-4)


def test_a_mounting_other_than_the_configured_one_is_refused():
    """5° are allowed: 3° pass, 7° do not."""
    for degrees, holds in ((3.0, True), (7.0, False)):
        measured = upright(ready_state().q, Mounting(roll_rad=np.radians(degrees)))
        gravity = {c.name: c for c in conditions(inputs(ready_state(accelerometer_m_s2=measured)))}["gravity"]
        assert gravity.holds is holds
        assert f"{degrees:.1f}°" in gravity.text


def test_the_accelerometer_of_a_real_arm_reads_up_as_we_do(real_data):
    """Sign and frame are right in a recording of a real arm at rest that stands upright."""
    table = pd.read_csv(real_data / "ur_standstill" / "real_10hz.csv", sep=r"\s+")
    q = table[[f"actual_q_{j}" for j in range(6)]].to_numpy().mean(axis=0)
    measured = table[[f"actual_tool_accelerometer_{k}" for k in range(3)]].to_numpy().mean(axis=0)
    assert tilt_deg(load_robot("ur5e"), Mounting(), q, measured) < 2.0


@pytest.mark.parametrize(
    ("windows", "at", "left"),
    [
        (("11:30-12:30",), NOON, 30.0),
        (("22:00-05:00",), NOON, None),
        (("22:00-05:00",), NOON + 11 * 3600, 360.0),  # 23:00
        (("22:00-05:00",), NOON + 16 * 3600, 60.0),  # 04:00
        (("00:00-24:00",), NOON, 720.0),
        (("01:00-02:00", "11:00-13:00"), NOON, 60.0),
        ((), NOON, np.inf),
    ],
)
def test_a_window_is_open_in_utc_and_may_pass_midnight(windows, at, left):
    """The result is the minutes that are left in the window; None outside every window."""
    assert replace(SIMULATED, windows_utc=windows).minutes_left(at) == left


def test_a_motion_must_end_before_its_window_does():
    """A motion of three seconds is refused where the window closes in two."""
    settings = replace(SIMULATED, windows_utc=("11:00-12:01",))
    assert conditions(inputs(ready_state(), settings=settings))[2].holds
    assert not conditions(inputs(ready_state(), settings=settings, now_unix_s=NOON + 58.0))[2].holds


@pytest.mark.parametrize(
    "wrong",
    [{"windows_utc": ("22-5",)}, {"windows_utc": ("25:00-26:00",)}, {"permit": "maybe"}, {"permit": "digital_input:18"}],
)
def test_an_invalid_window_or_permit_is_refused(wrong):
    """The message says what would be right."""
    with pytest.raises(BadInput, match="expected"):
        replace(SIMULATED, **wrong)


def test_a_refused_motion_carries_its_condition_and_what_was_found_as_codes():
    """Nobody parses the sentence, also on the other side of a pipe."""
    with pytest.raises(MotionRefused) as refused:
        guard.check_state(inputs(ready_state(robot_mode=3)))
    assert refused.value.condition == "robot_mode"
    why = refused.value.reason.parameters["why"]
    assert (why.code, why.parameters["mode"], why.parameters["name"]) == ("robot_mode_not_running", 3, "power off")
    told = reason_from(json.loads(json.dumps(refused.value.reason.document())))
    assert told.text == str(refused.value)
    assert told.parameters["why"].code == why.code
