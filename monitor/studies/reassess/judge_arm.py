"""What alerts said then, beside what they would say now: earlier, later, gone, new. Pure."""

import json
import math
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput, StoreError
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.alerts.health import TIERS, Health, Transition, alert_from_document
from monitor.judge.alerts.life_cycle import acknowledge, declare, unacknowledge
from monitor.judge.alerts.states import with_service_alert
from monitor.judge.assess import Rejected, judge_identification, refusal
from monitor.judge.assessment import Assessment
from monitor.judge.document import plain
from monitor.judge.drift.maintenance import Maintenance
from monitor.judge.maintenance import begin_maintenance, with_new_joints
from monitor.judge.settings import AssessSettings
from monitor.reason import reason_of
from monitor.recording import DAY_S
from monitor.service.history.assess_and_store import EstimatorState, read_parts
from monitor.service.history.recompute import Change, Tally, Unjudged, amended, judge_day, repeat
from monitor.store.history.assessments import JudgedReplay
from monitor.store.history.events import AlertEvent
from monitor.store.history.maintenance import Amendment, MaintenanceRow
from monitor.store.history.production import DayOfProduction
from monitor.store.store import Store
from monitor.studies.reassess import identify_month
from monitor.studies.reassess.identify_month import (
    JUDGES,
    REFUSED,
    UNIDENTIFIABLE,
    Cost,
    IdentifiedReplay,
    Meter,
    Results,
    address_of,
    from_bytes,
    keep_memory,
    program,
)
from monitor.studies.reassess.identify_month import KIND as IDENTIFIED
from monitor.studies.reassess.opened import opened
from monitor.studies.reassess.plan import PRUNED, Arm, identification_inputs, replays_of, settings_with

SAME, EARLIER, LATER, GONE, NEW = "same", "earlier", "later", "gone", "new"
UNKNOWN = "unknown"  # a replay said it that cannot be judged any more
CHANGES = (EARLIER, LATER, GONE, NEW, UNKNOWN, SAME)


class Said(NamedTuple):
    """One transition of an alert."""

    kind: str  # raised, updated, serviced, cleared, …
    joint: int | None  # from 1; None: the arm
    condition: str
    tier: str
    raised_at_unix_s: float
    at_unix_s: float
    cleared_at_unix_s: float | None

    @classmethod
    def of(cls, kind: str, alert: Mapping[str, Any]) -> "Said":
        """From the alert's document."""
        return cls(
            kind, alert["joint"], alert["condition"], alert["tier"], alert["raised_at_unix_s"], alert["updated_at_unix_s"],
            alert.get("cleared_at_unix_s"),
        )  # fmt: skip


class Episode(NamedTuple):
    """One alert from its beginning to its end, with the time of each tier that it reached."""

    joint: int | None
    condition: str
    raised_at_unix_s: float
    tiers: dict[str, float]
    ended_at_unix_s: float  # infinite while it is active


def episodes(said: Sequence[Said]) -> list[Episode]:
    """The alerts that replays have raised, in order of time; the monitor's alerts about itself are left out."""
    found: dict[tuple[int | None, str, float], Episode] = {}
    for each in said:
        if of_the_monitor(each.condition):
            continue
        key = (each.joint, each.condition, each.raised_at_unix_s)
        episode = found.setdefault(key, Episode(*key, {}, math.inf))
        episode.tiers.setdefault(each.tier, each.at_unix_s if episode.tiers else each.raised_at_unix_s)
        if each.cleared_at_unix_s is not None:
            found[key] = episode._replace(ended_at_unix_s=each.cleared_at_unix_s)
    return sorted(found.values(), key=lambda each: (each.raised_at_unix_s, each.joint or 0, each.condition))


def changed_alerts(then: Sequence[Episode], now: Sequence[Episode], unjudged: Collection[float] = ()) -> list[dict[str, Any]]:
    """One row for each tier of each alert: when it was reached then and now, and what changed.

    Two alerts of one joint and condition are the same alert where their times overlap. unjudged : times of the replays that cannot be
    judged any more: what only they have said is neither gone nor the same.
    """
    rows, left = [], list(now)
    for old in then:
        match = next((new for new in left if _same_alert(old, new)), None)
        if match is not None:
            left.remove(match)
        rows += _rows(old, match, unjudged)
    for new in left:
        rows += _rows(None, new, unjudged)
    return sorted(rows, key=lambda row: (min(at for at in (row["then_unix_s"], row["now_unix_s"]) if at is not None), row["joint"] or 0))


