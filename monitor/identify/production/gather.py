"""Segments of production → sums: rows are weighted, each segment's load is projected out, and nothing but the sums remains."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from monitor.identify.production.arm import LAW, LOADS, ProductionArm, ProductionRows, windows
from monitor.identify.production.cut import Cut
from monitor.identify.production.gate import CORRELATED_S, FRICTION_STD, Explained, Segments, friction_size, segments
from monitor.identify.production.information import NO_BIN, PATHS, ProductionInformation, Sums, added
from monitor.identify.settings import ProductionSettings
from monitor.recording import DAY_S, Array, Indices

WINDOW_S = 60.0  # of the rows that are judged together: long enough that joints turn to and fro
LOAD_ARM_M = 0.1  # a load that is wrong by so much mass is wrong by so much first moment a kilogram
PATH_GRID_RAD = 0.2  # segments between places that are nearer than this are one path
RECENT_DAYS = 2.0  # of information that says how friction is now


def initial(arm: ProductionArm, settings: ProductionSettings) -> ProductionInformation:
    """Information before the first row."""
    return ProductionInformation(
        robot=arm.robot.name,
        rigid_columns=arm.rigid_columns,
        law=LAW.name,
        payload_kg=0.0 if arm.payload_kg is None else arm.payload_kg,
        temperature_bin_k=settings.temperature_bin_k,
    )


def gather(
    rows: ProductionRows, arm: ProductionArm, settings: ProductionSettings, before: ProductionInformation | None = None
) -> ProductionInformation:
    """What these rows tell; `before + gather(…)` is what is known then.

    before : tells how friction is now, so that a load is not taken for friction, nor friction for a load. The rows may be of seconds or
    of hours: they are judged in windows of a minute, so a caller with live rows hands over about a minute at once.
    Raises BadInput and Unidentifiable as `segments`.
    """
    total = initial(arm, settings)
    for window in windows(rows, WINDOW_S):
        known = total if before is None or not _added_up(before, total) else before + total
        found = segments(window, arm, settings, friction_change(known, arm))
        total = total + _told(found, arm, settings)
    return total


def friction_change(information: ProductionInformation, arm: ProductionArm) -> Array:
    """(J, 2) by how much fc and fv differ from the last replay's, by the production of the last days; 0 where it tells nothing."""
    J = arm.joints
    if not information.cells:
        return np.zeros((J, 2))
    last = max(sums.end_unix_s for sums in information.cells.values())
    recent = [sums for sums in information.cells.values() if sums.end_unix_s > last - RECENT_DAYS * DAY_S]
    sums = added(recent)
    h = excess(sums, arm.rigid, arm.friction)
    size = FRICTION_STD * friction_size(arm)
    prior = np.stack([size**-2.0, 0.16 * size**-2.0], axis=1).ravel()
    return np.asarray(np.linalg.solve(sums.gram + np.diag(prior), h), dtype=float).reshape(J, 2)


def excess(sums: Sums, rigid: Array, friction: Array) -> Array:
    """(A,) XᵀW of the torque beyond that of the rigid parameters (R,) and of the friction (J, K)."""
    beyond = sums.beyond @ friction[:, 2:].ravel() if sums.beyond.shape[1] else 0.0
    left: Array = sums.torque - sums.rigid @ rigid - beyond - sums.gram @ friction[:, :2].ravel()
    return left


def _added_up(before: ProductionInformation, now: ProductionInformation) -> bool:
    return before.rigid_columns == now.rigid_columns and before.payload_kg == now.payload_kg and before.law == now.law


class _BySegment(NamedTuple):
    """Sums of each segment: of X (S, A, …) and of the load's columns P (S, 4, …), with themselves and with what explains torque."""

    xx: Array  # (S, J, 2, 2)
    xp: Array  # (S, A, 4)
    pp: Array  # (S, 4, 4)
    x_other: Array  # (S, A, 2 + R + J·E) of torque, residual, rigid columns, friction beyond fc and fv
    p_other: Array  # (S, 4, 2 + R + J·E)


