"""Prediction of joint torque by a compensated model. What does not depend on the state is computed once, so a prediction is fast."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.judge.torque.pointwise import UNKNOWN, PointLaw, point_law
from monitor.judge.torque.rigid import RigidTorque
from monitor.model.friction import SIGN_SPEED_RAD_S, smooth_sign
from monitor.model.robot import Robot
from monitor.recording import Array

MAX_REDUCTION = 0.95  # share of fc and fv that negative residual friction may cancel: friction never drives a joint


class TorquePrediction(NamedTuple):
    """Joint torque and its parts, (N, J) each [N·m]; standard deviations are NaN where a joint's friction was never identified."""

    torque: Array
    rigid: Array
    friction: Array
    std: Array  # of the torque itself
    extrapolated: np.ndarray  # (N, J) whether the temperature is outside the learned range
    measured_std: Array  # of one measured sample of the torque


class SamplePrediction(NamedTuple):
    """The fields of `TorquePrediction` for one sample, J plain numbers each."""

    torque: list[float]
    rigid: list[float]
    friction: list[float]
    std: list[float]
    extrapolated: list[bool]
    measured_std: list[float]


class _JointFigures(NamedTuple):
    """One joint's part of the model as plain numbers. The order of the fields is that in which `Predictor.sample` unpacks them."""

    coulomb: PointLaw
    viscous: PointLaw
    wear_factor: float
    double_correlation: float
    wear_var: float
    error_var: float
    coldest_c: float
    warmest_c: float
    unknown: bool
    noise_var: float
    residual: tuple[list[float], float, float, float] | tuple[()]  # K terms, largest speed, largest load, rotor inertia; or none


