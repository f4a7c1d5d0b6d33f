"""Whether two recordings are of the same motion, by the motion itself: what a file from elsewhere does not say.

Positions are compared as functions of time, with the offset in time that makes them most alike. Friction at a reference speed depends on
the speeds and loads of the motion, so the levels of different motions are not comparable.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.signals.motion import Motion, motion
from monitor.model.friction import STANDSTILL_SPEED_RAD_S
from monitor.recording import FOREIGN_MOTION, Array, Recording

RATE_HZ = 20.0  # of the path: an arm moves a hundredth of its way in a sample
COARSE = 1000  # samples, at most, in the search for the offset
SHARED = 0.8  # of the longer motion: what both recordings must hold
ALIKE = 0.02  # of a joint's motion (standard deviation): a controller repeats to a thousandth
FLOOR_RAD = 0.002  # of a joint that hardly moves
REFINEMENTS = 4  # Gauss–Newton steps of the offset


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """Positions from the first motion to the last, (n, J) at 20 Hz [rad]."""

    q: Array
    begins_s: float = 0.0  # on the recording's clock

    @classmethod
    def of(cls, moved: Motion) -> "Path":
        """The path of a motion."""
        t_s = moved.t_s
        moving = np.flatnonzero(np.any(np.abs(moved.qd) > STANDSTILL_SPEED_RAD_S, axis=1))
        first, last = (t_s[moving[0]], t_s[moving[-1]]) if len(moving) else (t_s[0], t_s[-1])
        at = np.arange(first, last, 1.0 / RATE_HZ)
        return cls(q=np.stack([np.interp(at, t_s, column) for column in moved.q.T], axis=1), begins_s=float(first))

    def same(self, other: "Path") -> bool:
        """Whether both are one motion, of which either recording may have lost a fifth at an end."""
        long, short = (self.q, other.q) if len(self.q) >= len(other.q) else (other.q, self.q)
        if long.shape[1] != short.shape[1] or len(short) < max(2.0, SHARED * len(long)):
            return False
        tolerance = ALIKE * np.std(long, axis=0) + FLOOR_RAD  # (J,)
        stride = -(-len(long) // COARSE)
        coarse, given = long[::stride], short[::stride]
        least = int(SHARED * len(coarse))
        lags = range(least - len(given), len(coarse) - least + 1)  # sample k of the short one is sample k + lag of the long one
        lag = stride * min(lags, key=lambda lag: float(np.mean((_overlap(coarse, given, lag) / tolerance) ** 2)))
        return bool(np.all(np.sqrt(np.mean(_refined(long, short, float(lag)) ** 2, axis=0)) <= tolerance))

    @property
    def digest(self) -> str:
        """A name for the motion. Noise changes it: recordings of one motion share the name of the first (`with_motions`)."""
        return FOREIGN_MOTION + hashlib.sha256(np.round(self.q, 2).tobytes()).hexdigest()[:12]


def _overlap(long: Array, short: Array, lag: int) -> Array:
    """(n, J) difference where both are known."""
    first, last = max(0, lag), min(len(long), len(short) + lag)
    difference: Array = long[first:last] - short[first - lag : last - lag]
    return difference


def _refined(long: Array, short: Array, lag: float) -> Array:
    """(n, J) difference where both are known, with the lag improved to a fraction of a sample."""
    slope, index = np.gradient(long, axis=0), np.arange(len(long))
    difference = long[:0]
    for _ in range(REFINEMENTS):
        at = np.arange(len(short)) + lag
        known = (at >= 0) & (at <= len(long) - 1)
        seen, speed = (np.stack([np.interp(at[known], index, column) for column in signal.T], axis=1) for signal in (long, slope))
        difference = seen - short[known]
        lag -= float(np.sum(speed * difference) / max(np.sum(speed**2), 1e-300))
    return difference


DECLARED = 0.1  # of a joint's motion, by which recordings that somebody declares as one motion may differ: their host's clock jitters
MOST_LAG_S = 3.0  # between the starts of such recordings


def of_one_trajectory(recordings: Sequence[Recording], name: str) -> list[Recording]:
    """Recordings of one trajectory, some of them stopped early, cut to what all share from its beginning, under the name that is given.

    Raises BadInput where a recording holds another motion, and Unidentifiable where it holds none.
    """
    motions = [motion(recording) for recording in recordings]
    paths = [Path.of(moved) for moved in motions]
    if not paths:
        return []
    shortest = min(paths, key=lambda path: len(path.q)).q
    lags = [_lag(path.q, shortest) for path in paths]
    first, last = max(0, -min(lags)), min(len(shortest), *(len(path.q) - lag for path, lag in zip(paths, lags, strict=True)))
    tolerance, found = DECLARED * np.std(shortest, axis=0) + 5.0 * FLOOR_RAD, []  # (J,)
    for recording, moved, path, lag in zip(recordings, motions, paths, lags, strict=True):
        off = path.q[first + lag : last + lag] - shortest[first:last]
        if last - first < 2 or np.any(np.sqrt(np.mean(off**2, axis=0)) > tolerance):
            raise BadInput(
                f"{recording.source or 'recording'}: is not of the trajectory {name!r}: its motion is another from the beginning on"
            )
        t_s = moved.recording.t_s - path.begins_s
        keep = (t_s >= (first + lag) / RATE_HZ) & (t_s <= (last + lag) / RATE_HZ)
        parts: dict[str, Any] = {key: signal[keep] for key, signal in recording.signals.items()}
        cut = replace(recording, **parts)
        found.append(replace(cut, context=replace(recording.context, trajectory_digest=FOREIGN_MOTION + name)))
    return found


def _lag(longer: Array, shortest: Array) -> int:
    """Sample of the longer motion at which the shortest begins."""
    most = round(MOST_LAG_S * RATE_HZ)
    count = max(2, len(shortest) - 2 * most)

    def off(lag: int) -> float:
        first = max(0, -lag)
        n = min(count, len(longer) - lag - first, len(shortest) - first)
        return float(np.mean((longer[lag + first : lag + first + n] - shortest[first : first + n]) ** 2)) if n > 1 else np.inf

    return min(range(-most, most + 1), key=off)


def with_motions(recordings: Sequence[Recording]) -> Iterator[Recording]:
    """The recordings in their order; one that names no trajectory has the name of the first recording of the same motion.

    A recording that cannot be used stays as it is: its reason is told where it is judged.
    """
    known: list[tuple[str, Path]] = []
    for recording in recordings:
        named = recording.context.trajectory_digest
        try:
            path = Path.of(motion(recording))
        except (BadInput, Unidentifiable):
            yield recording
            continue
        digest = named or next((name for name, earlier in known if path.same(earlier)), path.digest)
        if all(name != digest for name, _ in known):
            known.append((digest, path))
        yield recording if named else replace(recording, context=replace(recording.context, trajectory_digest=digest))
