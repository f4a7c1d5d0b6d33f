"""Payload and mounting as the controller knows them, and the rigid-body model that it computes with."""

import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.physics import Arm, Target, arm_model
from monitor.simulate.arm.reference import Reference
from monitor.simulate.arm.sensors import Sensors
from monitor.simulate.machine.journal import Journal
from monitor.simulate.machine.moves import Compliance, Limits, Moves
from monitor.simulate.machine.personality import Personality
from monitor.simulate.machine.registers import Registers
from monitor.simulate.machine.state import Clock, Modes, Supervisor
from monitor.simulate.settings import SimulateSettings


class Installation:
    """The declared payload and gravity. The arm itself may carry another payload or hang otherwise."""

    def __init__(self, settings: SimulateSettings, robot: Robot, arm: Arm) -> None:
        self._robot, self._arm = robot, arm
        # mass [kg] and centre of mass in the flange's frame [m], and gravity in the base's frame [m/s²]; a restart restores them
        self.installed_payload: tuple[float, ...] = (settings.payload_kg, *settings.payload_com_m)
        self.installed_gravity: Array = settings.mounting.gravity_in_base
        # the same, as a program declared it last
        self.payload: tuple[float, ...] = self.installed_payload
        self.gravity = self.installed_gravity
        self.inertia_kg_m2: tuple[float, ...] = (0.0,) * 6  # reported to clients; the model does not use it
        self._dynamics = InverseDynamics(arm.assumed_model)

    def declare(self, *, payload: tuple[float, ...] | None = None, gravity: Array | None = None) -> None:
        """Compute from now on with this payload and gravity. The arm does not change. None keeps the present value."""
        self.payload = payload or self.payload
        self.gravity = self.gravity if gravity is None else gravity
        arm = self._arm
        same_payload = self.payload == (arm.payload_kg, *arm.payload_com_m)
        if same_payload and np.array_equal(self.gravity, arm.model.gravity.linear):
            model = arm.model
        else:
            model = arm_model(self._robot, arm.mounting, self.payload[0], self.payload[1:])
            model.gravity.linear = self.gravity
        arm.assume_model(model)
        self._dynamics = InverseDynamics(model)

    def install(self, *, payload: tuple[float, ...] | None = None, gravity: Array | None = None) -> None:
        """Declare this payload and gravity, and restore them after a restart. None keeps the installed value."""
        self.installed_payload = payload or self.installed_payload
        self.installed_gravity = self.installed_gravity if gravity is None else gravity
        self.declare(payload=payload, gravity=gravity)

    def take_over(self, before: "Installation") -> None:
        """Restore what is installed, as after a restart of the controller. Declarations of programs are lost."""
        self.installed_payload, self.installed_gravity = before.installed_payload, before.installed_gravity
        self.declare(payload=self.installed_payload, gravity=self.installed_gravity)

    def target_moment(self, reference: Reference) -> Array:
        """(J,) torque that the rigid-body model needs at the targets, without friction [N·m]."""
        return self._dynamics.torque(reference.q, reference.qd, reference.qdd)


class InverseDynamics:
    """Inverse dynamics of one model. The last result is kept, since two variables ask for it in each control period."""

    def __init__(self, model: "pin.Model") -> None:
        self._model, self._data = model, model.createData()
        self._arguments: tuple[Array, Array, Array] = (np.empty(0),) * 3
        self._torque: Array = np.zeros(model.nv)

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """(J,) torque at a state, each argument (J,) [N·m]."""
        last = self._arguments
        if last[0] is not q or last[1] is not qd or last[2] is not qdd:
            self._torque = pin.rnea(self._model, self._data, q, qd, qdd).copy()
            self._arguments = (q, qd, qdd)
        return self._torque


# --- What a controller measures: sensor readings, their history, and encoders whose zeros may have moved ---

HISTORY_TICKS = 1024  # positions kept for get_actual_joint_positions_history


