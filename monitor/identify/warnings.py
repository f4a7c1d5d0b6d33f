"""Warnings about the data of an identification: what the reader of its result must know."""

from collections.abc import Iterator, Sequence

import numpy as np

from monitor.identify.fit.least_squares import Rows
from monitor.identify.signals.motion import Motion
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Mask, Recording

MOVING_SHARE = 0.2  # fraction of a recording's samples in which a joint moves: with less, its friction rests on a few seconds
USEFUL_SPEED_RAD_S = 0.2  # a joint that is always slower does not separate fc from fv
ONE_WAY_SHARE = 0.05  # fraction of the moving samples in one direction: with less, friction cannot be separated from weight
LOW_RATE_HZ = 50.0  # at a lower rate, reversals fall between samples
SAMPLES_A_PARAMETER = 20  # fewer samples for each parameter are few
TEMPERATURE_DRIFT_K = 1.0  # over this change of temperature fv changes by about 2 %
ILL_CONDITIONED = 1000.0  # condition number; an optimised excitation reaches 50–200: Raviola et al. (2021), table 3
FAR_FROM_PHYSICAL = 1.02  # residual of the physically consistent fit over that of unconstrained least squares
OUTLIER_WEIGHT = 0.2  # robust weight of a sample that is five standard deviations off
OUTLIER_SHARE = 0.01  # fraction of the samples with a lower weight; normal noise has none


REJECTED_ROWS = Sentence("rejected_rows", "{source}: {rejected} of {recorded} rows were left out: {why}")
REPAIRED_SPIKES = Sentence("repaired_spikes", "{source}: {count} readings of current or torque stood out alone and were repaired")
CURRENT_IS_TARGET = Sentence(
    "current_is_target", "{source}: the actual current equals the target's bit for bit: this is a simulator's, not an arm's"
)
LOW_RATE = Sentence("low_rate", "{source}: {rate_hz:.3g} Hz blurs reversals and accelerations; 100 Hz or more is better")
PAYLOAD = Sentence("payload", "{source}: a payload of {payload_kg:g} kg is part of the last link's parameters and of the load on friction")
TEMPERATURE_DRIFT = Sentence(
    "temperature_drift", "{source}: joint {joint} changed by {swing_k:.1f} K: viscous friction is that of the mean"
)
HARDLY_MOVES = Sentence(
    "joint_hardly_moves",
    "joint {joint} moves in {share:.0%} of the samples and never faster than {fastest_rad_s:.2g} rad/s: its friction is a guess",
)
ONE_DIRECTION = Sentence("one_direction", "joint {joint} moves one way only: Coulomb friction cannot be told from weight")
OUTLIERS = Sentence("outliers", "joint {joint}: {share:.1%} of the samples do not fit the rest and had next to no weight")
FEW_SAMPLES = Sentence("few_samples", "{samples} samples for {parameters} parameters; {enough} or more are better")
NOT_EXCITED = Sentence("not_excited", "this motion does not reveal {missing}: those values are the manufacturer's")
ILL_CONDITIONED_BASE = Sentence(
    "ill_conditioned", "the condition number of this motion is {condition:.3g}, in the best base; a designed excitation reaches 50–200"
)
UNPHYSICAL_FRICTION = Sentence(
    "unphysical_friction",
    "joint {joint}: fc = {fc_nm:.3g} N·m, fv = {fv_nm_s_per_rad:.3g} N·m·s/rad; friction cannot be negative: "
    "gains, model or motion are wrong",
)
NOT_AN_ARM = Sentence(
    "far_from_physical",
    "the best arm that can exist leaves {more:.1%} more than the best that cannot: gains, mounting, robot or friction law are doubtful",
)
VALIDATED_ON_FITTED = Sentence("validated_on_fitted", "{source}: was fitted too, as {fitted}: its error says nothing about other motions")
FITTED_TOGETHER = Sentence(
    "fitted_together",
    "{fitted} are fitted together; held out of the fit: {held_out} (each held-out file has its own --validate)",
)
MIXED_PAYLOAD = Sentence("mixed_payload", "the recordings differ in payload or tool: one set of parameters cannot fit them all")


def of_motion(motion: Motion, payload_kg: float | None) -> Iterator[Reason]:
    """Warnings about one motion. payload_kg : the payload that the recording names [kg]."""
    source = motion.source or "recording"
    if motion.rejected_samples:
        why = tuple(f"{count} {reason}" for reason, count in motion.rejected_why.items())
        yield REJECTED_ROWS(source=source, rejected=motion.rejected_samples, recorded=motion.recorded_samples, why=why)
    yield from motion.repairs
    if motion.repaired_samples:
        yield REPAIRED_SPIKES(source=source, count=motion.repaired_samples)
    if motion.current_is_target:
        yield CURRENT_IS_TARGET(source=source)
    if motion.rate_hz < LOW_RATE_HZ:
        yield LOW_RATE(source=source, rate_hz=motion.rate_hz)
    if payload_kg:
        yield PAYLOAD(source=source, payload_kg=payload_kg)
    if motion.temperature_c is not None:
        swing = np.ptp(motion.temperature_c, axis=0)  # (J,)
        for j in np.flatnonzero(swing > TEMPERATURE_DRIFT_K):
            yield TEMPERATURE_DRIFT(source=source, joint=j + 1, swing_k=swing[j])


