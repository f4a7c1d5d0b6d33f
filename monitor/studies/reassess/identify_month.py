"""The memory of a worker: what one recording has used is kept for the next one."""

import ctypes
import hashlib
import json
import os
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pyarrow as pa

import monitor
from monitor import __version__
from monitor.errors import ArchiveConflict, ArchiveLost, ArchiveRefused, ArchiveUnavailable, BadInput, StoreError, Unidentifiable
from monitor.identify.identification import Identification
from monitor.identify.kept import from_parts, parts_of
from monitor.judge.assess import identified
from monitor.judge.document import typed
from monitor.judge.settings import AssessSettings
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array, Context, Recording
from monitor.service.history.assess_and_store import robot_digest
from monitor.service.history.recompute import settings_from_document
from monitor.store.archive.places import ArchiveSettings, open_place
from monitor.store.formats.recordings import recording_of
from monitor.store.history.ledger import RecordingFolder
from monitor.store.provenance import provenance
from monitor.studies.reassess.plan import Files, Month, ReadAhead, Stored

KEEP_BYTES = 512 * 1024 * 1024  # at the top of the heap; more goes back to the system
MAPPED_BYTES = 64 * 1024 * 1024  # arrays up to this size come from the heap: those of a recording are 2 to 30 MB
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h of the GNU C library


@cache
def keep_memory() -> bool:
    """Let the C library keep freed memory of this process; whether it was told so.

    Dask starts workers with MALLOC_TRIM_THRESHOLD_=65536, by which each array of a recording is given back and asked for again: the
    kernel then clears a million pages a minute, which takes as long as four fifths of the identification itself.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return False
    return bool(mallopt(M_MMAP_THRESHOLD, MAPPED_BYTES)) and bool(mallopt(M_TRIM_THRESHOLD, KEEP_BYTES))


# --- The program that makes a result: its version, the text of its modules, the packages. A result of another program is another result ---

# what decides an identification, and what decides a verdict besides: another text of one of them makes another result
IDENTIFIES = (
    "recording.py", "errors.py", "reason.py", "identify", "model", "judge/assess.py", "store/formats/columns.py",
    "store/formats/recordings.py", "studies/reassess/identify_month.py",
)  # fmt: skip
JUDGES = (*IDENTIFIES, "judge", "service/history", "studies/reassess")


@cache
def program(parts: tuple[str, ...]) -> dict[str, Any]:
    """The program as far as it decides a result, as plain JSON; the processor is left out: it is told beside."""
    facts = {key: value for key, value in provenance().items() if key != "processor"}
    return {**facts, "text": _text_digest(parts)}


def address_of(*parts: Any) -> str:
    """The address of a result by all that it was made from: SHA-256 of the parts as JSON, in hexadecimal digits."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def worker_facts() -> dict[str, Any]:
    """What a worker is: asked of each before it gets work."""
    return {"python": ".".join(map(str, sys.version_info[:2])), "joint_monitor": __version__, "program": program(JUDGES), **_processor()}


def _processor() -> dict[str, str]:
    facts = provenance()
    return {"processor": facts["processor"], "threads": facts["threads"]}


def _text_digest(parts: tuple[str, ...]) -> str:
    """16 hexadecimal digits of the text of these modules and folders."""
    folder, digest = Path(monitor.__file__).parent, hashlib.sha256()
    for part in parts:
        path = folder / part
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


# --- What a task takes: its parts by the clock, the processor's time, bytes and memory ------------------

PARTS = ("read", "decode", "compute", "write")


class Cost(NamedTuple):
    """What a task took. Times by the clock, but for `processor_s`; sums over tasks, but for `peak_mb`."""

    recordings: int = 0  # that were identified or judged; not those of a result that was there already
    bytes_read: int = 0
    read_s: float = 0.0  # to bring bytes here and to check them
    decode_s: float = 0.0  # bytes to signals
    compute_s: float = 0.0  # identification, or verdicts
    write_s: float = 0.0
    task_s: float = 0.0
    processor_s: float = 0.0
    peak_mb: float = 0.0  # of the worker's memory, so far

    def plus(self, other: "Cost") -> "Cost":
        """Both together."""
        parts: list[Any] = [mine + theirs for mine, theirs in zip(self, other, strict=True)]
        summed = Cost(*parts)
        return summed._replace(peak_mb=max(self.peak_mb, other.peak_mb))


