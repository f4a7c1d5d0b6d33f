"""What a controller measures: sensor readings, their history, and encoders whose zeros may have moved."""

from collections import deque

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm.physics import Arm, Target
from monitor.simulate.arm.sensors import Sensors

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
        return self._arm.q + self.encoder_offset_rad if self._shifted else self._arm.q

    def true_target(self, target: Target) -> Target:
        """Where the servo drives the arm: the encoder offset subtracted from the target."""
        return target._replace(q=target.q - self.encoder_offset_rad) if self._shifted else target

    def take_over(self, before: "Measurements") -> None:
        """Keep the faults of the sensors and the encoder offset of the controller that ran before on the same arm."""
        self.sensors.faults = before.sensors.faults
        self.encoder_offset_rad, self._shifted = before.encoder_offset_rad, before._shifted
