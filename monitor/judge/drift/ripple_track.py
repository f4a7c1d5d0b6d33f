"""The slow track of gear ripple: a random walk per joint and order, in the context in force. It is for a person; what
is told of ripple is judged by the model beside friction.

A worn or cracked gear, or a bent wave generator, changes what repeats with each turn of the motor before it changes mean friction. Another
trajectory, payload or temperature changes it too, so the track begins anew with another context, and says how it began.
"""

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from monitor.identify.signals.ripple import Ripple
from monitor.judge.friction.kalman import predict, update
from monitor.recording import Array

WALK_PER_ROOT_DAY = 0.01  # of the amplitude, by which it may walk in a day: a tenth in a season
SCATTER = 0.1  # of the amplitude, from replay to replay of one trajectory: temperature, and the phase between gear and reversal
FIRST_REPLAYS = 5  # whose mean is what later replays are compared with


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RippleTrack:
    """Ripple of J joints at H cycles a turn, (J, H) each; NaN where no replay has shown any."""

    cycles_per_turn: Annotated[Array, "N K"]
    amplitude_a: Annotated[Array, "N K"]  # of the last replay
    std_a: Annotated[Array, "N K"]
    track_a: Annotated[Array, "N K"]
    track_var: Annotated[Array, "N K"]  # [A²]
    first_a: Annotated[Array, "N K"]  # mean of the first replays
    replays: Annotated[Array, "N K"]  # that have shown it


class JointRipple(NamedTuple):
    """Gear ripple of one joint, with the published names; a figure for each number of cycles, None where it is not known."""

    cycles_per_turn: tuple[int, ...]  # of the joint
    amplitude_a: tuple[float | None, ...]  # of the last replay
    std_a: tuple[float | None, ...]
    track_a: tuple[float | None, ...]  # over all replays of this context
    track_std_a: tuple[float | None, ...]
    first_a: tuple[float | None, ...]  # mean of the first replays of this context
    replays: tuple[int, ...]


def update_ripple(before: RippleTrack | None, ripple: Ripple | None, days: float, *, fresh: bool) -> RippleTrack | None:
    """The track after one more replay, `days` after the last one. fresh : another context: it begins anew."""
    if ripple is None:
        return None if fresh else before
    shape = ripple.amplitude_a.shape
    if fresh or before is None or not np.array_equal(before.cycles_per_turn, ripple.cycles_per_turn, equal_nan=True):
        unknown = np.full(shape, np.nan)
        before = RippleTrack(
            cycles_per_turn=ripple.cycles_per_turn,
            amplitude_a=unknown,
            std_a=unknown,
            track_a=unknown,
            track_var=unknown,
            first_a=unknown,
            replays=np.zeros(shape),
        )
    seen = np.isfinite(ripple.amplitude_a)
    noise = ripple.std_a**2 + (SCATTER * ripple.amplitude_a) ** 2
    begins, goes_on = seen & (before.replays == 0.0), seen & (before.replays > 0.0)
    mean, var = np.where(begins, ripple.amplitude_a, before.track_a), np.where(begins, noise, before.track_var)
    if goes_on.any():
        one = np.ones((int(goes_on.sum()), 1, 1))
        walk = days * (WALK_PER_ROOT_DAY * np.hypot(mean[goes_on], np.sqrt(noise[goes_on]))) ** 2
        x, P = predict(mean[goes_on][:, None], var[goes_on][:, None, None], one, walk[:, None, None])
        x, P = update(x, P, ripple.amplitude_a[goes_on], noise[goes_on], one[:, 0])
        mean[goes_on], var[goes_on] = x[:, 0], P[:, 0, 0]
    replays = before.replays + seen
    early = seen & (replays <= FIRST_REPLAYS)
    with np.errstate(invalid="ignore"):
        first = np.nan_to_num(before.first_a) + (ripple.amplitude_a - np.nan_to_num(before.first_a)) / np.maximum(replays, 1.0)
    return RippleTrack(
        cycles_per_turn=ripple.cycles_per_turn,
        amplitude_a=ripple.amplitude_a,
        std_a=ripple.std_a,
        track_a=mean,
        track_var=var,
        first_a=np.where(early, first, before.first_a),
        replays=replays,
    )


def joint_ripple(track: RippleTrack | None) -> tuple[JointRipple, ...] | None:
    """The published figures of every joint; None where no ripple was ever seen."""
    if track is None or not np.any(track.replays > 0.0):
        return None
    columns = {
        "amplitude_a": track.amplitude_a,
        "std_a": track.std_a,
        "track_a": track.track_a,
        "track_std_a": np.sqrt(track.track_var),
        "first_a": track.first_a,
    }
    return tuple(
        JointRipple(
            cycles_per_turn=tuple(round(cycles) for cycles in np.nan_to_num(track.cycles_per_turn[j])),
            replays=tuple(int(count) for count in track.replays[j]),
            **{name: tuple(_figure(value) for value in column[j]) for name, column in columns.items()},
        )
        for j in range(len(track.replays))
    )


def _figure(value: float) -> float | None:
    """[A] to a hundredth of a milliampere, far below any deviation: the history keeps these figures for years."""
    return round(float(value), 5) if math.isfinite(value) else None
