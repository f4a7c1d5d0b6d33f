"""Which segments of a window count: those whose torque is explained by the arm, its friction and what is declared in its hand.

All segments of a window are fitted together: each joint's friction may differ from the last known one, by the same in all segments, and
each segment may carry a load that nobody declared. A load pulls where gravity is felt, at all joints in proportion; friction opposes the
motion. What neither of them explains is contact.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.identify.production.arm import LOADS, ProductionArm, ProductionRows, Torques
from monitor.identify.production.cut import Cut, cut
from monitor.identify.settings import ProductionSettings
from monitor.recording import Array, Mask

CORRELATED_S = 0.5  # time over which residuals are alike, as in `fit.jackknife`
FRICTION_STD = 0.15  # by which friction may differ from what is known of it, one σ: the weather of a week …
WEATHER_PER_K, UNKNOWN_AWAY_K = 0.01, 5.0  # … and for each kelvin between replay and production …
FRICTION_FREE = 1.0  # … and where segments would otherwise carry less than nothing
POSSIBLE_KG, ARM_M = 5.0, 0.15  # undeclared load that is looked for, one σ, and how far from the flange's axis it is held
UNDECLARED_SHARE = 0.05  # of the largest payload: of a small arm's friction a small load is as large a part
SURE = 4.0  # standard deviations of a load that chance does not have
WITHOUT_SENSOR = "cb3"  # generation of arms that do not measure the force at the TCP
# [s], [deviations]: a residual counts as contact where its mean over such a time is so large …
CONTACT = ((0.1, 6.0), (0.5, 4.5))
CONTACT_AROUND_S = 0.25  # … and so do the rows around it
MOST_CONTACT = 0.5  # share of a segment that may be contact; with more the rest is doubtful too
CONTACT_SHARE = 0.04  # of friction: the least deviation, since friction itself differs by so much from place to place
MAD = 1.4826  # median absolute deviation → standard deviation of normal noise
FAR_M = 0.3  # from the flange: a load that is left out pulls as much at least
MOST_UNKNOWN = 0.6  # share of a window's motion with an unknown load, beyond which none of it counts
ROUNDS = 3  # of finding contact by what the fit leaves, and fitting again without it
HELPED = -0.7  # change of friction, as a fraction of it, that no joint has: a hand pushes
SEVERAL = 2  # joints, at least, that move in such a segment
# friction is the arm's: it is not now as it was known, in so much of a window's motion, and now by so much more or less
AS_KNOWN, AS_KNOWN_SHARE, OTHERWISE = 0.07, 0.15, 0.15
JOINED_S = 0.5  # a shorter pause between two segments is none: the hand holds what it held, and the tool touches what it touched
# friction of one joint in a segment beside that in its other segments of the window: more is a tool that drags or a bore that holds
ALONE, FEWEST_SEGMENTS = 0.3, 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Explained:
    """Rows of motion with what explains their torque, n rows."""

    cut: Cut
    torques: Torques
    used: Mask  # (n, J) rows in which a joint moves fast enough, and starts or stops slowly enough
    residual_nm: Array  # (n, J) measured less model, with the friction of the last replay and the declared load

    def chosen(self, rows: Mask) -> "Explained":
        """Some of the rows; segments are numbered anew."""
        torques = Torques(*(part[rows] for part in self.torques))
        return Explained(cut=self.cut.chosen(rows), torques=torques, used=self.used[rows], residual_nm=self.residual_nm[rows])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments:
    """The segments of a window that count, and the seconds that do not."""

    counted: Explained | None  # None: none counts
    left_out_s: dict[str, float]
    begin_unix_s: float
    duration_s: float  # of the window


def segments(rows: ProductionRows, arm: ProductionArm, settings: ProductionSettings, friction_change: Array | None = None) -> Segments:
    """The segments of a window that count.

    friction_change : (J, 2) of (fc, fv) since the last replay, as far as known; None: none. Raises as `cut`.
    """
    found, left_out = cut(rows, arm)
    counted = None
    if found is not None:
        torques = arm.torques(found.q, found.qd, found.qdd, found.direction)
        residual = found.torque_nm - torques.rigid @ arm.rigid - np.einsum("njk,jk->nj", torques.friction, arm.friction)
        residual -= np.einsum("njl,nl->nj", torques.load, found.load)
        used = (np.abs(found.qd) >= settings.min_speed_rad_s) & (np.abs(found.qdd) <= settings.max_acceleration_rad_s2)
        explained = Explained(cut=found, torques=torques, used=used, residual_nm=residual)
        change = np.zeros((arm.joints, 2)) if friction_change is None else friction_change
        bad = _judged(explained, arm, settings, change)
        for name, where in bad.items():
            if where.any():
                left_out[name] = left_out.get(name, 0.0) + float(np.sum(where)) / found.rate_hz
        good = ~np.any(list(bad.values()), axis=0)
        counted = explained.chosen(good) if good.any() else None
    return Segments(counted=counted, left_out_s=left_out, begin_unix_s=rows.at_unix_s, duration_s=rows.recording.duration_s)


def _judged(explained: Explained, arm: ProductionArm, settings: ProductionSettings, change: Array) -> dict[str, Mask]:
    """(n,) of each cause, the rows that do not count for it; a row has one cause at most."""
    found, load, used = explained.cut, explained.torques.load, explained.used
    line = explained.torques.friction[:, :, :2]  # (n, J, 2)
    left = explained.residual_nm - np.einsum("njk,jk->nj", line, change)
    known = friction_size(arm)
    warmer = WEATHER_PER_K * _away_k(found, arm)
    contact, changes = _by_force(found, arm, settings), _changes(found, line, left, used, arm)
    pushed = _disturbed(found, changes, warmer)  # (S,)
    dragged = pushed[found.segment]
    used = used & ~dragged[:, None]
    here, fit = _fitted(found, line, load, left, used, arm, (FRICTION_STD + warmer) * known, contact)
    least_kg = min(settings.undeclared_kg, UNDECLARED_SHARE * arm.robot.payload_max_kg)  # NaN, of an arm without a figure, is never less
    if np.any(fit.mass + SURE * fit.mass_std < -least_kg - found.load[found.starts, 0]):  # nothing weighs less than nothing
        here, fit = _fitted(found, line, load, left, used, arm, FRICTION_FREE * known, contact)
    odd = np.any(changes.seen & (np.abs(changes.share) > OTHERWISE + warmer), axis=1)  # (S,)
    share = _mean(found, here.astype(float))
    blind = SURE * fit.mass_std > least_kg
    helped = blind & np.any(changes.seen & (changes.share < HELPED), axis=1)  # less than no friction, and a load may explain it
    other = (_beside(found, _unknown_load(found, fit, least_kg) | pushed | helped, odd & blind) & ~pushed)[found.segment]
    if np.mean(other) > MOST_UNKNOWN:  # what is in the hand most of the time is there in the rest, too small to be seen in it
        other = np.ones_like(other)
    other &= ~here
    here = here | ((share > MOST_CONTACT)[found.segment] & ~other)
    changes = _changes(found, line, left - fit.of_load, used, arm)
    dragged |= (_disturbed(found, changes, warmer) | _of_one_joint(changes, ALONE + warmer))[found.segment]
    return {"contact": here, "payload_unknown": other, "disturbed": dragged & ~here & ~other}


def _beside(found: Cut, unknown: Mask, doubtful: Mask) -> Mask:
    """(S,) segments with something unknown at the tool, and the doubtful ones of the same unbroken motion, which cannot tell."""
    unknown, starts = unknown.copy(), found.starts
    pause_s = found.t_s[starts[1:]] - found.t_s[starts[1:] - 1]  # (S − 1,)
    for order in (range(1, len(starts)), range(len(starts) - 1, 0, -1)):
        for k in order:
            if pause_s[k - 1] < JOINED_S:
                unknown[k] |= doubtful[k] and bool(unknown[k - 1])
                unknown[k - 1] |= doubtful[k - 1] and bool(unknown[k])
    return unknown


def _unknown_load(found: Cut, fit: "_Fit", least_kg: float) -> Mask:
    """(S,) whether what is at the flange, beyond what is declared, is surely more than `least_kg`, or pulls as such a mass far from it."""
    mass = np.abs(fit.mass) > np.maximum(SURE * fit.mass_std, least_kg)
    unsure = 0.0 if found.centred else 2.0 * ARM_M * np.abs(found.load[found.starts, :1])  # of a declared load without a centre
    moment = np.abs(fit.moment) > np.maximum(SURE * fit.moment_std, least_kg * FAR_M + unsure)
    unknown: Mask = mass | np.any(moment, axis=1)
    return unknown


def _away_k(found: Cut, arm: ProductionArm) -> float:
    """How far the arm is from its temperature in the replay [K]; `UNKNOWN_AWAY_K` where that is not known."""
    if arm.identification.temperature_c is None:
        return UNKNOWN_AWAY_K
    away = np.abs(found.temperature_c - arm.identification.temperature_c)
    return float(np.mean(away[np.isfinite(away)])) if np.isfinite(away).any() else UNKNOWN_AWAY_K


def friction_size(arm: ProductionArm) -> Array:
    """(J,) of the friction of the last replay at 0.4 rad/s; of the residual where there is hardly any [N·m]."""
    size: Array = np.maximum(np.abs(arm.friction[:, 0]) + 0.4 * np.abs(arm.friction[:, 1]), 5.0 * arm.residual_nm)
    return size


def _fitted(
    found: Cut, line: Array, load: Array, left: Array, used: Mask, arm: ProductionArm, friction_std: Array, contact: Mask
) -> tuple[Mask, "_Fit"]:
    """The rows of contact (n,), and the fit of the others, found in turn."""
    fit = _fit(found, line, load, left, used & ~contact[:, None], arm, friction_std)
    here = contact
    for _ in range(ROUNDS):
        here = contact | _by_residual(found, np.where(used, left - fit.explained, 0.0), used, arm)
        fit = _fit(found, line, load, left, used & ~here[:, None], arm, friction_std)
    return here, fit


class _Fit(NamedTuple):
    """A window fitted: the load of each segment (S,) [kg] and (S, 3) [kg·m], their standard deviations, and what explains torque (n, J)."""

    mass: Array
    mass_std: Array
    moment: Array
    moment_std: Array
    explained: Array
    of_load: Array


def _mean(found: Cut, values: Array) -> Array:
    """(S, …) mean of each segment."""
    count = np.bincount(found.segment)
    sums: Array = np.add.reduceat(values, found.starts, axis=0)
    return sums / count.reshape(-1, *[1] * (values.ndim - 1))


def _fit(found: Cut, line: Array, load: Array, left: Array, used: Mask, arm: ProductionArm, friction_std: Array) -> _Fit:
    """Friction of the window and load of each segment, by least squares with priors. friction_std : (J,) [N·m]."""
    J = arm.joints
    S, starts = len(found.starts), found.starts
    weight = np.where(used, 1.0 / (found.rate_hz * CORRELATED_S), 0.0) / np.maximum(arm.residual_nm, 0.02 * friction_std) ** 2  # (n, J)
    wx, wp = weight[:, :, None] * line, weight[:, :, None] * load
    xx = np.einsum("njk,njl->jkl", wx, line)
    xp = np.add.reduceat(np.einsum("njk,njl->njkl", wx, load), starts, axis=0)  # (S, J, 2, 4)
    pp = np.add.reduceat(np.einsum("njk,njl->nkl", wp, load), starts, axis=0)  # (S, 4, 4)
    xr, pr = np.einsum("njk,nj->jk", wx, left), np.add.reduceat(np.einsum("njk,nj->nk", wp, left), starts, axis=0)
    prior = np.array([POSSIBLE_KG, *[POSSIBLE_KG * ARM_M] * 3])
    inner = np.linalg.inv(pp + np.diag(prior**-2.0))  # (S, 4, 4)
    B = xp.reshape(S, 2 * J, LOADS)
    M = np.zeros((2 * J, 2 * J))
    for j in range(J):
        M[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] = xx[j] + np.diag(np.array([1.0, 0.4]) ** 2 / np.maximum(friction_std[j], 1e-9) ** 2)
    M -= np.einsum("sal,slm,sbm->ab", B, inner, B)
    cov = np.linalg.inv(M)
    f = cov @ (xr.ravel() - np.einsum("sal,slm,sm->a", B, inner, pr))
    g = np.einsum("slm,sm->sl", inner, pr - np.einsum("sal,a->sl", B, f))  # (S, 4)
    K = np.einsum("slm,sam->sla", inner, B)  # (S, 4, 2J)
    std = np.sqrt(np.maximum(inner[:, range(LOADS), range(LOADS)] + np.einsum("sla,ab,slb->sl", K, cov, K), 0.0))  # (S, 4)
    of_load = np.einsum("njl,nl->nj", load, g[found.segment])
    explained = of_load + np.einsum("njk,jk->nj", line, f.reshape(J, 2))
    return _Fit(g[:, 0], std[:, 0], g[:, 1:], std[:, 1:], explained, of_load)


def _by_force(found: Cut, arm: ProductionArm, settings: ProductionSettings) -> Mask:
    """(n,) the rows with more force at the TCP than is usual in the window.

    A CB3 has no sensor: it computes the force from the currents, tens of newtons wrong in motion, and the residual says the same better.
    """
    if arm.robot.generation == WITHOUT_SENSOR or found.tcp_force_n is None or not np.all(np.isfinite(found.tcp_force_n)):
        return np.zeros(len(found.t_s), dtype=bool)
    size = np.linalg.norm(found.tcp_force_n, axis=1)
    usual = float(np.median(size))
    spread = MAD * float(np.median(np.abs(size - usual)))
    return _around(found, size > usual + max(settings.contact_n, 5.0 * spread))


def _by_residual(found: Cut, left: Array, used: Mask, arm: ProductionArm) -> Mask:
    """(n,) the rows whose torque is explained by nothing: its mean over a time of `CONTACT` is beyond chance in some joint.

    left : (n, J) 0 where a joint is too slow to tell, for there friction may be anything up to that of rest.
    """
    sums = np.cumsum(np.concatenate([np.zeros((1, left.shape[1])), left]), axis=0)
    usual = np.array([float(np.median(np.abs(left[on, j]))) if on.any() else 0.0 for j, on in enumerate(used.T)])
    scale = np.maximum(np.maximum(MAD * usual, arm.residual_nm), CONTACT_SHARE * friction_size(arm))
    beyond = np.zeros(len(left), dtype=bool)
    for time_s, deviations in CONTACT:
        width = max(1, round(time_s * found.rate_hz))
        first = np.maximum(np.arange(len(left)) - width // 2, 0)
        last = np.minimum(first + width, len(left))
        mean = (sums[last] - sums[first]) / (last - first)[:, None]
        beyond |= np.any(np.abs(mean) > deviations * scale, axis=1)
    return _around(found, beyond)


def _around(found: Cut, where: Mask) -> Mask:
    """(n,) these rows and those of the same segment within `CONTACT_AROUND_S` of them."""
    width = max(1, round(CONTACT_AROUND_S * found.rate_hz))
    if not where.any():
        return where
    wide = np.convolve(where.astype(float), np.ones(2 * width + 1), mode="same") > 0.5 if len(where) > 2 * width else where
    near: Mask = wide | where
    return near


class _Changes(NamedTuple):
    """Change of friction in each segment, as a fraction of it, (S, J): −1 is no friction at all."""

    share: Array  # NaN where a joint does not tell
    rows: Array  # that tell it
    seen: Mask


def _changes(found: Cut, line: Array, left: Array, used: Mask, arm: ProductionArm) -> _Changes:
    """Of each segment. left : (n, J) measured less what the arm with its known friction and each segment's load would need."""
    reference = np.einsum("njk,jk->nj", line, arm.friction[:, :2])  # (n, J) friction of the replay
    weight, starts = np.where(used, 1.0, 0.0), found.starts
    per = np.add.reduceat(weight * left * reference, starts, axis=0)
    size = np.add.reduceat(weight * reference**2, starts, axis=0)
    rows = np.add.reduceat(weight, starts, axis=0)
    seen = (rows > 0.2 * found.rate_hz) & (size > 0.0)
    return _Changes(np.divide(per, size, out=np.full_like(per, np.nan), where=seen), rows, seen)


