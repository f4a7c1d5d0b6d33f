"""Faults of joints beside wear follow their laws."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from command_line import printed

from monitor.model.robot import load_robot
from monitor.simulate.arm import damage
from monitor.simulate.arm.damage import DAMAGES, ENCODER_RAD, KINEMATIC_RAD, PASSES_PER_TURN, PLAY_RAD, STIFFNESS_LOST, STIFFNESS_PER_NM
from monitor.simulate.arm.friction import default_law
from monitor.simulate.arm.physics import Arm, Contact, Target
from monitor.simulate.arm.thermal import Temperatures
from monitor.simulate.controller.controller import Controller
from monitor.simulate.faults import parse
from monitor.simulate.settings import SimulateSettings

H = 0.002
HOME = np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0])
UR5 = load_robot("ur5")
RATIO = 101.0
JOINT = 2  # from 0
AT_REST = np.zeros(6)


def damaged(name: str, severity: float, law=None) -> Arm:
    arm = Arm(UR5, q=HOME, law=law)
    arm.damage_joint(name, JOINT, severity)
    return arm


def twist_rad(arm: Arm) -> float:
    """By how much the link is ahead of its motor."""
    return float(arm._gears.twist[JOINT])


def held_rad(arm: Arm, torque_nm: float) -> float:
    """The twist of a standing joint whose link bears a torque."""
    arm.contact = Contact(joint=JOINT, left_s=np.inf, torque_nm_on_joint=torque_nm)
    for _ in range(1500):
        arm.step(H, Target(HOME, AT_REST, AT_REST))
    return twist_rad(arm)


def turned(arm: Arm, speed_rad_s: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the joint's motor and of its link, at a constant speed that is reached within half a second."""
    motor, link = [], []
    for i in range(round(seconds / H)):
        t = (i + 0.5) * H
        ramp = min(t / 0.5, 1.0)
        way = speed_rad_s * (0.5 * t * ramp if ramp < 1.0 else t - 0.25)
        q, qd, qdd = HOME.copy(), np.zeros(6), np.zeros(6)
        q[JOINT], qd[JOINT], qdd[JOINT] = way, speed_rad_s * ramp, speed_rad_s / 0.5 if ramp < 1.0 else 0.0
        arm.step(H, Target(q, qd, qdd))
        if t > 1.0:
            motor.append(arm.q[JOINT])
            link.append(arm.q[JOINT] + twist_rad(arm))
    return np.array(motor), np.array(link)


def swung_nm(arm: Arm) -> np.ndarray:
    """(1000, 6) drive torque while all joints swing by 0.6 rad."""
    torque, one, w = [], np.full(6, 0.3), np.pi
    for i in range(1000):
        t = (i + 0.5) * H
        arm.step(H, Target(HOME + one * (1 - np.cos(w * t)), one * w * np.sin(w * t), one * w * w * np.cos(w * t)))
        torque.append(arm.torque_nm)
    return np.array(torque)


@pytest.mark.parametrize("severity", [1e-6, 0.5, 1.0])
def test_a_gear_yields_as_much_as_its_stiffness_says(severity):
    """Twenty newton metres more either way turn the link by twice that over the stiffness."""
    arm = damaged("soft_gear", severity)
    stiffness = STIFFNESS_PER_NM * UR5.max_torque_nm[JOINT] * (1.0 - STIFFNESS_LOST * severity)
    assert held_rad(arm, 20.0) - held_rad(arm, -20.0) == pytest.approx(40.0 / stiffness, rel=0.01)


def test_play_is_crossed_where_the_load_changes_its_side():
    """The link moves by the play and by what the gear yields."""
    sound, loose = damaged("backlash", 1e-9), damaged("backlash", 0.5)
    more = (held_rad(loose, 20.0) - held_rad(loose, -20.0)) - (held_rad(sound, 20.0) - held_rad(sound, -20.0))
    assert more == pytest.approx(0.5 * PLAY_RAD, rel=0.02)


