"""The gateway's frame: transitions once and in order, deliveries that outlast a restart, channels that do not hold each other up."""

import logging
import sqlite3
import threading
from contextlib import closing

import pytest
import sqlalchemy as sa
from small_plant import DAY_S, NOW_UNIX_S, alert

from monitor.errors import BadConfiguration, MonitorError, StoreUnavailable
from monitor.gateway.outbox import Outbox
from monitor.gateway.run import Gateway, Worker
from monitor.gateway.settings import load_gateway
from monitor.gateway.source import Source
from monitor.gateway.status import as_lines, gateway_status
from monitor.gateway.values import Delivery
from monitor.plant.arm import GONE, NO_WAY, ArmName
from monitor.plant.backup import back_up, rebuild, restore
from monitor.plant.ingest import set_arms
from monitor.plant.screen.arm_page import ArmContent
from monitor.plant.tables import FIGURES, friction, history, transition


class Noting:
    """A channel that owes one delivery a transition and delivers it to a list."""

    def __init__(self, surroundings, name="noting"):
        self.name, self.surroundings = name, surroundings
        self.got, self.fails = [], False

    def offer(self, transition):
        return [Delivery(key=transition.id, recipient="ada", kind="transition", document={"id": transition.id}, robot=str(transition.arm))]

    def step(self, now_unix_s):
        for owed in self.surroundings.outbox.owed(self.name, due_by_unix_s=now_unix_s):
            if self.fails:
                self.surroundings.outbox.failed([owed], "away", dead_after_s=DAY_S)
                raise MonitorError("its server is away, the word is s3cret")
            self.got.append(owed.document["id"])
            self.surroundings.outbox.delivered([owed.id])
        return 1.0

    def status(self):
        return f"{len(self.got)} delivered"

    def close(self):
        pass


def gateway(plant, *names):
    """A gateway with channels of the test, whose threads are not started, and these channels."""
    (plant.path.parent / "plant.toml").write_text(f'[plant]\ndatabase = "{plant.address}"\n')
    made = []

    def make(surroundings):
        made.extend(Noting(surroundings, name) for name in names or ("noting",))
        return made

    return Gateway(load_gateway(plant.path.parent / "plant.toml", {}), [make], plant.clock), made


def test_a_transition_is_offered_once_over_restarts_and_what_was_before_the_gateway_is_told_to_nobody(plant):
    """The cursor is committed with what is owed; a second gateway goes on where the first one ended."""
    plant.arm("hall/cell-1")
    plant.happens("hall/cell-1", at_unix_s=NOW_UNIX_S - DAY_S)
    for round_ in range(3):
        with gateway(plant)[0] as running:
            running.step()
            plant.now += 10.0
            plant.happens("hall/cell-1", "raised", joint=round_ + 1)
            running.step()
            owed = running.outbox.owed("noting")
            assert [each.document["id"].split("/")[2] for each in owed] == [f"j{k + 1}" for k in range(round_ + 1)]


def test_a_history_that_is_copied_anew_owes_nothing_again(plant, tmp_path):
    """After `plant rebuild` the same transitions come once more, with other numbers; after a restoration too."""
    plant.arm("hall/cell-1")
    with gateway(plant)[0] as running:
        running.step()
        plant.now += 10.0
        plant.happens("hall/cell-1")
        running.step()
        back_up(plant.database, tmp_path / "backup")
        before = running.outbox.owed("noting")
        rebuild(plant.database, who="ada")
        plant.arm("other/cell-9")  # takes the number of the arm that was forgotten
        plant.arm("hall/cell-1")
        plant.happens("hall/cell-1")
        running.step()
        assert [each.key for each in running.outbox.owed("noting")] == [each.key for each in before]
        running.outbox.delivered([before[0].id])
        restore(plant.database, tmp_path / "backup", force=True, who="ada")
        running.step()
        assert running.outbox.owed("noting") == []


