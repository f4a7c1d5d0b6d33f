"""The output variables of the RTDE interface: where the value of each comes from."""

from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.physics import Arm
from monitor.simulate.arm.reference import Reference
from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.identity import NOT_MODELLED, OUTPUT_TYPES
from monitor.simulate.machine.machine import Measurements
from monitor.simulate.machine.personality import SUPPLY_V, Personality
from monitor.simulate.machine.registers import INPUT_TYPES, REGISTERS, width
from monitor.simulate.machine.state import Modes, RobotMode, Runtime, SafetyMode
from monitor.simulate.wire.packing import Source, Variable, array, computed, constant, listed, number

CURRENT_WINDOW_SHARE = 0.1  # published tolerance of the joint currents, as a share of the current at maximum torque
JOINT_MODES = {
    RobotMode.POWER_OFF: 239,
    RobotMode.POWER_ON: 247,
    RobotMode.IDLE: 255,
    RobotMode.RUNNING: 253,
}  # off, booting, idle, running
JOINT_BRAKED = 255  # of a joint whose brake is closed
TOOL_RUNNING, TOOL_OFF = 253, 239
NOTHING = (0.0,) * 6
POWER_ON, PROGRAM_RUNNING, TEACH_BUTTON = 1 << 0, 1 << 1, 1 << 2  # robot_status_bits
NORMAL, REDUCED, PROTECTIVE, SAFEGUARD, ROBOT_EMERGENCY, EMERGENCY, STOPPED = (
    1 << 0,
    1 << 1,
    1 << 2,
    1 << 4,
    1 << 6,
    1 << 7,
    1 << 10,
)  # safety_status_bits
SAFETY_BITS = {
    SafetyMode.NORMAL: NORMAL,
    SafetyMode.REDUCED: REDUCED,
    SafetyMode.PROTECTIVE_STOP: PROTECTIVE | STOPPED,
    SafetyMode.SAFEGUARD_STOP: SAFEGUARD | STOPPED,
    SafetyMode.ROBOT_EMERGENCY_STOP: ROBOT_EMERGENCY | EMERGENCY | STOPPED,
}


def output_variables(controller: Controller) -> dict[str, Variable]:
    """Every output in OUTPUT_TYPES. `Identity.publishes` tells which of them the emulated version has.

    Forces at the tool (except the weight of a payload), momentum and analogue inputs are not modelled: they are always zero.
    """
    zero = constant(0.0)
    analog = listed(2, controller.registers.outputs.analog.copy)
    places: dict[str, Source | tuple[Source, int]] = {
        "timestamp": number(controller, "clock.published_s"),
        "control_step": number(controller, "clock.ticks"),
        **_motion(controller),
        **_modes(controller.modes),
        **_electric(controller),
        **_payload(controller),
        "actual_execution_time": listed(1, lambda: (controller.personality.execution_ms(),)),
        "speed_scaling": number(controller, "programs.speed_scaling"),
        "target_speed_fraction": number(controller, "registers.speed_fraction"),
        **dict.fromkeys(("actual_momentum", "tcp_force_scalar", "standard_analog_input0", "standard_analog_input1"), zero),
        "actual_TCP_force": computed(6, controller.tool_force),
        "joint_position_deviation_ratio": number(controller, "safety.deviation_ratio"),
        "joint_temperatures": array(controller, "measurements.latest.temperature_c"),
        "tool_temperature": number(controller, "arm.ambient_c"),
        "actual_digital_input_bits": number(controller, "registers.digital_inputs"),
        "actual_digital_output_bits": number(controller, "registers.outputs.digital"),
        "analog_io_types": number(controller, "registers.outputs.analog_types"),
        "standard_analog_output0": analog,
        "standard_analog_output1": (analog, 1),
        **_registers(controller),
        **{name: constant(*[0] * width(kind)) for name, kind in NOT_MODELLED.items()},
    }
    return {name: Variable(OUTPUT_TYPES[name], *(place if isinstance(place, tuple) else (place, 0))) for name, place in places.items()}


