"""A real daemon with a handed-in clock and handed-in recordings: all that it publishes and answers, and the history that it leaves.

The part `bus` writes a history from nothing; the part `history` opens one (the earlier set's, where there is one) and continues it.
"""

import fcntl
import hashlib
import json
import queue
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import zenoh

from . import entry, worlds
from .run import Run, environment
from .worlds import DAY_S, ENDPOINT, METRICS, WORLDS

WORLD = WORLDS["payload"]
FIRST, THEN = 15, 24  # replays until which the history is written, until which it is continued; the rest is imported
LATER_UNIX_S = WORLD.at_unix_s(60)
MARKER, MARKER_KIND = "golden/marker", "replay"
PATIENCE_S = 120.0
STATIC = (
    "page.css",
    "elements.js",
    "controls.js",
    "page.js",
    "arm.js",
    "charts.js",
    "uPlot.iife.min.js",
    "uPlot.min.css",
    "uPlot.LICENSE.txt",
    "icon.svg",
)


class Record:
    """What came over the bus, step by step."""

    def __init__(self, run: Run, session: zenoh.Session, prefix: str) -> None:
        self._run, self._session, self._prefix = run, session, prefix
        self._came: queue.Queue[tuple[str, str, str]] = queue.Queue()
        self._marks = 0
        self.lines: list[dict[str, Any]] = []
        self._subscriber = session.declare_subscriber(f"{prefix}/**", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).removeprefix(f"{self._prefix}/")
        self._came.put((key, str(sample.encoding), sample.payload.to_bytes().decode()))

    def begin(self, daemon: entry.Running) -> None:
        """Wait until the subscription has reached the daemon."""
        give_up = time.monotonic() + PATIENCE_S
        while time.monotonic() < give_up:
            daemon.say(MARKER, MARKER_KIND, {"mark": self._marks})
            try:
                while self._came.get(timeout=0.5)[0] != MARKER:
                    pass
            except queue.Empty:
                continue
            self.step(daemon, "the subscription has arrived")
            self.lines.clear()
            return
        raise TimeoutError("nothing that the daemon says arrives")

    def step(self, daemon: entry.Running, what: str) -> None:
        """All messages until now belong to this step, because the sender keeps their order."""
        self._marks += 1
        daemon.say(MARKER, MARKER_KIND, {"mark": self._marks})
        while True:
            key, encoding, payload = self._came.get(timeout=PATIENCE_S)
            if key != MARKER:
                self._note(what, "said", key, encoding, payload)
            elif json.loads(payload)["mark"] == self._marks:
                return

    def ask(self, daemon: entry.Running, key: str, payload: Any = None) -> None:
        """One query with its answers, and the messages that it caused."""
        text = payload if payload is None or isinstance(payload, str) else json.dumps(payload)
        found = []
        for reply in self._session.get(f"{self._prefix}/{key}", payload=text, timeout=PATIENCE_S):
            if reply.ok is not None:
                name = str(reply.ok.key_expr).removeprefix(f"{self._prefix}/")
                found.append(("answered", name, str(reply.ok.encoding), reply.ok.payload.to_bytes().decode()))
            elif reply.err is not None:
                found.append(("refused", key, str(reply.err.encoding), reply.err.payload.to_bytes().decode()))
        what = f"asked {key}" if text is None else f"asked {key} {text[:200]}"
        for how, name, encoding, answer in sorted(found):  # several come in no order
            if name != MARKER:
                self._note(what, how, name, encoding, answer)
        self.step(daemon, what)

    def _note(self, step: str, how: str, key: str, encoding: str, payload: str) -> None:
        self.lines.append({"step": step, how: key, "encoding": encoding, "payload": self._run.clean(payload)})


