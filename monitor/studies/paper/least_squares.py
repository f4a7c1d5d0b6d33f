"""Least squares as the paper does it, and the comparison of its parameters with a simulated arm's own."""

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from monitor.identify.identification import Identification
from monitor.identify.signals.motion import Motion
from monitor.identify.signals.torque import joint_torque
from monitor.identify.validate import errors_of
from monitor.model.base import Base, base_parameters
from monitor.model.fourier import State
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.recording import Array
from monitor.simulate.controller.controller import Controller

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueError:
    """e_N = √(eᵀe)/N over all joints and samples, and the RMS of each joint over all samples."""

    normalised_nm: float
    rms_nm: Array  # (J,)


def torque_error(measured_nm: Array, predicted_nm: Array) -> TorqueError:
    """The error of a prediction; both (N, J). Samples at standstill count, as in the paper."""
    found = errors_of(measured_nm, predicted_nm, np.ones(measured_nm.shape, dtype=bool))
    return TorqueError(normalised_nm=found.normalised_error_nm, rms_nm=found.rms_all_nm)


def solved(moved: Motion, robot: Robot, weight: Array) -> tuple[float, Array]:
    """Least squares over the rows of each joint times its weight (J,): the time that solving takes [s], and the base parameters (B,)."""
    base = base_parameters(robot, Mounting())
    rows = (base_regressor(moved, robot) * weight[:, None]).reshape(-1, base.count)  # (N·J, B)
    torque = (joint_torque(moved, robot) * weight).ravel()
    began = time.perf_counter()
    values = np.linalg.lstsq(rows, torque, rcond=None)[0].astype(float)
    return time.perf_counter() - began, values


def base_regressor(moved: Motion, robot: Robot) -> Array:
    """(N, J, B) on the ground. The direction in the column of fc is filtered like the measured torque."""
    base = base_parameters(robot, Mounting())
    Y = regressor(robot, Mounting(), moved.q, moved.qd, moved.qdd)  # (N, J, P)
    Y[:, np.arange(robot.joints), friction_columns(robot.joints)[0]] = moved.direction
    return Y[:, :, list(base.columns)]


def predictions(moved: Motion, robot: Robot, ls: Identification, weighted: Array, own: Identification) -> dict[str, Array]:
    """Torque along a motion (N, J) from the manufacturer's data alone, by LS, by the paper's WLS (B,), and by the monitor's own method."""
    nominal = regressor(robot, Mounting(), moved.q, moved.qd, moved.qdd) @ robot.nominal_parameters()
    Y = base_regressor(moved, robot)
    return {"before": nominal, "LS": Y @ ls.values, "WLS": Y @ weighted, "own": Y @ own.values}


def true_parameters(robot: Robot, base: Base, arm: Controller) -> Array:
    """(B,) base parameters of the simulated arm; NaN for fc and fv, because its friction follows another law."""
    standard = robot.nominal_parameters(with_inertia=True).reshape(robot.joints, PER_JOINT)
    standard[:, PER_JOINT - 1] = arm.arm.rotor_kg_m2
    values: Array = base.combination @ standard.ravel()
    return np.where(_is_friction(base.columns, robot), np.nan, values)


def rigid_drift(cold: Identification, warm: Identification, robot: Robot, path: State) -> tuple[Array, float]:
    """How much the rigid parameters differ between the cold and the warm identification.

    Returns the difference of each over its standard deviation (B,), NaN for friction; and the torque of all differences along the path,
    as RMS over the RMS of the whole torque.
    """
    friction = _is_friction(cold.columns, robot)
    change = np.where(friction, 0.0, warm.values - cold.values)
    deviation = np.sqrt(np.diag(cold.covariance) + np.diag(warm.covariance))
    Y = regressor(robot, cold.mounting, *path)[:, :, list(cold.columns)]
    moved, whole = Y @ change, Y @ cold.values
    return np.where(friction, np.nan, change / deviation), float(np.sqrt(np.mean(moved**2) / np.mean(whole**2)))


def _is_friction(columns: tuple[int, ...], robot: Robot) -> Mask:
    """(B,) whether each base parameter is led by fc or fv."""
    return np.isin(np.array(columns), np.concatenate(friction_columns(robot.joints)))
