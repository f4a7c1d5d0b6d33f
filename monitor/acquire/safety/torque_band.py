"""The band in which measured torque must stay while an arm plays a trajectory for the first time; outside it, something is in the way.

Predicted by the temperature-compensated model where one is known; else by the manufacturer's parameters and the configured payload,
whose friction is unknown: then every joint is allowed a stated share of its largest torque.
"""

from typing import NamedTuple

import numpy as np

from monitor.acquire.rows import COLUMN
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.judge.torque.predictor import predictor_for
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array

OUTSIDE_S = 0.04  # five rows at 125 Hz: a spike of the measured current is no collision
SIGMAS = 6.0  # of one measured sample from what replays foreseen have shown: chance alone leaves it once in years
TELLING_A = 0.2  # of predicted current: less than that times an unknown gain says nothing
STILL_RAD_S = 0.02  # slower, a joint may be held either way by all its friction: what it needs is told by no model
BREAKAWAY = 1.5  # times what it drags when it slides slowly; 1.1–1.3 on the harmonic drives that were measured
LEAST_SHARE = 0.05  # of a joint's largest torque: a model that is sure of itself still does not know its ripple


class _Band(NamedTuple):
    """One row's band."""

    predicted: Array  # (J,) [N·m]
    allowed: Array  # (J,) [N·m]


class TorqueBand:
    """Measured against predicted torque, row by row."""

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
        """`share`: of a joint's largest torque that is allowed where no model is known.

        gains_nm_per_a : (J,); where one is unknown (NaN) the controller's own model tells it, its moment over its current.
        """
        import pinocchio as pin

        self._robot, self._share, self._model = robot, share, model
        self._gains = np.array(gains_nm_per_a, dtype=float)
        self._untold = np.isnan(self._gains)
        self._rows = max(2, round(OUTSIDE_S * rate_hz))
        self._outside = np.zeros(robot.joints, dtype=int)  # successive rows
        self._arm = robot.pinocchio_model(mounting)
        if payload_kg > 0.0:  # where it hangs is not known: at the flange, within the allowance
            flange = self._arm.frames[self._arm.getFrameId(f"dh_{robot.joints}")].placement
            self._arm.appendBodyToJoint(robot.joints, pin.Inertia(payload_kg, np.zeros(3), np.zeros((3, 3))), flange)
        self._data = self._arm.createData()
        self._rnea = pin.rnea
        self.largest_share = 0.0  # of the allowance that was used

    @property
    def description(self) -> str:
        """Where the band comes from."""
        if self._model is not None:
            return (
                f"the model of {self._model.revision} replays ± {SIGMAS:g} σ, at least {100 * LEAST_SHARE:g} % of a joint's largest torque"
            )
        return f"the manufacturer's parameters ± {100 * self._share:g} % of a joint's largest torque"

    def outside(self, row: Array) -> tuple[str, str] | None:
        """Cause and text where torque has left the band for long enough; row (WIDTH,)."""
        of = {name: row[COLUMN[name]] for name in ("actual_q", "actual_qd", "target_qdd", "actual_current", "joint_temperatures")}
        if self._untold.any():
            moment, current = row[COLUMN["target_moment"]], row[COLUMN["target_current"]]
            tells = self._untold & (np.abs(current) > TELLING_A)
            self._gains[tells] = np.abs(moment[tells] / current[tells])
        measured = of["actual_current"] * self._gains
        band = self._at(of["actual_q"], of["actual_qd"], of["target_qdd"], of["joint_temperatures"])
        used = np.abs(measured - band.predicted) / band.allowed
        self.largest_share = max(self.largest_share, float(np.nanmax(used, initial=0.0)))
        # NaN of a gain that is not told yet is not outside; a current that is no number is
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
        most = self._robot.max_torque_nm
        if self._model is not None and np.all(np.isfinite(temperature_c)):
            still = np.abs(qd) < STILL_RAD_S
            slides = np.where(still, STILL_RAD_S, qd)
            found = predictor_for(self._model, self._robot).sample(*(x.tolist() for x in (q, slides, qdd, temperature_c)))
            friction, std = np.array(found.friction), np.nan_to_num(found.measured_std, nan=np.inf)
            allowed = np.maximum(SIGMAS * std, LEAST_SHARE * most) + np.where(still, BREAKAWAY * friction, 0.0)
            return _Band(np.array(found.rigid) + np.where(still, 0.0, friction), np.minimum(allowed, self._share * most))
        predicted: Array = self._rnea(self._arm, self._data, q, qd, qdd)
        return _Band(predicted.copy(), self._share * most)
