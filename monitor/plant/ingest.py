"""What is written into the plant's database: copied pages with their cursor in one transaction, last values, silence, the audit. I/O."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from monitor.plant.cursor import Cursor, Entry
from monitor.plant.database import Database
from monitor.plant.tables import FIGURES, LIFE_FIGURES, At, Said, arm, audit, friction, history, last_value, note, stored, transition
from monitor.publish.documents import Event, HistoryChange, HistoryRow
from monitor.reason import Reason, Sentence

EVENTS, CHANGES = "event", "change"  # the two logs of an arm, as their cursors are called
MOST_AN_HOUR, HOUR_S = 5, 3600.0  # histories of one arm: somebody who restores a backup may need several attempts
LONGEST_TEXT = 2000  # of a line of the audit
RUNNING = "running"  # name of the note that the plant runs


class CursorMoved(Exception):
    """Somebody else has copied this log in the meantime, or the database was emptied: ask anew."""


class HistoriesWithoutEnd(Exception):
    """An arm says another history time and again: copying each would fill the database and the audit."""


SET_ASIDE = Sentence("rows_set_aside", "{count} rows of its history cannot be read, the newest: {newest}")
FEW_ASIDE = 20  # that a line of the audit names


class Known(NamedTuple):
    """How far an arm's present history is copied."""

    arm: int
    number: int
    history_id: str | None
    event: Cursor
    change: Cursor
    newest_replay: int
    events_before: int | None  # the newest transition when the arm was first asked; None: it was not yet
    stored: int = 0  # number of the newest row of its tables


class Flaws(NamedTuple):
    """What is wrong with a page, for the audit."""

    at_unix_s: float
    robot: str
    gap: Reason | None  # which entries are missing between others
    aside: Sequence[Reason]  # which cannot be read


def known(database: Database, site: str, robot: str, now_unix_s: float) -> Known:
    """How far an arm is copied; an arm that was never seen is entered. Raises StoreError."""
    with database.read() as connection:
        row = _row(connection, site, robot)
    if row is None:
        enter(database, [(site, robot)], now_unix_s)
        with database.read() as connection:
            row = _row(connection, site, robot)
    assert row is not None
    return row


def _row(connection: sa.Connection, site: str, robot: str) -> Known | None:
    found = connection.execute(
        sa.select(
            arm.c.id,
            history.c.number,
            history.c.history_id,
            history.c.event_cursor,
            history.c.event_mark,
            history.c.change_cursor,
            history.c.change_mark,
            history.c.newest_replay,
            history.c.events_before,
            history.c.stored_cursor,
        )
        .join(history, (history.c.arm == arm.c.id) & (history.c.number == arm.c.history))
        .where(arm.c.site == site, arm.c.robot == robot)
    ).one_or_none()
    if found is None:
        return None
    number, at, identity, event, event_mark, change, change_mark, newest, *rest = found
    return Known(number, at, identity, Cursor(event, event_mark), Cursor(change, change_mark), newest, *rest)


def _begin_histories(
    connection: sa.Connection, of: Sequence[tuple[int, int]], history_id: str | None, why: Reason | None, now_unix_s: float
) -> None:
    """Begin histories. of : the number of the arm, and that of its history."""
    same = {"history_id": history_id, "began_at": now_unix_s, "why": why, "newest_replay": 0}
    cursors = {"event_cursor": 0, "event_mark": "", "change_cursor": 0, "change_mark": "", "events_before": None if why is None else 0}
    if of:
        connection.execute(sa.insert(history), [{"arm": arm, "number": number, **same, **cursors} for arm, number in of])


def begin_another_history(database: Database, before: Known, name: str, history_id: str | None, why: Reason, now_unix_s: float) -> None:
    """From now on another history of this arm is copied, from its beginning; what was copied before stays. It is audited.

    Raises CursorMoved where that is done already, HistoriesWithoutEnd where too many began within the last hour.
    """
    with database.write() as connection:
        hour = history.c.began_at.between(now_unix_s - HOUR_S, now_unix_s + HOUR_S)  # a clock that went back a year forbids none for a year
        lately = sa.select(sa.func.count()).where(history.c.arm == before.arm, hour)
        if connection.execute(lately).scalar_one() >= MOST_AN_HOUR:
            raise HistoriesWithoutEnd
        changed = connection.execute(
            sa.update(arm).where(arm.c.id == before.arm, arm.c.history == before.number).values(history=before.number + 1)
        ).rowcount
        if changed != 1:
            raise CursorMoved
        _begin_histories(connection, [(before.arm, before.number + 1)], history_id, why, now_unix_s)
        anew = f"its history is copied anew as number {before.number + 1}, and what was copied before is kept as number {before.number}"
        text = f"{why.text}; {anew}"
        add_audit(connection, now_unix_s, "plant", "another history", name, text)


