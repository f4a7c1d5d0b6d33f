"""The compensated model made ready for one arm, so that a question costs microseconds: what does not change is computed once.

Rigid torque is linear in the standard parameters, so pinocchio's recursive Newton–Euler in C++ gives it without the regressor. The
parameters are a regrouped set, no arm of its own: a link may have no mass but a first moment, and pinocchio stores a centre of mass.
So every link gets a point mass at its frame's origin, and the torque of those masses alone is taken off again.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.judge.torque.pointwise import UNKNOWN, point_law
from monitor.model.friction import SIGN_SPEED_RAD_S, smooth_sign
from monitor.model.regressor import ROTOR
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, Robot
from monitor.recording import Array

if TYPE_CHECKING:
    import pinocchio

LEAST_OFF = 0.95  # of fc and fv that what is beyond them may take off: friction never drives
LEAST_MASS_KG = 0.1  # of a link with its point mass: a centre of mass at mx/m keeps its digits
POINT_MASSES_KG = (10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 1280.0, 2560.0)  # J ≤ 8 links can rule out eight of these


class TorquePrediction(NamedTuple):
    """Joint torque and what it is made of, (N, J) each [N·m]; `std` is NaN where a joint's friction was never identified."""

    torque: Array
    rigid: Array
    friction: Array
    std: Array  # of the torque itself
    extrapolated: np.ndarray  # (N, J) the temperature is outside what was learnt
    measured_std: Array  # of one measured sample of it


class Sample(NamedTuple):
    """The same of one sample, as plain numbers: J each."""

    torque: list[float]
    rigid: list[float]
    friction: list[float]
    std: list[float]
    extrapolated: list[bool]
    measured_std: list[float]