def _told(found: Segments, arm: ProductionArm, settings: ProductionSettings) -> ProductionInformation:
    """What one window tells."""
    day = int(found.begin_unix_s // DAY_S)
    rows = found.counted
    return replace(
        initial(arm, settings),
        left_out_s={day: found.left_out_s} if found.left_out_s else {},
        seen_s={day: found.duration_s} if found.duration_s > 0.0 else {},
        cells={} if rows is None else {(day, _bin(rows.cut, settings)): _sums(rows, found.begin_unix_s, arm, settings)},
    )


def _bin(cut: Cut, settings: ProductionSettings) -> int:
    """The range of temperature of a window, by the mean over its joints."""
    known = cut.temperature_c[np.isfinite(cut.temperature_c)]
    return int(np.floor(np.mean(known) / settings.temperature_bin_k)) if len(known) else NO_BIN


def _sums(found: Explained, at_unix_s: float, arm: ProductionArm, settings: ProductionSettings) -> Sums:
    """The sums over the rows of a window."""
    cut, J = found.cut, arm.joints
    by = _by_segment(found, arm)
    std = np.tile(max(settings.load_std_kg, 1e-6) * np.array([1.0, *[LOAD_ARM_M] * 3]), (len(cut.starts), 1))  # (S, 4)
    if not cut.centred:
        std[:, 1:] = np.hypot(std[:, 1:], LOAD_ARM_M * cut.load[cut.starts, :1])
    inner = np.linalg.inv(by.pp + np.eye(LOADS) * std[:, None, :] ** -2.0)  # (S, 4, 4)
    gain = np.einsum("sal,slm->sam", by.xp, inner)  # (S, A, 4)
    grams = -np.einsum("sam,sbm->sab", gain, by.xp)  # (S, A, A)
    for j in range(J):
        grams[:, 2 * j : 2 * j + 2, 2 * j : 2 * j + 2] += by.xx[:, j]
    other = by.x_other - np.einsum("sam,smk->sak", gain, by.p_other)
    total, R = np.sum(other, axis=0), len(arm.rigid_columns)
    paths, path_gram, path = np.zeros((PATHS, 2 * J)), np.zeros((PATHS, J, 2, 2)), _paths(cut)
    np.add.at(paths, path, other[:, :, 1])
    own = 2 * np.arange(J)[:, None] + np.arange(2)  # (J, 2)
    np.add.at(path_gram, path, grams[:, own[:, :, None], own[:, None, :]])
    tick = 1.0 / cut.rate_hz
    seconds = found.used * tick  # (n, J)
    known = np.isfinite(cut.temperature_c)
    return Sums(
        gram=np.sum(grams, axis=0),
        torque=total[:, 0],
        rigid=total[:, 2 : 2 + R],
        beyond=total[:, 2 + R :],
        paths=paths,
        path_gram=path_gram,
        moving_s=np.sum(seconds, axis=0),
        temperature=np.stack([np.sum(seconds * np.where(known, cut.temperature_c, 0.0), axis=0), np.sum(seconds * known, axis=0)]),
        speed=np.sum(seconds * np.abs(cut.qd), axis=0),
        begin_unix_s=at_unix_s + float(cut.t_s[0]),
        end_unix_s=at_unix_s + float(cut.t_s[-1]),
    )


def _by_segment(found: Explained, arm: ProductionArm) -> _BySegment:
    cut, torques, J = found.cut, found.torques, arm.joints
    starts, n = cut.starts, len(cut.t_s)
    weight = np.where(found.used, 1.0 / (cut.rate_hz * CORRELATED_S), 0.0) / arm.residual_nm**2  # (n, J)
    line, load = torques.friction[:, :, :2], torques.load
    wx, wp = weight[:, :, None] * line, weight[:, :, None] * load
    torque = cut.torque_nm - np.einsum("njl,nl->nj", load, cut.load)
    common = np.concatenate([torque[:, :, None], found.residual_nm[:, :, None], torques.rigid], axis=2)  # (n, J, 2 + R)
    beyond = torques.friction[:, :, 2:]  # (n, J, E)
    E, S = beyond.shape[2], len(starts)
    x_common = np.add.reduceat(wx[:, :, :, None] * common[:, :, None, :], starts, axis=0).reshape(S, 2 * J, -1)
    x_beyond = np.zeros((S, J, 2, J, E))
    x_beyond[:, np.arange(J), :, np.arange(J)] = np.moveaxis(
        np.add.reduceat(wx[:, :, :, None] * beyond[:, :, None, :], starts, axis=0), 0, 1
    )
    p_common = np.add.reduceat(np.matmul(wp.transpose(0, 2, 1), common), starts, axis=0)  # (S, 4, 2 + R)
    p_beyond = np.add.reduceat(np.einsum("njl,nje->nlje", wp, beyond).reshape(n, LOADS, J * E), starts, axis=0)
    return _BySegment(
        xx=np.add.reduceat(wx[:, :, :, None] * line[:, :, None, :], starts, axis=0),
        xp=np.add.reduceat(wx[:, :, :, None] * load[:, :, None, :], starts, axis=0).reshape(S, 2 * J, LOADS),
        pp=np.add.reduceat(np.matmul(wp.transpose(0, 2, 1), load), starts, axis=0),
        x_other=np.concatenate([x_common, x_beyond.reshape(S, 2 * J, J * E)], axis=2),
        p_other=np.concatenate([p_common, p_beyond], axis=2),
    )


def _paths(cut: Cut) -> Indices:
    """(S,) the bucket of each segment's path, by where it begins and ends."""
    starts = cut.starts
    ends = np.append(starts[1:], len(cut.t_s)) - 1
    places = np.round(np.concatenate([cut.q[starts], cut.q[ends]], axis=1) / PATH_GRID_RAD).astype(np.int64)
    factor = np.array([(2654435761 * (k + 1) + 40503 * (k + 1) ** 2) % 1000003 for k in range(places.shape[1])])
    mixed = (places * factor).sum(axis=1) % 1000003
    bucket: Indices = (mixed * 7919 % 1000003) % PATHS
    return bucket