def test_a_kinematic_error_is_a_wave_of_two_periods_a_turn_of_the_motor():
    """At a slow constant speed the link is ahead of the motor by that wave, and by those of half and twice the period."""
    motor, link = turned(damaged("kinematic_error", 0.5), 0.05, 6.0)
    waves = np.stack([each(n * RATIO * motor) for n in (1, 2, 4) for each in (np.sin, np.cos)] + [np.ones_like(motor), motor], axis=1)
    found = np.hypot(*np.linalg.lstsq(waves, link - motor, rcond=None)[0][:6].reshape(3, 2).T)
    assert found / (0.5 * KINEMATIC_RAD) == pytest.approx([0.5, 1.0, 0.25], rel=0.1)


def test_an_elastic_sound_gear_takes_the_torque_that_a_rigid_one_takes():
    """Mean drive torque along a slow swing, once the jerk of its start is over, is the same to two percent of the largest."""
    rigid, elastic = (swung_nm(arm)[250:].reshape(15, 50, 6).mean(axis=1) for arm in (Arm(UR5, q=HOME), damaged("soft_gear", 1e-9)))
    assert np.abs(elastic - rigid).max() < 0.02 * np.abs(rigid).max()


def test_springs_of_gears_add_no_energy():
    """An arm that falls without friction and without a drive never has more kinetic and potential energy than at the start."""
    none = np.zeros(6)
    law = replace(default_law(UR5), coulomb_nm=none, load_factor=none, concave_nm=none, linear_nm_s_per_rad=none)
    arm = Arm(UR5, q=np.array([0.1, -1.1, 0.6, -1.2, 0.3, 0.0]), law=law)
    arm.damage_joint("backlash", JOINT, 1.0)
    arm.damage_joint("kinematic_error", 1, 1.0)

    def energy_j() -> float:
        gears, data = arm._gears, arm.model.createData()
        M = pin.crba(arm.model, data, arm.q + gears.twist) - np.diag(arm.rotor_kg_m2)
        moving = 0.5 * gears.speed @ M @ gears.speed + 0.5 * arm.rotor_kg_m2 @ arm.qd**2
        return float(moving + pin.computePotentialEnergy(arm.model, data, arm.q + gears.twist))

    start, most = energy_j(), -np.inf
    for _ in range(2000):
        arm.push(0.0005, none)
        most = max(most, energy_j())
    swung = float(arm.qd @ arm.qd)
    assert swung > 1.0  # it did swing
    assert most < start + 0.02 * abs(start)


def test_balls_that_pass_a_defect_brake_so_often_as_geometry_says():
    """In ten turns of the motor the number of pulses is that of passing balls; no pulse drives."""
    arm = damaged("bearing", 1.0)
    way = np.zeros((20_000, 6))
    way[:, JOINT] = np.linspace(0.0, 10 * 2 * np.pi / RATIO, 20_000)
    pulses = np.array([arm._bearings.pulse_nm(q) for q in way])
    braking = pulses[:, JOINT] > 0.0
    assert np.count_nonzero(braking[1:] & ~braking[:-1]) == pytest.approx(10 * PASSES_PER_TURN, abs=1)
    assert pulses.min() == 0.0
    assert pulses[:, JOINT].max() == pytest.approx(damage.PULSE_NM_PER_NM * 150.0, rel=0.01)
    assert not np.delete(pulses, JOINT, axis=1).any()


def test_spent_grease_rubs_more_when_slow_and_less_when_fast():
    """Dry friction reaches to ten times the speed, and viscous friction is thinner; new grease is as before."""
    arm, old = Arm(UR5, q=HOME), damaged("aged_lubricant", 1.0)

    def friction(of: Arm, speed: float) -> float:
        return float(of.friction_torque(np.full(6, speed), AT_REST)[JOINT])

    assert friction(old, 0.05) > 1.2 * friction(arm, 0.05)
    assert friction(old, 3.0) < 0.9 * friction(arm, 3.0)
    assert old.law.stribeck_rad_s[JOINT] == pytest.approx(10.0 * arm.law.stribeck_rad_s[JOINT])
    old.regrease(JOINT, 1.0)
    assert friction(old, 0.05) == friction(arm, 0.05)


def test_a_dragging_brake_rubs_whatever_load_and_temperature_are():
    """It adds the same torque to a cold free joint and to a warm loaded one that is worn."""
    arm, dragging = Arm(UR5, q=HOME), damaged("dragging_brake", 0.5)
    for each in (arm, dragging):
        each.set_wear(JOINT, coulomb=1.5)
    for load, grease in ((0.0, 10.0), (60.0, 40.0)):
        more = [each.friction_torque(np.full(6, 0.5), np.full(6, load), np.full(6, grease))[JOINT] for each in (arm, dragging)]
        assert more[1] - more[0] == pytest.approx(0.5 * damage.DRAG_NM_PER_NM * 150.0)


