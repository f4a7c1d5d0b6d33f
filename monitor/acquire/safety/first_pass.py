"""The first pass after a change: the same trajectory, slowly and within a torque band; it is recorded and not assessed."""

import dataclasses
import hashlib
import json

import numpy as np

from monitor.acquire.safety.torque_band import TorqueBand
from monitor.acquire.settings import ReplaySettings
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Array, Context


def slowed(excitation: Excitation, settings: ReplaySettings) -> Excitation:
    """One repetition of the same trajectory, at the configured fraction of its speed."""
    return dataclasses.replace(excitation, repetitions=1, time_scale=settings.first_pass_time_scale * excitation.time_scale)


def first_pass_key(excitation: Excitation, settings: ReplaySettings, context: Context) -> str:
    """Digest of everything whose change asks for a first pass: arm, trajectory and time scale, cell, mounting, payload, tool."""
    relevant = [
        context.robot,
        context.serial,
        excitation.digest,
        None if settings.cell is None else settings.cell.digest,
        context.mounting_rad,
        context.payload_kg,
        context.tool,
    ]
    return hashlib.sha256(json.dumps(relevant).encode()).hexdigest()[:16]


def band_for(
    robot: Robot, excitation: Excitation, settings: ReplaySettings, context: Context, *, gains: Array | None, model: CompensatedModel | None
) -> TorqueBand:
    """The torque band of a first pass.

    `gains` (J,) are the configured drive gains; None takes the published ones. `model` may come from another trajectory of this arm, but
    not from another payload; None where there is no such model.
    """
    drive_gains = gains if gains is not None else robot.drive_gain_nm_per_a
    return TorqueBand(
        robot,
        excitation.mounting,
        payload_kg=context.payload_kg or 0.0,
        gains_nm_per_a=np.asarray(drive_gains, dtype=float),
        share=settings.first_pass_band,
        rate_hz=settings.rate_hz,
        model=model,
    )
