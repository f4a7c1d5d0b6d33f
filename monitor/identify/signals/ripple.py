"""Gear ripple and noise of the current as it was recorded, not filtered. Ripple is what repeats with each turn of the motor.

A strain wave gear of ratio 101 lets the motor turn 101 times a turn of the joint; its current ripples once, twice and four times a turn of
the motor. In a joint's angle q that is cos(c·q) and sin(c·q) with c = 101, 202 and 404, whatever the speed. Each direction of motion has
its own phase: play and the delay of the current are seen from the other side. The amplitude is that over both.

Both the current and the regressors pass the same high-pass, which takes the torque of the motion away and adds no bias (Frisch and Waugh,
1933). The noise that remains is correlated, so the covariance is that of the delete-a-group jackknife over blocks of time, Bell and
McCaffrey (2002), and few blocks make the deviation wider, as for Student's t.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from monitor.model.friction import STANDSTILL_SPEED_RAD_S
from monitor.recording import Array, Indices

ORDERS = (1, 2, 4)  # cycles a turn of the motor, each twice the one before; strain wave gears have two lobes, so the second is their own
WINDOW_S = 0.32  # of the running mean that the high-pass takes away
LEAST_HZ = 4.0  # slower ripple is not told from the torque of the motion
MOST_OF_RATE = 0.4  # of the sample rate: near a half of it, ripple takes another frequency
LEAST_CYCLES = 20.0  # of one direction; fewer are an accident
LEAST_SEEN = 0.25  # of the rows that are fast enough: fewer are no fair part of the motion, and the rest takes frequencies beside theirs
BLOCK_S = 0.4  # longer than the correlation of what the high-pass leaves
LEAST_BLOCKS = 12
LEAST_FREEDOM = 4.0  # of Student's t; fewer count as so many
LEAST_A = 1e-9  # [A] a smaller deviation is one of made-up data without noise
MAD = 1.4826  # median absolute deviation → standard deviation of normal noise
OUTLIER_STD = 8.0  # a reading that is further off is a spike, and is cut to this size

SLOW = "too slow"  # why an amplitude is not known: the joint did not move, or so slowly that ripple is part of the motion
FAST = "too fast for the sample rate"


class Unfiltered(NamedTuple):
    """The sound rows of a recording as they were measured, in stretches without a hole."""

    t_s: Array  # (N,)
    q: Array  # (N, J) [rad]
    qd: Array  # (N, J) [rad/s]
    current: Array  # (N, J) [A]
    stretches: Sequence[slice]


class Ripple(NamedTuple):
    """Ripple of each joint at H cycles a turn."""

    cycles_per_turn: Array  # (J, H) of the joint
    amplitude_a: Array  # (J, H) [A]; NaN where it is not known
    std_a: Array  # (J, H) [A]
    why: tuple[tuple[str | None, ...], ...]  # J × H: SLOW or FAST where it is not known
    highest_rad_s: Array  # (J, H) up to which speed the sample rate shows it
    gain_nm_per_a: Array | None = None  # (J,) which makes torque of it; None: nobody knows


def current_noise(recorded: Sequence[Unfiltered | None]) -> Array | None:
    """(J,) standard deviation of the noise of one reading of the current while the joint moves [A]: the robust one of second differences.

    The torque of the motion is gone in these, and so is what happens at one place of a joint, since it fills few rows. None where a
    recording holds no current; NaN for a joint that does not move, or whose current is held over several rows.
    """
    known = [each for each in recorded if each is not None]
    if len(known) < len(recorded):
        return None
    stretches = [(each.current[rows], each.qd[rows]) for each in known for rows in each.stretches]
    changes = np.concatenate([np.diff(current, n=2, axis=0) for current, _ in stretches])
    moving = np.concatenate([np.abs(qd[1:-1]) > STANDSTILL_SPEED_RAD_S for _, qd in stretches])
    noise = [
        MAD * np.median(np.abs(change[on])) / math.sqrt(6.0) if on.any() else 0.0 for change, on in zip(changes.T, moving.T, strict=True)
    ]
    return np.where(np.array(noise) > LEAST_A, noise, np.nan)


def gear_ripple(unfiltered: Unfiltered | None, gear_ratio: Array, rate_hz: float) -> Ripple | None:
    """The ripple of the current. gear_ratio : (J,) turns of the motor a turn of the joint. None without a current or any known ratio."""
    if unfiltered is None or not np.any(np.isfinite(gear_ratio)):
        return None
    J, H = len(gear_ratio), len(ORDERS)
    cycles = np.outer(gear_ratio, ORDERS)
    highest = 2.0 * math.pi * MOST_OF_RATE * rate_hz / cycles
    amplitude, std = np.full((2, J, H), np.nan)
    why: list[tuple[str | None, ...]] = [(SLOW,) * H] * J
    width = max(3, 2 * round(0.5 * WINDOW_S * rate_hz) + 1)
    stretches = [rows for rows in unfiltered.stretches if rows.stop - rows.start > 2 * width]
    cases: list[_Case] = []
    if stretches:
        blocks = np.floor(_joined([unfiltered.t_s[each] for each in stretches]) / BLOCK_S)
        for j in np.flatnonzero(np.isfinite(gear_ratio)):  # one after the other: the waves of a long recording fill the memory
            qd = unfiltered.qd[:, j]
            turning, speed = np.sign(qd), np.abs(qd)
            signals = np.stack([*_waves(gear_ratio[j] * unfiltered.q[:, j]), unfiltered.current[:, j], turning])
            passed = _joined([_high_pass(signals[:, each], width) for each in stretches])  # (2·H + 2, n)
            turning, speed = (_joined([x[each] for each in stretches]) for x in (turning, speed))
            # 1 or −1 where the joint moves in this direction in all `width` samples around, else 0: there the high-pass holds no reversal
            direction = np.where(np.abs(turning - passed[-1]) > 1.0 - 0.5 / width, turning, 0.0)
            limit = OUTLIER_STD * 1.4826 * np.median(np.abs(passed[-2]))
            np.clip(passed[-2], -limit, limit, out=passed[-2])  # spikes
            own, why[j] = _of_joint(int(j), passed[:-1], direction, speed, blocks, cycles[j], rate_hz)
            cases += own
    weight, square, variance = np.zeros((3, J, H))  # sums over the directions
    for case, fitted in zip(cases, _squares(cases), strict=True):
        if fitted is not None:
            at, n = (case.joint, case.order), case.rows
            weight[at], square[at], variance[at] = weight[at] + n, square[at] + n * fitted[0], variance[at] + n * n * fitted[1]
    known = weight > 0.0
    why = [tuple(None if known[j, h] else reason for h, reason in enumerate(reasons)) for j, reasons in enumerate(why)]
    size, doubt = np.maximum(square[known] / weight[known], 0.0), np.sqrt(variance[known]) / weight[known]
    amplitude[known] = np.sqrt(size)
    # dA = dA²/(2·A) far from zero, and √dA² at zero; a current that never changes tells neither
    spread = amplitude[known] + np.sqrt(size + doubt)
    std[known] = np.divide(doubt, spread, out=np.full(len(doubt), np.nan), where=spread > 0.0)
    return Ripple(cycles, amplitude, std, tuple(why), highest)


def _waves(turned: Array) -> list[Array]:
    """Cosines, then sines, of each order, (N,) each, of a motor's angle (N,) [rad]."""
    cosines, sines = [np.cos(turned)], [np.sin(turned)]
    for _ in ORDERS[1:]:  # each order is twice the one before it
        c, s = cosines[-1], sines[-1]
        cosines.append(c * c - s * s)
        sines.append(2.0 * s * c)
    return [*cosines, *sines]


