"""Answers: queries' JSON → numbers checked for shape, finiteness and range → JSON. Pure; the bus and `predict` share it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.compensation import CompensatedModel
from monitor.judge.document import plain
from monitor.model.robot import Robot
from monitor.recording import Array

MOST_SAMPLES = 10_000
TEMPERATURE_RANGE_C = (-40.0, 120.0)  # beyond it a temperature is a mistake, not a climate


def torque_answer(model: CompensatedModel, robot: Robot, temperature_c: Array | None, request: Mapping[str, Any]) -> dict[str, Any]:
    """The `torque` query: temperature-corrected joint torque of one sample or of N.

    `q`, `qd` [rad, rad/s] are asked for; `qdd` [rad/s²] is 0 where not given, `temperature_c` the present one. Raises
    BadInput saying which argument is wrong, and how.
    """
    known = {"q", "qd", "qdd", "temperature_c"}
    for name in request:
        if name not in known:
            raise BadInput(f"torque: unknown argument {name!r}; known are {', '.join(sorted(known))}")
    joints = robot.joints
    q = _samples(request, "q", joints)
    single = q.ndim == 1
    q = np.atleast_2d(q)
    qd = _like(_samples(request, "qd", joints), "qd", q)
    qdd = _like(_samples(request, "qdd", joints), "qdd", q) if "qdd" in request else np.zeros_like(q)
    if "temperature_c" in request:
        temperature = _like(_samples(request, "temperature_c", joints), "temperature_c", q)
    elif temperature_c is not None:
        temperature = np.broadcast_to(temperature_c, q.shape)
    else:
        raise BadInput("torque: temperature_c is missing, and the arm's present temperatures are not known; give one figure a joint [°C]")
    for name, value, low, high in (
        ("q", q, -4 * np.pi, 4 * np.pi),
        ("qd", qd, -10.0, 10.0),
        ("qdd", qdd, -1000.0, 1000.0),
        ("temperature_c", temperature, *TEMPERATURE_RANGE_C),
    ):
        outside = np.argwhere((value < low) | (value > high))
        if len(outside):
            n, j = outside[0]
            raise BadInput(f"torque: {name} of joint {j + 1} is {value[n, j]:g}; expected {low:g} … {high:g}")
    predicted = model.torque(robot, q, qd, qdd, temperature)

    def pick(value: Any) -> Any:
        return plain(value[0] if single else value)

    return {
        "torque_nm": pick(predicted.torque),
        "rigid_nm": pick(predicted.rigid),
        "friction_nm": pick(predicted.friction),
        "std_nm": pick(predicted.std),
        "extrapolated": pick(predicted.extrapolated),
        "temperature_c": pick(temperature),
        "model_revision": model.revision,
    }


def _samples(request: Mapping[str, Any], name: str, joints: int) -> Array:
    if name not in request:
        raise BadInput(f"torque: {name} is missing; expected {joints} numbers, or N rows of {joints}")
    value = request[name]
    try:
        array = np.array(value, dtype=object)
        numbers = all(isinstance(item, int | float) and not isinstance(item, bool) for item in array.ravel())
        array = np.array(value, dtype=float) if numbers else array
    except (ValueError, TypeError, OverflowError):
        numbers = False
    if not numbers or array.ndim not in (1, 2) or array.shape[-1] != joints or array.shape[0] == 0:
        raise BadInput(f"torque: {name} is not {joints} numbers or N rows of {joints}")
    if array.ndim == 2 and len(array) > MOST_SAMPLES:
        raise BadInput(f"torque: {name} has {len(array)} rows; at most {MOST_SAMPLES} are answered in one query")
    if not np.all(np.isfinite(array)):
        raise BadInput(f"torque: {name} holds a value that is not finite")
    return array.astype(float)


def _like(value: Array, name: str, q: Array) -> Array:
    """One row stands for all; otherwise as many rows as q."""
    rows = np.atleast_2d(value)
    if len(rows) not in (1, len(q)):
        raise BadInput(f"torque: {name} has {len(rows)} rows but q has {len(q)}")
    return np.broadcast_to(rows, q.shape)
