"""What is copied of an arm is what its daemon answers: every transition once and in order, from its own handlers and a real history."""

import contextlib
import itertools
import shutil
import time
from types import SimpleNamespace

import orjson
import pytest
import sqlalchemy as sa
from heard_documents import whole
from simulated import ALERT, Way, copied, cursors, refusing

from monitor.errors import BadInput, BusError, StoreError
from monitor.plant.arm import DOUBLED, GONE, ArmName
from monitor.plant.backup import forget
from monitor.plant.cursor import Cursor
from monitor.plant.database import Database
from monitor.plant.follow import Following
from monitor.plant.ingest import EVENTS, CursorMoved, add_transitions, known
from monitor.plant.links import Inbox
from monitor.plant.pull import CannotCopy, Copied, Copying, pull
from monitor.plant.status import as_lines, plant_status
from monitor.plant.tables import arm as arm_table
from monitor.plant.tables import audit, friction, transition
from monitor.plant.tables import history as history_table
from monitor.service.handlers import Handlers
from monitor.store.store import Store

DAY = 86_400.0
LIFE = {"trend_probability": 0.0, "p10_days": None, "p50_days": None, "p90_days": None, "verdict": "none"}
ROW = {
    **{"coulomb_nm": 1.5, "coulomb_std_nm": 0.1, "viscous_nm_s_per_rad": 2.0, "viscous_std_nm_s_per_rad": 0.1, "temperature_c": None},
    **{"reference_speed_rad_s": 0.4, "reference_temperature_c": 25.0, "reference_torque_nm": 3.0, "reference_torque_std_nm": 0.1},
    **{"wear": 0.0, "wear_std": 0.1, "wear_rate_per_day": 0.0, "wear_rate_std_per_day": 0.0, "remaining_life": LIFE},
}


def way(store: Store) -> Way:
    handlers = Handlers(SimpleNamespace(robot=SimpleNamespace(joints=2), store=store), None)
    return Way({"history": handlers.history, "event": handlers.events})


def judged(store: Store, day: int, *, events: int = 1) -> int:
    replay = waiting(store, day)
    judge(store, replay, day, events=events)
    return replay


def waiting(store: Store, day: int) -> int:
    replay = store.ledger.claim(DAY * day, "scheduled", DAY * day)
    store.recordings.path(replay).write_bytes(b"PAR1")
    store.ledger.mark_recorded(replay)
    return replay


def judge(store: Store, replay: int, day: int, *, events: int = 1, late_s: float = 60.0) -> None:
    documents = {name: {} for name in ("assessment", "belief", "health", "model")}
    times = {"at_unix_s": DAY * day + late_s, "recorded_at_unix_s": DAY * day}
    store.assessments.commit(replay, **times, **documents, friction=[ROW, ROW], events=[ALERT] * events)


