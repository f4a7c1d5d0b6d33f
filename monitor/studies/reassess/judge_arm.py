"""The task of one arm: its identified replays are judged in their order, and what was said is compared. I/O, on a worker."""

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput, StoreError
from monitor.judge.assess import AssessSettings, Rejected, judge_identification, refusal
from monitor.judge.assessment import Assessment
from monitor.judge.document import plain
from monitor.service.history.assess_and_store import EstimatorState
from monitor.service.history.recompute import CHANGED, GONE, Tally, amended, repeat
from monitor.store.history.assessments import JudgedReplay
from monitor.store.store import Store
from monitor.studies.reassess import identified
from monitor.studies.reassess.amendments import AmendAnew
from monitor.studies.reassess.compare import SAME, UNKNOWN, Said, changed_alerts, episodes
from monitor.studies.reassess.cost import Cost, Meter
from monitor.studies.reassess.files import PRUNED, require_folder
from monitor.studies.reassess.identified import REFUSED, UNIDENTIFIABLE, IdentifiedReplay, from_bytes
from monitor.studies.reassess.identify_month import KIND as IDENTIFIED
from monitor.studies.reassess.memory import keep_memory
from monitor.studies.reassess.plan import Arm, replays_of
from monitor.studies.reassess.program import JUDGES, address_of, program
from monitor.studies.reassess.results import Results
from monitor.studies.reassess.settings import settings_with

KIND = "judged"  # of results
MONTHS_HELD = 3  # a replay may stand in the month beside that of its window
MOST_POINTS = 400  # of a joint's friction in a picture


class JudgedArm(NamedTuple):
    """What became of one arm."""

    document: dict[str, Any]
    found: bool  # whether it was there already
    cost: Cost


def judge_arm(arm: Arm, addresses: Sequence[str], changes: Mapping[str, Any], place: str) -> JudgedArm:
    """Judge an arm's replays once more and keep the result at `place`; or find it there.

    addresses : of the results of the arm's months, in their order. Without `changes` of the settings, each verdict is compared with the one
    that was stored, to the last bit. Raises StoreError where the history or the place of results cannot be read.
    """
    keep_memory()
    meter, results = Meter(), Results(place)
    require_folder(Path(arm.history))
    with Store.reader(Path(arm.history)) as store:
        planned = {stored.replay for month in arm.months for stored in month.recordings}
        # a daemon may have gone on since the months were listed
        replays = [each for each in replays_of(store) if each.ledger_id in planned or each.made_with is None]
        address = address_of(program(JUDGES), list(addresses), dict(changes), _content(store, replays))
        if (kept := results.read(KIND, address)) is not None:
            return JudgedArm(json.loads(kept), True, meter.cost(0, 0))
        months = _Months(arm, addresses, results)
        with meter.part("compute"):
            document = _judged(store, replays, months, changes)
    document = {"arm": arm.name, **document}
    with meter.part("write"):
        results.write(KIND, address, json.dumps(document, allow_nan=False).encode())
    return JudgedArm(document, False, meter.cost(len(replays), months.bytes_read))


def _judged(store: Store, replays: Sequence[JudgedReplay], months: "_Months", changes: Mapping[str, Any]) -> dict[str, Any]:
    judge = _Judge(store, months, changes)
    anew = AmendAnew(store, changes)
    tally, tracks = Tally(store), _Tracks()
    said: list[Said] = []
    unjudged: set[float] = set()
    accepted = 0
    until = max((each.judged_at_unix_s for each in replays), default=-math.inf)
    events = [event for event in store.events.rows() if event.at_unix_s <= until]
    of_replay: dict[int | None, list[Said]] = {}
    for event in events:
        of_replay.setdefault(event.ledger_id, []).append(Said.of(event.document["kind"], event.document))
    again = repeat(store, replays, judge, anew if changes else partial(amended, store), models=False, go_on=bool(changes))
    for each in again:
        outcome, replay = each.outcome, each.replay
        if replay.assessed and not changes:
            tally.add(each)
        if outcome is not None:
            accepted += not replay.assessed
            said += [Said.of(transition.kind, plain(transition.alert)) for transition in outcome.transitions]
            tracks.add(outcome)
            continue
        judge.left_out["unknown_state"] += not each.known
        gone = each.why.startswith((GONE, CHANGED))
        if not each.known or gone:
            unjudged.add(replay.recorded_at_unix_s)
        if not each.known or (gone and not (changes and tracks.count)):  # the state that follows is one of the history, with its alerts
            said += of_replay.get(replay.ledger_id, [])
    then = [one for group in of_replay.values() for one in group]
    said += anew.said if changes else of_replay.get(None, [])  # what people and ordinary work changed
    alerts = changed_alerts(episodes(then), episodes(said), unjudged)
    document: dict[str, Any] = {
        "replays": len(replays),
        "judged": tracks.count,
        "newly_accepted": accepted,
        "errors": judge.errors,
        "left_out": judge.left_out,
        "alerts": alerts,
    }
    if not changes:
        document["verdicts"] = {key: value for key, value in tally.document().items() if key not in ("circumstances", "other_recordings")}
    if any(row["change"] not in (SAME, UNKNOWN) for row in alerts):
        document["friction"] = {"then": _then(store), "now": tracks.thinned()}
    return document