class Predictor:
    """Torque of one arm at any state and joint temperature; immutable, shared by threads."""

    def __init__(self, model: CompensatedModel, robot: Robot) -> None:
        """Raises BadInput where the model is another robot's."""
        if robot.name != model.robot:
            raise BadInput(f"the model is of {model.robot}, the robot is {robot.name}")
        self._rigid = RigidTorque(robot, model.mounting, model.columns, model.values)
        self._laws = model.coulomb, model.viscous
        self._known = np.isfinite(model.coulomb.intercept) & np.isfinite(model.viscous.intercept)  # (J,)
        self._wear_factor = np.exp(model.wear)
        self._double_correlation = 2.0 * model.friction_correlation
        error_nm, sample_nm = (model.residual_rms_nm if of is None else of for of in (model.error_rms_nm, model.measured_rms_nm))
        self._wear_var, self._error_var = model.wear_std**2, error_nm**2
        self._noise_var = np.maximum(sample_nm**2 - self._error_var, 0.0)  # NaN stays NaN
        low, high = model.viscous.range_c.T
        self._range_c = low - model.viscous.margin_k, high + model.viscous.margin_k
        self._unknown = ~self._known | ~np.isfinite(low) | ~np.isfinite(high)  # no temperature has been learned
        self._residual = residual = model.residual_friction
        if residual is not None:
            at_c = np.where(np.isfinite(residual.temperature_c), residual.temperature_c, model.viscous.reference_c)
            viscous = self._coefficients(at_c)[0][1]
            self._per_viscous = np.divide(1.0, viscous, out=np.zeros_like(viscous), where=viscous > 0)  # (J,) 1/fv(T₁)
        self._joints = self._figures()

    def _figures(self) -> list[_JointFigures]:
        """The model of every joint as plain numbers, for `sample`."""
        laws = [[point_law(law, j) if known else UNKNOWN for j, known in enumerate(self._known.tolist())] for law in self._laws]
        arrays = (
            self._wear_factor,
            self._double_correlation,
            self._wear_var,
            self._error_var,
            *self._range_c,
            self._unknown,
            self._noise_var,
        )  # (J,) each
        residual = [()] * len(self._known)
        if self._residual is not None:
            terms = (self._residual.terms * self._per_viscous[:, None]).tolist()  # J lists of K
            limits = (part.tolist() for part in (self._residual.speed_rad_s, self._residual.load_nm, self._rigid.rotor))
            residual = list(zip(terms, *limits, strict=True))
        return [_JointFigures(*joint) for joint in zip(*laws, *(part.tolist() for part in arrays), residual, strict=True)]

    def _coefficients(self, temperature_c: Array) -> tuple[Array, Array]:
        """Fc and fv with present wear at temperatures (…, J), and their variances, (2, …, J) each; 0 and NaN where unknown."""
        fresh = [law.at(temperature_c) for law in self._laws]
        value = np.where(self._known, np.stack([law.value for law in fresh]) * self._wear_factor, 0.0)
        std = np.where(self._known, np.stack([law.std for law in fresh]) * self._wear_factor, np.nan)
        return value, std * std

    def torque(self, q: Array, qd: Array, qdd: Array, temperature_c: Array) -> TorquePrediction:
        """The prediction at states q, qd, qdd (N, J) [rad, rad/s, rad/s²] and temperatures (N, J) or (J,) [°C], all of them finite."""
        rigid = self._rigid.torque(q, qd, qdd)
        value, var = self._coefficients(np.broadcast_to(temperature_c, q.shape))  # (2, N, J) each
        drive = np.empty((2, *q.shape))
        drive[0], drive[1] = smooth_sign(qd), qd
        parts = value * drive  # (2, N, J)
        friction = parts[0] + parts[1]
        residual = self._residual
        if residual is not None:
            speed = np.minimum(np.abs(qd), residual.speed_rad_s)
            load = np.minimum(np.abs(rigid - qdd * self._rigid.rotor), residual.load_nm)
            opposing = residual.law.opposing_torque(residual.terms.T[:, None], np.abs(drive[0]), speed, load)
            scaled = opposing * value[1] * self._per_viscous
            friction += np.sign(qd) * np.maximum(scaled, -MAX_REDUCTION * np.abs(friction))
        of_fc, of_fv = var * drive * drive  # variances, (N, J) each
        correlated = self._double_correlation * np.sqrt(of_fc * of_fv)
        total = of_fc + of_fv + correlated + friction * friction * self._wear_var + self._error_var
        low, high = self._range_c
        outside = np.broadcast_to((temperature_c < low) | (temperature_c > high) | self._unknown, q.shape)
        return TorquePrediction(rigid + friction, rigid, friction, np.sqrt(total), outside, np.sqrt(total + self._noise_var))

    def sample(self, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float], temperature_c: Sequence[float]) -> SamplePrediction:
        """`torque` of one sample, J finite numbers each.

        The formulas are those of `torque`. Plain numbers take a tenth of the time that arrays of six elements take.
        """
        rigid = self._rigid.sample(q, qd, qdd)
        torque, friction, stds, outside, measured = [], [], [], [], []
        for link, v, a, T, joint in zip(rigid, qd, qdd, temperature_c, self._joints, strict=True):
            coulomb, viscous, wear_factor, correlation, wear_var, error_var, coldest, warmest, unknown, noise_var, residual = joint
            s = math.tanh(v / SIGN_SPEED_RAD_S)
            fc, var_c = coulomb.at(T)
            fv, var_v = viscous.at(T)
            worn_s, worn_v = wear_factor * s, wear_factor * v
            resisting = fc * worn_s + fv * worn_v
            var_c *= worn_s * worn_s  # NaN where unknown
            var_v *= worn_v * worn_v
            if residual:
                resisting += self._residual_at_point(residual, s, v, abs(link - a * residual[3]), fv * wear_factor, resisting)
            torque.append(link + resisting)
            friction.append(resisting)
            var = var_c + var_v + correlation * math.sqrt(var_c * var_v) + resisting * resisting * wear_var + error_var
            stds.append(math.sqrt(var))
            measured.append(math.sqrt(var + noise_var))
            outside.append(unknown or not coldest <= T <= warmest)
        return SamplePrediction(torque, rigid, friction, stds, outside, measured)

    def _residual_at_point(
        self, residual: tuple[list[float], float, float, float], s: float, v: float, load: float, viscous: float, resisting: float
    ) -> float:
        """Residual friction of one joint at one sample, with the sign of its speed v [N·m]; resisting : friction by fc and fv."""
        assert self._residual is not None
        terms, fastest, heaviest, _ = residual
        speed = abs(v)
        speed, load = fastest if speed > fastest else speed, heaviest if load > heaviest else load
        opposing = self._residual.law.opposing_torque_at_point(terms, abs(s), speed, load) * viscous
        least = -MAX_REDUCTION * abs(resisting)
        return math.copysign(1.0, v) * (least if opposing < least else opposing)


@lru_cache(maxsize=8)
def predictor_for(model: CompensatedModel, robot: Robot) -> Predictor:
    """The predictor of a model. Models and robots are immutable, so the cache knows them by identity. Raises BadInput as `Predictor`."""
    return Predictor(model, robot)


def predict_torque(
    model: CompensatedModel, robot: Robot, q: Array, qd: Array, qdd: Array, temperature_c: Array | None = None
) -> TorquePrediction:
    """Predicted joint torque at given states and joint temperatures.

    q, qd, qdd : (N, J) or (J,) [rad, rad/s, rad/s²]; temperature_c : (N, J) or (J,) [°C], None for the reference temperature.
    Raises BadInput for another robot, shapes that do not fit, or values that are not finite.
    """
    predictor = predictor_for(model, robot)
    T = model.viscous.reference_c if temperature_c is None else np.asarray(temperature_c, dtype=float)
    q, qd, qdd = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (q, qd, qdd))
    for name, x in (("q", q), ("qd", qd), ("qdd", qdd), ("temperature_c", np.atleast_2d(T))):
        if x.ndim != 2 or x.shape[1] != model.joints or len(x) not in (len(q), 1 if name == "temperature_c" else len(q)):
            raise BadInput(f"{name} has shape {x.shape}; expected ({len(q)}, {model.joints}) like q, or ({model.joints},)")
        if not np.all(np.isfinite(x)):
            raise BadInput(f"{name} holds values that are not finite")
    return predictor.torque(q, qd, qdd, T)