def _disturbed(found: Cut, changes: _Changes, warmer: float) -> Mask:
    """(S,) segments in which most moving joints have another friction than the arm can have: a hand or a tool pushes, or drags.

    warmer : share of friction by which another temperature than in the replay changes fast motion more than slow motion, at most.
    """
    share, _, seen = changes
    count = np.sum(seen, axis=1)
    several = count >= SEVERAL
    middle = np.array([float(np.nanmedian(row)) if enough else 0.0 for row, enough in zip(share, several, strict=True)])
    seconds = np.bincount(found.segment).astype(float)
    as_known = several & (np.abs(middle) < AS_KNOWN)
    otherwise = several & (np.abs(middle) > OTHERWISE + warmer)
    both = np.sum(seconds[as_known]) > AS_KNOWN_SHARE * np.sum(seconds)
    other: Mask = (several & (middle < HELPED)) | (otherwise & both)
    return other


def _of_one_joint(changes: _Changes, most: float) -> Mask:
    """(S,) segments in which one joint's friction is by more than `most` another than in most of its motion in the window."""
    share, rows, seen = changes
    other = np.zeros(len(share), dtype=bool)
    for j in range(share.shape[1]):
        on = np.flatnonzero(seen[:, j])
        if len(on) < FEWEST_SEGMENTS:
            continue
        order = on[np.argsort(share[on, j])]
        weight = np.cumsum(rows[order, j])
        usual = share[order[np.searchsorted(weight, 0.5 * weight[-1])], j]
        other[on] |= np.abs(share[on, j] - usual) > most
    return other
