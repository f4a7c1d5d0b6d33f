"""Individually identifiable parameters in any frames, and the document that presents base parameters to a person."""

import math
from collections.abc import Callable

import numpy as np

from monitor.errors import BadInput
from monitor.model.base import Base, Classification, base_parameters, sorted_into
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, Robot
from monitor.recording import Array

LEVEL_RAD = math.radians(1.0)  # with less tilt, the parameters that only the tilt reveals are fainter than friction


def _standard_dh(robot: Robot) -> list[tuple[Array, Array]]:
    """The frames of the standard convention: DH frame i itself."""
    return [(np.eye(3), np.zeros(3)) for _ in range(robot.joints)]


def _on_own_axis(robot: Robot) -> list[tuple[Array, Array]]:
    """Frames on the axis of joint i, with the origin of DH frame i−1: those of pinocchio's joints."""
    frames = []
    for i in range(robot.joints):
        ca, sa = math.cos(robot.alpha_rad[i]), math.sin(robot.alpha_rad[i])
        into_dh = np.array([[1.0, 0.0, 0.0], [0.0, ca, sa], [0.0, -sa, ca]])  # axes of the joint's frame → of DH frame i
        frames.append((into_dh, -into_dh @ np.array([robot.a_m[i], robot.y_m[i], robot.d_m[i]])))
    return frames


def _modified_dh(robot: Robot) -> list[tuple[Array, Array]]:
    """Frames by Craig's convention: on the axis of joint i, at the foot of the common normal to axis i + 1."""
    shifts = [np.array([0.0, 0.0, d]) for d in robot.d_m]
    return [(turn, origin + turn @ shift) for (turn, origin), shift in zip(_on_own_axis(robot), shifts, strict=True)]


FRAMES: dict[str, Callable[[Robot], list[tuple[Array, Array]]]] = {
    "standard-dh": _standard_dh,
    "modified-dh": _modified_dh,
    "joint": _on_own_axis,
}


def individually_identifiable(robot: Robot, mounting: Mounting, frames: str | list[tuple[Array, Array]] = "standard-dh") -> Classification:
    """The classes of the standard parameters where each link's parameters are given in another frame that is fixed to the link.

    frames : a name in `FRAMES`, or for each link (R, r): R (3, 3) turns components into DH frame i; r (3,) [m] is the origin in DH frame i.
    The base parameters are the same physics in any frame, but a parameter that is alone in one frame is a sum in another. Raises BadInput
    for an unknown name or a wrong number of frames.
    """
    if isinstance(frames, str):
        if frames not in FRAMES:
            raise BadInput(f"frames {frames!r} are not known; known are {', '.join(FRAMES)}")
        frames = FRAMES[frames](robot)
    if len(frames) != robot.joints:
        raise BadInput(f"{robot.name}: {len(frames)} frames; expected {robot.joints}, one a link")
    base = base_parameters(robot, mounting)
    change = np.eye(len(base.parameters))
    for i, (turn, origin) in enumerate(frames):
        block = slice(PER_JOINT * i, PER_JOINT * i + INERTIAL)
        change[block, block] = inertial_change(turn, origin)
    seen = base.combination @ change  # (B, P)
    Q = np.linalg.qr(seen.T)[0]  # (P, B) basis of the row space
    reach = np.sum(Q**2, axis=1)  # 1 for a unit vector that lies in the row space
    effect = np.linalg.norm(seen, axis=0)
    names = np.array(base.parameters)
    # cos² of the angle, so 1e-9 is 3e-5 rad: combinations are exact to 1e-12, and a true one shares at least 1e-4 with its neighbours
    return sorted_into(base.parameters, set(names[reach > 1.0 - 1e-9].tolist()), set(names[effect < 1e-9].tolist()))


