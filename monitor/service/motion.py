"""One motion of the arm, subject to guards, history and permit, with a slow first pass after a change.

The daemon's scheduler and `joint-monitor replay` both move an arm through `move`.
"""

import dataclasses
import logging
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from monitor.acquire.check import check
from monitor.acquire.replay import replay
from monitor.acquire.safety.first_pass import band_for, first_pass_key, slowed
from monitor.acquire.safety.gate import Announce, AskPermit
from monitor.acquire.safety.inputs import ConditionResult, Permit
from monitor.acquire.watch import ReplayProgress
from monitor.config.schema import Configuration
from monitor.errors import ReplayAborted, StoreError
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.model.fourier import Excitation
from monitor.publish.permit import PermitReply
from monitor.publish.timestamps import outside
from monitor.recording import Context, Recording
from monitor.store.backup import present
from monitor.store.recordings import write_recording
from monitor.store.store import Store

log = logging.getLogger(__name__)

AskAnswer = Callable[[Mapping[str, Any], float], PermitReply | None]


def move(
    configuration: Configuration,
    store: Store,
    excitation: Excitation,
    context: Context,
    *,
    should_stop: Callable[[], bool],
    first_pass_path: Path,
    on_progress: Callable[[ReplayProgress], None] | None = None,
    ask: AskAnswer | None = None,
    announce: Announce | None = None,
    model: CompensatedModel | None = None,
) -> Recording:
    """One replay. A slow first pass precedes it where something has changed since the last one; its recording goes to `first_pass_path`.

    Raises as `acquire.replay.replay`, and StoreError where the first pass cannot be kept.
    """
    settings, robot = configuration.replay, configuration.robot_description

    def play(played: Excitation, *, slowly: bool) -> Recording:
        waiting = store.stops.waiting()
        stop_text = waiting[-1].text if waiting else None
        band = None
        if slowly:
            band = band_for(
                robot, played, settings, context, gains=configuration.gains_nm_per_a, model=model if _same_load(store, context) else None
            )
            log.info("first pass at %g of the pace, torque within %s", played.time_scale, band.description)
        return replay(
            played,
            robot,
            settings,
            context=context,
            installation=configuration.installation,
            on_progress=on_progress,
            should_stop=should_stop,
            stopped_before=stop_text,
            ask=None if ask is None else _permit(ask),
            announce=announce,
            band=band,
        )

    digest = first_pass_key(excitation, settings, context)
    if settings.first_pass and not store.first_passes.is_latest(digest):
        slow = play(slowed(excitation, settings), slowly=True)
        note = "first pass, slow: not assessed"
        write_recording(first_pass_path, dataclasses.replace(slow, context=dataclasses.replace(slow.context, note=note)))
        store.first_passes.add(digest, _load(context) | {"recording": first_pass_path.name, "quality": dict(slow.quality)}, time.time())
        if should_stop():
            raise ReplayAborted("stopped on request after the first pass; the arm stands", "parent_asked_to_stop")
    return play(excitation, slowly=False)


def check_conditions(configuration: Configuration, *, ask: AskAnswer | None = None) -> tuple[ConditionResult, ...]:
    """Every condition as it is now. Nothing is sent to the arm but requests for its state; the history adds its stops."""
    stop_text = None
    try:
        with Store.reader(configuration.state_directory) as store:
            waiting = store.stops.waiting()
            stop_text = waiting[-1].text if waiting else None
    except StoreError:
        if present(configuration.state_directory):
            raise  # a history that cannot be read is not an empty one
    return check(
        configuration.replay,
        configuration.excitation,
        configuration.robot_description,
        configuration.context,
        installation=configuration.installation,
        stopped_before=stop_text,
        ask=None if ask is None else _permit(ask),
    )


def _permit(ask: AskAnswer) -> AskPermit:
    def asking(about: Mapping[str, Any], timeout_s: float) -> Permit | None:
        question = outside(dict(about))
        assert isinstance(question, dict)
        answer = ask(question, timeout_s)
        return None if answer is None else Permit(answer.allowed, answer.text)

    return asking


def _load(context: Context) -> dict[str, Any]:
    """The load and mounting that a torque model holds for: with another load the torque is another."""
    mounting = None if context.mounting_rad is None else list(context.mounting_rad)
    return {"payload_kg": context.payload_kg, "tool": context.tool, "mounting_rad": mounting}


def _same_load(store: Store, context: Context) -> bool:
    latest = store.first_passes.latest()
    return latest is not None and {key: latest.get(key) for key in _load(context)} == _load(context)
