"""What the history knows of an arm for the torque band of its next motion: model, and profile of the trajectory. I/O."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from monitor.acquire.safety.torque_basis import BandBasis
from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.judge.torque.model import CompensatedModel, model_from_document
from monitor.model.fourier import Excitation
from monitor.recording import Context, Recording
from monitor.service.computing import HERE, Compute, ComputingFailed
from monitor.store.store import Store

log = logging.getLogger(__name__)

PROFILE_REPLAYS = 3  # the latest accepted ones: enough to see what returns at a place, and it takes a second
PROFILE_ROWS = 8000  # 0.5 ms each: the motion begins so much later
LOOK_BACK = 12  # assessed replays among which those of this trajectory are searched


def learnt_basis(
    store: Store,
    configuration: Configuration,
    excitation: Excitation,
    context: Context,
    model: CompensatedModel | None = None,
    compute: Compute = HERE,
) -> BandBasis:
    """`torque_basis`, where `compute` reads the recordings. Raises StoreError."""
    if not store.ledger.rows(limit=1, states=("assessed",)):
        return BandBasis()
    try:
        return compute(_basis_of, store.directory, configuration, excitation, context, model)
    except ComputingFailed as error:
        log.warning("what was learnt for the torque band is read here: %s", error)
        return torque_basis(store, configuration, excitation, context, model)


def _basis_of(
    directory: Path, configuration: Configuration, excitation: Excitation, context: Context, model: CompensatedModel | None
) -> BandBasis:
    with Store.reader(directory) as store:
        return torque_basis(store, configuration, excitation, context, model)


def torque_basis(
    store: Store, configuration: Configuration, excitation: Excitation, context: Context, model: CompensatedModel | None = None
) -> BandBasis:
    """The basis of the band along this excitation. `model` is the present model; None takes the stored one.

    The model and the profile hold for the load of the latest assessed replay; with another load there are neither.
    """
    from monitor.acquire.safety.torque_band import learn_profile

    robot, installation = configuration.robot_description, configuration.installation
    earlier = _accepted(store)
    if not earlier or installation.drive_gains(robot) is None or not _same_load(earlier[0].context, context):
        return BandBasis()
    model = model or _stored_model(store)
    if model is None or model.robot != robot.name:
        return BandBasis()
    basis = BandBasis(model=model.as_document(), payload_kg=earlier[0].context.payload_kg)
    alike = [
        each
        for each in earlier
        if each.context.trajectory_digest == excitation.digest and _same_load(each.context, earlier[0].context) and each.qd is not None
    ]
    profile = learn_profile(_shortened(alike), robot, excitation, configuration.replay, installation, basis)
    return replace(basis, profile=profile)


def _shortened(recordings: list[Recording]) -> list[Recording]:
    """The first PROFILE_REPLAYS of them, fewer where they have more than PROFILE_ROWS rows together; the first in any case."""
    rows = [sum(each.samples for each in recordings[: count + 1]) for count in range(min(len(recordings), PROFILE_REPLAYS))]
    return recordings[: max(sum(total <= PROFILE_ROWS for total in rows), 1)]


def _accepted(store: Store) -> list[Recording]:
    """The latest assessed recordings, newest first; unreadable and pruned ones are left out."""
    from monitor.store.formats.recordings import read_recording

    found = []
    for row in reversed(store.ledger.rows(limit=LOOK_BACK, states=("assessed",))):
        path = store.recordings.path(row.id)
        try:
            found.append(read_recording(path))
        except BadInput:
            continue
    return found


def _same_load(recorded: Context, context: Context) -> bool:
    """Whether a replay carried what this one will: a model of another load expects another torque.

    A payload or tool that is not configured is compared by the streaming process, with what the controller reports.
    """
    payload = context.payload_kg is None or recorded.payload_kg is None or abs(recorded.payload_kg - context.payload_kg) < 1e-6
    one, other = recorded.mounting_rad, context.mounting_rad
    mounted = one is None or other is None or np.allclose(one, other, atol=1e-6)
    return payload and mounted and recorded.tool == context.tool


def _stored_model(store: Store) -> CompensatedModel | None:
    state = store.assessments.state()
    try:
        return None if state is None else model_from_document(state.model)
    except BadInput as wrong:
        log.warning("the stored torque model cannot be read, the band is that of the manufacturer's parameters: %s", wrong)
        return None