def inertial_change(turn: Array, origin: Array) -> Array:
    """(10, 10) map from the inertial parameters in a frame to those in DH frame i: p_dh = change · p_frame.

    Mass, first moments and second moments Σ = ½tr(J)·1 − J of a body change as its points do, x → R·x + r.
    turn : R (3, 3). origin : r (3,) [m].
    """
    columns = []
    for unit in np.eye(INERTIAL):
        m, h = unit[0], unit[1:4]
        xx, xy, xz, yy, yz, zz = unit[4:]
        J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        S = 0.5 * np.trace(J) * np.eye(3) - J
        moved_h = turn @ h + m * origin
        turned = turn @ h
        moved_S = turn @ S @ turn.T + np.outer(turned, origin) + np.outer(origin, turned) + m * np.outer(origin, origin)
        K = np.trace(moved_S) * np.eye(3) - moved_S
        columns.append([m, *moved_h, K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2], K[2, 2]])
    return np.array(columns).T


def base_document(robot: Robot, mounting: Mounting, frames: str = "standard-dh") -> dict[str, object]:
    """The JSON object that `base --json` prints. frames : a name in `FRAMES`."""
    base = base_parameters(robot, mounting)

    def class_document(classes: Classification) -> dict[str, object]:
        fully, combined, none = classes.counts
        return {
            "fully": fully,
            "in_combination": combined,
            "not_identifiable": none,
            "parameters": {
                "fully": list(classes.fully),
                "in_combination": list(classes.in_combination),
                "not_identifiable": list(classes.not_identifiable),
            },
        }

    return {
        "robot": robot.name,
        "mounting": {
            f"{axis}_deg": round(math.degrees(angle), 9) for axis, angle in zip(("roll", "pitch", "yaw"), mounting.angles_rad, strict=True)
        },
        "count": base.count,
        "singular_values": base.singular_values.tolist(),
        "cumulative_energy": base.cumulative_energy.tolist(),
        "combinations": [
            {"name": name, "text": text, "terms": terms} for name, text, terms in zip(base.names, base.texts, base.terms, strict=True)
        ],
        "classification": {
            "by_column": class_document(base.by_column),
            "as_in_paper": class_document(base.as_in_paper),
        },
        "quotable": {"frames": frames, **class_document(individually_identifiable(robot, mounting, frames))},
        "notes": list(_notes(robot, mounting, base)),
    }


def mounting_with_up(up_in_base: Array) -> Mounting:
    """The mounting with yaw 0 on which a unit vector (3,) of the base points up. Where roll and yaw have the same axis, roll is 0."""
    x, y, z = (float(component) for component in up_in_base)
    return Mounting(roll_rad=math.atan2(y, z) if math.hypot(y, z) > 1e-9 else 0.0, pitch_rad=math.atan2(-x, math.hypot(y, z)))


def _notes(robot: Robot, mounting: Mounting, base: Base) -> list[str]:
    """Sentences about parameters that only a small tilt of the base reveals, and about yaw."""
    notes = []
    gravity = robot.gravity(mounting)  # (3,) in frame 0, whose z is the axis of joint 1
    tilt = float(np.arctan2(np.hypot(gravity[0], gravity[1]), abs(gravity[2])))
    upright = mounting_with_up(robot.base_rotation[:, 2] * (-1.0 if gravity[2] > 0.0 else 1.0))
    extra = base.count - base_parameters(robot, upright).count
    if extra > 0 and tilt < LEVEL_RAD:
        weakest = base.singular_values[base.count - 1] / base.singular_values[0]
        new = [name for name, column in zip(base.names, base.columns, strict=True) if column not in base_parameters(robot, upright).columns]
        notes.append(
            f"the axis of joint 1 is {math.degrees(tilt):.3g}° from gravity: {extra} of the {base.count} ({'; '.join(new)}) show only "
            f"through that tilt, with {math.sin(tilt):.2g} of their weight (weakest singular value {weakest:.2g} of the largest); "
            "whether a recording carries them is told by their standard deviation in `identify`"
        )
    if np.any(mounting.yaw_rad):
        notes.append("yaw turns the arm about gravity: no torque depends on it")
    return notes
