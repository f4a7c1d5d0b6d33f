"""Arms whose wrist motors turn several joints: with the mapping their friction comes back, at the motors; without it, that is said."""

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from oracle_arm import COULOMB_NM, GROUND, ROTOR_KG_M2, VISCOUS, excitation, friction, rigid_torque

from monitor.design.objective import information
from monitor.errors import BadInput
from monitor.identify.energy import path_of_recording
from monitor.identify.fit.least_squares import Felt
from monitor.identify.identify import identify
from monitor.identify.production.arm import ProductionArm, ProductionRows
from monitor.identify.production.estimate import estimate
from monitor.identify.production.gather import gather
from monitor.identify.settings import ProductionSettings
from monitor.identify.validate import validate
from monitor.model.regressor import felt_columns, felt_regressor, regressor
from monitor.model.robot import Robot, load_robot, robot_from_document
from monitor.model.urdf import robot_from_urdf_text, urdf_text
from monitor.recording import Recording

UR5 = load_robot("ur5")
WRIST = np.eye(6)
WRIST[5, 4] = 1.0  # the sixth motor turns with the fifth axis, as in a Stäubli TX
DIFFERENTIAL = np.eye(6)
DIFFERENTIAL[4:, 4:] = [[1.0, 1.0], [1.0, -1.0]]  # both motors turn both axes


def coupled(C: np.ndarray, *, at_motors: bool = False) -> Robot:
    return replace(UR5, coupling=C, recorded_at_motors=at_motors)


def played(C: np.ndarray, seed: int = 1, *, at_motors: bool = False) -> Recording:
    """Torque of the links by pinocchio, shared among the motors by the power; friction and rotors turn with the motors."""
    rng = np.random.default_rng(seed)
    t_s, (q, qd, qdd) = excitation(UR5, seed=seed).sampled(125.0)
    links = rigid_torque(UR5, GROUND, q, qd, qdd)
    motor, speed, acceleration = q @ C.T, qd @ C.T, qdd @ C.T
    torque = np.linalg.solve(C.T, links.T).T + ROTOR_KG_M2 * acceleration + friction(speed)
    there = (motor, speed) if at_motors else (q, qd)
    return Recording(
        t_s=t_s,
        q=there[0] + 1e-5 * rng.normal(size=q.shape),
        qd=there[1] + 2e-4 * rng.normal(size=q.shape),
        current=torque / UR5.drive_gain_nm_per_a + 0.01 * rng.normal(size=q.shape),
        source="coupled",
    )


@pytest.mark.parametrize("at_motors", [False, True], ids=["joints recorded", "motors recorded"])
@pytest.mark.parametrize("C", [WRIST, DIFFERENTIAL], ids=["carried wrist", "differential"])
def test_friction_of_coupled_motors_comes_back(C, at_motors):
    """fc and fv of every motor to 3 % and 4 %, and another run is predicted to 2 % of its torque."""
    robot = coupled(C, at_motors=at_motors)
    found = identify([played(C, at_motors=at_motors)], robot, GROUND)
    assert found.coulomb_nm == pytest.approx(COULOMB_NM, rel=0.03)
    assert found.viscous_nm_s_per_rad == pytest.approx(VISCOUS, rel=0.04)
    assert not {"poor_fit", "mounting_contradiction", "coupled_axes"} & {warning.code for warning in found.warnings}
    held_out = validate(found, played(C, seed=2, at_motors=at_motors), robot)
    assert np.all(held_out.relative_rms < 0.02)


@pytest.mark.parametrize("at_motors", [False, True], ids=["joints recorded", "motors recorded"])
def test_production_of_coupled_motors_tells_the_friction_of_each_motor(at_motors):
    """Another run as if it were work: whichever positions were recorded, friction is that of the motors to 5 %."""
    robot, settings = coupled(DIFFERENTIAL, at_motors=at_motors), ProductionSettings()
    found = identify([played(DIFFERENTIAL, at_motors=at_motors)], robot, GROUND)
    production = ProductionRows(recording=played(DIFFERENTIAL, seed=2, at_motors=at_motors))
    told = gather(production, ProductionArm(robot=robot, mounting=GROUND, identification=found, payload_kg=0.0), settings)
    seen = estimate(told, found, settings, production.recording.duration_s)
    assert seen.friction_nm == pytest.approx(COULOMB_NM + VISCOUS * settings.reference_speed_rad_s, rel=0.05)