def _motion(controller: Controller) -> dict[str, Source | tuple[Source, int]]:
    tool, kinematics, measurements = ToolState(controller), controller.kinematics, controller.measurements
    actual, target = computed(12, tool.actual), computed(12, tool.target)
    return {
        "target_q": array(controller, "reference.q"),
        "target_qd": array(controller, "reference.qd"),
        "target_qdd": array(controller, "reference.qdd"),
        "actual_q": array(controller, "measurements.latest.q"),
        "actual_qd": array(controller, "measurements.latest.qd"),
        "actual_TCP_pose": actual,
        "actual_TCP_speed": (actual, 6),
        "target_TCP_pose": target,
        "target_TCP_speed": (target, 6),
        "actual_tool_accelerometer": computed(3, tool.accelerometer),
        "ft_raw_wrench": listed(6, tool.payload_wrench),
        "tcp_offset": array(controller, "kinematics.tool"),
        "elbow_position": computed(3, lambda: kinematics.elbow(measurements.latest.q)),
        "elbow_velocity": computed(3, lambda: kinematics.elbow_speed(measurements.latest.q, measurements.latest.qd)),
    }


def _modes(modes: Modes) -> dict[str, Source | tuple[Source, int]]:
    state = listed(12, ModeState(modes).read)
    return {
        "robot_mode": state,
        "safety_mode": (state, 1),
        "safety_status": (state, 1),
        "runtime_state": (state, 2),
        "robot_status_bits": (state, 3),
        "safety_status_bits": (state, 4),
        "joint_mode": (state, 5),
        "tool_mode": (state, 11),
    }


def _electric(controller: Controller) -> dict[str, Source | tuple[Source, int]]:
    arm, measurements, gain = controller.arm, controller.measurements, controller.arm.gain_nm_per_a
    installation, reference = controller.installation, controller.reference
    personality = controller.personality
    voltages = computed(2 + controller.robot.joints, personality.voltages)

    def target_current() -> Array:
        current: Array = (installation.target_moment(reference) + personality.target_friction_nm(reference.qd)) / gain
        return current

    window = CURRENT_WINDOW_SHARE * controller.robot.max_torque_nm / gain
    return {
        "target_moment": computed(6, lambda: installation.target_moment(reference)),
        "target_current": computed(6, target_current),
        "actual_current": array(controller, "measurements.latest.current"),
        "actual_current_as_torque": computed(6, lambda: measurements.latest.current * gain),
        "actual_current_window": constant(*window.tolist()),
        "joint_control_output": computed(6, lambda: arm.torque_nm / arm.true_gain_nm_per_a),
        "actual_joint_voltage": (voltages, 2),
        "actual_main_voltage": voltages,
        "actual_robot_voltage": (voltages, 1),
        "actual_robot_current": listed(1, lambda: (supply_current(arm, personality),)),
    }


def _payload(controller: Controller) -> dict[str, Source | tuple[Source, int]]:
    payload = listed(4, lambda: controller.installation.payload)
    return {
        "payload": payload,
        "payload_cog": (payload, 1),
        "payload_inertia": listed(6, lambda: controller.installation.inertia_kg_m2),
    }


def _registers(controller: Controller) -> dict[str, Source | tuple[Source, int]]:
    registers = controller.registers
    places: dict[str, Source | tuple[Source, int]] = {f"output_bit_register_{i}": constant(False) for i in range(64, 128)}
    for name in INPUT_TYPES:
        if name.startswith("input_bit"):
            places[name] = listed(1, lambda name=name: (registers.inputs.number(name, 0),))  # type: ignore[misc]
    for kind, values in (
        ("output_int", registers.output_ints),
        ("output_double", registers.output_doubles),
        ("input_int", registers.inputs.ints),
        ("input_double", registers.inputs.doubles),
    ):
        all_of_them = listed(REGISTERS, values.copy)
        places |= {f"{kind}_register_{i}": (all_of_them, i) for i in range(REGISTERS)}
    return places


