"""Whether the recorded speeds are those of the recorded positions, joint by joint and with their sign.

The median of a ratio over joints, which shows a wrong unit, is blind to one joint that is wrong, and to signs. Here the change of each
position over a window of time is set beside the median of its speed in this window.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.signals.order import median, medians, quantile
from monitor.identify.signals.slopes import Slopes, slopes
from monitor.recording import Array, Recording

MOVING_RAD_S = 0.02  # a joint whose 90 % quantile of speed is lower does not move enough for a comparison
FEWEST_WINDOWS = 20  # fewer say nothing
USUAL = 0.75  # quantile of the speeds that stands for their size
WRONG = 0.35  # of the speed's size: a larger mismatch is another signal
DOUBTFUL = 0.08  # a smaller one is noise, or a motion that is fast for its rate
EXPLAINS = 0.5  # of the mismatch may remain where an exchange or a sign explains it
SURE = 4.0  # times the noise of a window's speed
LATE_S = 0.008  # by which speeds may lag; on real controllers they lag by less than 2 ms


class SpeedDoubt(NamedTuple):
    """One joint whose speeds differ a little from the change of its positions."""

    joint: int  # from 0
    text: str


def check_speeds(recording: Recording, seen: Slopes | None) -> Iterator[SpeedDoubt]:
    """The joints whose speeds are doubtful. seen : `slopes` of its positions.

    Raises Unidentifiable where the speeds of a joint are another signal, with the likely reason: exchanged columns, a sign, a unit.
    """
    windows = _windows(recording.t_s, recording.q, recording.qd, seen)
    if windows is None:
        return
    slope, speed, noise, lag = windows
    wrong = [_mismatch(slope[:, j], speed[:, j]) for j in range(slope.shape[1])]
    size = [_size(slope[:, j]) for j in range(slope.shape[1])]
    moves = [size[j] > MOVING_RAD_S or _size(speed[:, j]) > MOVING_RAD_S for j in range(len(size))]
    unsure = [SURE * noise[j] / max(size[j], MOVING_RAD_S) for j in range(len(size))]
    beyond = [moves[j] and wrong[j] > max(WRONG, unsure[j]) for j in range(len(size))]
    if any(beyond):
        raise Unidentifiable(f"{recording.source or 'recording'}: {_reason(recording, slope, speed, beyond)}: check the columns")
    for j, off in enumerate(wrong):
        if moves[j] and off > DOUBTFUL + unsure[j]:
            factor = float(slope[:, j] @ speed[:, j] / (slope[:, j] @ slope[:, j]))
            yield SpeedDoubt(j, f"{100 * off:.0f} % of the speed of joint {j + 1} is not the change of its position (factor {factor:.3g})")
        elif moves[j] and abs(lag[j]) > LATE_S:
            order = "later" if lag[j] > 0 else "earlier"
            yield SpeedDoubt(j, f"the speed of joint {j + 1} comes {1e3 * abs(lag[j]):.0f} ms {order} than the change of its position")


def _reason(recording: Recording, slope: Array, speed: Array, beyond: list[bool]) -> str:
    """The likeliest reason why the speeds of the joints `beyond` are not the change of their positions."""
    joints = [j for j, is_so in enumerate(beyond) if is_so]
    named = ", ".join(str(j + 1) for j in joints)
    of = f"joint{'s' if len(joints) > 1 else ''} {named}"
    if recording.qd is not None:
        turned = _windows(recording.t_s, recording.qd, recording.q, slopes(recording.t_s, recording.qd, recording.q))
        if turned is not None and all(_mismatch(turned[0][:, j], turned[1][:, j]) < WRONG for j in joints):
            return f"the positions of {of} are the change of their speeds: q and q̇ are exchanged"
    if all(_mismatch(-slope[:, j], speed[:, j]) < EXPLAINS for j in joints):
        return f"the speeds of {of} have the opposite sign of their positions' change"
    for j in joints:
        crossed = [max(_mismatch(slope[:, k], speed[:, j]), _mismatch(slope[:, j], speed[:, k])) for k in range(len(beyond))]
        other = [k for k in joints if k != j and crossed[k] < WRONG]
        if other:
            return f"the speeds of joints {j + 1} and {other[0] + 1} are exchanged"
    j = joints[0]
    fast = np.abs(speed[:, j]) > 0.5 * _size(speed[:, j])
    factor = median(slope[fast, j] / speed[fast, j]) if fast.any() and _size(speed[:, j]) > 0.0 else 0.0
    if _mismatch(slope[:, j], factor * speed[:, j]) < WRONG and factor > 0.0:
        return f"the positions of {of} change {factor:.3g} times as fast as their speeds say; expected 1 (or 57.3 for degrees)"
    return f"the speeds of {of} are not the change of their positions"


def _mismatch(slope: Array, speed: Array) -> float:
    """The size of speed − slope beside that of the larger of both, by medians over the windows with motion; 0 without motion.

    Half of the windows may hold a torn row.
    """
    larger = np.maximum(np.abs(slope), np.abs(speed))
    informative = larger > 0.3 * quantile(larger, USUAL)
    if np.sum(informative) < FEWEST_WINDOWS:
        return 0.0
    return median(np.abs(speed - slope)[informative]) / median(larger[informative])


def _size(x: Array) -> float:
    """The 75 % quantile of |x|: a joint may rest for most of the time, and a torn row moves a fifth of the windows at most."""
    return quantile(np.abs(x), USUAL)


def _ripple(x: Array) -> Array:
    """(J,) standard deviation of what changes from row to row in x (N, J), by the median of second differences."""
    with np.errstate(invalid="ignore", over="ignore"):
        change = np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2])
        found = medians(np.ascontiguousarray(change.T))
        if np.any(np.isnan(found)):
            found = np.nanmedian(change, axis=0)
        ripple: Array = 1.4826 * found / math.sqrt(6.0)
    return ripple


def _windows(t_s: Array, x: Array, rate: Array | None, seen: Slopes | None) -> tuple[Array, Array, Array, Array] | None:
    """Change of x a second (W, J), median of its rate (W, J), noise of both together (J,), sure part of the rate's lag (J,) [s].

    seen : `slopes` of x. None with few rows.
    """
    if rate is None or seen is None or len(t_s) < FEWEST_WINDOWS:
        return None
    tick, length, dt, slope, speed = seen
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        turn = 2.0 * math.pi / dt[:, None] * np.sign(slope)
        slope = np.where(np.abs(slope - turn - speed) < 0.1 * np.abs(slope - speed), slope - turn, slope)  # a turn is no motion
        sound = (dt > 0.0) & (dt < 1.5 * length * tick) & np.all(np.abs(slope) < 1e4, axis=1) & np.all(np.abs(speed) < 1e4, axis=1)
    if np.sum(sound) < FEWEST_WINDOWS:
        return None
    noise = np.hypot(_ripple(rate) * 1.25 / math.sqrt(length + 1), _ripple(x) * math.sqrt(2.0) / (length * tick))
    change = np.gradient(slope, axis=0) / (max(1, length // 2) * tick)  # acceleration
    lag = np.zeros(x.shape[1])
    inner = sound & np.concatenate([sound[-1:], sound[:-1]]) & np.concatenate([sound[1:], sound[:1]])
    for j in range(x.shape[1]):
        left, a = slope[inner, j] - speed[inner, j], change[inner, j]
        strong = np.abs(a) > quantile(np.abs(a), 0.5) if len(a) else np.zeros(0, dtype=bool)
        if np.sum(strong) >= FEWEST_WINDOWS // 2 and np.all(np.abs(a[strong]) > 0.0):
            each = left[strong] / a[strong]
            middle = median(each)
            doubt = SURE * 1.5 * median(np.abs(each - middle)) / math.sqrt(len(each))
            lag[j] = math.copysign(max(0.0, abs(middle) - doubt), middle)
    return slope[sound], speed[sound], noise, lag