@contextmanager
def alone() -> Iterator[None]:
    """The endpoints are part of the settings' digest and therefore fixed: one run of this machine at a time."""
    with (Path(tempfile.gettempdir()) / "joint-monitor-golden.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


class Days:
    """Recordings in their order, and what happens instead of one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.next: Callable[[], Any] | int = 0

    def play(self) -> Any:
        """What the daemon's next replay is."""
        if isinstance(self.next, int):
            return self.recording(self.next)
        return self.next()

    def recording(self, replay: int) -> Any:
        """One of the world's."""
        return entry.recording_of(self.folder / f"day-{replay:02d}.parquet")


def raising(error: Exception) -> Callable[[], Any]:
    def play() -> Any:
        raise error

    return play


def bus(run: Run) -> bool:
    """A new history, fifteen replays long, with windows that fail in every way, alerts, questions, page and metrics."""
    days, log = Days(run.world(WORLD.name)), list[str]()
    home = run.artefacts / "history_of_today"
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    config = home / "arm.toml"
    config.write_text(worlds.configuration(WORLD, entry.true_gains(_arm())), "utf-8")
    clock = entry.Clock(WORLD.at_unix_s(0) - 60.0)
    with alone(), entry.log_lines(log):
        with entry.running(config, clock, days.play) as daemon, entry.listener(ENDPOINT) as session:
            record = Record(run, session, entry.key_prefix(config))
            record.begin(daemon)
            record.ask(daemon, "**")  # before anything is known
            for key, payload in ASKED_EARLY.items():
                record.ask(daemon, key, payload)
            for day in range(FIRST):
                _one_day(record, daemon, clock, days, day)
            _look_around(run, record, daemon, "bus")
        clock.unix_s += 3600.0
        with entry.running(config, clock, days.play) as daemon, entry.listener(ENDPOINT) as session:
            again = Record(run, session, entry.key_prefix(config))
            again.begin(daemon)
            again.ask(daemon, "**")  # after a restart
    run.put_lines("bus/said.jsonl", record.lines)
    run.put_lines("bus/said-after-restart.jsonl", again.lines)
    run.put("bus/log.json", log)
    run.put_lines("bus/history.jsonl", dumped(home / "history"))
    return True


def _arm() -> Any:
    return entry.simulated(WORLD.robot, seed=WORLD.seed, mounting=WORLD.mounting, scenario=WORLD.scenario, name=WORLD.name)


def _one_day(record: Record, daemon: entry.Running, clock: entry.Clock, days: Days, day: int) -> None:
    clock.unix_s = WORLD.at_unix_s(day) + 5.0
    daemon.announce(clock.unix_s + 10.0)
    days.next = day
    daemon.perform(WORLD.at_unix_s(day))
    record.step(daemon, f"day {day}: a replay")
    noon = WORLD.at_unix_s(day) + DAY_S / 2
    clock.unix_s = noon
    happens: dict[int, Callable[[], Any]] = {
        5: raising(entry.refused("speed_scaling: the pendant's slider is at 50 %; expected 100 %")),
        6: raising(entry.aborted("late: targets came late", "late")),
        9: lambda: entry.said_of(days.recording(day), quality={"late_share": 0.3}),
        11: raising(entry.aborted("protective_stop in the phase 'play'", "protective_stop")),
        13: raising(RuntimeError("a fault of the monitor's own")),
    }
    if day == 3:
        daemon.skip(noon, "missed: the monitor or its host was not running, or had another replay under way")
    if day in happens:
        days.next = happens[day]
        daemon.perform(noon)
    if day == 12:
        daemon.perform(WORLD.at_unix_s(day))  # known already: nothing happens
        record.ask(daemon, "cmd/ack", {"joint": 3, "condition": "wear_rising", "by": "Ada", "why": "grease is ordered"})
        record.ask(daemon, "cmd/shelve", {"joint": 3, "condition": "wear_rising", "by": "Ada", "hours": 48.0})
    if day in {7, 10}:
        _an_arm_at_work(record, daemon, clock, days, day)
        days.next = day  # observations until now belong to this replay
        daemon.perform(clock.unix_s)
    daemon.say_health()
    record.step(daemon, f"day {day}: noon")


def _an_arm_at_work(record: Record, daemon: entry.Running, clock: entry.Clock, days: Days, day: int) -> None:
    """Six minutes of work are observed; in the later ones joint 3 has more friction."""
    recording = days.recording(day)
    for round_ in range(36):
        for row in entry.rows(recording, 125):
            clock.unix_s += 1.0
            daemon.observe_production(recording, row, [1.0, 1.0, 1.0 if round_ < 9 else 1.6, 1.0, 1.0, 1.0])
            record.step(daemon, f"day {day}: an arm at work, round {round_}")  # each: of a stream, what is not taken is dropped
    daemon.say_health()
    record.step(daemon, f"day {day}: what work has told")


ONE = {"q": [0.1, -1.5, 0.5, -0.3, 0.2, 0.1], "qd": [0.5, -0.4, 0.3, 0.6, -0.7, 0.8]}
ASKED_EARLY: dict[str, Any] = {
    "torque": ONE,
    "history": None,
    "event": None,
    "cmd/ack": {"joint": 1, "condition": "wear_rising", "by": "A"},
}
ASKED: tuple[tuple[str, Any], ...] = (
    ("**", None),
    ("alert/**", None),
    ("joint/3/friction", None),
    ("torque", ONE),
    ("torque", {**ONE, "qdd": [1.0] * 6, "temperature_c": [25.0, 30.0, 35.0, 40.0, 55.0, 5.0]}),
    ("torque", {name: [values, [2 * value for value in values], [0.0] * 6] for name, values in ONE.items()}),
    ("torque", {"q": [ONE["q"]] * 2, "qd": [ONE["qd"]] * 2, "temperature_c": [[28.0] * 6]}),
    ("torque", {"q": 1}),
    ("torque", {"q": [0.1] * 5, "qd": [0.1] * 5}),
    ("torque", {**ONE, "speed": 1}),
    ("torque", "no json"),
    ("torque", None),
    ("history", None),
    ("history?joint=3", None),
    ("history?limit=7", None),
    ("history?joint=2;after=4;limit=3", None),
    ("history?from=2026-01-08;to=2026-01-10T12:00:00Z", None),
    ("history?joint=9", None),
    ("history?colour=red", None),
    ("event", None),
    ("event?after=1", None),
    ("event?after=x", None),
    ("cmd/replay", {"by": "Ada", "why": "after the crash"}),
    ("cmd/replay", {}),
    ("cmd/ack", {"joint": 5, "condition": "wear_rising", "by": "Ada"}),
    ("cmd/ack", {"joint": 3, "condition": "wear_rising"}),
    ("cmd/shelve", {"joint": 3, "condition": "wear_rising", "by": "Ada", "hours": -1.0}),
    ("cmd/ack", {"joint": None, "condition": "payload_contradiction", "by": "Bob", "why": "it will be declared"}),
    ("no/such/key", None),
)


def _look_around(run: Run, record: Record, daemon: entry.Running, part: str) -> None:
    """Everything that can be asked, and the monitor's own condition, page and metrics."""
    daemon.look_after()
    daemon.say_monitor()
    daemon.say_health()
    record.step(daemon, "the monitor's own condition")
    for key, payload in ASKED:
        record.ask(daemon, key, payload)
    assert daemon.page_url is not None
    for name in ("", "api/about", "api/history", "api/schedule", "api/monitor"):
        run.put_text(f"{part}/page-{name.replace('/', '-') or 'index'}.txt", _fetched(daemon.page_url + name))
    run.put(f"{part}/page-static.json", {name: _digest(_fetched(f"{daemon.page_url}static/{name}")) for name in STATIC})
    lines = _fetched(f"http://{METRICS}/metrics").splitlines()
    run.put_text(f"{part}/metrics.txt", "\n".join(lines) + "\n")


def _fetched(url: str) -> str:
    try:
        with urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
            return str(answer.read().decode())
    except urllib.error.HTTPError as error:
        return f"{error.code} {error.read().decode()}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def history(run: Run) -> bool:
    """A history of an earlier run: opened, continued by the schedule, queried, reported, exported, recomputed, imported into."""
    if not (run.history_of_today / "history").is_dir():
        bus(run)
    days, log = Days(run.world(WORLD.name)), list[str]()
    home = run.production / "continued"
    shutil.rmtree(home, ignore_errors=True)
    shutil.copytree(run.history_of_today, home)
    config = home / "arm.toml"
    _commands(run, home, "as-found")
    options = ("--by", "Ada", "--why", "the box is gone")
    run.command("history/allow.json", "allow", "--config", "arm.toml", *options, cwd=home, at_unix_s=WORLD.at_unix_s(FIRST) - 7200.0)
    config.write_text(worlds.configuration(WORLD, entry.true_gains(_arm()), payload_kg=2.0), "utf-8")
    clock = entry.Clock(WORLD.at_unix_s(FIRST) - 3600.0)
    with alone(), entry.log_lines(log), entry.running(config, clock, days.play) as daemon, entry.listener(ENDPOINT) as session:
        record = Record(run, session, entry.key_prefix(config))
        record.begin(daemon)
        record.ask(daemon, "**")
        daemon.schedules()
        daemon.tick()
        record.step(daemon, "the schedule has begun to look")
        for day in range(FIRST, THEN):
            _scheduled_day(record, daemon, clock, days, day)
        _commands_on_the_bus(run, home, clock.unix_s)
        record.step(daemon, "commands of others")
        _look_around(run, record, daemon, "history")
        clock.unix_s += 40 * DAY_S
        daemon.say_health()
        record.step(daemon, "forty days later: stale")
    run.put_lines("history/said.jsonl", record.lines)
    run.put("history/log.json", log)
    _commands(run, home, "continued")
    importing = ("import", "--config", config, "--manifest", "late.csv", "--json")
    folder = run.production / "late"
    folder.mkdir(exist_ok=True)
    rows = ["file,recorded_at,payload_kg"]
    for replay in range(THEN, WORLD.replays):
        shutil.copy(days.folder / f"day-{replay:02d}.parquet", folder)
        at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(WORLD.at_unix_s(replay)))
        rows.append(f"day-{replay:02d}.parquet,{at},2.0")
    (folder / "late.csv").write_text("\n".join(rows) + "\n", "utf-8")
    for name in ("import", "import-again"):
        run.command(f"history/{name}.json", *importing, cwd=folder, at_unix_s=LATER_UNIX_S)
    _commands(run, home, "imported")
    run.put_lines("history/dump.jsonl", dumped(home / "history"))
    return True