def add_audit(connection: sa.Connection, now_unix_s: float, who: str, act: str, robot: str | None, text: str) -> None:
    """One line of the audit, in the transaction of what it is about. Texts come from outside, and PostgreSQL stores no NUL."""
    who, text = who.replace("\0", ""), text.replace("\0", "")
    connection.execute(sa.insert(audit).values(at=now_unix_s, who=who, act=act, robot=robot, text=text))


def add_transitions(
    database: Database,
    at: Known,
    new: Sequence[Entry[Event]],
    cursor: Cursor,
    history_id: str | None,
    flaws: Flaws | None = None,
    events_before: int | None = None,
) -> None:
    """Transitions, the cursor after them, and what is wrong with them, in one transaction. Raises CursorMoved, StoreError."""
    rows: list[dict[str, Any]] = [
        {
            **{"arm": at.arm, "history": at.number, "seq": event.seq, "at": event.at.timestamp(), "joint": event.joint},
            **{"condition": event.condition, "tier": event.tier, "kind": event.kind, "by": event.by},
            "document": event.model_dump(mode="json"),
        }
        for event in (entry.content for entry in new)
    ]
    database.make_partitions("transition", (row["at"] for row in rows))
    with database.write() as connection:
        _move(
            connection, at, EVENTS, at.event, cursor, history_id, events_before=at.events_before if events_before is None else events_before
        )
        _audit_flaws(connection, at, flaws)
        if rows:
            connection.execute(sa.insert(transition), rows)


def add_changes(
    database: Database, at: Known, new: Sequence[Entry[HistoryChange]], cursor: Cursor, history_id: str | None, flaws: Flaws | None = None
) -> None:
    """The rows of changed replays, the cursor after them, and what is wrong with them, in one transaction.

    Raises CursorMoved, StoreError.
    """
    last = {entry.content.replay: entry.content for entry in new}  # a replay's rows stand in each of its changes: the last one has them
    rows = [_friction_row(at, row) for change in last.values() for row in change.rows]
    again = [replay for replay in last if replay <= at.newest_replay]
    database.make_partitions("friction", (row["recorded_at"] for row in rows))
    with database.write() as connection:
        _move(connection, at, CHANGES, at.change, cursor, history_id, newest_replay=max([at.newest_replay, *last]))
        _audit_flaws(connection, at, flaws)
        if again:
            of_arm = (friction.c.arm == at.arm) & (friction.c.history == at.number)
            connection.execute(sa.delete(friction).where(of_arm, friction.c.replay.in_(again)))
        if rows:
            connection.execute(sa.insert(friction), rows)


def add_stored(database: Database, at: Known, rows: Sequence[tuple[int, str, str, bytes | None]]) -> None:
    """Rows of the history's own tables, and the cursor after them, in one transaction.

    rows : number, table, name and content of each; None: it is gone. Raises CursorMoved, StoreError.
    """
    last = {(table, row): content for _, table, row, content in rows}
    with database.write() as connection:
        moved = sa.update(history).where(history.c.arm == at.arm, history.c.number == at.number, history.c.stored_cursor == at.stored)
        if connection.execute(moved.values(stored_cursor=rows[-1][0])).rowcount != 1:
            raise CursorMoved
        of_row = (stored.c.arm == at.arm) & (stored.c.history == at.number) & (stored.c.of_table == sa.bindparam("t"))
        connection.execute(sa.delete(stored).where(of_row, stored.c.row == sa.bindparam("r")), [{"t": t, "r": r} for t, r in last])
        of_arm = {"arm": at.arm, "history": at.number}
        new = [{**of_arm, "of_table": t, "row": r, "content": content} for (t, r), content in last.items() if content is not None]
        if new:
            connection.execute(sa.insert(stored), new)


def _audit_flaws(connection: sa.Connection, at: Known, flaws: Flaws | None) -> None:
    """A line of the audit for what is missing, and one for what is set aside; how much that is stands at the history, too."""
    if flaws is None:
        return
    if flaws.gap is not None:
        add_audit(connection, flaws.at_unix_s, "plant", "gap", flaws.robot, flaws.gap.text)
    if flaws.aside:
        own = (history.c.arm == at.arm) & (history.c.number == at.number)
        before = connection.execute(sa.select(history.c.set_aside).where(own)).scalar_one()
        count = len(flaws.aside) + (int(str(before.parameters["count"])) if before else 0)
        said = SET_ASIDE(count=count, newest=flaws.aside[-1])
        connection.execute(sa.update(history).where(own).values(set_aside=said))
        more = len(flaws.aside) - FEW_ASIDE
        named = [each.text for each in flaws.aside[:FEW_ASIDE]] + ([f"and {more} more"] if more > 0 else [])
        add_audit(connection, flaws.at_unix_s, "plant", "set aside", flaws.robot, "; ".join(named)[:LONGEST_TEXT])