@pytest.mark.parametrize(("name", "turns"), [("joint_encoder", 1.0), ("motor_encoder", RATIO)])
def test_an_encoder_off_its_centre_misreads_once_a_turn(name, turns):
    """What it shows is a sine of its own shaft, and the speed it shows is the derivative of that."""
    arm = damaged(name, 0.5)
    for q in np.linspace(-1.0, 1.0, 7):
        arm.q, arm.qd = HOME.copy(), np.ones(6)
        arm.q[JOINT] = q
        position, speed = arm.encoders()
        assert position[JOINT] - q == pytest.approx(0.5 * ENCODER_RAD * np.sin(turns * q) / turns)
        assert speed[JOINT] == pytest.approx(1.0 + 0.5 * ENCODER_RAD * np.cos(turns * q))
        assert np.array_equal(np.delete(position, JOINT), np.delete(arm.q, JOINT))


def test_the_servo_follows_what_the_encoder_shows():
    """At standstill the encoder shows the target, and the joint is beside it."""
    arm = damaged("joint_encoder", 1.0)
    goal = HOME.copy()
    goal[JOINT] = 0.5
    arm.q = goal.copy()
    for _ in range(1500):
        arm.step(H, Target(goal, AT_REST, AT_REST))
    assert arm.encoders()[0][JOINT] == pytest.approx(0.5, abs=1e-4)
    assert abs(arm.q[JOINT] - 0.5) > 1e-3


def test_heat_weakens_magnets_for_good():
    """The torque of a current falls with the hottest that the motor was, and does not come back; a new joint has sound magnets."""
    arm = Arm(UR5, q=HOME)
    gain = arm.true_gain_nm_per_a[JOINT]

    def heated(to_c: float) -> float:
        warm = np.full(6, 30.0)
        warm[JOINT] = to_c
        arm.set_temperatures(Temperatures(warm, np.full(6, 30.0)))
        return float(arm.true_gain_nm_per_a[JOINT] / gain)

    assert heated(75.0) == 1.0
    assert heated(100.0) == pytest.approx(0.96)
    assert heated(30.0) == pytest.approx(0.96)
    assert heated(90.0) == pytest.approx(0.96)
    assert heated(120.0) == pytest.approx(0.92)
    arm.replace_joint(JOINT, 1.0)
    assert heated(30.0) == 1.0


def test_a_weak_motor_needs_more_current_for_the_same_motion():
    """An arm whose joint 3 has lost an eighth of its flux needs so much more current there. At rest friction would hide it."""
    mean_a = []
    for arm in (Arm(UR5, q=HOME), damaged("demagnetisation", 1.0)):
        mean_a.append(np.mean(np.abs(swung_nm(arm) / arm.true_gain_nm_per_a)[250:], axis=0))
    assert mean_a[1][JOINT] / mean_a[0][JOINT] == pytest.approx(1.0 / (1.0 - damage.FLUX_LOST_PER_K * damage.OVERHEATED_K), rel=0.01)
    assert np.delete(mean_a[1] / mean_a[0], JOINT) == pytest.approx(np.ones(5), abs=0.01)


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_joint_is_sound_again_after_repair_and_after_replacement(name):
    """`clear` repairs all joints; a new joint is a sound one."""
    controller = Controller(SimulateSettings())
    for mend in (lambda: controller.inject("clear", {}), lambda: controller.arm.replace_joint(JOINT, 1.0)):
        assert name in controller.inject(name, {"joint": JOINT + 1, "severity": 0.7})
        assert controller.arm.damage.severity[name][JOINT] == 0.7
        mend()
        assert not any(each.any() for each in controller.arm.damage.severity.values())
        assert (controller.arm.damage.flux == 1.0).all()
        assert controller.arm._gears is None


def test_a_severity_may_stand_behind_the_name():
    assert parse("backlash:0.3 joint=2") == ("backlash", {"severity": "0.3", "joint": "2"})


@pytest.mark.slow
def test_help_names_every_fault_of_joints():
    told = printed("simulate", "--help")
    assert not [name for name in DAMAGES if name not in told]
