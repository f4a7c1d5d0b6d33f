"""What the gateway reads of the plant's database: each arm as it was heard last, and the transitions of alerts, once and in order. I/O.

Reading costs little where nothing has changed: documents and figures are read again only for arms that have said something.
"""

import threading
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from monitor.gateway.values import CLEARED, ENDED, GRAVER, MILDER, RAISED, Transition, transition_id
from monitor.plant.arm import MOST_JOINTS, ArmName, HeardArm, copied_friction
from monitor.plant.database import Database
from monitor.plant.ingest import RUNNING
from monitor.plant.status import DOCUMENTS, heard_arms
from monitor.plant.tables import arm, friction, gateway_cursor, history, last_value, note, transition
from monitor.publish.documents import Event, HistoryRow, mended
from monitor.publish.shown import tier_gravity
from monitor.publish.timestamps import utc

PAGE = 500  # transitions that are taken at once
READ_AT_ONCE = 200  # arms whose documents are read by one query


class Taken(NamedTuple):
    """Transitions after the cursors, and the cursors after them."""

    transitions: list[Transition]  # of each arm in order
    before: list[str]  # names of those that an arm had in its log when the plant first heard it
    known: list[ArmName]  # arms of which nothing of before is left
    cursors: dict[tuple[int, int], int]  # by arm and history: seq
    more: bool  # whether others wait