class _Judge:
    """How a replay is judged once more: from its identification, with its own settings or the changed ones."""

    def __init__(self, store: Store, months: "_Months", changes: Mapping[str, Any]) -> None:
        self.errors: list[dict[str, Any]] = []
        self.left_out = {"gone": 0, "changed": 0, "rejected": 0, "unknown_state": 0}
        self._store, self._months, self._changes = store, months, changes
        self._settings: dict[str, AssessSettings] = {}

    def __call__(self, replay: JudgedReplay, state: EstimatorState) -> tuple[Assessment | None, str]:
        """The assessment; None with the reason."""
        if replay.made_with is None:
            return self._gone("made before the settings of a verdict were kept with it")
        row, settings = self._months.replay(replay), self._settings_of(replay.made_with)
        if row is None or row.state == identified.GONE:
            if row is not None and row.reason != PRUNED:
                self.errors.append({"replay": replay.ledger_id, "reason": row.reason})
            return self._gone("no identification" if row is None else row.reason)
        if row.state == identified.CHANGED:
            self.errors.append({"replay": replay.ledger_id, "reason": row.reason})
            self.left_out["changed"] += 1
            return None, f"{CHANGED}{row.reason}"
        outcome: Assessment | Rejected | None = refusal(row.context, row.quality, row.samples, state.belief, settings.trust)
        try:
            if outcome is None and row.state == UNIDENTIFIABLE:
                outcome = Rejected(row.reason)
            if outcome is None and row.state == REFUSED:
                raise BadInput(row.reason)
            if outcome is None and row.identification is not None:
                outcome = judge_identification(
                    row.identification, row.context, belief=state.belief, health=state.health, settings=settings, source=row.source
                )
        except BadInput as error:
            self.errors.append({"replay": replay.ledger_id, "reason": str(error)})
            return None, f"cannot be assessed any more: {error}"
        if isinstance(outcome, Assessment):
            return outcome, ""
        self.left_out["rejected"] += 1
        return None, f"is rejected now: {'' if outcome is None else outcome.reason}"

    def _gone(self, reason: str) -> tuple[None, str]:
        self.left_out["gone"] += 1
        return None, f"{GONE}{reason}"

    def _settings_of(self, made_with: str) -> AssessSettings:
        if made_with not in self._settings:
            self._settings[made_with] = settings_with(self._store.assessments.provenance(made_with)["settings"], self._changes)
        return self._settings[made_with]


class _Months:
    """The identified replays of an arm, a few months at a time: years of them would fill the memory."""

    def __init__(self, arm: Arm, addresses: Sequence[str], results: Results) -> None:
        self.bytes_read = 0
        self._results = results
        self._address = {stored.replay: at for month, at in zip(arm.months, addresses, strict=True) for stored in month.recordings}
        self._held: dict[str, dict[int, IdentifiedReplay]] = {}

    def replay(self, replay: JudgedReplay) -> IdentifiedReplay | None:
        """One replay; None where no task had it, because it came while the others were identified."""
        address = self._address.get(replay.ledger_id)
        if address is None:
            return None
        if address not in self._held:
            content = self._results.read(IDENTIFIED, address)
            if content is None:
                raise StoreError(f"{self._results.place}: the result {IDENTIFIED}/{address} is not there any more: call again")
            self.bytes_read += len(content)
            if len(self._held) >= MONTHS_HELD:
                del self._held[next(iter(self._held))]
            self._held[address] = {row.replay: row for row in from_bytes(content)}
        return self._held[address].get(replay.ledger_id)


class _Tracks:
    """The wear of each joint from replay to replay."""

    def __init__(self) -> None:
        self.count = 0
        self._at: list[float] = []
        self._wear: list[list[float]] = []

    def add(self, outcome: Assessment) -> None:
        """One more replay."""
        self.count += 1
        self._at.append(outcome.recorded_at_unix_s)
        self._wear.append(np.expm1(outcome.belief.wear_with_undetected(outcome.drift)[0]).tolist())

    def thinned(self) -> dict[str, Any]:
        """Times and wear of each joint, `MOST_POINTS` replays at most."""
        which = _evenly(self.count)
        return {"at_unix_s": [self._at[k] for k in which], "wear": plain([self._wear[k] for k in which])}


def _then(store: Store) -> dict[str, Any]:
    """Times and wear of each joint as they were stored, `MOST_POINTS` replays at most."""
    replays = store.assessments.replays()
    rows = store.assessments.friction_of([replays[k] for k in _evenly(len(replays))])
    wear: dict[float, list[float]] = {}
    for _, _, at, document in rows:
        wear.setdefault(at, []).append(document["wear"])
    return {"at_unix_s": list(wear), "wear": list(wear.values())}


def _evenly(count: int) -> list[int]:
    return [int(k) for k in np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).round())]


def _content(store: Store, replays: Sequence[JudgedReplay]) -> list[Any]:
    """What the history holds, as far as a verdict depends on it."""
    maintenance = [(row.id, row.undone_at_unix_s) for row in store.maintenance.rows()]
    amendments = [(each.id, each.at_unix_s) for each in store.maintenance.amendments()]
    return [[list(each) for each in replays], store.events.range(), maintenance, amendments, [day.day for day in store.production.rows()]]