class Measurements:
    """Reads one arm through its sensors. `latest` holds the newest reading."""

    def __init__(self, arm: Arm, sensors: Sensors) -> None:
        self._arm = arm
        self.sensors = sensors
        self.history: deque[Array] = deque([arm.q], maxlen=HISTORY_TICKS)
        self.latest = sensors.read(arm)
        self.encoder_offset_rad: Array = np.zeros_like(arm.q)  # (J,) encoder position minus true position
        self._shifted = False

    def read(self) -> None:
        """Measure the present state."""
        self.latest = self.sensors.read(self._arm)

    def record(self) -> None:
        """Measure the present state and append the position to the history."""
        self.read()
        self.history.append(self.latest.q)

    def shift_encoders(self, offset_rad: Array) -> None:
        """Add an offset (J,) to what the encoders show. The arm stays where it is."""
        self.encoder_offset_rad = self.encoder_offset_rad + offset_rad
        self._shifted = bool(self.encoder_offset_rad.any())
        self.sensors.faults.encoder_offset_rad = self.encoder_offset_rad if self._shifted else None

    @property
    def encoder_q(self) -> Array:
        """(J,) position of the arm as the encoders show it, without noise [rad]."""
        shown = self._arm.encoders()[0]
        return shown + self.encoder_offset_rad if self._shifted else shown

    def true_target(self, target: Target) -> Target:
        """Where the servo drives the arm: the encoder offset subtracted from the target."""
        return target._replace(q=target.q - self.encoder_offset_rad) if self._shifted else target

    def take_over(self, before: "Measurements") -> None:
        """Keep the faults of the sensors and the encoder offset of the controller that ran before on the same arm."""
        self.sensors.faults = before.sensors.faults
        self.encoder_offset_rad, self._shifted = before.encoder_offset_rad, before._shifted


# --- The parts of a controller that programs read and move, and the watchdog of a program ---------------

STANDING_RAD_S = 0.01  # below this speed the arm stands: the servo still settles by microradians


class Watchdog:
    """Expires when a watched input has not arrived for too long."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.variable: str | None = None  # the watched input; None if nothing is watched
        self.limit_s, self._fed_at_s = math.inf, 0.0
        self.action = "stop"  # what happens to the program: "stop" or "pause"
        self.dead = False  # a watchdog that is acknowledged and never expires

    def watch(self, variable: str, min_frequency_hz: float, action: str = "stop") -> None:
        """Expire when this input has not arrived for one period of this frequency. The action "ignore" ends the watch."""
        if action == "ignore":
            self.clear()
            return
        self.action = action
        self.variable, self.limit_s = variable, 1.0 / min_frequency_hz
        self.feed()

    def feed(self) -> None:
        """Begin the time limit again."""
        self._fed_at_s = self._clock.now_s

    def received(self, names: Collection[str]) -> None:
        """Begin the time limit again if the watched input is among the names."""
        if self.variable in names:
            self.feed()

    def clear(self) -> None:
        """Watch nothing."""
        self.variable, self.limit_s = None, math.inf

    @property
    def expired(self) -> bool:
        """Whether the watched input is overdue."""
        return not self.dead and self.variable is not None and self._clock.now_s - self._fed_at_s > self.limit_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """One controller, as its programs see it."""

    settings: SimulateSettings
    personality: Personality
    robot: Robot
    arm: Arm
    clock: Clock
    modes: Modes
    registers: Registers
    measurements: Measurements
    reference: Reference
    kinematics: Kinematics
    limits: Limits
    moves: Moves
    compliance: Compliance
    installation: Installation
    journal: Journal
    watchdog: Watchdog
    supervisor: Supervisor

    @property
    def standing(self) -> bool:
        """Whether nothing is asked of the arm and the arm has come to rest."""
        return self.reference.at_rest and not np.any(np.abs(self.arm.qd) > STANDING_RAD_S)
