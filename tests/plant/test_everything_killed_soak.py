"""Everything between an arm and a person is killed again and again, each program a hundred times: one mail and one ticket an alert."""

import email
import email.policy
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from contextlib import suppress
from pathlib import Path

import pytest
import sqlalchemy as sa
from killed_world import ADDRESS, ARMS, MAIL, ORDERS, ROUTER, append, lines
from mosquitto_broker import PROGRAM, Mosquitto, Onlooker, waited
from small_plant import DAY_S, NOW_UNIX_S, alert
from test_tickets import CREDENTIALS

from monitor.errors import StoreError
from monitor.gateway.outbox import DEAD
from monitor.plant.database import Database
from monitor.plant.tables import delivery, gateway_cursor, history
from monitor.publish.timestamps import rfc3339

ROUNDS, AWAY_FROM, AWAY_UNTIL = 100, 40, 60
LIFE_S = 1.2, 4.0  # between these
QUIET_SHARE, QUIET_S = 0.3, 10.0  # of the rounds, and how long at most
ROLES = ("router", "arms", "plant", "gateway", "mail", "orders")
OUTSIDE = {"mail", "orders", "broker"}  # away for a day
PEOPLE = ("ada@plant.example", "bob@plant.example")
FILE = f"""
[plant]
database = "ADDRESS_OF"
connect = ["tcp/{ADDRESS}:{ROUTER}"]
[gateway]
silent_hours = 0.0
plant_silent_minutes = 0.0
[notify]
smtp = "{ADDRESS}:{MAIL}"
tls = "none"
sender = "monitor@plant.example"
fleet_arms = 1000
gather_s = 0
[[notify.to]]
name = "a"
mail = ["{PEOPLE[0]}"]
[[notify.to]]
name = "b"
mail = ["{PEOPLE[1]}"]
quiet = "22:00-05:00"
[tickets]
open_url = "http://{ADDRESS}:{ORDERS}/api/orders"
number = "/data/id"
find_url = "http://{ADDRESS}:{ORDERS}/api/orders?reference={{key}}"
authorization = "credential:cmms"
close_url = "http://{ADDRESS}:{ORDERS}/api/orders/{{number}}"
[mqtt]
host = "127.0.0.1"
port = PORT_OF
tls = false
"""


class World:
    """The processes, the alerts that arms have raised, and the clock."""

    def __init__(self, folder, address, postgres):
        self.folder, self.chance, self.now = folder, random.Random(28), NOW_UNIX_S
        self.address, self.postgres = address, postgres
        self.life_s = LIFE_S[0]  # of a process, about: longer on a slow machine, so that there is something to kill
        self.kills, self.alerts, self.cleared = 0, {}, set()  # texts by alert; alerts that are over
        self.passes(0.0)
        self.broker = Mosquitto(folder)
        (folder / "plant.toml").write_text(FILE.replace("ADDRESS_OF", address).replace("PORT_OF", str(self.broker.port)))
        (folder / "cmms").write_text(CREDENTIALS["cmms"])
        self._process = subprocess.Popen(
            [sys.executable, Path(__file__).parents[1] / "gateway/killed_world.py", folder],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=(folder / "log").open("ab"), text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )  # fmt: skip
        self._numbers = {}

    @property
    def log(self):
        return (self.folder / "log").read_text()

    def passes(self, seconds):
        self.now += seconds
        replaced = self.folder / "clock.new"
        replaced.write_text(str(self.now))
        replaced.replace(self.folder / "clock")

    def start(self, role):
        if role == "broker":
            self.broker.start()
        elif role == "database":
            self.postgres.start()
        else:
            self._process.stdin.write(f"{role}\n")
            self._process.stdin.flush()
            self._numbers[role] = int(self._process.stdout.readline())

    def kill(self, role):
        self.kills += 1
        if role == "broker":
            self.broker.kill()
        elif role == "database":
            self.postgres.kill()
        else:
            number = self._numbers.pop(role)
            os.kill(number, signal.SIGKILL)
            until = time.monotonic() + 30.0
            with suppress(ProcessLookupError):  # gone at last
                while True:
                    os.kill(number, 0)
                    assert time.monotonic() < until, role
                    time.sleep(0.002)

    def close(self):
        for number in self._numbers.values():
            os.kill(number, signal.SIGKILL)
        self._process.stdin.close()
        self._process.wait(timeout=60.0)
        self.broker.kill()

    def happens(self):
        """An arm raises an alert, or one of its alerts is over."""
        self.passes(2.0)
        arm, joint = self.chance.randrange(ARMS), self.chance.randint(1, 6)
        active = [each for each in self.alerts if each[:2] == (arm, joint) and each not in self.cleared]
        number = sum(map(len, self.alerts.values()))
        kind = "cleared" if active else "raised"
        text = f"event {number:04d} {kind}"
        raised = active[0][2] if active else self.now
        if active:
            self.cleared.add(active[0])
            self.alerts[active[0]].append(text)
        else:
            self.alerts[arm, joint, raised] = [text]
        event = alert(joint, raised_unix_s=raised, active=not active, text=text)
        append(self.folder / "transitions", {"arm": arm, "event": {**event, "kind": kind, "at": rfc3339(self.now), "by": None}})

    def round(self, roles, away):
        """Everything is killed once, each at a moment of its own, and begins again a moment later; what is away stays away."""
        moments = []
        for role in roles:
            at = self.chance.uniform(0.0, self.life_s)
            moments.append((at, "kill", role))
            if not (away and role in OUTSIDE):
                moments.append((at + self.chance.uniform(0.0, 0.2), "start", role))
        moments += [(self.chance.uniform(0.0, self.life_s), "happens", "") for _ in range(self.chance.randint(0, 3))]
        began = time.monotonic()
        for at, what, role in sorted(moments):
            time.sleep(max(began + at - time.monotonic(), 0.0))
            if what == "happens":
                self.happens()
            else:
                getattr(self, what)(role)