def _scheduled_day(record: Record, daemon: entry.Running, clock: entry.Clock, days: Days, day: int) -> None:
    """The window of a day, as the schedule's thread comes upon it; one is missed, one is asked for."""
    at = WORLD.at_unix_s(day)
    for pause in range(1, 12):  # the schedule looks now and then
        clock.unix_s = at - DAY_S + pause * DAY_S / 12
        daemon.tick()
    days.next = day
    if day == FIRST + 3:
        clock.unix_s = at + 7200.0
        daemon.tick()
        record.step(daemon, f"day {day}: the window was missed")
        record.ask(daemon, "cmd/replay", {"by": "Ada", "why": "it was missed"})
        daemon.tick()
    else:
        clock.unix_s = at + 3.0
        daemon.tick()
    record.step(daemon, f"day {day}: the schedule's replay")
    clock.unix_s = at + 60.0
    if day == FIRST + 5:
        _an_arm_at_work(record, daemon, clock, days, day)
        daemon.tick()  # pulled forward, where the schedule allows it
    daemon.say_health()
    daemon.say_monitor()
    record.step(daemon, f"day {day}: a minute later")


def _commands_on_the_bus(run: Run, home: Path, at_unix_s: float) -> None:
    """Commands that ask the daemon."""
    config = ("--config", "arm.toml")
    figures = [",".join(map(str, values)) for values in ONE.values()]
    for name, arguments in {
        "alerts": ("alerts", *config),
        "alerts-json": ("alerts", *config, "--json"),
        "alerts-all": ("alerts", *config, "--all", "--json"),
        "ack": ("ack", *config, "j3/wear_rising", "--by", "Bob", "--why", "seen"),
        "ack-unknown": ("ack", *config, "j6/wear_rising", "--by", "Bob"),
        "ack-malformed": ("ack", *config, "six", "--by", "Bob"),
        "shelve": ("shelve", *config, "j3/wear_rising", "--hours", "5", "--by", "Bob", "--json"),
        "predict": ("predict", *config, f"--q={figures[0]}", f"--qd={figures[1]}", "--json"),
        "predict-text": ("predict", *config, f"--q={figures[0]}", f"--qd={figures[1]}", "--temperature", "10,20,30,40,50,60"),
    }.items():
        run.command(f"history/bus-{name}.json", *arguments, cwd=home, at_unix_s=at_unix_s)
    for keys in ("alert/**", "joint/*/friction", "health"):
        for json_or_text in (("--json",), ()):
            name = f"history/watch-{keys.split('/')[0]}{'-json' if json_or_text else ''}.txt"
            run.put_text(name, _watched(home, at_unix_s, "--keys", keys, *json_or_text))