def copy(database: Database, store: Store):
    return pull(database, way(store), "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda: 5.0)


def test_what_is_new_is_copied_and_nothing_twice(database, tmp_path):
    """After years, after nothing, after one more replay, and after a verdict that came late or was taken back."""
    with Store.open(tmp_path) as store:
        for day in range(1, 41):
            judged(store, day * 20)  # over more than two years: months of their own
        copy(database, store)
        assert copied(database) == {"lab/cell-1": (list(range(1, 41)), [(replay, joint) for replay in range(1, 41) for joint in (1, 2)])}
        copy(database, store)
        late = waiting(store, 1000)
        assert judged(store, 1001) == late + 1
        copy(database, store)
        judge(store, late, 1000, late_s=2.0 * DAY)
        copy(database, store)
        events, rows = copied(database)["lab/cell-1"]
        assert events == list(range(1, 43))
        assert rows[-4:] == [(late, 1), (late, 2), (late + 1, 1), (late + 1, 2)]
        store.assessments.roll_back(1000.5 * DAY, ({}, {}, {}))
        copy(database, store)
        assert copied(database)["lab/cell-1"][1][-2:] == [(late, 1), (late, 2)]
        assert cursors(database) == [(1, 1, 42, 43, None)]


def test_a_restored_history_is_copied_beside_the_one_before_and_told(database, tmp_path):
    """Whether the daemon restored it, or a person put an old file in its place and it has come further since."""
    with Store.open(tmp_path) as store:
        for day in range(1, 6):
            judged(store, day)
        store.database.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        shutil.copy(tmp_path / "history.sqlite", tmp_path / "older")
        for day in range(6, 9):
            judged(store, day)
        copy(database, store)
    shutil.copytree(tmp_path / "recordings", tmp_path / "aside")
    for path in sorted((tmp_path / "recordings").iterdir())[5:]:
        path.unlink()  # else the store itself would see what is lost
    for name in ("history.sqlite-wal", "history.sqlite-shm"):
        (tmp_path / name).unlink(missing_ok=True)
    shutil.copy(tmp_path / "older", tmp_path / "history.sqlite")
    with Store.open(tmp_path) as store:
        for day in range(20, 30):
            judged(store, day)
        copy(database, store)
        events, rows = copied(database)["lab/cell-1"]
        assert events == list(range(1, 16))
        assert len(rows) == 2 * 15
        assert [row[1] for row in cursors(database)] == [1, 2]
        assert "is another one than before" in cursors(database)[1][4].text
        store.changes.begin_another_history()  # as after a restoration by the daemon itself
        copy(database, store)
        assert "restored from a backup, or replaced" in cursors(database)[2][4].text
    with database.read() as connection:
        told = connection.execute(sa.select(audit.c.act, audit.c.robot)).all()
        kept = connection.execute(sa.select(sa.func.count()).select_from(friction).where(friction.c.history == 1)).scalar_one()
    assert told == [("another history", "lab/cell-1")] * 2
    assert kept == 2 * 8


def test_a_gap_in_an_arms_numbers_is_told_once(database, tmp_path):
    """What follows it is copied; the audit and the journal name what is missing, as somebody may have taken it away."""
    with Store.open(tmp_path) as store:
        for day in range(1, 8):
            judged(store, day)
        store.database.connection.execute("DELETE FROM event WHERE seq IN (1, 4, 5)")
        store.database.connection.execute("DELETE FROM change WHERE seq = 3")
        for _ in range(2):
            copy(database, store)
        assert copied(database)["lab/cell-1"][0] == [2, 3, 6, 7]
    with database.read() as connection:
        told = connection.execute(sa.select(audit.c.act, audit.c.robot, audit.c.text).order_by(audit.c.id)).all()
    assert [(act, robot) for act, robot, _ in told] == [("gap", "lab/cell-1")] * 2
    assert "lacks the transitions 1, 4 to 5; those after them are copied" in told[0].text
    assert "lacks the changes 3;" in told[1].text


class Killed(BaseException):
    """The process is gone at this place."""


def test_a_kill_at_any_statement_loses_and_doubles_nothing(database, tmp_path):
    """The plant dies at the first, second, third … statement of a copy; the next one goes on from there."""
    with Store.open(tmp_path) as store:
        statement, day = 0, 0
        while statement is not None:
            judged(store, (day := day + 1), events=3)
            seen = 0

            def die(*_, at=statement):
                nonlocal seen
                seen += 1
                if seen > at:
                    raise Killed

            sa.event.listen(database._engine, "before_cursor_execute", die)
            try:
                copy(database, store)
                statement = None
            except Killed:
                statement += 1
            finally:
                sa.event.remove(database._engine, "before_cursor_execute", die)
        assert day > 6
        copy(database, store)
        events, rows = copied(database)["lab/cell-1"]
        assert events == list(range(1, 3 * day + 1))
        assert rows == [(replay, joint) for replay in range(1, day + 1) for joint in (1, 2)]


def test_two_plants_that_copy_the_same_page_write_it_once(database, tmp_path):
    """The cursor moves in the page's transaction, and only from where the question was asked."""
    with Store.open(tmp_path) as store:
        judged(store, 1)
        before = known(database, "lab", "cell-1", 1.0)
        copy(database, store)
        with pytest.raises(CursorMoved):
            add_transitions(database, before, [], Cursor(7, "x"), None)
        assert known(database, "lab", "cell-1", 1.0).event.seq == 1


def test_what_an_arm_answers_wrongly_is_its_problem_and_stops_nobody(database):
    """A refusal, no answer, nonsense, figures that no database takes: each with a sentence."""
    event = {"seq": 2**63 + 5, "at": "2026-01-01T00:00:00Z"} | {key: value for key, value in ALERT.items() if not key.endswith("_unix_s")}
    event |= {"raised_at": "2026-01-01T00:00:00Z", "updated_at": "2026-01-01T00:00:00Z"}
    page = {"events": [event], "first_kept": 1, "last": 1}
    for answers, says in (
        ({"event": refusing("busy")}, "it refuses: busy"),
        ({}, "no answer"),
        ({"event": lambda _: {"events": 7}}, "cannot be read: events: Input should be a valid list"),
        (
            {"event": lambda _: page | {"events": [event | {"seq": 1, "at": "0001-01-01T00:00:00+14:00"}]}},
            "cannot be read: events.0.at: Value error, year 0",
        ),
        ({"event": lambda _: page | {"events": [event | {"seq": 1, "at": "9999-12-31T23:59:59.999999Z"}]}}, "at: Value error, year 10000"),
        ({"event": lambda _: {"events": [event, event], "first_kept": 1, "last": 1}}, "not in order"),
        ({"event": lambda _: page}, "cannot be stored"),
        ({"event": lambda _: {"events": [], "first_kept": 1, "last": 9, "next": 9}}, "more follows, and nothing does"),
    ):
        with pytest.raises(CannotCopy, match=says):
            pull(database, Way(answers), "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda: 5.0)
    assert copied(database) == {"lab/cell-1": ([], [])}


def test_pages_are_asked_for_one_after_the_other(database, tmp_path, monkeypatch):
    """A week of many transitions is more than one page; each page repeats the last entry of the one before."""
    monkeypatch.setattr("monitor.plant.pull.PAGE", 20)
    with Store.open(tmp_path) as store:
        judged(store, 1, events=45)
        asked = way(store)
        pull(database, asked, "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda: 5.0)
        assert len([key for key in asked.asked if f"/{EVENTS}?" in key]) == 3
        assert copied(database)["lab/cell-1"][0] == list(range(1, 46))


def test_an_unreachable_database_is_said_in_a_sentence_without_its_password():
    """A caller that can wait tries again."""
    database = Database("postgresql+psycopg://ada:hunter2@127.0.0.1:9/plant")
    with pytest.raises(StoreError) as error:
        database.migrate()
    assert "127.0.0.1" in str(error.value)
    assert "refused" in str(error.value)
    assert "hunter2" not in str(error.value)


class Slow:
    """A way on which most arms do not answer for a while."""

    up = True

    def __init__(self, answering):
        self.answering = answering

    def reached(self):
        return self.up

    def ask(self, key):
        if "/well/" in key:
            return self.answering.ask(key)
        time.sleep(0.1)
        raise BusError("does not answer")


def test_arms_that_do_not_answer_do_not_hold_up_those_that_do(tmp_path):
    """Thirty hung monitors wait for one that has something to tell, with one thread for all."""
    database = Database(f"sqlite:///{tmp_path / 'plant.sqlite'}")
    database.migrate()
    with Store.open(tmp_path / "history") as store:
        judged(store, 1)
        with Copying(database, {"a": Slow(way(store))}, 1, lambda: 5.0) as copying:
            for k in range(30):
                copying.ask(ArmName("hung", f"arm-{k}"), {"a"}, last_values=False, doubtful=True)
            well = ArmName("well", "cell-1")
            assert copying.ask(well, {"a"}, last_values=False)
            assert not copying.ask(well, {"a"}, last_values=False)  # it waits already
            outcomes = [copying.done.get(timeout=10.0) for _ in range(3)]
    assert well in {outcome.arm for outcome in outcomes}
    assert {outcome.problem.text for outcome in outcomes if outcome.arm != well} == {"does not answer"}
    database.close()


def test_an_arm_is_not_to_blame_for_a_way_that_is_lost(tmp_path):
    """It is shown as silent with the router's name, and copied when there is a way again; it has no problem of its own."""
    database = Database(f"sqlite:///{tmp_path / 'plant.sqlite'}")
    database.migrate()
    lost = Slow(None)
    lost.up = False
    with Copying(database, {"a": lost}, 1, lambda: 5.0) as copying:
        copying.ask(ArmName("lab", "cell-1"), {"a"}, last_values=False)
        assert copying.done.get(timeout=10.0) == Copied(ArmName("lab", "cell-1"), None, None, None)
    database.close()


def test_a_health_that_cannot_be_read_is_not_an_earlier_one(database):
    """Whoever said NORMAL once, and sends nonsense or too much since then, is shown as doubtful, with the reason."""
    inbox, name = Inbox(), ArmName("lab", "cell-1")
    with Copying(database, {}, 0, lambda: 5.0) as copying:
        following = Following(database, inbox, {}, copying, 60.0, lambda: 5.0)
        inbox.tokens.put(("a", name, True))
        for payload, why in (
            (orjson.dumps(whole("health", why="no change")), "no change"),
            (b'{"state":5', "cannot be read: "),
            (orjson.dumps(whole("health")), None),
            (b"[1]", "cannot be read: it is no JSON object"),
            (b" " * 1_000_001, "cannot be read: 1000001 bytes"),
        ):
            inbox.put(name, "health", payload)
            following.receive()
            following.write()
            arm = plant_status(database, 5.0).arms[0]
            assert arm.shown.state == (None if why and "cannot" in why else "NORMAL")
            assert why is None or why in arm.shown.said.text


def test_an_arm_that_says_another_history_each_time_is_told_and_not_copied_for_ever(database):
    """Five within the hour are somebody's attempts; more would fill the database and bury in the audit what people did."""
    said = iter(range(1000))

    def of_another(**document):
        return lambda _: {"history_id": f"history-{next(said)}", "next": None, **document}

    flapping = Way({"history": of_another(rows=[], changes=[]), "event": of_another(events=[], first_kept=None, last=None)})

    def audited() -> int:
        with database.read() as connection:
            return connection.execute(sa.select(sa.func.count()).select_from(audit)).scalar_one()

    for k in range(40):
        with contextlib.suppress(CannotCopy):
            pull(database, flapping, "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda k=k: 5.0 + k)
    assert 1 <= audited() <= 5
    with pytest.raises(CannotCopy, match="time and again within the hour"):
        pull(database, flapping, "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda: 50.0)
    for later in (9000.0, 9000.0 - 365 * DAY):  # an hour is over, and then the clock goes back
        before = audited()
        with contextlib.suppress(CannotCopy):
            pull(database, flapping, "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda later=later: later)
        assert audited() > before


WELL = orjson.dumps(whole("health", why="well"))


def test_one_document_that_cannot_be_stored_keeps_no_other_out(database):
    """One arm sends more levels than anybody can write, and another one was forgotten by somebody else: all others come through."""
    inbox, names = Inbox(), [ArmName("lab", f"cell-{k}") for k in range(3)]
    deep = WELL[:-1] + b',"deep":' + b"[" * 900 + b"]" * 900 + b"}"
    with Copying(database, {}, 0, lambda: 5.0) as copying:
        following = Following(database, inbox, {}, copying, 60.0, lambda: 5.0)

        def say(**documents):
            for name in names:
                inbox.put(name, "health", documents.get(name.robot.replace("-", "_"), WELL))
            following.receive()
            following.write()
            return {each.name.robot: each for each in plant_status(database, 5.0).arms}

        for name in names:
            inbox.tokens.put(("a", name, True))
        found = say(cell_1=deep)
        assert [found[name.robot].shown.state for name in names] == ["NORMAL", None, "NORMAL"]
        assert "its document health cannot be read: Recursion limit" in found["cell-1"].shown.said.text
        forget(database, "lab/cell-2", who="ada")
        found = say(cell_0=orjson.dumps(whole("health", state="FAILURE")))
        assert [found[name.robot].shown.state for name in names[:2]] == ["FAILURE", "NORMAL"]
        assert {each.shown.state for each in say().values()} == {"NORMAL"}
        assert len(say()) == 3  # it is there, so it comes back


def test_two_monitors_of_one_name_are_told_and_neither_is_copied(database):
    """They take turns, also within one look; a monitor that is started anew, or whose history is restored, is one."""
    inbox, name = Inbox(), ArmName("lab", "cell-1")

    def say(started, history_id):
        store = {"history_id": history_id, "last_event": 3, "last_change": 3}
        said = whole("monitor", started_at=f"2026-01-01T{started}:00Z", store=store, at=next(ticks))
        inbox.put(name, "monitor", orjson.dumps(said))

    ticks = itertools.count()
    with Copying(database, {}, 0, lambda: 5.0) as copying:
        following = Following(database, inbox, {}, copying, 60.0, lambda: 5.0)
        inbox.tokens.put(("a", name, True))
        for started, history_id in (("08:00", "x"), ("08:00", "x"), ("09:00", "x"), ("09:30", "x"), ("09:30", "y")):
            say(started, history_id)
            following.receive()
            following.write()
            assert plant_status(database, 5.0).arms[0].problem is None
        for _ in range(2):
            say("07:00", "z")
            say("09:30", "y")
        following.receive()
        following.write()
        (arm,) = plant_status(database, 5.0).arms
        assert arm.problem == DOUBLED
        assert following._to_copy == {}
        following.arms[name]._doubled_at -= 200.0  # one of them is ended
        say("09:30", "y")
        following.receive()
        assert list(following._to_copy) == [name]


def test_an_arm_that_was_renamed_and_a_disk_that_was_copied_are_told(database):
    """Two names have one history; the old name says how it is taken away."""
    for robot in ("old", "new", "other"):
        known(database, "lab", robot, 1.0)
    with database.write() as connection:
        connection.execute(sa.update(history_table).values(history_id=sa.case((history_table.c.arm == 3, "b"), else_="a")))
        connection.execute(sa.update(arm_table).where(arm_table.c.robot == "old").values(silent_since=1.0, silent_why=GONE))
    lines = {line.split()[1]: line for line in as_lines(plant_status(database, 5.0)) if "lab/" in line}
    assert "its history is that of lab/new as well: if it was renamed, joint-monitor plant forget lab/old" in lines["lab/old"]
    assert "its history is that of lab/old as well: was it renamed, or its disk copied?" in lines["lab/new"]
    assert "its history" not in lines["lab/other"]


def worn(probability):
    """A row of friction with this probability."""
    return {**ROW, "remaining_life": {**LIFE, "before_service_probability": probability}}


def commit(store, day, *rows, events=(ALERT,)):
    replay = waiting(store, day)
    documents = {name: {} for name in ("assessment", "belief", "health", "model")}
    times = {"at_unix_s": DAY * day + 60.0, "recorded_at_unix_s": DAY * day}
    store.assessments.commit(replay, **times, **documents, friction=list(rows), events=list(events))
    return replay


def test_a_row_that_its_document_does_not_take_is_set_aside_by_name_and_the_rest_is_copied(database, tmp_path):
    """A rounding above 1 is one; a probability of 1.5 is none. The arm's own answer names it, and so do audit and status of the plant."""
    with Store.open(tmp_path) as store:
        for day in range(1, 211):
            commit(store, day, worn(1.0000000000000002 if day == 10 else 0.5), worn(1.5 if day in (100, 210) else 0.5))
        copy(database, store)
        rows = Handlers(SimpleNamespace(robot=SimpleNamespace(joints=2), store=store), None).history({})
        assert (len(rows.rows), len(rows.set_aside)) == (418, 2)
        copy(database, store)
    events, copied_rows = copied(database)["lab/cell-1"]
    assert (len(events), len(copied_rows)) == (210, 418)
    assert {(100, 2), (210, 2)} & set(copied_rows) == set()
    with database.read() as connection:
        told = connection.execute(sa.select(audit.c.act, audit.c.text)).all()
    assert [act for act, _ in told] == ["set aside"]
    assert "joint 2 of replay 100: remaining_life.before_service_probability: Input should be less than or equal to 1" in told[0].text
    lines = "\n".join(as_lines(plant_status(database, 5.0)))
    assert "SET ASIDE: 2 rows of its history cannot be read, the newest: joint 2 of replay 210: " in lines


def test_what_an_arm_of_another_release_says_wrongly_is_set_aside_and_the_rest_is_copied(database):
    """Each entry by itself: a change without its time, a joint that is none, a transition with half of its document."""
    at, event = "2026-01-01T00:00:00Z", {key: value for key, value in ALERT.items() if not key.endswith("_unix_s")}
    event |= {"at": at, "raised_at": at, "updated_at": at}
    row = {**ROW, "joint": 1, "replay": 1, "recorded_at": at}
    events = [
        {**event, "seq": 1},
        {**event, "seq": 2, "change": None, "tier": "limit", "text": "It turns heavier."},
        {**event, "seq": 3, "at": 5},
        {**event, "seq": 4},
    ]
    changes = [
        {"seq": 1, "replay": 1, "at": at, "rows": [row, {**row, "joint": 9}, {**row, "joint": 2}, 7]},
        {"seq": 2, "replay": 2, "at": None, "rows": [{**row, "replay": 2}]},
        {"seq": 3, "replay": 3, "at": at, "rows": [{**row, "replay": 3}]},
    ]

    def after(name, listed):
        def answer(given):
            if "stored_after" in given:
                raise BadInput("history: unknown parameter 'stored_after'")  # as an earlier release says
            return {"next": None, name: [each for each in listed if each["seq"] > int(given[PARAMETER[name]])]}

        return answer

    arm = Way(
        {
            "event": lambda given: {"first_kept": 1, "last": len(events), **after("events", events)(given)},
            "history": lambda given: {"rows": [], **after("changes", changes)(given)},
        }
    )
    for _ in range(3):
        pull(database, arm, "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda: 5.0)
        seen, rows = copied(database)["lab/cell-1"]
        assert (seen, sorted(rows)) == ([1, 2, 4], [(1, 1), (1, 2), (3, 1)])
    events.append({**event, "seq": 5, "at": 5})  # the newest one, which every answer repeats from now on
    for _ in range(2):
        pull(database, arm, "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda: 5.0)
    events.append({**event, "seq": 6})
    pull(database, arm, "joint-monitor/v1/lab/cell-1", "lab", "cell-1", lambda: 5.0)
    assert copied(database)["lab/cell-1"][0] == [1, 2, 4, 6]
    with database.read() as connection:
        told = "\n".join(connection.execute(sa.select(audit.c.text).where(audit.c.act == "set aside")).scalars())
        document = connection.execute(sa.select(transition.c.document).where(transition.c.seq == 2)).scalar_one()
    for what in ("transition 2: change:", "transition 3: at:", "transition 5: at:", "change 2: at:", "joint 9 of replay 1: joint:"):
        assert what in told
    assert (document["tier"], document["change"]) == ("limit", 0.0)
    assert document["text"].startswith("It turns heavier. ")


PARAMETER = {"events": "after", "changes": "changed_after"}
