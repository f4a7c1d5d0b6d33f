"""A plant on a real bus: its arms live, vanish and hang; plant, router and database are killed. What is copied is what the arms hold."""

import logging
import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing, contextmanager

import pytest
import zenoh
from simulated import ALERT, BEGIN_UNIX_S, copied

from monitor.config.load import from_document
from monitor.errors import BadConfiguration
from monitor.plant.arm import GONE, NO_WAY
from monitor.plant.backup import forget
from monitor.plant.database import Database
from monitor.plant.metrics import plant_families
from monitor.plant.run import Plant
from monitor.plant.screen.settings import ScreenSettings
from monitor.plant.settings import PlantConfiguration, PlantSettings
from monitor.plant.status import as_lines, plant_status
from monitor.publish.documents import ArmLink, Waiting
from monitor.publish.session import session_config
from monitor.service.daemon import Daemon
from monitor.service.monitor_document import MonitorDocument, OfOthers
from monitor.service.problems import Problems
from monitor.store.store import Store
from monitor.studies.plant import Lives, PlantOnBus, SimulatedPlant, Transition

ARMS = 6


class RestlessLives(Lives):
    """Arms whose alert changes with every replay: there are as many transitions as replays."""

    def live(self, days=1):
        for _ in range(days):
            super().live()
            for arm, replayed in enumerate(self.figures[-1].replayed):
                if replayed:
                    self.transitions[arm].append(Transition(self.day - 1, 1 + self.day % 6, "updated", "advisory", 0, 0.05))


class Site:
    """A router and simulated arms behind it."""

    def __init__(self, port, arms=ARMS, days=6):
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self.router = None
        self.open_router()
        self.lives = RestlessLives(arms, 3, BEGIN_UNIX_S)
        self.lives.live(days)
        settings = SimulatedPlant(arms=arms, sites=2, days=days, connect=(self.endpoint,))
        self.arms = PlantOnBus(settings, self.lives)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self.arms.run, args=(self._stopping,), daemon=True)
        self._thread.start()

    def open_router(self):
        self.router = zenoh.open(session_config(mode="router", listen=(self.endpoint,)))

    def close(self):
        self._stopping.set()
        self._thread.join(timeout=20.0)
        self.arms.__exit__()
        self.router.close()

    def truth(self):
        """What a copy must hold."""
        return {
            "/".join(self.arms.names[arm]): (
                list(range(1, len(self.lives.transitions[arm]) + 1)),
                [(k + 1, joint) for k in range(len(self.lives.replays[arm])) for joint in range(1, self.lives.joints + 1)],
            )
            for arm in range(self.lives.arms)
        }


@pytest.fixture
def site(free_port):
    made = Site(free_port)
    yield made
    made.close()


def configuration(site, address, **more):
    return PlantConfiguration(path=None, plant=PlantSettings(connect=(site.endpoint,), database=address, **more))


def until(plant, condition, within_s=30.0):
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < within_s, plant.status()
        plant.step()
        time.sleep(0.02)


@contextmanager
def reading(address):
    database = Database(address)
    yield database
    database.close()


def test_a_plant_copies_its_arms_follows_them_and_tells_who_is_gone(site, address, monkeypatch):
    """Also while router and database are away, and also an arm that is there and says nothing."""
    monkeypatch.setattr("monitor.plant.run.HEARTBEAT_S", 0.2)
    with Plant(configuration(site, address, silent_s=15.0)) as plant, reading(address) as database:
        until(plant, lambda: plant.trouble is None and copied(database) == site.truth())
        site.arms.pass_day()
        until(plant, lambda: copied(database) == site.truth())  # as soon as they say so, and not when a period is over
        until(plant, lambda: all(each.shown.state == "NORMAL" for each in plant_status(database).arms))
        first = plant_status(database)
        assert (len(first.arms), first.not_running) == (ARMS, None)

        site.router.close()
        until(plant, lambda: {each.silent_why.code if each.silent_why else None for each in plant_status(database).arms} == {NO_WAY.code})
        site.arms.pass_day()
        site.open_router()
        until(plant, lambda: not any(each.silent_why for each in plant_status(database).arms) and copied(database) == site.truth())

        gone = site.arms._held[1]
        gone.undeclare()
        until(plant, lambda: any(each.silent_why == GONE for each in plant_status(database).arms))
        site.arms._held.remove(gone)
        worst = plant_status(database).arms[0]
        assert worst.silent_why == GONE  # all others are well
        assert "SILENT since" in "".join(line for line in as_lines(plant_status(database)) if worst.name.robot in line)
        site_name, robot = worst.name
        arm = plant.following.arms[next(name for name in plant.following.arms if name == (site_name, robot))]
        assert arm.ways == set()
        forget(database, f"{site_name}/{robot}", who="ada")
        until(plant, lambda: len(plant.following.arms) == ARMS - 1)
        plant.step()
        assert len(plant_status(database).arms) == ARMS - 1  # it is not there any more, so it does not come back
    with reading(address) as database:
        for shift_s in (3600.0, -3600.0):  # a clock that went back does not make a dead plant run
            assert "the plant does not run" in plant_status(database, time.time() + shift_s).not_running.text