def left(database, transitions):
    """What is still to be copied, taken or delivered."""
    with database.read() as connection:
        copied = connection.execute(sa.select(sa.func.sum(history.c.event_cursor))).scalar() or 0
        taken = connection.execute(sa.select(sa.func.sum(gateway_cursor.c.seq))).scalar() or 0
        owed = connection.execute(sa.select(sa.func.count()).where(delivery.c.state == "owed")).scalar_one()
        dead = connection.execute(sa.select(sa.func.count()).where(delivery.c.state == DEAD)).scalar_one()
    assert dead == 0
    return transitions - copied, transitions - taken, owed


def has_left(database, world):
    """How many transitions the gateway has not taken yet."""
    with suppress(StoreError):  # its server may be starting
        return left(database, sum(map(len, world.alerts.values())))[1]


@pytest.mark.soak
@pytest.mark.timeout(1500)
@pytest.mark.skipif(PROGRAM is None, reason="mosquitto is not installed: apt-get install mosquitto")
def test_one_mail_and_one_ticket_an_alert_over_a_hundred_restarts_of_everything_and_a_day_s_outage(address, request, tmp_path, soak_row):
    """Each program that lies between an arm and a person dies a hundred times, in the midst of whatever it does.

    A mail that was taken while one of the two ends died may come twice: unchanged, with one Message-ID. Tickets never do.
    """
    postgres = request.getfixturevalue("postgres") if address.startswith("postgresql") else None
    rounds = int(os.environ.get("RESTARTS", ROUNDS))
    roles = [*ROLES, "broker", *(["database"] if postgres else [])]
    away_from, away_until = rounds * AWAY_FROM // ROUNDS, rounds * AWAY_UNTIL // ROUNDS
    world = World(tmp_path, address, postgres)
    database = Database(address)
    try:
        began = time.monotonic()
        for role in ROLES:
            world.start(role)
        until = began + 300.0
        while True:  # what happened before a gateway first ran is told in another way
            with suppress(Exception), database.read() as connection:
                if connection.execute(sa.select(sa.func.count()).where(delivery.c.kind == "began")).scalar_one():
                    break
            assert time.monotonic() < until, world.log
            time.sleep(0.05)
        world.life_s = min(max(LIFE_S[0], time.monotonic() - began), LIFE_S[1])
        for k in range(rounds):
            away = away_from <= k < away_until
            world.round([role for role in roles if not (k > away_from and away and role in OUTSIDE)], away)
            if away and k == away_until - 1:
                for role in sorted(OUTSIDE):
                    world.start(role)
            if world.chance.random() < QUIET_SHARE:  # so that a slow machine also gets through to people between the kills
                quiet_until = time.monotonic() + QUIET_S
                while time.monotonic() < quiet_until and has_left(database, world):
                    time.sleep(0.05)
            world.passes(DAY_S / (away_until - away_from) if away else world.chance.uniform(30.0, 1800.0))
        until, transitions = time.monotonic() + 400.0, sum(map(len, world.alerts.values()))
        before = transitions - (has_left(database, world) or 0)
        while (waits := left(database, transitions)) != (0, 0, 0):
            assert time.monotonic() < until, (waits, world.log[-3000:])
            world.passes(600.0)
            time.sleep(0.2)
        wanted = active_by_arm(world)
        with Onlooker(world.broker.port, "joint-monitor/#") as onlooker:
            while (shown := shown_by_arm(onlooker)) != wanted and time.monotonic() < until:
                time.sleep(0.1)
        seen_by_home_assistant(world)
    finally:
        world.close()
        database.close()
    wrong, again = mails(world)
    opened = [line["fields"]["reference"] for line in lines(tmp_path / "tickets") if line["new"]]
    closed = {line["number"] for line in lines(tmp_path / "tickets") if line["fields"].get("status") == "closed"}
    kind = "PostgreSQL" if postgres else "SQLite"
    soak_row(f"{kind}: {world.kills} kills −9 of {', '.join(roles)}, and a day without servers: alerts", str(len(world.alerts)), "told")
    soak_row(f"… of {transitions} events told to two people, lost or in two messages", str(len(wrong)), "0")
    soak_row("… events taken by the gateway between kills, and not in the quiet afterwards", str(before), "told")
    soak_row("… mails that came again, unchanged and with their Message-ID", str(again), "told")
    soak_row("… tickets opened / closed", f"{len(opened)} / {len(closed)}", f"{len(world.alerts)} / {len(world.cleared)}")
    soak_row("… arms whose retained alerts at the broker are not those of the arm", str(sum(shown[k] != wanted[k] for k in wanted)), "0")
    assert wrong == []
    assert len(set(opened)) == len(opened) == len(world.alerts)
    assert len(closed) == len(world.cleared)
    assert shown == wanted
    assert "Traceback" not in world.log


