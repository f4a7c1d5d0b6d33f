"""What is judged once more: the arms, their months, and the recordings of each, as plain values that travel to the workers. I/O."""

import datetime
import os
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from monitor.errors import BadInput, StoreError
from monitor.store.backup import HISTORY
from monitor.store.history.assessments import JudgedReplay
from monitor.store.store import Store
from monitor.studies.reassess.settings import for_arm, settings_with, with_changes

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
    history: str  # folder
    months: tuple[Month, ...]
    changes: dict[str, Any]  # of its settings

    @property
    def recordings(self) -> int:
        """How many."""
        return sum(len(month.recordings) for month in self.months)


class Found(NamedTuple):
    """One arm's history, before its recordings are listed: those of a plant would fill a memory."""

    name: str
    folder: str
    recordings: int  # about


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


def _fitting(store: Store, name: str, changes: Mapping[str, Any]) -> int:
    """About how many recordings a history has. Raises BadInput where the changes do not fit its settings."""
    for digest in {replay.made_with for replay in store.assessments.judged()} - {None}:
        try:
            made_with = store.assessments.provenance(str(digest))
            settings_with(made_with["settings"], for_arm(changes, made_with))
        except BadInput as wrong:
            raise BadInput(f"{name}: {wrong}") from None
    return sum(each.made_with is not None for each in replays_of(store))


def arm_of(found: Found, changes: Mapping[str, Any]) -> Arm:
    """An arm with its months. Raises StoreError where its history cannot be read, BadInput as `histories`."""
    with Store.reader(Path(found.folder)) as store:
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
