"""What makes an arm give way: force control along one direction, and freedrive."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.physics import Arm
from monitor.simulate.arm.reference import Reference
from monitor.simulate.controller.identity.personality import Personality

FORCE_GAIN_M_S_N = 6e-4  # speed of the tool for each newton that is missing
FRICTION_HELP = 0.7  # share of its own model of friction that the controller adds in freedrive, so that the arm is light


@dataclass(frozen=True, slots=True)
class Comply:
    """A force_mode along one direction of the base: the tool presses with this force [N], and gives way no faster than this [m/s]."""

    direction: tuple[float, float, float]  # of length 1
    force_n: float
    speed_max_m_s: float = 0.05


class Giving:
    """Force control and freedrive of one arm; a controller without them holds its path."""

    def __init__(self, arm: Arm, reference: Reference, kinematics: Kinematics, personality: Personality) -> None:
        self._arm, self._reference, self._kinematics, self._personality = arm, reference, kinematics, personality
        self._comply: Comply | None = None
        self.freedrive = False
        self.felt_n: Array = np.zeros(3)  # (3,) force from outside at the tool, along the axes of the base

    def comply(self, comply: Comply | None) -> None:
        """Begin force control, or end it with None: the next move begins where the arm has been led."""
        self._comply = comply
        if comply is None:
            self._reference.keep()

    def end(self) -> None:
        """Hold the path again: the program has ended."""
        self.freedrive = False
        if self._comply is not None:
            self.comply(None)

    @property
    def any(self) -> bool:
        """Whether the arm gives way."""
        return self.freedrive or self._comply is not None

    def step(self, tick_s: float, substeps: int, encoder_q: Array) -> bool:
        """Give way for one control period. Returns whether that moved the arm, so that its servo must not."""
        if self.freedrive:
            arm = self._arm
            for _ in range(substeps):
                gravity = pin.computeGeneralizedGravity(arm.assumed_model, arm.assumed_model.createData(), arm.q)
                arm.push(tick_s / substeps, gravity + FRICTION_HELP * self._personality.target_friction_nm(arm.qd))
            self._reference.reset(encoder_q)
            return True
        if self._comply is not None:
            direction = np.array(self._comply.direction)
            missing = self._comply.force_n + float(direction @ self.felt_n)  # what is felt pushes back
            speed = float(np.clip(FORCE_GAIN_M_S_N * missing, -self._comply.speed_max_m_s, self._comply.speed_max_m_s))
            twist = np.concatenate([speed * direction, np.zeros(3)])
            self._reference.give(tick_s * self._kinematics.towards(self._reference.q, twist))
        return False
