"""How informative a motion is: figures of merit of its regressor, and the expected standard deviations of friction.

The figures for weighted estimates divide each joint's rows by its torque noise, and leave out the samples in which the joint stands still,
as the default method of `identify` does.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.model.base import base_parameters
from monitor.model.fourier import Excitation
from monitor.model.friction import STANDSTILL_SPEED_RAD_S
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.recording import Array

OBJECTIVES = ("friction", "condition", "scaled", "dopt")
REPORT_RATE_HZ = 125.0  # of the samples for which the figures are reported
# torque noise as a fraction of the torque limit, for large joints and wrists: the residual of identified models of real UR arms
NOISE_SHARE = (0.007, 0.0035)
LARGE_JOINTS = 3
CORRELATION_S = 0.2  # time constant of the residuals' correlation e^(−τ/0.2 s): gone after half a second, as on real arms
# nominal friction for the check of torque limits, where no identification is given: Coulomb torque as a fraction of the torque limit,
# and viscous friction as a fraction of the torque limit per rad/s
COULOMB_SHARE, VISCOUS_SHARE = 0.065, 0.065  # [1], [s/rad]


class Merits(NamedTuple):
    """Four figures of merit. Smaller is better; infinite where the motion does not excite some parameter."""

    condition: float  # the paper's: cond(Y_B) in SI units, over all samples
    scaled: float  # the same with columns of unit length
    dopt: float  # log det of the covariance of all base parameters, for one repetition with white noise
    friction: float  # log det of the covariance of all fc and fv, for correlated noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Information:
    """Everything that is needed to compute figures of merit for one arm on one mounting."""

    robot: Robot
    mounting: Mounting
    columns: tuple[int, ...]  # (B,) of the base parameters, friction last
    friction: int  # number of friction parameters: fc1…fcJ, fv1…fvJ
    parameters: Array  # (13·J,) nominal standard parameters, for the torque
    noise_nm: Array  # (J,) standard deviation of torque noise

    def rows(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """Y_B (J, B, N) and the torque of the nominal model (N, J) [N·m], at the motors, of a state of the joints, each (N, J)."""
        at_motors = (self.robot.motors_of(x) for x in (q, qd, qdd))
        Y = regressor(self.robot, self.mounting, *at_motors).transpose(1, 2, 0)  # (J, P, N), contiguous
        torque: Array = np.einsum("jpn,p->nj", Y, self.parameters)
        return Y[:, list(self.columns)], torque

    def _weighted(self, Y: Array, qd: Array) -> Array:
        """(B, B) Fisher information for white noise: Σ YᵀY/σ² over the moving samples."""
        A = self._rows_over_noise(Y, qd).transpose(1, 0, 2).reshape(len(self.columns), -1)
        gram: Array = A @ A.T
        return gram

    def _covariance(self, Y: Array, qd: Array, duration_s: float) -> Array | None:
        """(B, B) covariance of the weighted estimate under correlated noise; None where the motion does not excite every parameter.

        The estimator's weights assume white noise, so its covariance is the sandwich G⁻¹ (Aᵀ R A) G⁻¹. A are the rows over the noise's
        standard deviation, G = AᵀA, and R is the true correlation e^(−τ/0.2 s). The motion is periodic, so R is circulant, and the Fourier
        transform diagonalises it.
        """
        A = self._rows_over_noise(Y, qd)  # (J, B, N)
        N = len(qd)
        lag_s = np.minimum(np.arange(N), N - np.arange(N)) * (duration_s / N)
        spectrum = np.fft.rfft(np.exp(-lag_s / CORRELATION_S)).real
        smeared = np.fft.irfft(np.fft.rfft(A) * spectrum, n=N)  # R A
        flat, B = A.transpose(1, 0, 2).reshape(A.shape[1], -1), A.shape[1]
        gram, norms = _scaled(flat @ flat.T)
        try:
            np.linalg.cholesky(gram)
        except np.linalg.LinAlgError:
            return None
        inverse = np.linalg.inv(gram) / np.outer(norms, norms)
        covariance: Array = inverse @ (flat @ smeared.transpose(1, 0, 2).reshape(B, -1).T) @ inverse
        return covariance

    def _rows_over_noise(self, Y: Array, qd: Array) -> Array:
        """(J, B, N) the rows over the noise's standard deviation; 0 where the motor stands still."""
        weight = (np.abs(self.robot.motors_of(qd)) > STANDSTILL_SPEED_RAD_S).T / self.noise_nm[:, None]  # (J, N)
        rows: Array = Y * weight[:, None, :]
        return rows

    def plain_gram(self, Y: Array) -> Array:
        """(B, B) ΣYᵀY over all samples."""
        A = Y.transpose(1, 0, 2).reshape(len(self.columns), -1)
        gram: Array = A @ A.T
        return gram

    def merit(self, objective: str, Y: Array, qd: Array, duration_s: float = 10.0) -> float:
        """One of the four figures, for a motion with rows Y (J, B, N) and speeds qd (N, J)."""
        if objective in {"condition", "scaled"}:
            gram = self.plain_gram(Y)
            if objective == "scaled":
                gram = _scaled(gram)[0]
            sigma2 = np.linalg.eigvalsh(gram)
            return math.sqrt(sigma2[-1] / sigma2[0]) if sigma2[0] > 1e-15 * sigma2[-1] else math.inf
        if objective == "friction":
            covariance = self._covariance(Y, qd, duration_s)
            return math.inf if covariance is None else float(np.linalg.slogdet(covariance[-self.friction :, -self.friction :])[1])
        per_sample = duration_s * REPORT_RATE_HZ / len(qd)  # samples of the controller for each sample here
        scaled, norms = _scaled(self._weighted(Y, qd) * per_sample)
        try:
            L = np.linalg.cholesky(scaled)
        except np.linalg.LinAlgError:
            return math.inf
        return float(-2.0 * np.sum(np.log(np.diag(L) * norms)))

    def merits(self, excitation: Excitation) -> Merits:
        """All four figures, for one repetition at 125 Hz."""
        qd, Y = self._played(excitation)
        return Merits(**{name: self.merit(name, Y, qd, excitation.pass_s) for name in OBJECTIVES})

    def friction_std(self, excitation: Excitation, repetitions: int = 1) -> tuple[Array, Array]:
        """Expected standard deviations of fc [N·m] and fv [N·m·s/rad], each (J,), with residuals correlated as on real arms.

        More repetitions reduce them only as far as the residual is noise. The error of a friction law is the same in every repetition.
        """
        qd, Y = self._played(excitation)
        J = Y.shape[0]
        covariance = self._covariance(Y, qd, excitation.pass_s)
        if covariance is None:
            return np.full(J, np.inf), np.full(J, np.inf)
        std = np.sqrt(np.diag(covariance)[-self.friction :] / repetitions)
        return std[:J], std[J:]

    def document(self, excitation: Excitation) -> dict[str, Any]:
        """All figures as a JSON object; null for a figure that is not finite."""
        merits = self.merits(excitation)
        fc_std, fv_std = self.friction_std(excitation)
        _, state = excitation.sampled(REPORT_RATE_HZ)
        speed = np.abs(self.robot.motors_of(state.qd))  # friction acts there
        moving = np.where(speed > STANDSTILL_SPEED_RAD_S, speed, np.nan)
        return {
            "condition_number": _plain(merits.condition),
            "scaled_condition_number": _plain(merits.scaled),
            "log_det_covariance_all": _plain(merits.dopt),
            "log_det_covariance_friction": _plain(merits.friction),
            "repetitions": 1,
            "coulomb_std_nm": [_plain(value) for value in fc_std],
            "viscous_std_nm_s_per_rad": [_plain(value) for value in fv_std],
            "speed_range_rad_s": [[_plain(low), _plain(high)] for low, high in np.nanpercentile(moving, [5.0, 100.0], axis=0).T],
            "moving_share": [_plain(value) for value in np.mean(speed > STANDSTILL_SPEED_RAD_S, axis=0)],
            "noise_model": {
                "torque_std_nm": [_plain(value) for value in self.noise_nm],
                "correlation_s": CORRELATION_S,
                "rate_hz": REPORT_RATE_HZ,
            },
        }

    def _played(self, excitation: Excitation) -> tuple[Array, Array]:
        """The rows (J, B, N) and speeds (N, J) of one repetition at 125 Hz."""
        t_s = np.arange(round(excitation.pass_s * REPORT_RATE_HZ)) / REPORT_RATE_HZ
        state = excitation.at(t_s)
        return state.qd, self.rows(*state)[0]


