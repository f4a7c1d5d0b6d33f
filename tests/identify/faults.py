"""A generator of recordings that are not what they say: each fault, a sound recording with it, and what names it."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array, Recording

GAINS = ("other_gain", "friction_size", "weight_size", "others_disagree")
POSITIONS = ("q", "qd", "target_q", "target_qd")
DRIVES = ("current", "torque", "target_current")


class Fault(NamedTuple):
    """What was done, and the code and numbers of the cause that is true, or one that cannot be told from it."""

    of: Callable[[Recording], Recording]
    causes: tuple[str, ...]
    joints: frozenset[int] = frozenset()


def permuted(recording: Recording, order: list[int], names: tuple[str, ...]) -> Recording:
    """With these signals' joints in another order."""
    given = {name: getattr(recording, name) for name in names}
    return replace(recording, **{name: value[:, order] for name, value in given.items() if value is not None})


def scaled(recording: Recording, factor: Array, names: tuple[str, ...]) -> Recording:
    """With these signals times a factor (J,)."""
    given = {name: getattr(recording, name) for name in names}
    return replace(recording, **{name: value * factor for name, value in given.items() if value is not None})


def faults(robot: Robot) -> Iterator[tuple[str, Fault]]:
    """Exchanged and turned joints, signs and units of one drive or all, each for every joint and pair."""
    J = robot.joints
    one = np.eye(J)
    for j, k in combinations(range(J), 2):
        order = list(range(J))
        order[j], order[k] = k, j
        both = frozenset({j + 1, k + 1})
        swaps = {"exchanged_currents": DRIVES, "exchanged_positions": POSITIONS, "exchanged_joints": POSITIONS + DRIVES}
        for cause, names in swaps.items():
            yield f"{cause} {j + 1} {k + 1}", Fault(lambda r, o=order, n=names: permuted(r, o, n), (cause,), both)
    signs = ("other_sign", "other_position_sign")
    for j in range(J):
        minus, joint = 1.0 - 2.0 * one[j], frozenset({j + 1})
        yield f"sign of current {j + 1}", Fault(lambda r, f=minus: scaled(r, f, DRIVES), signs, joint)
        yield f"sign of position {j + 1}", Fault(lambda r, f=minus: scaled(r, f, POSITIONS), signs, joint)
        yield f"axis {j + 1}", Fault(lambda r, f=minus: scaled(r, f, POSITIONS + DRIVES), ("other_axis",), joint)
        yield f"zero drive {j + 1}", Fault(lambda r, f=1.0 - one[j]: scaled(r, f, DRIVES), ("current_stuck",), joint)
        for factor in (0.02, 30.0):
            size = 1.0 + (factor - 1.0) * one[j]
            yield f"drive {j + 1} times {factor:g}", Fault(lambda r, f=size: scaled(r, f, DRIVES), GAINS, joint)
        for turn in (math.pi / 2.0, math.pi):
            where = frozenset({j + 1})
            yield (
                f"zero of joint {j + 1} by {math.degrees(turn):.0f}°",
                Fault(lambda r, q=turn * one[j]: replace(r, q=r.q + q), ("other_zero",), where),
            )
    yield "all signs", Fault(lambda r: scaled(r, -np.ones(J), DRIVES), ("other_signs",))
    yield "N·m for A", Fault(lambda r: scaled(r, robot.drive_gain_nm_per_a, DRIVES), ("nm_for_a",))
    yield "A for N·m", Fault(lambda r: replace(r, torque=r.current, current=None), ("a_for_nm",))
    yield "cycle of three", Fault(lambda r: permuted(r, [2, 0, 1, *range(3, J)], POSITIONS + DRIVES), ("both_causes",))
    yield "two signs", Fault(lambda r: scaled(r, 1.0 - 2.0 * (one[1] + one[2]), DRIVES), ("other_signs",))
    yield "shifted currents", Fault(lambda r: permuted(r, [*range(1, J), 0], DRIVES), ("order_currents",))
    yield "reversed", Fault(lambda r: permuted(r, [*range(J)][::-1], POSITIONS + DRIVES), ("order_joints",))
    yield "halves", Fault(lambda r: permuted(r, [*range(J // 2, J), *range(J // 2)], POSITIONS + DRIVES), ("order_joints",))
