"""Payload and mounting as the controller knows them, and the rigid-body model that it computes with."""

import numpy as np
import pinocchio as pin

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.physics import Arm, arm_model
from monitor.simulate.arm.reference import Reference
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