class Predictor:
    """Torque of one arm at any state and joint temperature; immutable, shared by threads."""

    def __init__(self, model: CompensatedModel, robot: Robot) -> None:
        """Raises BadInput where the model is another robot's."""
        if robot.name != model.robot:
            raise BadInput(f"the model is of {model.robot}, the robot is {robot.name}")
        self._rigid = _Rigid(robot, model.mounting, model.columns, model.values)
        self._lines = model.coulomb, model.viscous
        unknown = ~np.isfinite(model.coulomb.intercept) | ~np.isfinite(model.viscous.intercept)  # (J,)
        self._known, self._worn = ~unknown, np.exp(model.wear)
        self._correlation = 2.0 * model.friction_correlation
        error_nm, sample_nm = (model.residual_rms_nm if of is None else of for of in (model.error_rms_nm, model.measured_rms_nm))
        self._wear_var, self._rest_var = model.wear_std**2, error_nm**2
        self._noise_var = np.maximum(sample_nm**2 - self._rest_var, 0.0)  # NaN stays
        low, high = model.viscous.range_c.T
        self._range_c = low - model.viscous.margin_k, high + model.viscous.margin_k
        self._beyond = None if model.residual_friction is None else model.residual_friction.terms.T[:, None]  # (K, 1, J)
        if model.residual_friction is not None:
            T1 = np.where(
                np.isfinite(model.residual_friction.temperature_c), model.residual_friction.temperature_c, model.viscous.reference_c
            )
            then = self._friction(T1)[0][1]
            self._per_viscous = np.divide(1.0, then, out=np.zeros_like(then), where=then > 0)  # (J,)
            self._law = model.residual_friction.law
            self._speed, self._load = model.residual_friction.speed_rad_s, model.residual_friction.load_nm
        self._unknown = unknown | ~np.isfinite(low) | ~np.isfinite(high)  # of no temperature at all
        whole: tuple[Array, ...] = (
            self._correlation,
            self._wear_var,
            self._rest_var,
            *self._range_c,
            self._unknown,
            self._noise_var,
        )  # (J,) each
        residual_friction = [()] * len(self._worn)
        if model.residual_friction is not None:
            scaled = (model.residual_friction.terms * self._per_viscous[:, None]).tolist()  # J lists of K
            limits = (part.tolist() for part in (self._speed, self._load, self._rigid.rotor))
            residual_friction = list(zip(scaled, *limits, strict=True))
        laws = [[point_law(line, j) if known else UNKNOWN for j, known in enumerate(self._known.tolist())] for line in self._lines]
        self._figures = list(
            zip(*laws, self._worn.tolist(), *(part.tolist() for part in whole), residual_friction, strict=True)
        )  # J tuples

    def _friction(self, temperature_c: Array) -> tuple[Array, Array]:
        """With present wear, fc and fv at temperatures (…, J), and their variances, (2, …, J) each; 0 and NaN where unknown."""
        fresh = [line.at(temperature_c) for line in self._lines]
        value = np.where(self._known, np.stack([law.value for law in fresh]) * self._worn, 0.0)
        std = np.where(self._known, np.stack([law.std for law in fresh]) * self._worn, np.nan)
        return value, std * std

    def torque(self, q: Array, qd: Array, qdd: Array, temperature_c: Array) -> TorquePrediction:
        """Everything at states q, qd, qdd (N, J) [rad, rad/s, rad/s²] and temperatures (N, J) or (J,), finite and of these shapes."""
        rigid = self._rigid.torque(q, qd, qdd)
        value, var = self._friction(np.broadcast_to(temperature_c, q.shape))  # (2, N, J) each; friction never drives
        drive = np.empty((2, *q.shape))
        drive[0], drive[1] = smooth_sign(qd), qd
        parts = value * drive  # (2, N, J)
        friction = parts[0] + parts[1]
        if self._beyond is not None:
            s, speed = np.abs(drive[0]), np.minimum(np.abs(qd), self._speed)
            load = np.minimum(np.abs(rigid - qdd * self._rigid.rotor), self._load)
            more = self._law.opposing_torque(self._beyond, s, speed, load) * value[1] * self._per_viscous
            friction += np.sign(qd) * np.maximum(more, -LEAST_OFF * np.abs(friction))
        of_fc, of_fv = var * drive * drive  # variances, (N, J) each
        total = of_fc + of_fv + self._correlation * np.sqrt(of_fc * of_fv) + friction * friction * self._wear_var + self._rest_var
        low, high = self._range_c
        outside = (temperature_c < low) | (temperature_c > high) | self._unknown
        if outside.shape != q.shape:
            outside = np.broadcast_to(outside, q.shape)
        return TorquePrediction(rigid + friction, rigid, friction, np.sqrt(total), outside, np.sqrt(total + self._noise_var))

    def sample(self, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float], temperature_c: Sequence[float]) -> Sample:
        """`torque` of one sample, J finite figures each. The same formulas on plain numbers: a tenth of the time of arrays of six."""
        rigid = self._rigid.sample(q, qd, qdd)
        torque, friction, stds, outside, measured = [], [], [], [], []
        for rest, v, a, T, figures in zip(rigid, qd, qdd, temperature_c, self._figures, strict=True):
            dry, wet, worn, correlation, wear_var, rest_var, low, high, unknown, noise_var, more = figures
            s = math.tanh(v / SIGN_SPEED_RAD_S)
            of_fc, var_c = dry.at(T)
            of_fv, var_v = wet.at(T)
            drags, flows = worn * s, worn * v
            viscous = of_fv * worn
            rubs = of_fc * drags + of_fv * flows
            var_c *= drags * drags  # what is unknown is NaN, and stays so
            var_v *= flows * flows
            if more:
                terms, fastest, heaviest, rotor = more
                speed, load = abs(v), abs(rest - a * rotor)
                speed, load = fastest if speed > fastest else speed, heaviest if load > heaviest else load
                beyond = self._law.opposing_torque_at_point(terms, abs(s), speed, load) * viscous
                least = -LEAST_OFF * abs(rubs)
                rubs += math.copysign(1.0, v) * (least if beyond < least else beyond)
            torque.append(rest + rubs)
            friction.append(rubs)
            var = var_c + var_v + correlation * math.sqrt(var_c * var_v) + rubs * rubs * wear_var + rest_var
            stds.append(math.sqrt(var))
            measured.append(math.sqrt(var + noise_var))
            outside.append(unknown or not low <= T <= high)
        return Sample(torque, rigid, friction, stds, outside, measured)


