"""Other settings for the past: the keys that a file names replace those with which each verdict was made; the others stay. I/O."""

import datetime
import hashlib
import os
import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import orjson

from monitor.config.files import OF_PLANT, find_prior
from monitor.config.schema import FlowSettings, assess_sections, section_classes
from monitor.config.sections import Mistake, nearest, of_key, of_section, read_section
from monitor.config.sources import Source
from monitor.errors import ArchiveConflict, ArchiveUnavailable, BadInput, StoreError
from monitor.judge.document import plain
from monitor.judge.friction.settings import DriftSettings
from monitor.judge.settings import AssessSettings
from monitor.plant.database import Database
from monitor.service.history.recompute import settings_from_document
from monitor.store.archive.archive import Archive, split_address
from monitor.store.archive.places import ArchiveSettings
from monitor.store.backup import HISTORY
from monitor.store.history.assessments import JudgedReplay
from monitor.store.store import Store
from monitor.store.stored import unpacked_row
from monitor.studies.from_plant import PlantArm, arms_of_plant, rows_of


def read_changes(path: Path) -> dict[str, Any]:
    """The keys of a TOML file that a verdict depends on, as `AssessSettings` has them; sections of other rooms are left out.

    Raises BadConfiguration that names every mistake with its key, and BadInput where the file names nothing that a verdict depends on.
    """
    source = Source.read(path)
    document, mistakes = source.document, source.mistakes
    sections = {**assess_sections(), "assess": FlowSettings}
    known = section_classes()
    mistakes += [of_section(name, f": unknown section{nearest(name, [*sections])}") for name in document if name not in known]
    changes: dict[str, Any] = {}
    drift = document.get("drift")
    prior = drift.pop("prior", None) if isinstance(drift, dict) else None  # it names a file, see `for_arm`
    for name, cls in sections.items():
        if name not in document:
            continue
        wrong: list[Mistake] = []
        read_section(name, cls, document[name], wrong)
        # whether values go together is seen with those of the history, and not with the defaults: `settings_with`
        mistakes += [mistake for mistake in wrong if len(mistake.key) > 1 or not isinstance(document[name], dict)]
        if isinstance(document[name], dict):
            changes |= document[name] if name == "assess" else {name: document[name]}
    if prior == OF_PLANT:
        mistakes.append(of_key(("drift", "prior"), f'"{OF_PLANT}": a daemon asks it; expected the file of `joint-monitor prior --plant`'))
    elif isinstance(prior, str):
        changes["drift"] = {**changes.get("drift", {}), "prior": str(path.absolute().parent / prior) if prior else ""}
    elif prior is not None:
        mistakes.append(of_key(("drift", "prior"), f"{prior!r}: expected the path of a file that `joint-monitor prior` has written"))
    source.refuse()
    if not any(changes.values()):
        raise BadInput(f"{path}: changes nothing that a verdict depends on; expected keys of {', '.join(f'[{name}]' for name in sections)}")
    return changes


def for_arm(changes: Mapping[str, Any], made_with: Mapping[str, Any]) -> dict[str, Any]:
    """The changes for one arm: a fleet's prior is that of its model, as the file holds it. made_with : of one of its verdicts.

    Raises BadInput where the file cannot be read, or holds no prior of this model.
    """
    drift = changes.get("drift", {})
    if "prior" not in drift:
        return dict(changes)
    speed = with_changes(made_with["settings"], changes)["drift"].get("reference_speed_rad_s", DriftSettings().reference_speed_rad_s)
    return {**changes, "drift": {**drift, "prior": plain(find_prior(drift["prior"], made_with["robot"], speed, Path()))}}