def seen_by_home_assistant(world):
    """What it goes by at each of its starts: the last will of a gateway that was killed, a broker that lost everything, its own birth."""
    with Onlooker(world.broker.port) as home:
        waited(lambda: home.kept.get("joint-monitor/availability") == b"online", "online")
        world.kill("gateway")
        waited(lambda: home.kept.get("joint-monitor/availability") == b"offline", "the last will")
        world.start("gateway")
        waited(lambda: home.kept.get("joint-monitor/availability") == b"online", "it is back")
    world.kill("broker")
    world.start("broker")
    with Onlooker(world.broker.port) as home:

        def announced():
            return Counter(topic for topic, _ in home.heard if topic.startswith("homeassistant/device/"))

        waited(lambda: len(announced()) == ARMS and home.kept.get("joint-monitor/availability") == b"online", "everything is told anew")
        before = announced()
        home.publish("homeassistant/status", "online")
        waited(lambda: all(announced()[topic] > count for topic, count in before.items()), "each device is announced once more")


def mails(world):
    """Which events did not come to a person in exactly one message, and how many mails came again."""
    messages, contents, events = defaultdict(set), defaultdict(set), [text for each in world.alerts.values() for text in each]
    taken = lines(world.folder / "mails")
    for line in taken:
        (person,), message = line["to"], email.message_from_string(line["content"], policy=email.policy.default)
        contents[person, message["Message-ID"]].add(line["content"])
        for event in events:
            if event in message.get_content():
                messages[person, event].add(message["Message-ID"])
    assert all(len(each) == 1 for each in contents.values())
    return [(person, event) for person in PEOPLE for event in events if len(messages[person, event]) != 1], len(taken) - len(contents)


def active_by_arm(world):
    found = {k: set() for k in range(ARMS)}
    for each in world.alerts:
        if each not in world.cleared:
            found[each[0]].add(each[1])
    return found


def shown_by_arm(onlooker):
    kept = {k: onlooker.kept.get(f"joint-monitor/site-1/arm-{k + 1:04d}/alerts") for k in range(ARMS)}
    return {k: {each["joint"] for each in json.loads(said)["alerts"]} if said else None for k, said in kept.items()}