def of_the_monitor(name: str) -> bool:
    """Whether a condition is one of the monitor itself, which no replay raises."""
    condition = CONDITIONS.get(name)
    return condition is not None and condition.joint is None and condition.arm is None


def counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """How many rows of each change."""
    return {change: sum(row["change"] == change for row in rows) for change in CHANGES}


def _same_alert(old: Episode, new: Episode) -> bool:
    if (old.joint, old.condition) != (new.joint, new.condition):
        return False
    return old.raised_at_unix_s <= new.ended_at_unix_s and new.raised_at_unix_s <= old.ended_at_unix_s


def _rows(old: Episode | None, new: Episode | None, unjudged: Collection[float]) -> list[dict[str, Any]]:
    one = old or new
    assert one is not None
    reached = [{} if each is None else each.tiers for each in (old, new)]
    tiers = [tier for tier in TIERS if tier in reached[0] or tier in reached[1]]
    return [_row(one, tier, reached[0].get(tier), reached[1].get(tier), unjudged) for tier in tiers]


def _row(one: Episode, tier: str, then: float | None, now: float | None, unjudged: Collection[float]) -> dict[str, Any]:
    days = None
    if then in unjudged:
        change, now = UNKNOWN, None if now == then else now  # equal: only copied
    elif then is None or now is None:
        change = NEW if then is None else GONE
    else:
        days = (now - then) / DAY_S
        change = SAME if days == 0.0 else EARLIER if days < 0.0 else LATER
    return {
        "joint": one.joint, "condition": one.condition, "tier": tier, "change": change, "then_unix_s": then, "now_unix_s": now, "days": days
    }  # fmt: skip


# --- What people and ordinary work changed between two replays, done anew upon another state than that of then ---


class AmendAnew:
    """Declared work, days of ordinary work and what people did to alerts, each applied to the state as it would be.

    Work that was taken back counts as never declared. What a person did to an alert counts where that alert is active.
    """

    def __init__(self, store: Store, changes: Mapping[str, Any]) -> None:
        self.said: list[Said] = []
        self._store, self._changes = store, changes
        self._declared: dict[float, MaintenanceRow] = {
            row.declared_at_unix_s: row for row in store.maintenance.rows() if row.ledger_id is None and row.in_force
        }
        self._made_with = next((each.made_with for each in reversed(store.assessments.judged()) if each.made_with), None)

    def __call__(self, state: EstimatorState | None, changes: Sequence[Change]) -> EstimatorState | None:
        """The state after changes between two replays; None where it was not known."""
        for change in changes:
            if state is None:
                return None
            if isinstance(change, Amendment):
                state = self._with_declared(state, change)
            elif isinstance(change, DayOfProduction):
                state = self._with_day(state, change)
            else:
                state = self._with_person(state, change)
        return state

    def _with_declared(self, state: EstimatorState, change: Amendment) -> EstimatorState:
        row = self._declared.get(change.at_unix_s)
        if row is None or state.belief is None or state.health is None or self._made_with is None:
            return state
        kept = row.document
        act = Maintenance(kept["joint"], kept["kind"], kept["at_unix_s"], kept["declared_at_unix_s"], kept["by"], kept["why"])
        settings = settings_with(self._store.assessments.provenance(self._made_with)["settings"], self._changes)
        begun, maintenance = begin_maintenance(state.belief, (act,), settings)
        after = with_new_joints(begun, maintenance, settings)
        serviced = declare(state.health, maintenance, change.at_unix_s)
        self._say(serviced.transitions)
        return EstimatorState(belief=after, health=serviced.health)

    def _with_day(self, state: EstimatorState, day: DayOfProduction) -> EstimatorState:
        if state.belief is None or state.health is None or not state.health.joints:
            return state
        settings = settings_with(self._store.assessments.provenance(day.made_with)["settings"], self._changes)
        try:
            verdict = judge_day(day, state.belief, state.health, settings)
        except BadInput:  # the period ends before what this state has learnt
            return state
        self._say(verdict.transitions)
        return EstimatorState(belief=verdict.belief, health=verdict.health)

    def _with_person(self, state: EstimatorState, event: AlertEvent) -> EstimatorState:
        document, health = event.document, state.health or Health(joints=())
        if of_the_monitor(document["condition"]):
            health = with_service_alert(health, alert_from_document(document), event.at_unix_s)
        elif (act := {"acknowledged": acknowledge, "unacknowledged": unacknowledge}.get(document["kind"])) is not None:
            try:
                by, why = document.get("by") or "unknown", document.get("why") or ""
                health = act(health, document["joint"], document["condition"], by=by, why=why, at_unix_s=event.at_unix_s)
            except BadInput:  # the alert is not active here
                return state
        return EstimatorState(belief=state.belief, health=health)

    def _say(self, transitions: Sequence[Transition]) -> None:
        self.said += [Said.of(each.kind, plain(each.alert)) for each in transitions]