def with_changes(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The plain settings of a verdict with these keys replaced."""
    changed = dict(settings)
    for key, value in changes.items():
        before = changed.get(key)
        # a fleet's prior is replaced as a whole
        changed[key] = (
            with_changes(before, value) if key != "prior" and isinstance(value, Mapping) and isinstance(before, Mapping) else value
        )
    return changed


def settings_with(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> AssessSettings:
    """The settings of a verdict with these keys replaced. Raises BadInput where they do not go together."""
    try:
        made: AssessSettings = settings_from_document(AssessSettings, with_changes(settings, changes))
    except (BadInput, ValueError) as wrong:
        raise BadInput(f"the changed settings do not fit those of the history: {wrong}") from None
    return made


# --- What is judged once more: the arms, their months, and the recordings of each, as plain values that travel to the workers. I/O ---

DEEP = 4  # folders below a given one in which histories are looked for
# why a replay was rejected that no setting and no program changes: its time
OF_TIME = ("this replay ", "the recording does not say when", "dated in the future")


class Stored(NamedTuple):
    """One recording, wherever it is kept."""

    replay: int  # its number in the ledger
    path: str  # of the file in the history's folder; empty: it is not there
    address: str  # in the archive; empty: it is not there
    sha256: str  # as the history knows it; empty: it is computed where the file is read
    inputs: int  # index of `Month.inputs`


class Month(NamedTuple):
    """The recordings of one arm in one month of UTC: one task."""

    arm: str
    name: str  # e.g. 2026-11
    inputs: tuple[dict[str, Any], ...]  # what identifies them besides: arm, mounting, gains, settings
    archive: dict[str, str] | None  # `ArchiveSettings`, without keys; None: the history has none
    recordings: tuple[Stored, ...]


class Arm(NamedTuple):
    """One arm: its history, and its recordings."""

    name: str
    history: str  # folder; empty: `kept` has it
    months: tuple[Month, ...]
    changes: dict[str, Any]  # of its settings
    kept: str = ""  # address of a plant's copy among the results

    @property
    def recordings(self) -> int:
        """How many."""
        return sum(len(month.recordings) for month in self.months)


class Found(NamedTuple):
    """One arm's history, before its recordings are listed: those of a plant would fill a memory."""

    name: str
    folder: str  # empty: the plant has it
    recordings: int  # about
    of_plant: PlantArm | None = None


def histories(places: Sequence[Path], changes: Mapping[str, Any]) -> list[Found]:
    """The arms whose histories are at or below these folders. changes : of the settings, from `read_changes`.

    One that cannot be read is listed with no recordings: `arm_of` says why, and the others are judged. Raises BadInput where a place
    holds no history or the changes do not fit its settings, StoreError where none can be read.
    """
    found = [folder for place in places for folder in _histories(place)]
    names = _names(found)
    listed, unread = [], []
    for folder in dict.fromkeys(found):
        try:
            with Store.reader(folder) as store:
                listed.append(Found(names[folder], str(folder), _fitting(store, names[folder], changes)))
        except StoreError as wrong:
            unread.append(wrong)
            listed.append(Found(names[folder], str(folder), 0))
    if len(unread) == len(listed):
        raise unread[0]
    return listed


def histories_of_plant(database: Database, changes: Mapping[str, Any]) -> list[Found]:
    """The arms of a plant, as `histories`. Raises BadInput where the changes do not fit the settings of one, StoreError."""
    arms = arms_of_plant(database)
    for arm in arms if changes else ():
        for _, content in rows_of(database, arm, "provenance"):
            _refuse_unfitting(arm.name, orjson.loads(unpacked_row(content)["document"]), changes)
    return [Found(arm.name, "", arm.replays, arm) for arm in arms]


def _fitting(store: Store, name: str, changes: Mapping[str, Any]) -> int:
    """About how many recordings a history has. Raises BadInput where the changes do not fit its settings."""
    for digest in {replay.made_with for replay in store.assessments.judged()} - {None}:
        _refuse_unfitting(name, store.assessments.provenance(str(digest)), changes)
    return sum(each.made_with is not None for each in replays_of(store))


def _refuse_unfitting(name: str, made_with: Mapping[str, Any], changes: Mapping[str, Any]) -> None:
    try:
        settings_with(made_with["settings"], for_arm(changes, made_with))
    except BadInput as wrong:
        raise BadInput(f"{name}: {wrong}") from None


def arm_of(found: Found, changes: Mapping[str, Any], folder: Path | None = None) -> Arm:
    """An arm with its months. folder : of a plant's copy. Raises StoreError where its history cannot be read, BadInput as `histories`."""
    with Store.reader(Path(found.folder) if folder is None else folder) as store:
        newest = next((each.made_with for each in reversed(store.assessments.judged()) if each.made_with is not None), None)
        own = dict(changes) if newest is None else for_arm(changes, store.assessments.provenance(newest))
        return Arm(found.name, found.folder, tuple(_months(store, found.name, own)), own)


def replays_of(store: Store) -> list[JudgedReplay]:
    """Every replay that was judged or rejected, in the order of time; those that were rejected for their time are left out.

    A rejected replay has the settings of the one before it.
    """
    judged = store.assessments.judged()
    with_ = [replay.made_with for replay in judged if replay.made_with is not None]
    found, times = list(judged), [replay.judged_at_unix_s for replay in judged]
    for row in store.ledger.rows(states=("rejected",)):
        if row.recording is None or (row.reason_text or "").startswith(OF_TIME) or row.ended_at_unix_s is None or not with_:
            continue
        before = judged[max(0, bisect_right(times, row.ended_at_unix_s) - 1)]
        made_with = before.made_with or with_[0]
        found.append(JudgedReplay(row.id, row.window_unix_s, row.ended_at_unix_s, made_with, assessed=False))
    return sorted(found, key=lambda each: (each.recorded_at_unix_s, each.ledger_id))


def identification_inputs(made_with: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """What an identification depends on besides the recording, from what a verdict was made with."""
    settings = with_changes(made_with["settings"], changes)
    return {
        "robot": made_with["robot"],
        "mounting_rad": made_with["mounting_rad"],
        "gains_nm_per_a": made_with["gains_nm_per_a"],
        "settings": {key: settings[key] for key in ("method", "identify") if key in settings},
    }


def _months(store: Store, arm: str, changes: Mapping[str, Any]) -> Iterator[Month]:
    months: dict[str, list[JudgedReplay]] = {}
    for replay in replays_of(store):
        if replay.made_with is not None:
            day = datetime.datetime.fromtimestamp(replay.recorded_at_unix_s, datetime.UTC)
            months.setdefault(f"{day:%Y-%m}", []).append(replay)
    known: dict[str, dict[str, Any]] = {}
    archived = {row.ledger_id: row for row in store.archived.rows()}
    place = store.archived.place()
    here = {number for number, _ in store.recordings.numbered()}
    for name in sorted(months):
        inputs: list[dict[str, Any]] = []
        recordings = []
        for replay in months[name]:
            assert replay.made_with is not None
            if replay.made_with not in known:
                known[replay.made_with] = identification_inputs(store.assessments.provenance(replay.made_with), changes)
            if (own := known[replay.made_with]) not in inputs:
                inputs.append(own)
            number, row = replay.ledger_id, archived.get(replay.ledger_id)
            path = str(store.recordings.path(number).absolute()) if number in here else ""
            address, sha256 = ("", "") if row is None else (row.address, row.sha256)
            recordings.append(Stored(number, path, address, sha256, inputs.index(own)))
        yield Month(arm, name, tuple(inputs), None if place is None else place.as_document(), tuple(recordings))


def _histories(place: Path) -> list[Path]:
    """The folders at or below a place that hold a history. Raises BadInput where there is none."""
    if not place.exists():
        raise BadInput(f"{place}: no such folder; expected a history's folder, a folder of them, or an arm's .toml")
    if place.is_file():
        if place.suffix != ".toml":
            raise BadInput(f"{place}: is a file; expected a history's folder, a folder of them, or an arm's .toml")
        from monitor.config.load import load

        return [load(place, secrets_needed=False).state_directory]
    top = place.resolve()
    found = []
    for folder, below, files in os.walk(top):
        if HISTORY in files:
            found.append(Path(folder))
            below.clear()
        elif len(Path(folder).relative_to(top).parts) >= DEEP:
            below.clear()
    if not found:
        raise BadInput(f"{place}: holds no history ({HISTORY}), and neither do its folders, {DEEP} deep")
    return sorted(found)


def _names(folders: Sequence[Path]) -> dict[Path, str]:
    """A short name for each history: its folder's, with those above it as far as they tell the folders apart."""
    depth = 1
    while True:
        names = {folder: "/".join(folder.parts[-depth:]) for folder in folders}
        if len(set(names.values())) == len(names) or depth > max(len(folder.parts) for folder in folders):
            return names
        depth += 1


# --- The bytes of recordings where a worker finds them: in the history's folder, or in its archive. I/O ---

MOST_HELD = 64_000_000  # [byte] of recordings that are held from their digest to their identification; beyond it, a file is read again
WAITS_S = (1.0, 5.0, 20.0)  # between attempts where the archive does not answer
PRUNED = "no recording any more"  # the reason where neither history nor archive has it


class Files:
    """The recordings of one month, each read once as long as they are small together."""

    def __init__(self, month: Month) -> None:
        self.bytes_read = 0
        self.failed: list[str] = []  # recordings that the history knows by their SHA-256, and that could not be read
        self._archive = month.archive
        self._held: dict[int, bytes] = {}
        self._size = 0

    def digest(self, stored: Stored) -> str:
        """SHA-256 of a recording that the history does not know by it; empty where it cannot be read. Raises as `content`."""
        try:
            content = self._fetched(stored)
        except BadInput:
            return ""
        if self._size + len(content) <= MOST_HELD:
            self._held[stored.replay] = content
            self._size += len(content)
        return hashlib.sha256(content).hexdigest()

    def content(self, stored: Stored, digest: str) -> bytes:
        """The bytes of a recording.

        Raises BadInput where it cannot be read, ArchiveConflict where it is not the one of this digest; StoreError where this worker does
        not reach the history, ArchiveUnavailable or ArchiveRefused where it does not reach the archive.
        """
        content = self._held.pop(stored.replay, None)
        if content is not None:
            return content
        try:
            content = self._fetched(stored)
            if digest and hashlib.sha256(content).hexdigest() != digest:
                raise ArchiveConflict(f"{stored.path or stored.address}: is not the recording that was made: its SHA-256 is another")
        except (BadInput, ArchiveConflict) as wrong:
            if stored.sha256:
                self.failed.append(f"{stored.replay}: {wrong}")
            raise
        return content

    def _fetched(self, stored: Stored) -> bytes:
        """From the folder, else from the archive."""
        if stored.path:
            try:
                content = Path(stored.path).read_bytes()
            except FileNotFoundError:
                if not stored.address:
                    require_folder(Path(stored.path).parent)
                    raise BadInput(PRUNED) from None  # since the months were listed
            except OSError as wrong:
                raise BadInput(f"{stored.path}: cannot be read: {wrong.strerror or wrong}") from None
            else:
                self.bytes_read += len(content)
                return content
        if not stored.address:
            raise BadInput(PRUNED)
        content = self._archived(stored)
        self.bytes_read += len(content)
        return content

    def _archived(self, stored: Stored) -> bytes:
        root, key = split_address(stored.address)
        archive = _opened(replace(ArchiveSettings.from_document(self._archive or {"address": root}), address=root))
        for wait_s in WAITS_S:
            try:
                return archive.read(key, stored.sha256)
            except ArchiveUnavailable:
                time.sleep(wait_s)
        return archive.read(key, stored.sha256)


class ReadAhead:
    """The contents of a month's recordings in their order: each is fetched while the one before it is identified.

    A server far away answers after a tenth of a second, as long as an identification takes.
    """

    def __init__(self, files: Files, wanted: Iterable[tuple[Stored, str]]) -> None:
        self._files, self._wanted = files, iter(wanted)
        self._reader = ThreadPoolExecutor(max_workers=1)  # `Files` is for one thread
        self._coming = self._fetch()

    def __enter__(self) -> "ReadAhead":
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.shutdown(cancel_futures=True)

    def next(self) -> bytes:
        """The next recording's bytes; raises as `Files.content` for this one. To be called once for each recording."""
        this, self._coming = self._coming, self._fetch()
        assert this is not None
        return this.result()

    def _fetch(self) -> Future[bytes] | None:
        found = next(self._wanted, None)
        return None if found is None else self._reader.submit(self._files.content, *found)


def require_folder(folder: Path) -> None:
    """Raises StoreError where a folder of a history is not there for this process."""
    if not folder.is_dir():
        raise StoreError(f"{folder}: a worker does not find it; expected histories where all workers reach them under the same name")


@lru_cache(maxsize=8)
def _opened(settings: ArchiveSettings) -> Archive:
    """One connection a worker, not one a recording."""
    return Archive.open(settings)