def test_of_two_plants_of_one_embedded_database_one_leads(tmp_path, monkeypatch):
    """What one hears the other would call silent. The other takes over when the first one ends; with SQLite too."""
    monkeypatch.setattr("monitor.plant.run.STANDBY_S", 0.0)
    settings = PlantSettings(connect=("tcp/127.0.0.1:9",), database=f"sqlite:///{tmp_path / 'plant.sqlite'}")
    plants = [PlantConfiguration(path=None, plant=settings)] * 2

    def step(*those):
        for each in those:
            each.step()

    with ExitStack() as standing:
        with Plant(plants[0]) as first:
            step(first)
            second = standing.enter_context(Plant(plants[1]))
            step(second, first, second)
            assert [first.leads, second.leads] == [True, False]
            assert "STANDS BY: another plant leads" in second.status()
            assert "STANDS BY" not in first.status()
        step(second)
        assert second.leads
        assert "STANDS BY" not in second.status()


def test_a_lock_that_somebody_holds_on_the_database_is_one_line_and_its_end_another(tmp_path, monkeypatch, caplog):
    """What is locked can still be read: that alone is no end, or each try would be a pair of lines."""
    monkeypatch.setattr("monitor.plant.database.WAIT_FOR_LOCK_S", 0.05)
    monkeypatch.setattr("monitor.plant.run.HEARTBEAT_S", 0.0)
    path = tmp_path / "plant.sqlite"
    settings = PlantSettings(connect=("tcp/127.0.0.1:9",), database=f"sqlite:///{path}")
    with Plant(PlantConfiguration(path=None, plant=settings)) as plant, closing(sqlite3.connect(path, isolation_level=None)) as other:
        plant.step()
        caplog.clear()
        caplog.set_level(logging.INFO)
        other.execute("BEGIN IMMEDIATE")
        for _ in range(3):
            plant.step()
            plant._next_try = 0.0
        assert "WAITING FOR THE DATABASE" in plant.status()
        other.execute("ROLLBACK")
        plant.step()
        plant.step()
        assert "WAITING" not in plant.status()
    said = [record.message for record in caplog.records if record.name == "monitor.plant.run"]
    assert [line.partition(": ")[0] for line in said] == ["trouble=database", "the database answers again"]


def test_a_plant_whose_screen_cannot_listen_leaves_nothing_open(tmp_path):
    """Its sessions and threads end with it, as whoever starts it may try again in the same process."""
    before = set(threading.enumerate())
    with socket.create_server(("127.0.0.1", 0)) as taken:
        screen = ScreenSettings(listen=f"127.0.0.1:{taken.getsockname()[1]}")
        settings = PlantSettings(connect=("tcp/127.0.0.1:9",), database=f"sqlite:///{tmp_path / 'plant.sqlite'}")
        with pytest.raises(BadConfiguration, match="another program listens there"):
            Plant(PlantConfiguration(path=None, plant=settings, screen=screen))
    deadline = time.monotonic() + 60.0
    while left := {thread.name for thread in set(threading.enumerate()) - before}:
        assert time.monotonic() < deadline, left
        time.sleep(0.05)


def test_a_database_that_is_killed_is_waited_for(site, postgres, monkeypatch):
    """Nothing is lost or doubled, and the status says what is waited for."""
    monkeypatch.setattr("monitor.plant.run.LONGEST_PAUSE_S", 0.2)
    address = postgres.address()
    with Plant(configuration(site, address)) as plant, reading(address) as database:
        until(plant, lambda: plant.trouble is None and plant.following.counts().arms == ARMS)
        postgres.kill()  # while the first histories are being copied
        try:
            site.arms.pass_day()
            until(plant, lambda: plant.trouble is not None)
            assert plant.status().startswith("WAITING FOR THE DATABASE, nothing is stored:")
            assert "s3cret" not in plant.status()
        finally:
            postgres.start()
        until(plant, lambda: plant.trouble is None and copied(database) == site.truth())


def killed_and_caught_up(site, address, kills, tmp_path, kill_database=None):
    """A plant's process that is killed again and again while days pass."""
    (tmp_path / "plant.toml").write_text(f'[plant]\nconnect = ["{site.endpoint}"]\ndatabase = "{address}"\n')
    rng = random.Random(7)
    environment = {**os.environ, "COLUMNS": "200"}
    for kill in range(kills):
        process = subprocess.Popen(
            [sys.executable, "-m", "monitor", "plant", "--config", str(tmp_path / "plant.toml")],
            stderr=(tmp_path / "log").open("a"), env=environment,
        )  # fmt: skip
        try:
            with reading(address) as database:
                before = _rows(database)
                deadline = time.monotonic() + 120.0  # a busy machine takes its time to start a process
                while _rows(database) == before:
                    assert process.poll() is None, (tmp_path / "log").read_text()
                    assert time.monotonic() < deadline, (tmp_path / "log").read_text()
                    time.sleep(rng.uniform(0.0, 0.05))
                site.arms.pass_day()
                time.sleep(rng.uniform(0.0, 0.2))
                what = rng.choice(("plant", "router", *(["database"] if kill_database else []))) if kill else "plant"
                if what == "router":
                    site.router.close()
                    site.open_router()
                elif what == "database":
                    kill_database()
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
        site.arms.pass_day()  # there is always something to copy
    return (tmp_path / "log").read_text()