class ModeState:
    """Modes and status bits. They are computed again only when a mode has changed."""

    def __init__(self, modes: Modes) -> None:
        self._modes = modes
        self._last: tuple[object, ...] = ()
        self._values: tuple[int, ...] = ()

    def read(self) -> tuple[int, ...]:
        """Robot mode, safety mode, program state, robot status bits, safety status bits, six joint modes, tool mode: 12 numbers."""
        modes = self._modes
        now = modes.robot, modes.safety, modes.runtime, modes.teach_button, modes.braked
        if now != self._last:
            self._last = now
            tool = TOOL_RUNNING if modes.powered else TOOL_OFF
            joints = [JOINT_BRAKED if joint in modes.braked else joint_mode(modes) for joint in range(6)]
            self._values = (*map(int, now[:3]), robot_status_bits(modes), SAFETY_BITS[modes.safety], *joints, tool)
        return self._values


class ToolState:
    """Pose and speed of the tool in the base's frame: position [m], rotation vector [rad], velocity [m/s], angular velocity [rad/s]."""

    def __init__(self, controller: Controller) -> None:
        self._arm: Arm = controller.arm
        self._personality: Personality = controller.personality
        self._measurements: Measurements = controller.measurements
        self._reference: Reference = controller.reference
        kinematics: Kinematics = controller.kinematics
        self._actual, self._target = kinematics.watch(), kinematics.watch()
        # the mounting's gravity is a product of three matrices, too costly for every control period
        self._mounting, self._upwards = self._arm.mounting, -self._arm.mounting.gravity_in_base

    def actual(self) -> Array:
        """(12,) of the arm as it is measured."""
        return self._actual.at(self._measurements.latest.q, self._measurements.latest.qd)

    def target(self) -> Array:
        """(12,) at the targets."""
        return self._target.at(self._reference.q, self._reference.qd)

    def accelerometer(self) -> Array:
        """(3,) what the accelerometer in the flange shows, in the flange's frame [m/s²]. The acceleration of the tool is not modelled."""
        return self._personality.accelerometer(self.upwards())

    def upwards(self) -> Array:
        """(3,) what an ideal accelerometer at rest shows, in the flange's frame [m/s²]."""
        mounting = self._arm.mounting
        if mounting is not self._mounting:
            self._mounting, self._upwards = mounting, -mounting.gravity_in_base
        self.actual()
        upwards: Array = self._upwards.dot(self._actual.flange.rotation)
        return upwards

    def payload_wrench(self) -> tuple[float, ...]:
        """Force [N] and torque [N·m] of the payload on the flange at rest, in the flange's frame: 6 numbers.

        A raw sensor shows this whether the payload is declared or not. Bias and noise are not modelled.
        """
        arm = self._arm
        if arm.payload_kg == 0.0:
            return NOTHING
        x, y, z = (-arm.payload_kg * self.upwards()).tolist()
        at_x, at_y, at_z = arm.payload_com_m
        return x, y, z, at_y * z - at_z * y, at_z * x - at_x * z, at_x * y - at_y * x  # r × F: np.cross takes ten times as long


def joint_mode(modes: Modes) -> int:
    """The mode of every joint, by the arm's power: with closed brakes it is idle."""
    return JOINT_MODES[modes.robot]


def robot_status_bits(modes: Modes) -> int:
    """The bits "power on", "program running" and "teach button pressed"."""
    program = PROGRAM_RUNNING if modes.runtime == Runtime.PLAYING else 0
    return (POWER_ON if modes.powered else 0) | program | (TEACH_BUTTON if modes.teach_button else 0)


def supply_current(arm: Arm, personality: Personality) -> float:
    """Current of the whole arm at 48 V [A]: electronics, and what the drives turn into motion and heat."""
    return personality.supply_a(max(arm.electric_w(), 0.0) / SUPPLY_V)
