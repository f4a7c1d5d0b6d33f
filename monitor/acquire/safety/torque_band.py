"""The torque band of a first pass: measured torque that leaves it means that something is in the way of the arm.

The middle of the band is the torque that the temperature-compensated model predicts, where such a model exists. Otherwise it is the
torque by the manufacturer's parameters and the configured payload; friction is unknown then, so a larger difference is allowed.
"""

from typing import NamedTuple

import numpy as np

from monitor.acquire.rows import COLUMN
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.judge.torque.predictor import predictor_for
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array

OUTSIDE_S = 0.04  # torque must be outside for so long, five rows at 125 Hz: a spike of the measured current is no collision
SIGMAS = 6.0  # standard deviations of one measured sample: by chance alone a sound arm leaves the band once in years
LEAST_CURRENT_A = 0.2  # the gain of a joint is computed from target currents above this; smaller ones are too imprecise
STILL_RAD_S = 0.02  # below this speed static friction may hold a joint in either direction, and no model predicts its torque
BREAKAWAY = 1.5  # static friction over friction at STILL_RAD_S; measured values of harmonic drives are 1.1 to 1.3
LEAST_SHARE = 0.05  # of a joint's largest torque is always allowed: even a precise model does not know the torque ripple


class _Band(NamedTuple):
    """The band at one row."""

    predicted: Array  # (J,) [N·m] its middle
    allowed: Array  # (J,) [N·m] half its width


class TorqueBand:
    """Compares measured with predicted torque, row by row."""

    def __init__(
        self,
        robot: Robot,
        mounting: Mounting,
        *,
        payload_kg: float,
        gains_nm_per_a: Array,
        share: float,
        rate_hz: float,
        model: CompensatedModel | None = None,
    ) -> None:
        """Prepare the comparison.

        gains_nm_per_a : (J,) drive gains; where one is unknown (NaN) it is taken from the rows, as target moment over target current.
        share : of a joint's largest torque that is allowed where no model is known.
        """
        import pinocchio as pin

        self._robot, self._share, self._model = robot, share, model
        self._gains = np.array(gains_nm_per_a, dtype=float)
        self._unknown_gains = np.isnan(self._gains)
        self._rows = max(2, round(OUTSIDE_S * rate_hz))
        self._outside = np.zeros(robot.joints, dtype=int)  # successive rows
        self._arm = robot.pinocchio_model(mounting)
        if payload_kg > 0.0:  # its centre of mass is unknown: the flange is near enough for the allowance
            flange = self._arm.frames[self._arm.getFrameId(f"dh_{robot.joints}")].placement
            self._arm.appendBodyToJoint(robot.joints, pin.Inertia(payload_kg, np.zeros(3), np.zeros((3, 3))), flange)
        self._data = self._arm.createData()
        self._rnea = pin.rnea
        self.largest_share = 0.0  # largest difference so far, as a share of what is allowed

    @property
    def description(self) -> str:
        """What the band is made of, for a message."""
        if self._model is not None:
            return (
                f"the model of {self._model.revision} replays ± {SIGMAS:g} σ, at least {100 * LEAST_SHARE:g} % of a joint's largest torque"
            )
        return f"the manufacturer's parameters ± {100 * self._share:g} % of a joint's largest torque"

    def outside(self, row: Array) -> tuple[str, str] | None:
        """Cause and text where torque has been outside the band for OUTSIDE_S; else None. Call it with every row (WIDTH,) in turn."""
        of = {name: row[COLUMN[name]] for name in ("actual_q", "actual_qd", "target_qdd", "actual_current", "joint_temperatures")}
        if self._unknown_gains.any():
            moment, current = row[COLUMN["target_moment"]], row[COLUMN["target_current"]]
            known_now = self._unknown_gains & (np.abs(current) > LEAST_CURRENT_A)
            self._gains[known_now] = np.abs(moment[known_now] / current[known_now])
        measured = of["actual_current"] * self._gains
        band = self._at(of["actual_q"], of["actual_qd"], of["target_qdd"], of["joint_temperatures"])
        used = np.abs(measured - band.predicted) / band.allowed
        self.largest_share = max(self.largest_share, float(np.nanmax(used, initial=0.0)))
        # a joint without a gain counts as inside; a measured current that is NaN counts as outside
        self._outside = np.where(~(used <= 1.0) & ~np.isnan(self._gains), self._outside + 1, 0)
        j = int(np.argmax(self._outside))
        if self._outside[j] < self._rows:
            return None
        return (
            "torque_band",
            f"joint {j + 1} needs {measured[j]:.1f} N·m where {band.predicted[j]:.1f} ± {band.allowed[j]:.1f} were expected "
            f"({self.description})",
        )

    def _at(self, q: Array, qd: Array, qdd: Array, temperature_c: Array) -> _Band:
        """The band in one state of the arm; all (J,)."""
        most = self._robot.max_torque_nm
        if self._model is not None and np.all(np.isfinite(temperature_c)):
            still = np.abs(qd) < STILL_RAD_S
            sliding_qd = np.where(still, STILL_RAD_S, qd)
            found = predictor_for(self._model, self._robot).sample(*(x.tolist() for x in (q, sliding_qd, qdd, temperature_c)))
            friction, std = np.array(found.friction), np.nan_to_num(found.measured_std, nan=np.inf)
            allowed = np.maximum(SIGMAS * std, LEAST_SHARE * most) + np.where(still, BREAKAWAY * friction, 0.0)
            return _Band(np.array(found.rigid) + np.where(still, 0.0, friction), np.minimum(allowed, self._share * most))
        predicted: Array = self._rnea(self._arm, self._data, q, qd, qdd)
        return _Band(predicted.copy(), self._share * most)