def test_an_alert_changes_its_tier_by_kinds_that_people_know(plant):
    """Raised, graver, milder, cleared; an update within a tier changes nothing that people are told of."""
    plant.arm("hall/cell-1")
    raised = plant.now
    for kind, tier in (("raised", "advisory"), ("updated", "advisory"), ("updated", "limit"), ("updated", "wear"), ("cleared", "wear")):
        plant.now += 60.0
        plant.happens("hall/cell-1", kind, tier=tier, raised_unix_s=raised)
    plant.happens("hall/cell-1", "acknowledged", joint=None, condition="stopped", tier="advisory", by="ada")
    found = Source(plant.database).transitions().transitions
    assert [(each.kind, each.before, each.after, each.changes_tier) for each in found] == [
        ("raised", "none", "advisory", True),
        ("updated", "advisory", "advisory", False),
        ("graver", "advisory", "limit", True),
        ("milder", "limit", "wear", True),
        ("cleared", "wear", "none", True),
        ("acknowledged", "advisory", "advisory", False),
    ]
    assert len({each.id for each in found}) == len(found)
    assert len({each.alert_id for each in found[:5]}) == 1


def test_states_are_read_again_only_for_arms_that_said_something(plant):
    """An arm that is silent keeps the very object; one that is forgotten is gone."""
    for k in range(3):
        plant.arm(f"hall/cell-{k}", health={"state": "NORMAL", "alerts": []}, info={"robot": {"model": "ur5e"}})
    source = Source(plant.database)
    source.refresh()
    before = source.arms()
    plant.now += 1.0
    plant.arm("hall/cell-1", health={"state": "MAINTENANCE_REQUIRED", "alerts": [alert(), alert(active=False, joint=1), "nonsense"]})
    source.refresh()
    after = source.arms()
    assert after[ArmName("hall", "cell-0")] is before[ArmName("hall", "cell-0")]
    assert [each.joint for each in after[ArmName("hall", "cell-1")].alerts] == [3]
    assert after[ArmName("hall", "cell-1")].model == "ur5e"
    assert before[ArmName("hall", "cell-1")].alerts == ()


def test_a_channel_whose_server_is_away_holds_up_no_other_one_and_its_trouble_holds_no_secret(plant, monkeypatch):
    """Each has a thread; what it owes stays owed, with the attempts that were made."""
    monkeypatch.setattr("monitor.gateway.run.TROUBLE_PAUSE_S", (600.0, 600.0))  # by the clock of the test its next attempt is never due
    plant.arm("hall/cell-1")
    running, channels = gateway(plant, "away", "well")
    with running:
        channels[0].fails = True
        object.__setattr__(running._surroundings, "scrub", lambda text: text.replace("s3cret", "***"))
        running.step()
        plant.now += 10.0
        plant.happens("hall/cell-1")
        running.step()
        running.start()
        waited = threading.Event()
        for _ in range(1000):
            if running.workers[0].trouble and channels[1].got:
                break
            waited.wait(0.02)
        assert "***" in running.workers[0].trouble
        assert "s3cret" not in running.status()
        assert len(channels[1].got) == 1
    owed = Outbox(plant.database, plant.clock).owed("away")
    assert [(each.attempts, each.error) for each in owed] == [(1, "away")]
    assert "away to ada: transition, hall/cell-1" in "\n".join(as_lines(gateway_status(plant.database, plant.now)))


def test_the_parts_of_a_message_are_noted_together_and_what_could_not_be_noted_is_noted_first(plant, monkeypatch):
    """A part of a message would be sent again under the name of the whole; nothing is asked of the outbox before it knows."""
    outbox = Outbox(plant.database, plant.clock)
    outbox.owe("mail", [Delivery(key=str(k), recipient="ada", kind="alert", document={}) for k in range(3)])
    ids = [each.id for each in outbox.owed("mail")]
    write, left = plant.database.write, [1]

    def writes_once():
        if not left[0]:
            raise StoreUnavailable("away")
        left[0] -= 1
        return write()

    monkeypatch.setattr(plant.database, "write", writes_once)
    outbox.delivered(ids[:2])
    assert [each.id for each in outbox.owed("mail")] == ids[2:]
    for _ in range(2):
        with pytest.raises(StoreUnavailable):
            outbox.delivered(ids[2:])
    with pytest.raises(StoreUnavailable):
        outbox.owed("mail")
    left[0] = 5
    assert outbox.owed("mail") == []


def test_many_deliveries_that_are_refused_keep_none_behind_them_waiting(plant):
    """Of more than are read at once those come first that are due first: an attempt that failed comes later each time."""
    outbox = Outbox(plant.database, plant.clock)
    outbox.owe("mail", [Delivery(key=str(k), recipient="bob", kind="alert", document={}) for k in range(5)])
    outbox.failed(outbox.owed("mail"), "refused", dead_after_s=DAY_S)
    outbox.owe("mail", [Delivery(key=name, recipient="ada", kind="alert", document={}) for name in "xy"])
    assert [each.recipient for each in outbox.owed("mail", most=3)] == ["bob", "ada", "ada"]
    plant.now += 60.0
    assert [each.recipient for each in outbox.owed("mail", most=2)] == ["ada", "ada"]


