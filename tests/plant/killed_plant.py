"""Restless arms behind three routers, whose plant, routers and PostgreSQL are killed; and what the table holds against the arms."""

import ctypes
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import ExitStack
from datetime import datetime
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import psycopg

from monitor.plant.database import Database

HERE = Path(__file__).parent
SITES = ("site-1", "site-2", "site-3")
ROLES = ("plant", "router 1", "router 2", "router 3", "database")
TOGETHER = 0.3  # of the kills: another one joins it before what was killed first is back
AWAY_S, BETWEEN_S, WITHIN_S = (0.0, 6.0), (0.0, 6.0), 600.0  # a busy machine takes its time
PR_SET_PDEATHSIG = 1  # linux/prctl.h
JOINTS = 6
# the server's own witness of what was written, and in which order: a counter that no program of ours moves
WITNESS = """
CREATE TABLE IF NOT EXISTS arrived (number bigserial PRIMARY KEY, arm bigint, history int, seq bigint);
CREATE OR REPLACE FUNCTION arrives() RETURNS trigger LANGUAGE plpgsql AS
$$ BEGIN INSERT INTO arrived (arm, history, seq) VALUES (NEW.arm, NEW.history, NEW.seq); RETURN NULL; END $$;
CREATE OR REPLACE TRIGGER arrives AFTER INSERT ON transition FOR EACH ROW EXECUTE FUNCTION arrives();
"""
TIMES = {"at", "raised_at", "updated_at", "cleared_at"}