def _joined(parts: Sequence[Array]) -> Array:
    """The parts (…, n) one after the other."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)


def combined(ripples: Sequence[Ripple | None]) -> Ripple | None:
    """The ripple of several recordings of one arm: each amplitude's mean, weighted by certainty. None where no recording has any."""
    known = [ripple for ripple in ripples if ripple is not None]
    if len(known) < 2:  # most often
        return known[0] if known else None
    amplitude, std = (np.stack([getattr(ripple, name) for ripple in known]) for name in ("amplitude_a", "std_a"))
    weight = np.where(np.isfinite(amplitude), 1.0 / np.maximum(std, LEAST_A) ** 2, 0.0)
    total = np.sum(weight, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, both = np.sum(weight * np.nan_to_num(amplitude), axis=0) / total, 1.0 / np.sqrt(total)
    mean, both = (np.where(total > 0.0, value, np.nan) for value in (mean, both))
    why = tuple(tuple(None if total[j, h] > 0.0 else reason for h, reason in enumerate(reasons)) for j, reasons in enumerate(known[0].why))
    return Ripple(known[0].cycles_per_turn, mean, both, why, np.max([ripple.highest_rad_s for ripple in known], axis=0))


class _Case(NamedTuple):
    """One order in one direction of motion."""

    joint: int  # from 0
    order: int  # place in ORDERS
    rows: float  # number of rows
    sums: Array  # (blocks, pairs) products of cosines, sines and current over each block of time, as `_products` gives them


def _of_joint(
    joint: int, signals: Array, direction: Array, speed: Array, blocks: Array, cycles: Array, rate_hz: float
) -> tuple[list[_Case], tuple[str | None, ...]]:
    """The cases of one joint, and why an order without any has no amplitude.

    signals : (2·H + 1, n) cosines, sines and current, all through the high-pass. direction : (n,) as in `gear_ripple`. speed : (n,) |q̇|.
    blocks : (n,) number of the block of time. cycles : (H,).
    """
    per_speed = cycles / (2.0 * math.pi)  # [Hz·s/rad]
    frequency = speed * per_speed[:, None]  # (H, n) [Hz]
    fast = frequency > MOST_OF_RATE * rate_hz
    seen = (frequency >= LEAST_HZ) & ~fast
    hidden = [np.count_nonzero(a) < LEAST_SEEN * (np.count_nonzero(a) + np.count_nonzero(b)) for a, b in zip(seen, fast, strict=True)]
    # rows in a row that are used alike: all else is computed from their sums
    used_as = 3.0 * blocks + direction
    for each in seen:
        used_as = 2.0 * used_as + each
    ends = np.append(1 + np.flatnonzero(used_as[1:] != used_as[:-1]), len(blocks))
    starts = np.append(0, ends[:-1])
    way, block, each_seen = direction[starts], blocks[starts], seen[:, starts]
    rows, turned = (ends - starts).astype(float), np.add.reduceat(speed, starts)
    products = _products(signals, starts)
    cases = []
    for this_way in (way > 0.0, way < 0.0):
        for h in (h for h, unknown in enumerate(hidden) if not unknown):
            used = this_way & each_seen[h]
            if used @ turned * per_speed[h] < LEAST_CYCLES * rate_hz:
                continue
            changes = block[used][1:] != block[used][:-1]
            if np.count_nonzero(changes) + 1 >= LEAST_BLOCKS:
                sums = np.add.reduceat(products[used], np.append(0, changes.nonzero()[0] + 1), axis=0)
                cases.append(_Case(joint, h, float(used @ rows), sums))
    return cases, tuple(FAST if each else SLOW for each in hidden)


def _squares(cases: Sequence[_Case]) -> list[tuple[float, float] | None]:
    """Of each case |z|² of its wave's coefficient without the part that noise adds, and its variance; None where it has no solution.

    The other orders are regressed too: where ripple is faster than the sample rate shows, it takes another frequency with it. With
    b ~ N(z, C), E|b|² = |z|² + tr C and var |b|² = 4·zᵀCz + 2·tr C².
    """
    if not cases:
        return []
    lengths, H = [len(case.sums) for case in cases], len(ORDERS)
    sums = np.concatenate([case.sums for case in cases])[:, _pairs(2 * H + 1)]
    first = np.cumsum([0, *lengths[:-1]])
    gram, along = sums[:, :-1, :-1], sums[:, :-1, -1]
    whole, total = np.add.reduceat(gram, first, axis=0), np.add.reduceat(along, first, axis=0)
    try:
        b = np.linalg.solve(whole, total[:, :, None])  # (cases, 2·H, 1)
        left = along - (gram @ np.repeat(b, lengths, axis=0))[:, :, 0]
        moved = np.linalg.solve(np.repeat(whole, lengths, axis=0) - gram, left[:, :, None])[:, :, 0]  # by the block that is left out
    except np.linalg.LinAlgError:  # waves that are one, as of a joint that turned to and fro by a thousandth of a turn
        return [None] if len(cases) == 1 else [_squares([case])[0] for case in cases]
    orders, each = np.array([case.order for case in cases]), np.arange(len(sums))
    z = np.stack([b[np.arange(len(cases)), orders + part, 0] for part in (0, H)])  # (2, cases)
    places = [np.repeat(orders + part, lengths) for part in (0, H)]
    apart = [moved[each, own] for own in places]
    energy = sum(gram[each, own, own] for own in places)  # of the wave in each block

    def total_of(x: Array) -> Array:
        summed: Array = np.add.reduceat(x, first)
        return summed

    freedom = np.maximum(total_of(energy) ** 2 / total_of(energy**2) - 2 * H, LEAST_FREEDOM)
    # few blocks, some of them short: intervals of 90 % are those of Student's t; Abramowitz and Stegun (1972), 26.7.5
    wider = (1.0 + 0.926 / freedom + 0.864 / freedom**2) ** 2
    Cxx, Cxy, Cyy = (wider * total_of(apart[a] * apart[b]) for a, b in ((0, 0), (0, 1), (1, 1)))
    pure = 2.0 * (Cxx**2 + 2.0 * Cxy**2 + Cyy**2)
    square = z[0] ** 2 + z[1] ** 2 - Cxx - Cyy
    variance = np.maximum(4.0 * (z[0] ** 2 * Cxx + 2.0 * z[0] * z[1] * Cxy + z[1] ** 2 * Cyy) - pure, pure)
    return list(zip(square.tolist(), variance.tolist(), strict=True))


def _products(signals: Array, starts: Indices) -> Array:
    """(R, pairs) sums of the products of signals (S, n) over the runs of rows that begin at `starts`, in the order of `_pairs`."""
    return np.concatenate([np.add.reduceat(own * signals[a:], starts, axis=1) for a, own in enumerate(signals)]).T


@lru_cache(maxsize=8)
def _pairs(S: int) -> Indices:
    """(S, S) place of each product among the S·(S + 1)/2 of `_products`."""
    places = np.zeros((S, S), dtype=np.intp)
    places[np.triu_indices(S)] = np.arange(S * (S + 1) // 2)
    return np.maximum(places, places.T)


def _high_pass(x: Array, width: int) -> Array:
    """(…, n) without the running mean over `width` samples, an odd number; at the ends over those that there are."""
    from scipy.ndimage import uniform_filter1d

    share = uniform_filter1d(np.ones(x.shape[-1]), width, mode="constant")  # of the samples around that there are
    high: Array = x - uniform_filter1d(x, width, axis=-1, mode="constant") / share
    return high