@pytest.mark.parametrize(
    ("C", "says"),
    [
        (WRIST, r"joint 6 \+1 × that of joint 5 explains most of it: coupled axes"),
        (DIFFERENTIAL, r"joint 5 \+1 × that of joint 6 explains most of it: coupled axes"),
        (0.5 * (WRIST + np.eye(6)), r"joint 6 \+0.5 × that of joint 5 explains most of it: coupled axes"),
    ],
    ids=["carried wrist", "differential", "half carried"],
)
def test_without_the_mapping_coupled_wrists_are_said(C, says):
    """The same recordings as of an arm without coupling: the warning says which axes, and by how much one motor turns with the other."""
    found = identify([played(C)], UR5, GROUND)
    assert any(re.search(says, warning.text) for warning in found.warnings if warning.code == "poor_fit"), found.warnings


def test_friction_from_positions_of_the_motors_needs_no_mapping():
    """Friction is that of the motors, at the motors' speeds: it is right without the coupling, which matters for links alone."""
    found = identify([played(WRIST, at_motors=True)], UR5, GROUND)
    assert found.coulomb_nm == pytest.approx(COULOMB_NM, rel=0.03)


@pytest.mark.parametrize("C", [WRIST, DIFFERENTIAL, DIFFERENTIAL @ WRIST])
def test_the_columns_that_motors_feel_are_those_of_the_whole_regressor(C):
    """What is formed for each motor equals the full regressor's row, and the rest of the row is zero; power is the same on both sides."""
    robot, rng = coupled(C), np.random.default_rng(3)
    q, qd, qdd = rng.normal(size=(3, 40, 6))
    Y = regressor(robot, GROUND, q, qd, qdd)
    columns = tuple(range(78))
    felt = felt_columns(columns, 6, robot.innermost)
    blocks = felt_regressor(robot, GROUND, felt, q, qd, qdd, np.tanh(qd / 0.001))
    dense = Felt(40, 78, felt.places, lambda at: [block[at] for block in blocks])[:]
    friction_columns = [13 * j + 10 for j in range(6)]
    assert np.delete(dense, friction_columns, axis=2) == pytest.approx(np.delete(Y, friction_columns, axis=2), abs=1e-12)
    parameters = UR5.nominal_parameters(with_inertia=True)
    joints = (robot.joints_of(each) for each in (q, qd, qdd))
    links = rigid_torque(UR5, GROUND, *joints)
    assert np.sum((Y @ parameters) * qd, axis=1) == pytest.approx(np.sum(links * robot.joints_of(qd), axis=1), rel=1e-9, abs=1e-9)


def test_the_energy_of_a_coupled_arm_is_that_of_its_links():
    """The path in joint positions is the same whether joints or motors were recorded."""
    paths = [path_of_recording(played(WRIST, at_motors=motors), coupled(WRIST, at_motors=motors)) for motors in (False, True)]
    assert paths[0].q == pytest.approx(paths[1].q, abs=1e-3)


ARM = """
name = "carried"
generation = "urdf"
rate_hz = 125.0
payload_max_kg = 2.0
max_torque_nm = [10.0, 10.0]
max_speed_rad_s = [3.0, 3.0]
max_position_rad = [3.0, 3.0]
{more}
[[link]]
name = "a"
a_m = 0.3
d_m = 0.1
alpha_rad = 1.5
mass_kg = 1.0
com_m = [0.0, 0.0, 0.1]
inertia_kg_m2 = {{ xx = 0.1, xy = 0.0, xz = 0.0, yy = 0.1, yz = 0.0, zz = 0.1 }}
[[link]]
name = "b"
a_m = 0.2
d_m = 0.0
alpha_rad = 0.0
mass_kg = 1.0
com_m = [0.0, 0.0, 0.1]
inertia_kg_m2 = {{ xx = 0.1, xy = 0.0, xz = 0.0, yy = 0.1, yz = 0.0, zz = 0.1 }}
"""


