"""What the daemon computes of ordinary work in a process of its own: the frozen model of the arm, and the verdict of a day. Reads files.

Both want what a daemon that only listens does not load (scipy, filterpy, pyarrow), and what is loaded once stays for ever.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.identify.production.information import ProductionInformation
from monitor.identify.production.settings import ProductionSettings
from monitor.judge.alerts.health import Health
from monitor.judge.assess import AssessSettings
from monitor.judge.belief import Belief
from monitor.judge.drift.contexts import differences
from monitor.judge.production import ProductionAssessment, assess_production, observation_of
from monitor.judge.production_observation import ProductionObservation, context_of_production
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, Context
from monitor.store.formats.recordings import read_recording


class ReplayInputs(NamedTuple):
    """What the model of a kept replay depends on, besides its recording."""

    robot: Robot
    mounting: Mounting
    gains: Array | None
    settings: AssessSettings
    declared: Context  # what the configuration says now of payload, tool and mounting


class ReplayModel(NamedTuple):
    """What a kept replay says of the arm."""

    identification: Identification
    payload_kg: float | None


class DayInputs(NamedTuple):
    """What the verdict of a day of work depends on, besides the sums."""

    identification: Identification
    name: str  # of the replay that gave it
    context: Context  # of the arm that works
    production: ProductionSettings
    settings: AssessSettings
    belief: Belief
    health: Health


def declared_now(known: Context, declared: Context) -> Context:
    """A context with what is declared now of payload, tool and mounting."""
    return replace(known, payload_kg=declared.payload_kg, tool=declared.tool, mounting_rad=declared.mounting_rad)


def replay_model(path: Path, inputs: ReplayInputs) -> ReplayModel | None:
    """The identification of a kept replay; None where its payload, tool or mounting are not the declared ones.

    Raises BadInput and Unidentifiable where it gives none.
    """
    recording = read_recording(path)
    now = declared_now(recording.context, inputs.declared)
    if differences(context_of_production(now), context_of_production(recording.context)):
        return None
    found = identify(
        [recording],
        inputs.robot,
        inputs.mounting,
        method=inputs.settings.method,
        gains=inputs.gains,
        settings=inputs.settings.identify,
        residual_friction=True,
    )
    return ReplayModel(found, recording.context.payload_kg)


def production_verdict(
    information: ProductionInformation, last_day: int, inputs: DayInputs
) -> tuple[ProductionObservation, ProductionAssessment] | None:
    """What the work until the end of a UTC day tells, and what follows; None where nothing was listened to.

    Raises BadInput where these days were judged already.
    """
    belief, drift = inputs.belief, inputs.settings.drift
    before = None if belief.production is None else belief.production.learnt_at_unix_s
    found = observation_of(
        information, inputs.identification, inputs.production, learnt_at_unix_s=before, last_day=last_day, arm=inputs.name
    )
    if found is None:
        return None
    verdict = assess_production(
        found,
        inputs.context,
        belief=belief,
        health=inputs.health,
        settings=drift,
        laws=inputs.settings.temperature,
        limits=inputs.settings.health,
    )
    return found, verdict
