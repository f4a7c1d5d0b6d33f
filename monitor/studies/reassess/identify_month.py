"""The task of one arm-month: its recordings are read and identified, and what a verdict needs of them is kept. I/O, on a worker."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import ArchiveConflict, ArchiveLost, BadInput, Unidentifiable
from monitor.judge.assess import AssessSettings, identified
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Recording
from monitor.service.history.assess_and_store import robot_digest
from monitor.service.history.recompute import settings_from_document
from monitor.store.formats.recordings import RecordingFolder, recording_of
from monitor.studies.reassess.cost import Cost, Meter
from monitor.studies.reassess.files import Files, ReadAhead
from monitor.studies.reassess.identified import CHANGED, GONE, IDENTIFIED, REFUSED, UNIDENTIFIABLE, IdentifiedReplay, to_bytes
from monitor.studies.reassess.memory import keep_memory
from monitor.studies.reassess.plan import Month, Stored
from monitor.studies.reassess.program import IDENTIFIES, address_of, program
from monitor.studies.reassess.results import Results

KIND = "identified"  # of results


class IdentifiedMonth(NamedTuple):
    """What became of one arm-month."""

    address: str  # of the result
    found: bool  # whether it was there already
    cost: Cost


def identify_month(month: Month, place: str) -> IdentifiedMonth:
    """Identify the recordings of a month and keep the result at `place`; or find it there.

    A recording without an identification is a row of the result. Raises ResultsRefused where nothing can be kept, and as `Files.content`
    where the history or the archive is out of reach.
    """
    keep_memory()
    meter, results, files = Meter(), Results(place), Files(month)
    with meter.part("read"):
        digests = [stored.sha256 or files.digest(stored) for stored in month.recordings]
    inputs = [{**each, "robot_digest": robot_digest(load_robot(each["robot"]))} for each in month.inputs]
    rows = [(stored.replay, digest, stored.inputs) for stored, digest in zip(month.recordings, digests, strict=True)]
    address = address_of(program(IDENTIFIES), inputs, rows)
    if results.has(KIND, address):
        return IdentifiedMonth(address, True, meter.cost(0, files.bytes_read))
    replays = []
    pairs = list(zip(month.recordings, digests, strict=True))
    with ReadAhead(files, pairs) as contents:
        for stored, digest in pairs:
            replays.append(_identify(stored, digest, month.inputs[stored.inputs], contents, meter))
    if files.failed:  # what the history knows is not there, or is another: it may come back, so this result has an address of its own
        address = address_of(address, files.failed)
    with meter.part("write"):
        results.write(KIND, address, to_bytes(replays))
    return IdentifiedMonth(address, False, meter.cost(len(replays), files.bytes_read))


def _identify(stored: Stored, digest: str, inputs: dict[str, Any], contents: ReadAhead, meter: Meter) -> IdentifiedReplay:
    """One recording's row."""
    try:
        with meter.part("read"):
            content = contents.next()
        with meter.part("decode"):
            recording = recording_of(content, stored.path or stored.address)
            if recording.source == stored.address.rpartition("/")[2]:  # a file that does not say its name has that of the history's folder
                recording = replace(recording, source=RecordingFolder(Path()).path(stored.replay).name)
    except (BadInput, ArchiveLost) as wrong:
        return IdentifiedReplay(replay=stored.replay, state=GONE, reason=str(wrong))
    except ArchiveConflict as wrong:
        return IdentifiedReplay(replay=stored.replay, state=CHANGED, reason=str(wrong))
    gains = inputs["gains_nm_per_a"]
    settings: AssessSettings = settings_from_document(AssessSettings, inputs["settings"])
    found, state, reason = None, IDENTIFIED, ""
    with meter.part("compute"):
        try:
            found = identified(
                recording,
                load_robot(inputs["robot"]),
                Mounting.of(inputs["mounting_rad"]),
                np.array(gains) if gains else None,
                settings,
            )
        except Unidentifiable as wrong:
            state, reason = UNIDENTIFIABLE, str(wrong)
        except BadInput as wrong:
            state, reason = REFUSED, str(wrong)
        except Exception as wrong:  # an error of this program in one recording must not end the reassessment of a plant
            state, reason = REFUSED, f"internal: {type(wrong).__name__}: {wrong}"
    return _row(stored, digest, recording, state, reason, found)


def _row(stored: Stored, digest: str, recording: Recording, state: str, reason: str, found: Any) -> IdentifiedReplay:
    return IdentifiedReplay(
        replay=stored.replay,
        state=state,
        reason=reason,
        sha256=digest,
        context=recording.context,
        quality=recording.quality,
        samples=recording.samples,
        source=recording.source,
        identification=found,
    )