def test_what_cannot_be_delivered_is_given_up_after_its_days_and_stays_to_be_seen(plant):
    """Attempts come later and later; at last the status names it as given up."""
    outbox = Outbox(plant.database, plant.clock)
    outbox.owe("mail", [Delivery(key="a", recipient="ada", kind="transition", document={})])
    pauses = []
    for _ in range(40):
        owed = outbox.owed("mail", due_by_unix_s=plant.now)
        if owed and outbox.failed(owed, "no answer", dead_after_s=2 * DAY_S):
            break
        due = outbox.owed("mail")[0].due_at_unix_s
        pauses.append(due - plant.now)
        plant.now = due + (0.0 if len(pauses) < 20 else DAY_S)
    assert pauses[0] < 13.0
    assert max(pauses) <= 1100.0
    status = gateway_status(plant.database, plant.now)
    assert [line.error for line in status.dead] == ["no answer"]
    assert outbox.owed("mail") == []


def test_the_file_of_the_plant_has_the_gateway_s_sections_and_each_program_reads_its_own(plant, tmp_path):
    """The plant needs no credential of the gateway; an unknown section is refused by both."""
    from monitor.plant.settings import load_plant

    path = tmp_path / "plant.toml"
    path.write_text('[plant]\nworkers = 2\n[gateway]\nlink = "credential:absent"\n')
    assert load_plant(path, {}).plant.workers == 2
    with pytest.raises(BadConfiguration, match="asks for the credential absent"):
        load_gateway(path, {})
    path.write_text('[gateway]\nlanguage = "xx"\n[notfy]\n')
    with pytest.raises(BadConfiguration) as refused:
        load_gateway(path, {})
    assert "language = 'xx'" in str(refused.value)
    assert "did you mean notify?" in str(refused.value)


def test_a_database_that_is_away_is_waited_for(plant, monkeypatch):
    """The gateway goes on as soon as it answers, and has lost nothing."""
    plant.arm("hall/cell-1")
    running, _ = gateway(plant)
    with running:
        running.step()
        plant.now += 10.0
        plant.happens("hall/cell-1")
        with plant.database.write() as connection:
            connection.execute(sa.text("ALTER TABLE delivery RENAME TO away"))
        running.step()
        assert "no such table" in running.trouble
        with plant.database.write() as connection:
            connection.execute(sa.text("ALTER TABLE away RENAME TO delivery"))
        running._next_try = 0.0
        running.step()
        assert running.trouble is None
        assert len(running.outbox.owed("noting")) == 1