# --- The task of one arm: its identified replays are judged in their order, and what was said is compared. I/O, on a worker ---

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
    with opened(arm, results) as store:
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
        if isinstance(outcome, Assessment):
            accepted += not replay.assessed
            said += [Said.of(transition.kind, plain(transition.alert)) for transition in outcome.transitions]
            tracks.add(outcome)
            continue
        judge.left_out["unknown_state"] += not each.known
        gone = outcome is not None and outcome.without_recording
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
        "of_parts": judge.of_parts,
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
        self.of_parts = 0  # that have no recording any more, judged of what the history has kept of their identification
        self._store, self._months, self._changes = store, months, changes
        self._settings: dict[str, AssessSettings] = {}

    def __call__(self, replay: JudgedReplay, state: EstimatorState) -> Assessment | Unjudged:
        """The assessment, or why there is none."""
        if replay.made_with is None:
            return self._gone("made before the settings of a verdict were kept with it")
        row, settings = self._months.replay(replay), self._settings_of(replay.made_with)
        if row is not None and row.state == identify_month.GONE and row.reason == PRUNED:
            row = self._kept(replay) or row
        if row is None or row.state == identify_month.GONE:
            if row is not None and row.reason != PRUNED:
                self.errors.append({"replay": replay.ledger_id, "reason": row.reason})
            return self._gone("no identification" if row is None else row.reason)
        if row.state == identify_month.CHANGED:
            self.errors.append({"replay": replay.ledger_id, "reason": row.reason})
            self.left_out["changed"] += 1
            return Unjudged("changed", row.reason)
        outcome: Assessment | Rejected | None = refusal(row.context, row.quality, row.samples, state.belief, settings.quality)
        try:
            if outcome is None and row.state == UNIDENTIFIABLE:
                outcome = Rejected(reason_of(row.reason))
            if outcome is None and row.state == REFUSED:
                raise BadInput(row.reason)
            if outcome is None and row.identification is not None:
                outcome = judge_identification(
                    row.identification, row.context, belief=state.belief, health=state.health, settings=settings, source=row.source
                )
        except BadInput as error:
            self.errors.append({"replay": replay.ledger_id, "reason": str(error)})
            return Unjudged("refused", f"cannot be assessed any more: {error}")
        if isinstance(outcome, Assessment):
            return outcome
        self.left_out["rejected"] += 1
        return Unjudged("rejected", f"is rejected now: {'' if outcome is None else outcome.reason}")

    def _kept(self, replay: JudgedReplay) -> IdentifiedReplay | None:
        """A replay without a recording, as it was identified then; None where that is not kept, or would be identified otherwise now."""
        made_with = self._store.assessments.provenance(str(replay.made_with))
        content = self._store.assessments.identified(replay.ledger_id)
        if content is None or identification_inputs(made_with, self._changes) != identification_inputs(made_with, {}):
            return None
        kept = read_parts(content)
        self.of_parts += 1
        return IdentifiedReplay(replay=replay.ledger_id, state=identify_month.IDENTIFIED, **kept._asdict())

    def _gone(self, reason: str) -> Unjudged:
        self.left_out["gone"] += 1
        return Unjudged("gone", reason)

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
        self._wear.append(np.expm1(outcome.belief.change_with_unfound(outcome.settings.friction)[0]).tolist())

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
    days, parts = [day.day for day in store.production.rows()], store.assessments.identified_replays()
    return [[list(each) for each in replays], store.events.range(), maintenance, amendments, days, parts]
