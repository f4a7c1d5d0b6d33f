"""What the gateway keeps is kept by SQLite and by PostgreSQL alike: transitions once, deliveries once, one gateway at a time."""

from contextlib import contextmanager
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa
from heard_documents import whole

from monitor.errors import StoreUnavailable
from monitor.gateway import run
from monitor.gateway.outbox import AnotherGateway, GatewayLock, Outbox
from monitor.gateway.settings import load_gateway
from monitor.gateway.source import Source
from monitor.gateway.status import gateway_status
from monitor.gateway.values import Delivery
from monitor.plant.arm import ArmName
from monitor.plant.cursor import Cursor, Entry
from monitor.plant.database import Database
from monitor.plant.ingest import add_audit, add_transitions, enter, keep_last_values, known
from monitor.plant.tables import audit
from monitor.publish.documents import Event

AT_UNIX_S = 1_780_300_800.0
ALERT = {
    **{
        "joint": 3,
        "condition": "wear_rising",
        "tier": "wear",
        "active": True,
        "change": 0.1,
        "probability": 0.99,
        "text": "t",
        "action": "a",
    },
    **{"raised_at": datetime.fromtimestamp(AT_UNIX_S, UTC), "updated_at": datetime.fromtimestamp(AT_UNIX_S, UTC)},
}


def test_what_the_gateway_takes_and_owes_is_the_same_in_both_databases(database):
    """States, transitions by cursor, deliveries by key, answers as documents, times to the millisecond."""
    number = enter(database, [("hall", "cell-1")], AT_UNIX_S)["hall", "cell-1"]
    keep_last_values(database, {(number, "health"): (AT_UNIX_S, whole("health"))})
    where = known(database, "hall", "cell-1", AT_UNIX_S)
    events = [
        Event.model_validate({**ALERT, "seq": seq, "at": datetime.fromtimestamp(AT_UNIX_S + seq, UTC), "kind": kind})
        for seq, kind in ((1, "raised"), (2, "cleared"))
    ]
    add_transitions(database, where, [Entry(event.seq, "", event) for event in events], Cursor(2, "m"), "h")
    source, now = Source(database), [AT_UNIX_S + 10.0]
    outbox = Outbox(database, lambda: now[0])
    source.refresh()
    assert source.arms()[ArmName("hall", "cell-1")].shown.state == "NORMAL"
    for _ in range(2):
        taken = source.transitions()
        owed = [
            Delivery(key=each.id, recipient="ada", kind="alert", document={"id": each.id}, robot=str(each.arm))
            for each in taken.transitions
        ]
        with database.write() as connection:
            outbox.add(connection, "mail", owed + owed)
            outbox.begin(connection)
            outbox.note_taken(connection, taken.transitions)
            source.commit(connection, taken.cursors)
    found = outbox.told(AT_UNIX_S, AT_UNIX_S + 60.0)
    assert [(each.kind, each.before, each.after, each.at_unix_s) for each in outbox.told(AT_UNIX_S, AT_UNIX_S + 60.0)] == [
        ("raised", "none", "wear", AT_UNIX_S + 1.0),
        ("cleared", "wear", "none", AT_UNIX_S + 2.0),
    ]
    first, second = outbox.owed("mail", due_by_unix_s=now[0])
    assert (first.made_at_unix_s, first.document["id"]) == (now[0], "hall/cell-1/j3/wear_rising/raised/wear/1780300801.000/1")
    outbox.gather([first.id, second.id], "m.1.a")
    outbox.delivered([first.id], {"number": "4711"})
    outbox.failed([second], "busy", dead_after_s=60.0)
    now[0] += 120.0
    assert outbox.failed(outbox.owed("mail"), "busy", dead_after_s=60.0)
    assert outbox.answered("mail", "alert")[0].answer == {"number": "4711"}
    assert [past.message for past in outbox.delivered_since("mail", AT_UNIX_S)] == ["m.1.a"]
    assert [line.error for line in gateway_status(database, now[0]).dead] == ["busy"]
    now[0] += 500 * 86_400.0
    outbox.prune()
    assert outbox.answered("mail", "alert") == []
    assert outbox.told(AT_UNIX_S, AT_UNIX_S + 60.0) == []
    assert outbox.taken([each.id for each in found] + ["another"]) == {each.id for each in found}  # for ever
    assert outbox.began_unix_s() == AT_UNIX_S + 10.0


def test_a_second_gateway_waits_for_the_end_of_the_first(database, address):
    """Also of one that was killed: the lock ends with its holder."""
    second = Database(address)
    first_lock, second_lock = GatewayLock(database), GatewayLock(second)
    first_lock.take()
    first_lock.take()
    with pytest.raises(AnotherGateway, match="until it ends"):
        second_lock.take()
    first_lock.release()
    second_lock.take()
    with pytest.raises(AnotherGateway):
        first_lock.take()
    second_lock.release()
    second.close()


def test_a_server_that_dies_while_the_lock_is_asked_for_is_waited_for(postgres, monkeypatch):
    """Between the connection and the lock: the gateway goes on, as in any other outage."""
    address = postgres.address()
    database, admin = Database(address), Database(address)
    session = database.session

    @contextmanager
    def dying():
        with session() as connection:
            number = connection.execute(sa.text("SELECT pg_backend_pid()")).scalar_one()
            connection.rollback()
            with admin.write() as other:
                other.execute(sa.text("SELECT pg_terminate_backend(:number)"), {"number": number})
            yield connection

    monkeypatch.setattr(database, "session", dying)
    with pytest.raises(StoreUnavailable, match="the connection was lost"):
        GatewayLock(database).take()
    monkeypatch.undo()
    lock = GatewayLock(database)
    lock.take()
    lock.release()
    database.close()
    admin.close()


def test_a_server_that_does_not_get_on_is_waited_for_by_the_gateway(postgres, tmp_path, monkeypatch):
    """Somebody holds a lock: it is told as the database's trouble before the service manager believes that the gateway hangs."""
    address = postgres.address()
    (tmp_path / "plant.toml").write_text(f'[plant]\ndatabase = "{address}"\n')
    monkeypatch.setattr(run, "PATIENCE_S", 1)
    admin = Database(address)
    with run.Gateway(load_gateway(tmp_path / "plant.toml", {}), []) as running:
        running.step()
        assert running.trouble is None
        with admin.write() as connection:
            connection.execute(sa.text("LOCK TABLE arm IN ACCESS EXCLUSIVE MODE"))
            running.step()
            assert "statement timeout" in running.trouble
        running._next_try = 0.0
        running.step()
        assert running.trouble is None
    admin.close()


def test_the_audit_keeps_a_line_whose_texts_hold_what_postgresql_does_not_store(database):
    """Names and reasons come from outside: a NUL in them must not lose the line."""
    with database.write() as connection:
        add_audit(connection, AT_UNIX_S, "A\0da", "ack", "hall/cell-1", "by mqtt: why \0grease")
    with database.read() as connection:
        assert connection.execute(sa.select(audit.c.who, audit.c.text)).all() == [("Ada", "by mqtt: why grease")]