def _move(connection: sa.Connection, at: Known, log: str, before: Cursor, after: Cursor, history_id: str | None, **more: Any) -> None:
    """Move a cursor, if it is where the question was asked from: two plants, or two threads, never write a page twice."""
    moved = connection.execute(
        sa.update(history)
        .where(history.c.arm == at.arm, history.c.number == at.number, history.c[f"{log}_cursor"] == before.seq)
        .values({f"{log}_cursor": after.seq, f"{log}_mark": after.mark, "history_id": history_id or at.history_id, **more})
    ).rowcount
    if moved != 1:
        raise CursorMoved


def _friction_row(at: Known, row: HistoryRow) -> dict[str, Any]:
    values = {"arm": at.arm, "history": at.number, "joint": row.joint, "recorded_at": row.recorded_at.timestamp(), "replay": row.replay}
    figures = {name: getattr(row, name) for name in FIGURES}
    return values | figures | {name: getattr(row.remaining_life, name) for name in LIFE_FIGURES}


def keep_last_values(database: Database, values: Mapping[tuple[int, str], tuple[float, Any]]) -> None:
    """Last values by (arm, key): when it was heard, and the document."""
    if not values:
        return
    rows = [{"arm": number, "key": key, "heard_at": at, "document": document} for (number, key), (at, document) in values.items()]
    insert = (postgresql.insert if database.postgresql else sqlite.insert)(last_value)
    replaced = {name: insert.excluded[name] for name in ("heard_at", "document")}
    with database.write() as connection:
        connection.execute(insert.on_conflict_do_update(index_elements=["arm", "key"], set_=replaced), rows)


def enter(database: Database, names: Sequence[tuple[str, str]], now_unix_s: float) -> dict[tuple[str, str], int]:
    """The numbers of arms in the database; those that were never seen are entered. Raises StoreError.

    Others may enter the same arms at the same time, as threads that copy do once the database is back: each is entered once.
    """
    insert = (postgresql.insert if database.postgresql else sqlite.insert)(arm).on_conflict_do_nothing(index_elements=["site", "robot"])
    listed = sa.select(arm.c.site, arm.c.robot, arm.c.id)
    with database.write() as connection:
        numbers = {(site, robot): number for site, robot, number in connection.execute(listed)}
        # all at once: a statement an arm would take as many ways to the server and back; in one order: two never wait for each other
        new = [{"site": site, "robot": robot, "first_seen": now_unix_s, "history": 1} for site, robot in sorted(set(names) - set(numbers))]
        if new:
            entered = connection.execute(insert.returning(arm.c.id), new).scalars().all()  # of those that nobody else has entered meanwhile
            _begin_histories(connection, [(number, 1) for number in entered], None, None, now_unix_s)
            numbers = {(site, robot): number for site, robot, number in connection.execute(listed)}
    return {(site, robot): numbers[site, robot] for site, robot in names}


def set_arms(database: Database, changed: Sequence[Mapping[str, Any]]) -> None:
    """Silence and problems of arms: `number`, `since` and `why` of the silence, `problem`. A silence that goes on keeps its beginning."""
    if not changed:
        return
    with database.write() as connection:
        since = sa.case(
            (sa.bindparam("since", type_=At()).is_(None), sa.null()),
            else_=sa.func.coalesce(arm.c.silent_since, sa.bindparam("since", type_=At())),
        )
        statement = sa.update(arm).where(arm.c.id == sa.bindparam("number"))
        reasons = {"silent_why": sa.bindparam("why", type_=Said()), "problem": sa.bindparam("problem", type_=Said())}
        statement = statement.values(silent_since=since, **reasons)
        connection.execute(statement, list(changed))


def set_note(database: Database, key: str, now_unix_s: float, document: Any) -> None:
    """A fact about the plant itself; it replaces an earlier one of this name."""
    insert = (postgresql.insert if database.postgresql else sqlite.insert)(note).values(key=key, at=now_unix_s, document=document)
    with database.write() as connection:
        connection.execute(
            insert.on_conflict_do_update(index_elements=["key"], set_={"at": insert.excluded.at, "document": insert.excluded.document})
        )