def _rows(database):
    try:
        return sum(len(rows) for _, rows in copied(database).values())
    except Exception:  # there are no tables yet, or the database starts again
        return 0


def test_a_plant_that_is_killed_while_it_copies_goes_on_where_it_was(site, tmp_path):
    """Its process, by SIGKILL. The next life copies what is left."""
    address = f"sqlite:///{tmp_path / 'plant.sqlite'}"
    killed_and_caught_up(site, address, 1, tmp_path)
    with Plant(configuration(site, address)) as plant, reading(address) as database:
        until(plant, lambda: plant.trouble is None and copied(database) == site.truth())


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_fifty_kills_of_plant_router_and_database(postgres, free_port, tmp_path, soak_row):
    """Every transition once and in order, after each of them."""

    def again():
        postgres.kill()
        postgres.start()

    address = postgres.address()
    with ExitStack() as stack:
        site = Site(free_port, arms=60, days=30)
        stack.callback(site.close)
        killed_and_caught_up(site, address, 50, tmp_path, again)
        with Plant(configuration(site, address)) as plant, reading(address) as database:
            until(plant, lambda: plant.trouble is None and copied(database) == site.truth(), 120.0)
    # PostgreSQL's own client counts numbers that are missing or twice, and rows of a replay that are not one a joint
    step = "SELECT seq - lag(seq, 1, 0::bigint) OVER (PARTITION BY arm, history ORDER BY seq) AS step FROM transition"
    joints = "SELECT 1 FROM friction GROUP BY arm, history, replay HAVING count(*) <> 6 OR count(DISTINCT joint) <> 6"
    assert postgres.asked(address, f"SELECT count(*) FROM ({step}) AS steps WHERE step <> 1") == "0"
    assert postgres.asked(address, f"SELECT count(*) FROM ({joints}) AS wrong") == "0"
    assert postgres.asked(address, "SELECT max(number) FROM history") == "1"
    transitions = sum(len(each) for each in site.lives.transitions)
    soak_row("50 kills of plant, router and database: transitions lost or doubled", f"0 of {transitions}", "0")


def test_a_real_daemon_is_copied_and_its_document_says_how_far_it_is(free_port, address, tmp_path):
    """Not a simulated one: its bus, its handlers, its store; what happens while it is followed comes as soon as it says so."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    document = {
        "robot": {"model": "ur5", "site": "lab", "id": "cell-1"},
        "store": {"directory": str(tmp_path / "history")},
        "bus": {"connect": [endpoint], "listen": []},
        "inspection": {"items": [{"name": "gripper", "every_days": 30.0}]},
    }
    plant_settings = PlantSettings(connect=(endpoint,), database=address)
    with ExitStack() as stack:
        stack.enter_context(zenoh.open(session_config(mode="router", listen=(endpoint,))))
        store = stack.enter_context(Store.open(tmp_path / "history"))
        events = store.events.revise({"alerts": []}, [ALERT] * 130, BEGIN_UNIX_S)
        daemon = stack.enter_context(Daemon(from_document(document, tmp_path / "cell.toml"), store, now=time.time, play=None))
        plant = stack.enter_context(Plant(PlantConfiguration(path=None, plant=plant_settings)))
        database = stack.enter_context(reading(address))
        until(plant, lambda: plant.trouble is None and copied(database).get("lab/cell-1", ([], []))[0] == [event.seq for event in events])
        (later,) = store.events.revise({"alerts": []}, [ALERT], BEGIN_UNIX_S + 60.0)
        of_others = OfOthers(None, None, None, None, None, ArmLink(heard=True), Waiting(to_send=0, to_answer=0, dropped=0), {}, [])
        said = MonitorDocument(store, Problems(time.time), time.time).collect(of_others)
        assert (said.store.last_event, said.store.last_change) == (later.seq, 0)
        name = next(iter(plant.following.arms))
        assert plant.following.arms[name].behind(said)
        daemon.publisher.event(later)
        until(plant, lambda: copied(database)["lab/cell-1"][0] == list(range(1, later.seq + 1)))
        until(plant, lambda: not plant.following.arms[name].behind(said))
        until(plant, lambda: checks_due(database) == [1.0])


def checks_due(database):
    """How many checks are due, of each arm, as Prometheus is told."""
    [family] = [each for each in plant_families(database) if each.name == "joint_monitor_plant_inspections_due"]
    return [sample.value for sample in family.samples]
