"""The first pass after a change, which is slow, recorded and not assessed; and the torque band of any motion."""

import dataclasses
import hashlib
import json
import math
from collections.abc import Sequence

import numpy as np

from monitor.acquire.rows import COLUMN
from monitor.acquire.safety.band.basis import BandBasis
from monitor.acquire.safety.band.torque_band import TorqueBand
from monitor.acquire.settings import Installation, ReplaySettings
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
    row: Array,
    *,
    robot: Robot,
    excitation: Excitation,
    settings: ReplaySettings,
    context: Context,
    installation: Installation,
    basis: BandBasis,
) -> TorqueBand:
    """The torque band of a motion that is about to begin; `row` (WIDTH,) is what the controller reports before it.

    Payload and centre of mass are the configured ones, else the reported ones, with which the controller computes.
    Raises MotionRefused where a drive gain is not known.
    """
    payload_kg = context.payload_kg if context.payload_kg is not None else float(np.nan_to_num(row[COLUMN["payload"]][0]))
    if basis.payload_kg is not None and abs(payload_kg - basis.payload_kg) > settings.max_payload_error_kg:
        basis = BandBasis()  # the payload is not configured, and the controller was told of another one than that of the model
    com_m: Sequence[float] = installation.payload_cog_m or row[COLUMN["payload_cog"]].tolist()
    known = all(math.isfinite(metres) for metres in com_m) and any(com_m)  # a controller that was never told says 0
    x, y, z = com_m
    return TorqueBand(
        robot,
        excitation.mounting,
        settings,
        installation,
        basis,
        payload_kg=payload_kg,
        payload_com_m=(x, y, z) if known else None,
    )
