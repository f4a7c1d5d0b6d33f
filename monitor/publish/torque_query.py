"""The torque query: its JSON, checked for shape, finiteness and range, becomes arrays and is answered. The bus and `predict` share it."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.torque.model import CompensatedModel
from monitor.judge.torque.predictor import predictor_for
from monitor.model.robot import Robot
from monitor.recording import Array

MOST_SAMPLES = 10_000
RANGES = {
    "q": (-4 * math.pi, 4 * math.pi),  # [rad]
    "qd": (-10.0, 10.0),  # [rad/s]
    "qdd": (-1000.0, 1000.0),  # [rad/s²]
    "temperature_c": (-40.0, 120.0),  # [°C] a value beyond it is a mistake
}
_PARTS = ("torque_nm", "rigid_nm", "friction_nm", "std_nm", "extrapolated", "measured_std_nm", "temperature_c")
Rows = list[list[float]]


def torque_answer(model: CompensatedModel, robot: Robot, temperature_c: Array | None, request: Mapping[str, Any]) -> dict[str, Any]:
    """Temperature-corrected joint torque of one sample or of N, as arrays or lists in the shape of the request.

    `q` and `qd` [rad, rad/s] are required; `qdd` [rad/s²] is 0 where it is missing, `temperature_c` the present one. Raises BadInput that
    names the wrong argument.
    """
    unknown = sorted(name for name, value in request.items() if value is not None and name not in RANGES)
    if unknown:
        raise BadInput(f"torque: unknown argument {unknown[0]!r}; known are {', '.join(sorted(RANGES))}")
    predictor = predictor_for(model, robot)
    rows = {name: _rows(name, request.get(name), robot.joints, temperature_c) for name in RANGES}
    N = len(rows["q"])
    for name, given in rows.items():
        if len(given) not in (1, N):
            raise BadInput(f"torque: {name} has {len(given)} rows but q has {N}")
    if not isinstance(request["q"][0], list):
        sample = [given[0] for given in rows.values()]
        parts: tuple[Any, ...] = (*predictor.sample(*sample), sample[-1])
    else:
        state = [np.broadcast_to(np.array(given, dtype=float), (N, robot.joints)) for given in rows.values()]
        parts = (*predictor.torque(*state), np.array(state[-1]))
    return {**dict(zip(_PARTS, parts, strict=True)), "model_revision": model.revision}


def _rows(name: str, value: Any, joints: int, temperature_c: Array | None) -> Rows:
    """The rows of an argument, J numbers each: one where it is one sample, or stands for all samples."""
    if value is None:
        if name == "qdd":
            return [[0.0] * joints]
        if name != "temperature_c":
            raise BadInput(f"torque: {name} is missing; expected {joints} numbers, or N rows of {joints}")
        if temperature_c is None:
            raise BadInput("torque: temperature_c is missing, and the arm's present temperatures are not known; give one a joint [°C]")
        value = temperature_c.tolist()
    rows = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    if len(rows) > MOST_SAMPLES:
        raise BadInput(f"torque: {name} has {len(rows)} rows; at most {MOST_SAMPLES} are answered in one query")
    low, high = RANGES[name]
    for row in rows:
        # by exact type: Python counts `true` as an int
        if not (isinstance(row, list) and len(row) == joints and _NUMBERS.issuperset(map(type, row))):
            raise BadInput(f"torque: {name} is not {joints} numbers or N rows of {joints}")
        for j, figure in enumerate(row):
            if not low <= figure <= high:
                raise BadInput(f"torque: {name} of joint {j + 1} is {figure:g}; expected {low:g} … {high:g}")
    return rows


_NUMBERS = {int, float}