def _watched(home: Path, at_unix_s: float, *options: str) -> str:
    """The first output of `watch`, in arbitrary order, until no more comes for a while."""
    command = [sys.executable, "-m", "tests.golden.at", repr(at_unix_s), "watch", "--config", "arm.toml", *options]
    with (
        tempfile.TemporaryFile("w+") as out,
        subprocess.Popen(command, stdout=out, stderr=subprocess.DEVNULL, cwd=home, env=environment()) as process,
    ):
        length, since = 0, time.monotonic()
        while time.monotonic() - since < (2.0 if length else PATIENCE_S):
            time.sleep(0.1)
            if (now := out.seek(0, 2)) != length:
                length, since = now, time.monotonic()
        process.terminate()
        process.wait(timeout=PATIENCE_S)
        out.seek(0)
        return "".join(sorted(out.read().splitlines(keepends=True)))


def _commands(run: Run, home: Path, when: str) -> None:
    """Commands that read the history without a daemon."""
    config, exported = ("--config", "arm.toml"), run.production / "exported.csv"
    figures = [",".join(map(str, values)) for values in ONE.values()]
    page = run.production / "report.html"
    for name, arguments in {
        "status-json": ("status", *config, "--json"),
        "status": ("status", *config, "--why", "3"),
        "status-why": ("status", *config, "--why", "2", "--json"),
        "history": ("history", *config),
        "history-json": ("history", *config, "--limit", "1000", "--json"),
        "history-part": ("history", *config, "--joint", "3", "--from", "2026-01-08", "--to", "2026-01-15", "--limit", "4"),
        "schedule": ("schedule", *config),
        "schedule-json": ("schedule", *config, "--count", "4", "--json"),
        "report-json": ("report", *config, "--json"),
        "report-part": ("report", *config, "--from", "2026-01-10", "--to", "2026-01-14", "--json"),
        "recomputed": ("assess", "--from-store", *config),
        "recomputed-json": ("assess", "--from-store", *config, "--json"),
        "predict-local": ("predict", *config, "--local", f"--q={figures[0]}", f"--qd={figures[1]}", "--json"),
    }.items():
        run.command(f"history/{when}-{name}.json", *arguments, cwd=home, at_unix_s=LATER_UNIX_S)
    page.unlink(missing_ok=True)  # a command replaces no file unasked
    run.command(f"history/{when}-report.json", "report", *config, "-o", page, cwd=home, at_unix_s=LATER_UNIX_S, files=[page])
    for what in ("friction", "ledger", "events", "assessments"):
        exported.unlink(missing_ok=True)
        table = ("--what", what, "-o", exported)
        run.command(f"history/{when}-export-{what}.json", "export", *config, *table, cwd=home, at_unix_s=LATER_UNIX_S, files=[exported])
    exported.unlink(missing_ok=True)
    options = ("--what", "recording", "--replay", "3", "-o", exported)
    run.command(f"history/{when}-export-recording.json", "export", *config, *options, cwd=home, at_unix_s=LATER_UNIX_S)
    run.put(f"history/{when}-exported-recording.json", {"sha256": _digest(exported.read_text("utf-8"))})


def dumped(directory: Path) -> Iterator[dict[str, Any]]:
    """Every row of every table of a history, in the order of its primary key; what is packed is unpacked."""
    with closing(sqlite3.connect(f"file:{directory / 'history.sqlite'}?mode=ro", uri=True)) as db:
        yield {"user_version": db.execute("PRAGMA user_version").fetchone()[0]}
        schema = db.execute("SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL ORDER BY name").fetchall()
        yield {"schema": dict(schema)}
        for (table,) in db.execute("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name").fetchall():
            cursor = db.execute(f"SELECT * FROM {table} ORDER BY 1, 2")
            names = [column[0] for column in cursor.description]
            for row in cursor:
                yield {"table": table, "row": {name: _unpacked(value) for name, value in zip(names, row, strict=True)}}


def _unpacked(value: Any) -> Any:
    return zlib.decompress(value).decode() if isinstance(value, bytes) else value
