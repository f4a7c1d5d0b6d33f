"""The torque query: its JSON, checked for shape, finiteness and range, becomes arrays and is answered. The bus and `predict` share it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.judge.torque.predictor import predictor_for
from monitor.model.robot import Robot
from monitor.recording import Array

MOST_SAMPLES = 10_000
RANGES = {
    "q": (-4 * np.pi, 4 * np.pi),  # [rad]
    "qd": (-10.0, 10.0),  # [rad/s]
    "qdd": (-1000.0, 1000.0),  # [rad/s²]
    "temperature_c": (-40.0, 120.0),  # [°C] a value beyond it is a mistake
}
_LOW, _HIGH = np.array(list(RANGES.values())).T[:, :, None, None]  # (4, 1, 1) each
_NUMBERS = {int, float}
_PARTS = ("torque_nm", "rigid_nm", "friction_nm", "std_nm", "extrapolated", "measured_std_nm", "temperature_c")


def torque_answer(model: CompensatedModel, robot: Robot, temperature_c: Array | None, request: Mapping[str, Any]) -> dict[str, Any]:
    """Temperature-corrected joint torque of one sample or of N, as arrays or lists in the shape of the request.

    `q` and `qd` [rad, rad/s] are required; `qdd` [rad/s²] is 0 where it is missing, `temperature_c` the present one. Raises BadInput that
    names the wrong argument.
    """
    predictor = predictor_for(model, robot)
    if (flat := _one_sample(request, temperature_c, robot.joints)) is not None:
        return {**dict(zip(_PARTS, (*predictor.sample(*flat), flat[3]), strict=True)), "model_revision": model.revision}
    request = {name: value for name, value in request.items() if value is not None}
    for name in request:
        if name not in RANGES:
            raise BadInput(f"torque: unknown argument {name!r}; known are {', '.join(sorted(RANGES))}")
    joints = robot.joints
    q = _rows(request, "q", joints)
    state = np.empty((len(RANGES), len(q), joints))  # q, qd, qdd, temperature
    state[0], state[1] = q, _like(_rows(request, "qd", joints), "qd", q)
    state[2] = _like(_rows(request, "qdd", joints), "qdd", q) if "qdd" in request else 0.0
    if "temperature_c" in request:
        state[3] = _like(_rows(request, "temperature_c", joints), "temperature_c", q)
    elif temperature_c is not None:
        state[3] = temperature_c
    else:
        raise BadInput("torque: temperature_c is missing, and the arm's present temperatures are not known; give one figure a joint [°C]")
    if not ((state >= _LOW) & (state <= _HIGH)).all():
        raise BadInput(f"torque: {_outside(state)}")
    predicted = predictor.torque(*state)
    single = not isinstance(request["q"][0], list)
    parts = (part[0] if single else part for part in (*predicted, state[3]))
    return {**dict(zip(_PARTS, parts, strict=True)), "model_revision": model.revision}


def _one_sample(request: Mapping[str, Any], temperature_c: Array | None, joints: int) -> list[list[float]] | None:
    """q, qd, qdd and temperature of a request that is plainly one valid sample, as most are; None where it must be checked in full."""
    sample = []
    for name, (low, high) in RANGES.items():
        value = request.get(name)
        if value is None:
            if name == "qdd":
                value = [0.0] * joints
            elif name == "temperature_c" and temperature_c is not None:
                value = temperature_c.tolist()
        if not (type(value) is list and len(value) == joints and _NUMBERS.issuperset(map(type, value))):
            return None
        for figure in value:
            if not low <= figure <= high:
                return None
        sample.append(value)
    return sample if request.keys() <= RANGES.keys() else None


def _rows(request: Mapping[str, Any], name: str, joints: int) -> Array:
    """(N, J) of an argument; N is 1 where it is one sample."""
    if name not in request:
        raise BadInput(f"torque: {name} is missing; expected {joints} numbers, or N rows of {joints}")
    value = request[name]
    rows = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    if len(rows) > MOST_SAMPLES:
        raise BadInput(f"torque: {name} has {len(rows)} rows; at most {MOST_SAMPLES} are answered in one query")
    for row in rows:
        # by exact type: Python counts `true` as an int
        if not (isinstance(row, list) and len(row) == joints and _NUMBERS.issuperset(map(type, row))):
            raise BadInput(f"torque: {name} is not {joints} numbers or N rows of {joints}")
    try:
        array = np.array(rows, dtype=float)
    except OverflowError:
        raise BadInput(f"torque: {name} holds a whole number beyond every range") from None
    return array


def _like(value: Array, name: str, q: Array) -> Array:
    """The rows of an argument, as many as q has; one row stands for all."""
    if len(value) not in (1, len(q)):
        raise BadInput(f"torque: {name} has {len(value)} rows but q has {len(q)}")
    return value


def _outside(state: Array) -> str:
    """The text about the first figure that is out of its range."""
    for name, value, (low, high) in zip(RANGES, state, RANGES.values(), strict=True):
        if not np.all(np.isfinite(value)):
            return f"{name} holds a value that is not finite"
        found = np.argwhere((value < low) | (value > high))
        if len(found):
            n, j = found[0]
            return f"{name} of joint {j + 1} is {value[n, j]:g}; expected {low:g} … {high:g}"
    raise AssertionError("called where every figure is within its range")