def moving_share(moving: Sequence[Mask]) -> Array:
    """(J,) fraction of the samples in which a joint moves, of the recording in which it moves most. moving : (N, J) of each recording.

    Of the sweeps of single joints each moves one joint throughout, and in all together every joint moves in a sixth of the samples.
    """
    share: Array = np.max([[np.count_nonzero(column) / len(column) for column in one.T] for one in moving], axis=0)
    return share


def of_joints(speeds: Sequence[Array], moving: Sequence[Mask]) -> Iterator[Reason]:
    """Warnings about joints that hardly move, or in one direction only. speeds [rad/s], moving : (N, J) of each recording."""
    together, on = np.concatenate(speeds), np.concatenate(moving)
    for j, share in enumerate(moving_share(moving).tolist()):
        fastest = float(np.max(np.abs(together[:, j])))
        forward = np.count_nonzero(on[:, j] & (together[:, j] > 0.0)) / np.count_nonzero(on[:, j]) if share else 0.0
        if share < MOVING_SHARE or fastest < USEFUL_SPEED_RAD_S:
            yield HARDLY_MOVES(joint=j + 1, share=share, fastest_rad_s=fastest)
        elif min(forward, 1.0 - forward) < ONE_WAY_SHARE:
            yield ONE_DIRECTION(joint=j + 1)


def of_robust_weights(rows: Sequence[Rows]) -> Iterator[Reason]:
    """Warnings about joints with many outliers, by the weights of a robust fit."""
    for j in range(rows[0].torque_nm.shape[1]):
        weights = [rec.robust_weight[rec.used[:, j], j] for rec in rows if rec.robust_weight is not None]
        weight = np.concatenate([np.empty(0), *weights])
        share = float(np.mean(weight < OUTLIER_WEIGHT)) if len(weight) else 0.0
        if share > OUTLIER_SHARE:
            yield OUTLIERS(joint=j + 1, share=share)


def of_solution(
    names: Sequence[str], excited: Mask, condition: float, samples: int, coulomb_nm: Array, viscous_nm_s_per_rad: Array
) -> Iterator[Reason]:
    """Warnings by the solution: few samples, parameters that are not excited, a bad condition, negative friction.

    names, excited : (B,) of the base parameters. coulomb_nm, viscous_nm_s_per_rad : (J,).
    """
    enough = SAMPLES_A_PARAMETER * len(names)
    if samples < enough:
        yield FEW_SAMPLES(samples=samples, parameters=len(names), enough=enough)
    if not np.all(excited):
        missing = "; ".join(name for name, known in zip(names, excited, strict=True) if not known)
        yield NOT_EXCITED(missing=missing)
    elif condition > ILL_CONDITIONED:
        yield ILL_CONDITIONED_BASE(condition=condition)
    for j, (fc, fv) in enumerate(zip(coulomb_nm, viscous_nm_s_per_rad, strict=True)):
        if fc < 0.0 or fv < 0.0:
            yield UNPHYSICAL_FRICTION(joint=j + 1, fc_nm=fc, fv_nm_s_per_rad=fv)


def far_from_physical(residual_ratio: float) -> Reason:
    """The warning for a physically consistent fit whose residual is much larger than that of the unconstrained fit."""
    return NOT_AN_ARM(more=residual_ratio - 1.0)


def of_held_out(fitted: Sequence[Recording], held_out: Sequence[Recording]) -> Iterator[Reason]:
    """Warnings about what is fitted and what is held out of the fit."""
    for held in held_out:
        for one in fitted:
            if held.samples == one.samples and np.array_equal(held.t_s, one.t_s) and np.array_equal(held.q, one.q):
                yield VALIDATED_ON_FITTED(source=held.source, fitted=one.source)
    if held_out and len(fitted) > 1:
        yield FITTED_TOGETHER(fitted=[one.source for one in fitted], held_out=[held.source for held in held_out])


def of_recordings(recordings: Sequence[Recording]) -> Iterator[Reason]:
    """Warnings about recordings that do not belong together."""
    if len({(recording.context.payload_kg, recording.context.tool) for recording in recordings}) > 1:
        yield MIXED_PAYLOAD()