def test_a_lock_that_somebody_holds_on_the_database_is_one_line_and_its_end_another(plant, monkeypatch, caplog):
    """What is locked can still be read: that alone is no end."""
    caplog.set_level(logging.INFO)
    monkeypatch.setattr("monitor.gateway.run.HEARTBEAT_S", 0.0)
    monkeypatch.setattr("monitor.plant.database.WAIT_FOR_LOCK_S", 0.05)
    running, _ = gateway(plant)
    with running:
        running.step()
        with closing(sqlite3.connect(running.database.file, isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            for _ in range(3):
                running.step()
                running._next_try = 0.0
            assert running.trouble is not None
            other.execute("ROLLBACK")
        running.step()
        running.step()
        assert running.trouble is None
    said = [record.message for record in caplog.records if record.name == "monitor.gateway.run"]
    assert [line.partition(": ")[0] for line in said] == ["trouble=database", "the database answers again"]


def test_states_that_are_shown_age_while_the_database_is_away(plant):
    """Such a channel goes on, until something goes wrong: another gateway may have its place then. What is owed waits."""
    running, _ = gateway(plant)
    with running:
        channel = Noting(running._surroundings)
        owes, shows = (Worker(channel, running._surroundings, running.heartbeats, running.permitted, shows=each) for each in (False, True))
        assert (owes.may, shows.may) == (False, False)  # nothing was read yet
        running.step()
        assert (owes.may, shows.may) == (True, True)
        owes.once()
        shows.once()
        running.permitted.clear()
        assert (owes.may, shows.may) == (False, True)
        plant.arm("hall/cell-1")
        plant.now += 10.0
        plant.happens("hall/cell-1")
        running._take()
        channel.fails = True
        shows.once()
        assert not shows.may


@pytest.mark.parametrize("name", ["hall/cell-1", "plant/service"])
def test_an_arm_that_nobody_hears_for_a_day_is_told_of_once_and_its_return_too(plant, name):
    """The arm itself cannot say it; a shorter silence, and one over a restart of the gateway, is no second message."""
    number = plant.arm(name)

    def heard(why, since=None):
        set_arms(plant.database, [{"number": number, "since": since, "why": why, "problem": None}])

    heard(GONE, plant.now)
    for _ in range(3):
        with gateway(plant)[0] as running:
            for _ in range(10):
                running.step()
                plant.now += 3600.0
    said = Outbox(plant.database, plant.clock).owed("noting")
    assert [each.document["id"].split("/")[2:5] for each in said] == [["arm", "monitor_silent", "raised"]]
    assert [line.channel for line in gateway_status(plant.database, plant.now).owed] == ["noting"]  # to somebody
    heard(None)
    with gateway(plant)[0] as running:
        running.step()
        running.step()
        heard(NO_WAY(ways=["router"]), plant.now)
        plant.now += 3600.0
        running.step()
    said = Outbox(plant.database, plant.clock).owed("noting")
    assert [each.document["id"].split("/")[4] for each in said] == ["raised", "cleared"]
    assert Outbox(plant.database, plant.clock).owed("silence") == []


def test_a_gateway_that_only_shows_states_runs_beside_the_one_with_deliveries_and_takes_nothing_from_it(plant, tmp_path):
    """It neither waits for the lock nor moves the cursor; the status names the channels of both."""
    plant.arm("hall/cell-1")
    running, _ = gateway(plant)
    with running:
        running.step()
        (tmp_path / "states.toml").write_text(f'[plant]\ndatabase = "{plant.address}"\n')
        with Gateway(load_gateway(tmp_path / "states.toml", {}), now=plant.clock) as beside:
            plant.now += 10.0
            plant.happens("hall/cell-1")
            beside.step()
            assert (beside.trouble, len(beside.source.arms())) == (None, 1)
            running.step()
            assert len(running.outbox.owed("noting")) == 1
            again, _ = gateway(plant)
            with again:
                again.step()
                assert "another gateway works with" in again.trouble
    assert gateway_status(plant.database, plant.now).not_running is None
    assert set(gateway_status(plant.database, plant.now).channels) == {"noting"}


def test_rows_that_no_document_takes_neither_end_the_gateway_nor_keep_an_alert_from_people(plant):
    """A transition half of whose document is gone is told by its columns, the friction of a joint is left out, and all else goes on."""
    number = plant.arm("hall/cell-1", health={"state": "FAILURE", "alerts": [alert(2, change=None, text="It turns heavier.")]})
    with gateway(plant)[0] as running:
        running.step()
        for joint in (1, 3):
            plant.happens("hall/cell-1", joint=joint, tier="limit")
        with plant.database.write() as connection:
            connection.execute(sa.update(transition).where(transition.c.joint == 1).values(document={"change": "NaN", "text": "Heavier."}))
            row = {"arm": number, "history": 1, "recorded_at": NOW_UNIX_S, "replay": 1}
            row |= dict.fromkeys(FIGURES, 1.0) | {"p10_days": None, "p50_days": None, "p90_days": None}
            rows = [row | {"joint": joint, "trend_probability": chance} for joint, chance in ((1, 1.5), (2, 0.5))]
            connection.execute(sa.insert(friction), rows)
            connection.execute(sa.update(history).values(change_cursor=7))
        for _ in range(4):
            running.step()
            plant.now += 60.0
        assert running.trouble is None
        owed = running.outbox.owed("noting")
        assert [each.document["id"].split("/")[2:5:2] for each in owed] == [["j1", "raised"], ["j3", "raised"], ["j2", "active"]]
        arm = running.source.arms()[ArmName("hall", "cell-1")]
        assert list(arm.friction) == [2]
        assert arm.alerts[0].text.startswith("It turns heavier. A part of what its arm says of this alert cannot be read (change: ")
        told = running.outbox.told(0.0, plant.now)
        assert told[0].alert.text.startswith("Heavier. A part of what its arm says of this alert cannot be read (")
    content = ArmContent(ArmName("hall", "cell-1"), plant.database, lambda _: [], lambda *_: None, "en")
    assert [key for key in content.live.last_payloads() if key.startswith("joint/")] == ["joint/2/friction"]