class _Rigid:
    """Torque of links and rotors with given standard parameters, by recursive Newton–Euler."""

    def __init__(self, robot: Robot, mounting: Mounting, columns: tuple[int, ...], values: Array) -> None:
        import pinocchio as pin  # 0.2 s: only where torque is asked for

        J = robot.joints
        self._rnea = pin.rnea
        parameters = np.zeros(PER_JOINT * J)
        parameters[list(columns)] = values
        blocks = parameters.reshape(J, PER_JOINT)
        self.rotor = blocks[:, ROTOR]  # (J,)
        self.rotors = self.rotor.tolist()
        masses = blocks[:, 0]
        more = next(mass for mass in POINT_MASSES_KG if np.all(np.abs(masses + mass) >= LEAST_MASS_KG))
        points = np.zeros((J, INERTIAL))
        points[:, 0] = more
        self._with, self._points = _arm(robot, mounting, blocks[:, :INERTIAL] + points), _arm(robot, mounting, points)
        self._data = self._with.createData(), self._points.createData()

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """(N, J) [N·m]."""
        # one call holds the interpreter's lock from its beginning until its result is copied: threads may share the workspace
        rnea, (whole, points), (of_whole, of_points) = self._rnea, (self._with, self._points), self._data
        torque = np.empty_like(q)
        for n in range(len(q)):
            state = q[n], qd[n], qdd[n]
            torque[n] = rnea(whole, of_whole, *state)
            torque[n] -= rnea(points, of_points, *state)
        torque += qdd * self.rotor
        return torque

    def sample(self, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float]) -> list[float]:
        """J figures [N·m]."""
        state = np.array(q, float), np.array(qd, float), np.array(qdd, float)
        whole = self._rnea(self._with, self._data[0], *state).tolist()
        points = self._rnea(self._points, self._data[1], *state).tolist()
        return [all_of_it - point + rotor * a for all_of_it, point, rotor, a in zip(whole, points, self.rotors, qdd, strict=True)]


def _arm(robot: Robot, mounting: Mounting, blocks: Array) -> "pinocchio.Model":
    """Pinocchio's model with these inertial parameters (J, 10), each about its link's DH origin, in the axes of the DH frame."""
    import pinocchio as pin

    model = robot.pinocchio_model(mounting)
    for i, (m, mx, my, mz, xx, xy, xz, yy, yz, zz) in enumerate(blocks.tolist()):
        to_dh = model.frames[model.getFrameId(f"dh_{i + 1}")].placement
        about_dh = pin.Inertia.FromDynamicParameters(np.array([m, mx, my, mz, xx, xy, yy, xz, yz, zz]))  # pinocchio's order
        model.inertias[i + 1] = to_dh.act(about_dh)
    return model


@lru_cache(maxsize=8)
def prepared(model: CompensatedModel, robot: Robot) -> Predictor:
    """The predictor of a model; models and robots are immutable, and known by identity. Raises BadInput as `Predictor`."""
    return Predictor(model, robot)


def predict_torque(
    model: CompensatedModel, robot: Robot, q: Array, qd: Array, qdd: Array, temperature_c: Array | None = None
) -> TorquePrediction:
    """Predicted joint torque at given states and joint temperatures.

    q, qd, qdd : (N, J) or (J,) [rad, rad/s, rad/s²]; temperature_c : (N, J) or (J,) [°C], None for the reference temperature.
    Raises BadInput for another robot, shapes that do not fit, or values that are not finite.
    """
    predictor = prepared(model, robot)
    T = model.viscous.reference_c if temperature_c is None else np.asarray(temperature_c, dtype=float)
    q, qd, qdd = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (q, qd, qdd))
    for name, x in (("q", q), ("qd", qd), ("qdd", qdd), ("temperature_c", np.atleast_2d(T))):
        if x.ndim != 2 or x.shape[1] != model.joints or len(x) not in (len(q), 1 if name == "temperature_c" else len(q)):
            raise BadInput(f"{name} has shape {x.shape}; expected ({len(q)}, {model.joints}) like q, or ({model.joints},)")
        if not np.all(np.isfinite(x)):
            raise BadInput(f"{name} holds values that are not finite")
    return predictor.torque(q, qd, qdd, T)