def information(robot: Robot, mounting: Mounting, *, noise_nm: Array | None = None, parameters: Array | None = None) -> Information:
    """The `Information` of an arm.

    noise_nm : (J,) standard deviation of the joint torque; None: the fractions above. parameters : (13·J,) standard parameters of the
    present model, friction included; None: the manufacturer's masses with a nominal friction.
    Raises BadInput where a shape or value is wrong.
    """
    J = robot.joints
    if noise_nm is None:
        noise_nm = robot.max_torque_nm * np.where(np.arange(J) < LARGE_JOINTS, *NOISE_SHARE)
    if noise_nm.shape != (J,) or not np.all((noise_nm > 0.0) & np.isfinite(noise_nm)):
        raise BadInput(f"noise = {noise_nm.tolist()}; expected {J} positive torques in N·m")
    fc, fv = friction_columns(J)
    if parameters is None:
        parameters = robot.nominal_parameters(with_inertia=True)
        parameters[fc], parameters[fv] = COULOMB_SHARE * robot.max_torque_nm, VISCOUS_SHARE * robot.max_torque_nm
    if parameters.shape != (PER_JOINT * J,) or not np.all(np.isfinite(parameters)):
        raise BadInput(f"parameters have shape {parameters.shape}; expected {PER_JOINT * J} finite standard parameters")
    friction = [*fc.tolist(), *fv.tolist()]
    rigid = [column for column in base_parameters(robot, mounting).columns if column not in friction]
    return Information(
        robot=robot, mounting=mounting, columns=(*rigid, *friction), friction=2 * J, parameters=parameters, noise_nm=noise_nm
    )


def _scaled(gram: Array) -> tuple[Array, Array]:
    """The matrix with a unit diagonal, and the lengths of the columns; a column of zeros has length 1."""
    norms = np.sqrt(np.diag(gram))
    norms = np.where(norms > 0.0, norms, 1.0)
    return gram / np.outer(norms, norms), norms


def _plain(value: float) -> float | None:
    """A figure for JSON: six digits, since the seventh differs between processors and libraries; None where it is not finite."""
    return float(f"{value:.6g}") if math.isfinite(value) else None