class Meter:
    """Measures one task."""

    def __init__(self) -> None:
        self._began, self._processor = time.perf_counter(), time.process_time()
        self._parts = dict.fromkeys(PARTS, 0.0)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """What happens inside counts as this part."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._parts[name] += time.perf_counter() - began

    def cost(self, recordings: int, bytes_read: int) -> Cost:
        """What the task took until now."""
        return Cost(
            recordings=recordings,
            bytes_read=bytes_read,
            **{f"{name}_s": seconds for name, seconds in self._parts.items()},
            task_s=time.perf_counter() - self._began,
            processor_s=time.process_time() - self._processor,
            peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        )


# --- Identified replays as rows of an Arrow file, and back to the last bit: what a verdict needs of an identification, and no code ---

IDENTIFIED, UNIDENTIFIABLE, REFUSED, GONE, CHANGED = "identified", "unidentifiable", "refused", "gone", "changed"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentifiedReplay:
    """One recording after its identification, or why there is none."""

    replay: int  # its number in the ledger
    state: str  # IDENTIFIED; UNIDENTIFIABLE: too little motion; REFUSED: does not fit the arm; GONE: no recording; CHANGED: another one
    reason: str = ""
    sha256: str = ""  # of the file
    context: Context = field(default_factory=Context)
    quality: Mapping[str, Any] = field(default_factory=dict)
    samples: int = 0
    source: str = ""
    identification: Identification | None = None


def to_bytes(replays: Iterable[IdentifiedReplay]) -> bytes:
    """The Arrow file of a month's replays."""
    documents, numbers = [], []
    for replay in replays:
        document = {
            **{f.name: getattr(replay, f.name) for f in fields(replay) if f.name not in ("context", "quality", "identification")},
            "context": asdict(replay.context),
            "quality": dict(replay.quality),
        }
        flat: list[Array] = []
        if replay.identification is not None:
            document["identification"] = parts_of(replay.identification, flat)
        documents.append(json.dumps(document, default=_plain))
        numbers.append(np.concatenate([np.zeros(0), *(np.ravel(part) for part in flat)]))
    table = pa.table({"document": pa.array(documents, pa.large_string()), "numbers": pa.array(numbers, pa.large_list(pa.float64()))})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as writer:
        writer.write_table(table)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def from_bytes(content: bytes) -> list[IdentifiedReplay]:
    """The replays of `to_bytes`."""
    table = pa.ipc.open_file(pa.BufferReader(content)).read_all()
    rows = zip(table.column("document").to_pylist(), table.column("numbers"), strict=True)
    return [_replay(json.loads(text), np.asarray(row.values.to_numpy())) for text, row in rows]


def _replay(document: dict[str, Any], numbers: Array) -> IdentifiedReplay:
    identification = document.pop("identification", None)
    context = typed(Context, document.pop("context"), where="context")
    made = None if identification is None else from_parts(identification, numbers)
    return IdentifiedReplay(**document, context=context, identification=made)


def _plain(value: Any) -> Any:
    """JSON of numpy's numbers and arrays, which acquisition may have put into `quality`."""
    return value.tolist()


# --- The place of finished results, a folder or an S3 bucket: each under the address of all that it was made from. I/O ---

Found = TypeVar("Found")


class ResultsRefused(StoreError):
    """The place of the results refuses: nothing that is computed can be kept."""


class Results:
    """Results by kind and address. Every method raises ResultsRefused where the place does not answer, or does not let us in."""

    def __init__(self, place: str, *, make: bool = False) -> None:
        """Place : a folder, or s3://BUCKET/PREFIX. make : a folder that is not there. Raises BadInput for another address."""
        self.place = place
        if "://" not in place:
            folder = Path(place).absolute()
            place = str(folder)
            if make:
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                except OSError as wrong:
                    raise BadInput(f"--results {self.place}: cannot be made: {wrong.strerror or wrong}") from None
        try:
            self._at = open_place(ArchiveSettings(address=place))
        except BadInput as wrong:
            raise BadInput(f"--results {wrong}") from None

    def has(self, kind: str, address: str) -> bool:
        """Whether a result is finished."""
        return self._asked(lambda: self._at.has(_key(kind, address)))

    def read(self, kind: str, address: str) -> bytes | None:
        """A finished result; None where there is none."""
        return self._asked(lambda: self._at.read(_key(kind, address)))

    def write(self, kind: str, address: str, content: bytes) -> None:
        """Keep a finished result."""
        self._asked(lambda: self._at.write(_key(kind, address), content))

    def _asked(self, ask: Callable[[], Found]) -> Found:
        try:
            return ask()
        except (ArchiveUnavailable, ArchiveRefused) as wrong:
            raise ResultsRefused(f"--results {str(wrong).replace('[store] recordings', 'the address')}") from None


def whole(place: str) -> str:
    """The place as a worker with another working directory finds it."""
    return place if "://" in place else os.path.abspath(place)


def _key(kind: str, address: str) -> str:
    return f"{kind}/{address[:2]}/{address}"


# --- The task of one arm-month: its recordings are read and identified, and what a verdict needs of them is kept. I/O, on a worker ---

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