def ends_with_its_parent():
    """In a child: nothing that a soak has started outlives it."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class Killed(NamedTuple):
    """Some kills at about one moment, and how it went on."""

    roles: tuple[str, ...]
    held: int  # transitions of the arms that the plant had not copied at the first kill
    away_s: float  # from the first kill until the last of them was started again
    again_s: float  # from then until every site that was cut off was caught up, and newer transitions of it were written


class KilledPlant:
    """The processes. A context manager."""

    def __init__(self, postgres, folder, *, arms, days, changes_a_s, day_every_s, seed):
        self.postgres, self.folder, self.address = postgres, folder, postgres.address()
        self.chance = random.Random(seed)
        self.routers = [f"tcp/127.0.0.1:{port}" for port in free_ports(len(SITES))]
        text = f'[plant]\nconnect = {self.routers}\ndatabase = "{self.address}"\nworkers = 12\n'.replace("'", '"')
        (folder / "plant.toml").write_text(text)
        self._stack, self._running = ExitStack(), {}
        try:
            for role in ROLES[1:4]:
                self.start(role)
            words = map(str, (arms, days, changes_a_s, day_every_s, seed, *self.routers))
            self._arms = self._process("arms", [HERE / "restless_arms.py", *words])
            self.first = sum(json.loads(self._said()).values())
            self._witness()
            self.start("plant")
        except BaseException:
            self.__exit__()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._stack.close()

    def _process(self, name, words):
        process = subprocess.Popen(
            [sys.executable, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=(self.folder / f"{name}.log").open("ab"),
            text=True, env={**os.environ, "COLUMNS": "200"}, start_new_session=True,  # as services have their own shares of the processor
            preexec_fn=ends_with_its_parent,  # noqa: PLW1509 - it only asks the kernel
        )  # fmt: skip
        self._stack.callback(_end, process)
        return process

    def start(self, role):
        """Begin what was killed; it may take a while until it works again."""
        if role == "database":
            self.postgres.start()
        elif role.startswith("plant"):
            self._running[role] = self._process(role, ["-m", "monitor", "plant", "--config", self.configuration(role)])
        else:
            endpoint = self.routers[int(role[-1]) - 1]
            self._running[role] = self._process(role, [HERE / "site_router.py", endpoint])
            assert self._running[role].stdout.readline() == "open\n", self.log(role)

    def configuration(self, role):
        """The file of a plant."""
        return self.folder / "plant.toml"

    def kill(self, role):
        """By SIGKILL, and it is gone when this returns."""
        if role == "database":
            self.postgres.kill()
        else:
            process = self._running.pop(role)
            assert process.poll() is None, f"{role} had ended by itself: {self.log(role)}"
            process.kill()
            process.wait()

    def log(self, name):
        return (self.folder / f"{name}.log").read_text()[-3000:]

    def _said(self):
        said = self._arms.stdout.readline()
        assert said, self.log("arms")
        return said

    def held(self):
        """Transitions that the arms of each site hold."""
        self._arms.stdin.write("held\n")
        self._arms.stdin.flush()
        return json.loads(self._said())

    def copied(self):
        """How many transitions of each site are written; nothing where the database is away or has no tables yet."""
        per_site = "SELECT site, sum(event_cursor)::bigint FROM history JOIN arm ON arm.id = history.arm GROUP BY site"
        try:
            return dict.fromkeys(SITES, 0) | dict(self.asked(per_site))
        except (psycopg.OperationalError, psycopg.errors.UndefinedTable):
            return dict.fromkeys(SITES, 0)

    def asked(self, question):
        with psycopg.connect(self.address.replace("+psycopg", ""), autocommit=True, connect_timeout=5) as connection:
            cursor = connection.execute(question)
            return cursor.fetchall() if cursor.description else []

    def until(self, condition, what, within_s=WITHIN_S):
        """Wait; the seconds that it took."""
        began = time.monotonic()
        while not condition():
            for role, process in self._running.items():
                assert process.poll() is None, f"{role} has ended by itself: {self.log(role)}"
            assert time.monotonic() - began < within_s, f"{what}: {self.held()} held, {self.copied()} copied; {self.log('plant')}"
            time.sleep(0.1)
        return time.monotonic() - began

    def _witness(self):
        """Before a plant writes: what it writes first is seen too."""
        database = Database(self.address)
        try:
            database.migrate()
        finally:
            database.close()
        self.asked(WITNESS)

    def caught_up(self):
        """Wait until nothing is behind for a moment, while transitions go on."""
        return self.until(lambda: sum(self.held().values()) - sum(self.copied().values()) <= 5, "caught up")

    def kills(self, each):
        """Kill every role so many times, in an order and at moments of the seed; yields what was killed, some kills at a time."""
        left = list(ROLES) * each
        self.chance.shuffle(left)
        while left:
            together = len(left) > 1 and left[0] != left[1] and self.chance.random() < TOGETHER
            roles, left = left[: 1 + together], left[1 + together :]
            yield self._kill(roles)
            time.sleep(self.chance.uniform(*BETWEEN_S))

    def _kill(self, roles):
        chance = self.chance
        behind = sum(self.held().values()) - sum(self.copied().values())
        moments = []  # when what happens
        for role in roles:
            at = chance.uniform(0.0, 2.0)
            moments += [(at, self.kill, role), (at + chance.uniform(*AWAY_S), self.start, role)]
        began = time.monotonic()
        for at, act, role in sorted(moments, key=lambda moment: moment[0]):
            time.sleep(max(began + at - time.monotonic(), 0.0))
            act(role)
        away_s = time.monotonic() - began
        cut = SITES if {"plant", "database"} & set(roles) else [f"site-{role[-1]}" for role in roles]
        held = self.held()  # transitions of after this moment must come through
        again_s = self.until(lambda: all(self.copied()[site] > held[site] for site in cut), f"after {roles}")
        return Killed(tuple(roles), behind, away_s, again_s)

    def finish(self):
        """End the changes, and wait until all of them are copied. Returns what the arms hold, and the seconds that it took."""
        self._arms.stdin.write(f"stop {self.folder}\n")
        self._arms.stdin.flush()
        count = int(self._said())
        with (self.folder / "arms.jsonl").open() as file:
            arms = [json.loads(line) for line in file]
        assert len(arms) == count
        rows = JOINTS * sum(arm["replays"] for arm in arms)
        took_s = self.until(lambda: self.copied() == self.held() and self.asked("SELECT count(*) FROM friction") == [(rows,)], "all of it")
        return arms, took_s

    def wrong(self, arms):
        """What the tables have otherwise than the arms."""
        rows = self.asked(
            "SELECT site, robot, transition.history, seq, document, at, joint, condition, tier, kind, by "
            "FROM transition JOIN arm ON arm.id = transition.arm ORDER BY site, robot, at, seq"
        )
        arrived = self.asked("SELECT site, robot, arrived.history, seq FROM arrived JOIN arm ON arm.id = arrived.arm ORDER BY number")
        found = wrong_transitions(arms, rows) + wrong_order(arms, arrived)
        per_arm = (
            "SELECT site, robot, count(*), count(DISTINCT (replay, joint)), coalesce(min(replay), 1), coalesce(max(replay), 0) "
            "FROM arm LEFT JOIN friction ON friction.arm = arm.id GROUP BY site, robot"
        )
        replays = {tuple(arm["arm"]): arm["replays"] for arm in arms}
        for site, robot, *figures in self.asked(per_arm):
            has = replays.get((site, robot))
            if figures != [JOINTS * (has or 0), JOINTS * (has or 0), 1, has]:
                found.append(f"{site}/{robot}: rows, different ones, first and last replay {figures}, and the arm has {has} replays")
        found += [f"audit: {line}" for line in self.asked("SELECT act, robot, text FROM audit WHERE act IN ('gap', 'another history')")]
        return found


def wrong_transitions(arms, rows):
    """Arms of which the table holds anything but each of their transitions once, in the order of their times; a sentence for each.

    arms : as they write themselves. rows : site, robot, number of the history, number, document, and the columns beside it.
    """
    there = defaultdict(list)
    for site, robot, *row in rows:
        there[site, robot].append(row)
    found = []
    for arm in arms:
        has, expected = there.pop(tuple(arm["arm"]), []), arm["transitions"]
        for k, (row, event) in enumerate(zip_longest(has, expected)):
            if row is None or event is None or not _same(row, event, k + 1):
                found.append(f"{'/'.join(arm['arm'])}: {len(has)} rows of {len(expected)}; row {k + 1} is {row} instead of {event}")
                break
    return found + [f"{'/'.join(name)}: there is no such arm" for name in there]


def _same(row, event, number):
    """Whether a row is an arm's transition of this number: in its columns, and in every field of its document that the arm says."""
    history, seq, document, at, *columns = row
    names = ("joint", "condition", "tier", "kind", "by")
    return (
        (history, seq, event["seq"]) == (1, number, number)
        and [at.timestamp(), *columns] == [instant(event["at"]), *(event[name] for name in names)]
        and all(_value(name, document.get(name)) == _value(name, value) for name, value in event.items())
    )


def _value(name, value):
    return instant(value) if name in TIMES and value else value


def wrong_order(arms, arrived):
    """Arms whose transitions were not written one after the other, each once.

    arrived : site, robot, history, number, as they were written.
    """
    there = defaultdict(list)
    for site, robot, history, seq in arrived:
        there[site, robot].append((history, seq))
    found = []
    for arm in arms:
        has = there[tuple(arm["arm"])]
        if has != [(1, seq) for seq in range(1, len(arm["transitions"]) + 1)]:
            found.append(f"{'/'.join(arm['arm'])}: written as {has[:20]} …")
    return found


def instant(text):
    """Seconds since 1970."""
    return datetime.fromisoformat(text).timestamp()


def free_ports(count):
    """TCP ports of 127.0.0.1 that were free a moment ago, no two of them the same."""
    with ExitStack() as stack:
        return [stack.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1] for _ in range(count)]


def _end(process):
    process.kill()
    process.wait()
    process.stdin.close()
    process.stdout.close()