class Source:
    """The plant as its database has it. Several threads may read `arms`; one calls `refresh` and `transitions`."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._arms: dict[ArmName, HeardArm] = {}
        self._seen: dict[int, tuple[Any, ...]] = {}  # by arm: what its state was made of
        self.plant_said_unix_s: float | None = None  # by its own clock; None: it has never run

    def arms(self) -> Mapping[ArmName, HeardArm]:
        """Every arm as it was at the last refresh. The mapping does not change any more."""
        with self._lock:
            return self._arms

    def refresh(self) -> None:
        """Read what has changed. Raises StoreError."""
        with self._database.read() as connection:
            rows = {row.id: row for row in connection.execute(sa.select(arm))}
            self.plant_said_unix_s = connection.execute(sa.select(note.c.at).where(note.c.key == RUNNING)).scalar_one_or_none()
            copied = {
                (each.arm, each.number): each.change_cursor
                for each in connection.execute(sa.select(history.c.arm, history.c.number, history.c.change_cursor))
            }
            heard: dict[int, dict[str, float]] = {number: {} for number in rows}
            times = sa.select(last_value.c.arm, last_value.c.key, last_value.c.heard_at).where(last_value.c.key.in_(DOCUMENTS))
            for number, key, at in connection.execute(times):
                if number in heard:
                    heard[number][key] = at
            seen = {number: (*row, copied.get((number, row.history)), *sorted(heard[number].items())) for number, row in rows.items()}
            changed = [number for number, what in seen.items() if self._seen.get(number) != what]
            states = {state.number: state for state in self._arms.values() if seen.get(state.number) == self._seen.get(state.number)}
            for begin in range(0, len(changed), READ_AT_ONCE):
                for each in heard_arms(connection, changed[begin : begin + READ_AT_ONCE]):
                    states[each.number] = replace(each, friction=_newest_friction(connection, each))
        if changed or len(states) != len(self._arms):
            with self._lock:
                self._arms = {state.name: state for _, state in sorted(states.items())}
        self._seen = seen

    def transitions(self, known: Collection[ArmName] = ()) -> Taken:
        """The next transitions. known : arms of which all are new. `commit` notes that they are taken. Raises StoreError."""
        found: list[Transition] = []
        before: list[str] = []
        all_new: list[ArmName] = []
        cursors: dict[tuple[int, int], int] = {}
        more = False
        with self._database.read() as connection:
            joined = (gateway_cursor.c.arm == history.c.arm) & (gateway_cursor.c.history == history.c.number)
            taken = sa.func.coalesce(gateway_cursor.c.seq, 0)
            wanted = (
                sa.select(history.c.arm, history.c.number, history.c.event_cursor, history.c.events_before, taken, arm.c.site, arm.c.robot)
                .join(arm, arm.c.id == history.c.arm)
                .outerjoin(gateway_cursor, joined)
                .order_by(history.c.arm, history.c.number)
            )
            if all(name in known for name in self.arms()):
                wanted = wanted.where(history.c.event_cursor > taken)
            for number, at, last, first, done, site, robot in connection.execute(wanted).all():
                left, name = PAGE - len(found) - len(before), ArmName(site, robot)
                if left <= 0:
                    more = True
                    break
                old, upto = 0 if name in known else first or 0, done
                if last > done:
                    of_arm = (transition.c.arm == number, transition.c.history == at)
                    rows = sa.select(transition).where(*of_arm, transition.c.seq > done, transition.c.seq <= last)
                    page = connection.execute(rows.order_by(transition.c.seq).limit(left)).all()
                    before += [_id(name, row) for row in page if row.seq <= old]
                    found += [_transition(connection, name, row) for row in page if row.seq > old]
                    upto = cursors[number, at] = last if len(page) < left else page[-1].seq
                if name not in known and first is not None and upto >= first:
                    all_new.append(name)
        return Taken(found, before, all_new, cursors, more or len(found) + len(before) >= PAGE)

    def everything(self, connection: sa.Connection) -> Taken:
        """What is copied now, as of before; arms whose first copying goes on are not known yet."""
        columns = [transition.c[name] for name in ("joint", "condition", "kind", "tier", "at", "seq")]
        rows = connection.execute(sa.select(arm.c.site, arm.c.robot, *columns).join(arm, transition.c.arm == arm.c.id))
        before = [_id(ArmName(row.site, row.robot), row) for row in rows]
        histories = connection.execute(sa.select(history, arm.c.site, arm.c.robot).join(arm, arm.c.id == history.c.arm)).all()
        whole = [row for row in histories if row.event_cursor >= (1 if row.events_before is None else row.events_before)]
        return Taken(
            [],
            before,
            [ArmName(row.site, row.robot) for row in whole],
            {(row.arm, row.number): row.event_cursor for row in histories},
            False,
        )

    def commit(self, connection: sa.Connection, cursors: Mapping[tuple[int, int], int]) -> None:
        """Note in this transaction that transitions are taken."""
        if not cursors:
            return
        insert = (postgresql.insert if self._database.postgresql else sqlite.insert)(gateway_cursor)
        rows = [{"arm": number, "history": at, "seq": seq} for (number, at), seq in cursors.items()]
        connection.execute(insert.on_conflict_do_update(index_elements=["arm", "history"], set_={"seq": insert.excluded.seq}), rows)


def _newest_friction(connection: sa.Connection, arm: HeardArm) -> dict[int, HistoryRow]:
    """The newest row of each joint: a look each into the index, however long the history is."""
    of_arm = (friction.c.arm == arm.number) & (friction.c.history == arm.histories)
    found = {}
    for joint in range(1, MOST_JOINTS + 1):
        newest = sa.select(friction).where(of_arm, friction.c.joint == joint).order_by(friction.c.recorded_at.desc()).limit(1)
        row = connection.execute(newest).one_or_none()
        if row is not None and (copied := copied_friction(row)) is not None:
            found[joint] = copied
    return found


def _transition(connection: sa.Connection, name: ArmName, row: Any) -> Transition:
    columns = {name: getattr(row, name) for name in ("seq", "joint", "condition", "tier", "kind")} | {"at": utc(row.at)}
    alert, _ = mended(Event, {**row.document, **columns} if isinstance(row.document, dict) else columns)
    before = ENDED if row.kind == RAISED else _tier_before(connection, row)
    after = ENDED if row.kind == CLEARED else row.tier
    kind = row.kind
    if kind == "updated" and tier_gravity(after) != tier_gravity(before):
        kind = GRAVER if tier_gravity(after) > tier_gravity(before) else MILDER
    return Transition(
        id=_id(name, row),
        seq=row.seq,
        arm=name,
        joint=row.joint,
        condition=row.condition,
        before=before,
        after=after,
        kind=kind,
        at_unix_s=row.at,
        raised_at_unix_s=alert.raised_at.timestamp(),
        alert=alert,
    )


def _id(name: ArmName, row: Any) -> str:
    return transition_id(name, row.joint, row.condition, row.kind, row.tier, row.at, row.seq)


def _tier_before(connection: sa.Connection, row: Any) -> str:
    """The tier of this alert at its transition before this one; where that is not kept, the tier that the row itself says."""
    wanted = (
        sa.select(transition.c.tier, transition.c.kind)
        .where(
            *(transition.c.arm == row.arm, transition.c.history == row.history, transition.c.seq < row.seq),
            *(transition.c.condition == row.condition, transition.c.joint.is_not_distinct_from(row.joint)),
        )
        .order_by(transition.c.seq.desc())
        .limit(1)
    )
    found = connection.execute(wanted).one_or_none()
    return str(row.tier) if found is None else ENDED if found.kind == CLEARED else str(found.tier)
