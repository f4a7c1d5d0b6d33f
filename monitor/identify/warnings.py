"""Warnings about the data of an identification: what the reader of its result must know."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.least_squares import Rows
from monitor.identify.signals.cleaning import DOUBTS
from monitor.identify.signals.motion import Motion
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


class DataWarning(NamedTuple):
    """One warning; `code` is for programs, `text` for people."""

    code: str
    text: str


def of_motion(motion: Motion, payload_kg: float | None) -> Iterator[DataWarning]:
    """Warnings about one motion. payload_kg : the payload that the recording names [kg]."""
    name = motion.source or "recording"
    if motion.rejected_samples:
        why = ", ".join(f"{count} {reason}" for reason, count in motion.rejected_why.items())
        yield DataWarning("rejected_rows", f"{name}: {motion.rejected_samples} of {motion.recorded_samples} rows were left out: {why}")
    for repair in motion.repairs:
        yield DataWarning(repair.code, f"{name}: {repair.text}{'' if repair.code in DOUBTS else '; put right'}")
    if motion.repaired_samples:
        yield DataWarning(
            "repaired_spikes", f"{name}: {motion.repaired_samples} readings of current or torque stood out alone and were repaired"
        )
    if motion.current_is_target:
        yield DataWarning(
            "current_is_target", f"{name}: the actual current equals the target's bit for bit: this is a simulator's, not an arm's"
        )
    if motion.rate_hz < LOW_RATE_HZ:
        yield DataWarning("low_rate", f"{name}: {motion.rate_hz:.3g} Hz blurs reversals and accelerations; 100 Hz or more is better")
    if payload_kg:
        yield DataWarning(
            "payload", f"{name}: a payload of {payload_kg:g} kg is part of the last link's parameters and of the load on friction"
        )
    if motion.temperature_c is not None:
        swing = np.ptp(motion.temperature_c, axis=0)  # (J,)
        for j in np.flatnonzero(swing > TEMPERATURE_DRIFT_K):
            yield DataWarning(
                "temperature_drift", f"{name}: joint {j + 1} changed by {swing[j]:.1f} K: viscous friction is that of the mean"
            )


def moving_share(moving: Sequence[Mask]) -> Array:
    """(J,) fraction of the samples in which a joint moves, of the recording in which it moves most. moving : (N, J) of each recording.

    Of the sweeps of single joints each moves one joint throughout, and in all together every joint moves in a sixth of the samples.
    """
    share: Array = np.max([[np.count_nonzero(column) / len(column) for column in one.T] for one in moving], axis=0)
    return share


def of_joints(speeds: Sequence[Array], moving: Sequence[Mask]) -> Iterator[DataWarning]:
    """Warnings about joints that hardly move, or in one direction only. speeds [rad/s], moving : (N, J) of each recording."""
    together, on = np.concatenate(speeds), np.concatenate(moving)
    for j, share in enumerate(moving_share(moving).tolist()):
        fastest = float(np.max(np.abs(together[:, j])))
        forward = np.count_nonzero(on[:, j] & (together[:, j] > 0.0)) / np.count_nonzero(on[:, j]) if share else 0.0
        if share < MOVING_SHARE or fastest < USEFUL_SPEED_RAD_S:
            text = f"joint {j + 1} moves in {share:.0%} of the samples and never faster than {fastest:.2g} rad/s: its friction is a guess"
            yield DataWarning("joint_hardly_moves", text)
        elif min(forward, 1.0 - forward) < ONE_WAY_SHARE:
            yield DataWarning("one_direction", f"joint {j + 1} moves one way only: Coulomb friction cannot be told from weight")


def of_robust_weights(rows: Sequence[Rows]) -> Iterator[DataWarning]:
    """Warnings about joints with many outliers, by the weights of a robust fit."""
    for j in range(rows[0].torque_nm.shape[1]):
        weights = [rec.robust_weight[rec.used[:, j], j] for rec in rows if rec.robust_weight is not None]
        weight = np.concatenate([np.empty(0), *weights])
        share = float(np.mean(weight < OUTLIER_WEIGHT)) if len(weight) else 0.0
        if share > OUTLIER_SHARE:
            yield DataWarning("outliers", f"joint {j + 1}: {share:.1%} of the samples do not fit the rest and had next to no weight")


def of_solution(
    names: Sequence[str], excited: Mask, condition: float, samples: int, coulomb_nm: Array, viscous_nm_s_per_rad: Array
) -> Iterator[DataWarning]:
    """Warnings by the solution: few samples, parameters that are not excited, a bad condition, negative friction.

    names, excited : (B,) of the base parameters. coulomb_nm, viscous_nm_s_per_rad : (J,).
    """
    if samples < SAMPLES_A_PARAMETER * len(names):
        yield DataWarning(
            "few_samples", f"{samples} samples for {len(names)} parameters; {SAMPLES_A_PARAMETER * len(names)} or more are better"
        )
    if not np.all(excited):
        missing = "; ".join(name for name, known in zip(names, excited, strict=True) if not known)
        yield DataWarning("not_excited", f"this motion does not reveal {missing}: those values are the manufacturer's")
    elif condition > ILL_CONDITIONED:
        yield DataWarning(
            "ill_conditioned",
            f"the condition number of this motion is {condition:.3g}, in the best base; a designed excitation reaches 50–200",
        )
    for j, (fc, fv) in enumerate(zip(coulomb_nm, viscous_nm_s_per_rad, strict=True)):
        if fc < 0.0 or fv < 0.0:
            text = (
                f"joint {j + 1}: fc = {fc:.3g} N·m, fv = {fv:.3g} N·m·s/rad; friction cannot be negative: gains, model or motion are wrong"
            )
            yield DataWarning("unphysical_friction", text)


def far_from_physical(residual_ratio: float) -> DataWarning:
    """The warning for a physically consistent fit whose residual is much larger than that of the unconstrained fit."""
    text = (
        f"the best arm that can exist leaves {residual_ratio - 1.0:.1%} more than the best that cannot: "
        f"gains, mounting, robot or friction law are doubtful"
    )
    return DataWarning("far_from_physical", text)


def of_held_out(fitted: Sequence[Recording], held_out: Sequence[Recording]) -> Iterator[DataWarning]:
    """Warnings about what is fitted and what is held out of the fit."""
    for held in held_out:
        for one in fitted:
            if held.samples == one.samples and np.array_equal(held.t_s, one.t_s) and np.array_equal(held.q, one.q):
                yield DataWarning(
                    "validated_on_fitted", f"{held.source}: was fitted too, as {one.source}: its error says nothing about other motions"
                )
    if held_out and len(fitted) > 1:
        yield DataWarning(
            "fitted_together",
            f"{', '.join(one.source for one in fitted)} are fitted together; held out of the fit: "
            f"{', '.join(held.source for held in held_out)} (each held-out file has its own --validate)",
        )


def of_recordings(recordings: Sequence[Recording]) -> Iterator[DataWarning]:
    """Warnings about recordings that do not belong together."""
    if len({(recording.context.payload_kg, recording.context.tool) for recording in recordings}) > 1:
        yield DataWarning("mixed_payload", "the recordings differ in payload or tool: one set of parameters cannot fit them all")
