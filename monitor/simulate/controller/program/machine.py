"""The parts of a controller that programs read and move, and the watchdog of a program."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from monitor.model.robot import Robot
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.limits import Limits
from monitor.simulate.arm.physics import Arm
from monitor.simulate.arm.reference import Reference
from monitor.simulate.controller.clock import Clock
from monitor.simulate.controller.giving import Giving
from monitor.simulate.controller.identity.personality import Personality
from monitor.simulate.controller.installation import Installation
from monitor.simulate.controller.journal import Journal
from monitor.simulate.controller.measurements import Measurements
from monitor.simulate.controller.modes import Modes, Supervisor
from monitor.simulate.controller.moves import Moves
from monitor.simulate.controller.registers import Registers
from monitor.simulate.settings import SimulateSettings

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

    def revive(self) -> None:
        """Expire again as asked."""
        self.dead = False

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
    giving: Giving
    installation: Installation
    journal: Journal
    watchdog: Watchdog
    supervisor: Supervisor

    @property
    def standing(self) -> bool:
        """Whether nothing is asked of the arm and the arm has come to rest."""
        return self.reference.at_rest and not np.any(np.abs(self.arm.qd) > STANDING_RAD_S)
