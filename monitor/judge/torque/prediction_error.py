"""How far predicted torque is off, told apart from the noise of its measurement: replays foreseen by the model that was held before them.

Measured minus foreseen torque is the model's error and the measurement's noise. The error lasts, the noise is over within a few
samples: so the residual's covariance with itself `NOISE_S` later is the error's alone. (An estimate of noise from differences, Rice (1984),
taken off the whole.) After a reversal the servo catches up: it overshoots and takes that back, which `NOISE_S` later is large and of
either sign, so these moments count for the measurement only. One replay tells the error badly, so replays are pooled; until some
have, the fit's own residual stands for both.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from monitor.judge.document import arrays
from monitor.judge.torque.predictor import prepared
from monitor.model.robot import Robot
from monitor.recording import Array, Recording

if TYPE_CHECKING:
    from monitor.judge.torque.compensated_model import CompensatedModel

MOVING_RAD_S = 0.02  # below it friction holds rather than rubs, and no model of it says how much
NOISE_S = 0.08  # drives' noise of successive samples of 8 ms is correlated by 0.3, of every tenth by less than 0.01
SETTLED_S = 0.1  # since the joint turned round: a simulated servo has caught up after 70 ms
LEAST_PAIRS = 100  # of samples that far apart, in motion: fewer say nothing
POOLED_REPLAYS = 40.0  # what is older fades
OWN_REPLAYS = 3.0  # the fit's own residual, noise and all, weighs as many
LEAST_SHARE = 0.04  # of the square of that residual: nothing is known better than to a fifth of it
WILDEST = 4.0  # times what is believed: one replay says no more than that


class Doubt(NamedTuple):
    """Pooled over replays, (J,) each."""

    replays: Array  # how many told, POOLED_REPLAYS at most
    error_nm2: Array  # mean square of the model's error; of few replays it may come out negative
    measured_nm2: Array  # mean square of a raw sample's residual


class Missed(NamedTuple):
    """The same of one replay; NaN where a joint says nothing."""

    error_nm2: Array
    measured_nm2: Array


def missed(recording: Recording, model: "CompensatedModel", robot: Robot, gains: Array | None) -> Missed | None:
    """How far the model was off in a replay that it has not learnt from; None where the recording lacks a signal for that."""
    qd, qdd, current, temperature_c = recording.qd, recording.target_qdd, recording.current, recording.temperature_c
    if qd is None or qdd is None or current is None or temperature_c is None or recording.samples < LEAST_PAIRS:
        return None
    foreseen = prepared(model, robot).torque(recording.q, qd, qdd, temperature_c)
    gain = robot.drive_gain_nm_per_a if gains is None else gains
    residual = np.where((np.abs(qd) > MOVING_RAD_S) & ~foreseen.extrapolated, current * gain - foreseen.torque, np.nan)  # (N, J)
    settled = np.where(_since_reversal_s(recording.t_s, qd) > SETTLED_S, residual, np.nan)
    later = max(1, round(NOISE_S / float(np.median(np.diff(recording.t_s)))))
    products = settled[later:] * settled[:-later]
    enough = np.isfinite(products).sum(axis=0) >= LEAST_PAIRS
    return Missed(*(_mean(np.where(enough, part, np.nan)) for part in (products, residual**2)))


def pooled(doubt: Doubt | None, told: Missed, residual_rms_nm: Array) -> Doubt:
    """After one more replay. residual_rms_nm : (J,) of the model's fit, which nothing but several replays may be far from."""
    J = len(residual_rms_nm)
    before = doubt or Doubt(np.zeros(J), np.zeros(J), np.zeros(J))
    tells = np.isfinite(told.error_nm2) & np.isfinite(told.measured_nm2) & np.isfinite(residual_rms_nm)
    n = np.minimum(before.replays + tells, POOLED_REPLAYS)
    of_error, of_measured = believed(before, residual_rms_nm)
    error = np.clip(np.where(tells, told.error_nm2, 0.0), -WILDEST * of_error**2, WILDEST * of_error**2)
    square = np.where(tells, told.measured_nm2, 0.0)
    square = np.where(before.replays > 0, np.minimum(square, WILDEST * of_measured**2), square)
    share = np.where(tells, 1.0 / np.maximum(n, 1.0), 0.0)
    return Doubt(
        replays=n,
        error_nm2=before.error_nm2 + share * (error - before.error_nm2),
        measured_nm2=before.measured_nm2 + share * (square - before.measured_nm2),
    )


def believed(doubt: Doubt | None, residual_rms_nm: Array) -> tuple[Array, Array]:
    """(J,) each [N·m]: root mean square of the model's error, and of a measured sample's residual.

    Until replays were foreseen both are the fit's own residual, and for the error that counts as `OWN_REPLAYS` of them later on.
    """
    if doubt is None:
        return residual_rms_nm, residual_rms_nm
    own = residual_rms_nm**2
    error = (OWN_REPLAYS * own + doubt.replays * doubt.error_nm2) / (OWN_REPLAYS + doubt.replays)
    error = np.sqrt(np.maximum(error, LEAST_SHARE * own))
    measured = np.where(doubt.replays > 0, np.sqrt(doubt.measured_nm2), residual_rms_nm)
    return error, np.maximum(measured, error)


def doubt_from_document(document: Any, J: int) -> Doubt | None:
    """Raises BadInput naming what is missing or wrong; None of null."""
    return None if document is None else Doubt(**arrays(document, Doubt._fields, (J,), where="belief: doubt"))


def _since_reversal_s(t_s: Array, qd: Array) -> Array:
    """(N, J) time since each joint last stood or turned round; long before it was first seen to."""
    turned = np.abs(qd) <= MOVING_RAD_S
    turned[1:] |= np.sign(qd[1:]) != np.sign(qd[:-1])
    when: Array = np.maximum.accumulate(np.where(turned, t_s[:, None], -np.inf), axis=0)
    return t_s[:, None] - when


def _mean(values: Array) -> Array:
    """(J,) of what is finite; NaN where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    mean: Array = np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    return mean