def test_a_coupling_is_read_from_toml():
    """The matrix, and where positions are recorded; joints where nothing is said, and no coupling without the key."""
    read = robot_from_document(tomllib.loads(ARM.format(more='coupling = [[1, 0], [0.5, 1]]\npositions_at = "motors"')))
    assert read.coupling.tolist() == [[1.0, 0.0], [0.5, 1.0]]
    assert read.recorded_at_motors
    assert read.joints_of(read.motors_of(np.array([[0.2, 0.7]]))) == pytest.approx(np.array([[0.2, 0.7]]))
    assert robot_from_document(tomllib.loads(ARM.format(more=""))).coupling is None


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ("coupling = [[1, 1], [1, 1]]", "coupling.*can be inverted"),
        ("coupling = [[1, 0, 0], [0, 1, 0]]", "coupling.*2 rows of 2 numbers"),
        ("coupling = [[1, 0], [nan, 1]]", "coupling"),
        ('positions_at = "motors"', "positions_at: motors needs the coupling"),
        ('coupling = [[1, 0], [1, 1]]\npositions_at = "flange"', "positions_at: 'flange'; expected joints or motors"),
    ],
)
def test_a_coupling_that_no_arm_has_is_refused(more, says):
    """The message names the key."""
    with pytest.raises(BadInput, match=says):
        robot_from_document(tomllib.loads(ARM.format(more=more)))


def urdf(transmissions: str) -> Robot:
    return robot_from_urdf_text(urdf_text(UR5).replace("</robot>", f"{transmissions}</robot>"))


def transmission(kind: str, joints: dict[str, float], actuators: list[float]) -> str:
    turned = "".join(f'<joint name="{n}"><mechanicalReduction>{r}</mechanicalReduction></joint>' for n, r in joints.items())
    motors = "".join(f'<actuator name="m{k}"><mechanicalReduction>{r}</mechanicalReduction></actuator>' for k, r in enumerate(actuators))
    return f'<transmission name="t"><type>transmission_interface/{kind}</type>{turned}{motors}</transmission>'


def test_the_transmissions_of_a_urdf_are_read():
    """A simple one gives the ratio, a differential one and a four-bar linkage the coupling; one of a hand's joint does not count."""
    simple = urdf(transmission("SimpleTransmission", {"joint_1": 1.0}, [101.0]) + transmission("Any", {"finger": 1.0}, [3.0]))
    assert simple.gear_ratio[0] == 101.0
    assert np.all(np.isnan(simple.gear_ratio[1:]))
    assert simple.coupling is None
    both = urdf(transmission("DifferentialTransmission", {"joint_5": 1.0, "joint_6": 1.0}, [50.0, 60.0]))
    assert np.array_equal(both.coupling, DIFFERENTIAL)
    assert both.gear_ratio[4:].tolist() == [50.0, 60.0]
    carried = urdf(transmission("FourBarLinkageTransmission", {"joint_5": 1.0, "joint_6": 1.0}, [45.0, 32.0]))
    assert np.array_equal(carried.coupling, WRIST)


def test_a_transmission_that_couples_joints_in_an_unknown_way_is_refused():
    """Three joints on two actuators: the message names it and what would be right."""
    with pytest.raises(BadInput, match=r"transmission 't': Odd of 2 actuators couples 3 joints; expected DifferentialTransmission"):
        urdf(transmission("Odd", {"joint_4": 1.0, "joint_5": 1.0, "joint_6": 1.0}, [50.0, 60.0]))
    with pytest.raises(BadInput, match="expected a mechanicalReduction"):
        urdf(transmission("DifferentialTransmission", {"joint_5": 0.0, "joint_6": 1.0}, [50.0, 60.0]))


@pytest.mark.parametrize("C", [WRIST, DIFFERENTIAL], ids=["carried wrist", "differential"])
def test_a_design_reckons_with_the_torque_of_the_motors_that_turn_several_joints(C):
    """Its torque is pinocchio's for the links, shared among the motors by the power; its rows weigh what the motors do."""
    _, state = excitation(UR5, seed=3).sampled(25.0)
    of_joints = rigid_torque(UR5, GROUND, *state)
    found = information(coupled(C), GROUND, parameters=UR5.nominal_parameters(with_inertia=True))
    rows, torque = found.rows(*state)
    assert torque == pytest.approx(np.linalg.solve(C.T, of_joints.T).T, abs=1e-6 * np.abs(of_joints).max())
    viscous = rows[:, -6:].transpose(2, 0, 1)  # (N, J, J): each motor's row of all fv
    assert np.allclose(viscous, (state.qd @ C.T)[:, :, None] * np.eye(6))
