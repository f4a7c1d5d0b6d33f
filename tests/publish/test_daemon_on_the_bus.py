"""The daemon on the bus, with a real store, real Zenoh and stepped replays: its documents are valid by their schemas."""

import json
import shutil
import socket
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
import zenoh
from once import once
from undeclared import undeclared

from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.config.files import find_excitation
from monitor.config.load import from_document
from monitor.errors import BadInput
from monitor.judge.alerts.health import Alert
from monitor.publish.client import Client
from monitor.publish.documents import Document, TorqueLive, as_json
from monitor.publish.registry import KINDS, schema
from monitor.publish.session import session_config
from monitor.reason import reason_of
from monitor.service.daemon import Daemon
from monitor.service.housekeeping import Housekeeping
from monitor.service.main_loop import MainLoop, Reloader, Workers
from monitor.service.monitor_document import MonitorDocument
from monitor.service.problems import Problems
from monitor.service.publisher import digest
from monitor.service.scheduler import Scheduler
from monitor.service.shared_state import ReplayRequests
from monitor.service.systemd import Heartbeats
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.store import Store

DAY_S = 86_400.0
START_UNIX_S = 1_767_582_000.0
PREFIX = "joint-monitor/v1/lab/cell-1"


class Arm:
    """An arm with one replay a day, all of them equal."""

    def __init__(self, recording) -> None:
        self.recording = recording
        self.clock_unix_s = START_UNIX_S

    def now(self) -> float:
        return self.clock_unix_s

    def play(self, excitation, context, should_stop, window):
        return replace(self.recording, context=replace(context, firmware=self.recording.context.firmware))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """One replay of the simulated UR5."""
    excitation = replace(find_excitation("ur5-ground", Path()), repetitions=1)
    return once(tmp_path_factory, "recording", lambda _: stepped_replay(Controller(SimulateSettings(robot="ur5")), excitation))


def settled(folder: Path, endpoint: str):
    """The configuration of a cell whose history is in that folder."""
    document = {
        "robot": {"model": "ur5", "site": "lab", "id": "cell-1"},
        "replay": {"allow_motion": True},
        "store": {"directory": str(folder / "history")},
        "bus": {"listen": [endpoint]},
    }
    return from_document(document, folder / "cell.toml")


@pytest.fixture(scope="module")
def history(tmp_path_factory, recording) -> Path:
    """The directory of a daemon after three replays; each test continues from a copy."""
    return once(tmp_path_factory, "history", lambda folder: _after_three_replays(folder, Arm(recording)))


def _after_three_replays(folder: Path, arm: Arm) -> Path:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with Store.open(folder / "history") as store, Daemon(settled(folder, endpoint), store, now=arm.now, play=arm.play) as daemon:
        for _ in range(3):
            assert daemon.monitor.perform(arm.clock_unix_s).state == "assessed"
            arm.clock_unix_s += DAY_S
    return folder / "history"


@pytest.fixture
def cell(tmp_path: Path, free_port: int, recording, history):
    """A daemon with three replays in its history, and its endpoint."""
    endpoint, arm = f"tcp/127.0.0.1:{free_port}", Arm(recording)
    arm.clock_unix_s = START_UNIX_S + 3 * DAY_S
    shutil.copytree(history, tmp_path / "history")
    with (
        Store.open(tmp_path / "history") as store,
        Daemon(settled(tmp_path, endpoint), store, now=arm.now, play=arm.play, requests=ReplayRequests()) as daemon,
    ):
        yield daemon, store, arm, endpoint


def raise_alert(daemon: Daemon, at_unix_s: float, joint: int | None = 3, condition: str = "wear_rising") -> None:
    """Raise an alert as a verdict does: stored, held and published."""
    alert = Alert(
        joint=joint, condition=condition, tier="wear", raised_at_unix_s=at_unix_s, updated_at_unix_s=at_unix_s,
        change=0.06, probability=0.99, text=reason_of("Joint 3: friction rose"), action=reason_of("inspect"),
    )  # fmt: skip
    with daemon.state.revising:
        health = replace(daemon.state.health, alerts=(*daemon.state.health.alerts, alert))
        daemon.alerts.keep(health, "raised", alert, at_unix_s)


def test_everything_published_and_answered_is_valid_by_its_schema(cell):
    """Every last value by the kind its encoding names, every answer, and every error: all valid against the printed JSON Schema."""
    daemon, _, arm, endpoint = cell
    raise_alert(daemon, arm.clock_unix_s)
    daemon.publisher.replay_announced(4, {"robot": "ur5", "moves_at_unix_s": arm.clock_unix_s, "duration_s": 10.0})
    daemon.live.sample(*(np.full(6, x) for x in (0.1, 0.2, 0.3, 1.0, 30.0)))
    asked = {
        "torque": {"q": [0.1] * 6, "qd": [0.5] * 6},
        "cmd/ack": {"joint": 3, "condition": "wear_rising", "by": "ada"},
        "cmd/shelve": {"joint": 3, "condition": "wear_rising", "by": "ada", "hours": 2.0},
        "history?limit=2": None,
        "event": None,
        "cmd/replay": {"by": "ada"},  # there is no scheduler here: an error
        "torque?": {"q": 1},
    }
    seen = set()
    with zenoh.open(session_config(mode="client", connect=(endpoint,))) as session:
        replies = list(session.get(f"{PREFIX}/**", timeout=5.0))
        for key, payload in asked.items():
            replies += session.get(f"{PREFIX}/{key}", payload=None if payload is None else json.dumps(payload), timeout=5.0)
        for reply in replies:
            answer = reply.ok or reply.err
            kind = str(answer.encoding).removeprefix("application/json;joint-monitor.").removesuffix(".v1")
            document = json.loads(answer.payload.to_bytes())
            jsonschema.validate(document, schema(kind), format_checker=jsonschema.FormatChecker())
            assert undeclared(KINDS[kind].model.model_validate(document)) == []
            seen.add(kind)
    kinds = {"info", "health", "friction", "alert", "model", "compensation", "replay", "torque", "torque-live"}
    kinds |= {"answer", "history", "events", "error"}
    assert seen == kinds


def test_a_client_reads_the_health_of_an_arm_with_an_alert(cell):
    """Health has the whole alert, and none of the counts of the judge."""
    daemon, _, arm, endpoint = cell
    raise_alert(daemon, arm.clock_unix_s)
    daemon.publisher.health()
    with Client(endpoint, "lab", "cell-1") as client:
        health = client.health()
    assert [(alert.joint, alert.active) for alert in health.alerts] == [(3, True)]
    assert health.joints[0].model_dump().keys() == {"joint", "state", "why", "since", "stale", "learnt_at", "reasons"}


def test_info_gives_the_settings_in_force_and_since_when(cell):
    """Serial and firmware of the connected controller, boot of the host, versions, and a digest that depends on every setting."""
    daemon, _, arm, endpoint = cell
    with Client(endpoint, "lab", "cell-1") as client:
        info = client.info()
    assert info.started_at.timestamp() == START_UNIX_S + 3 * DAY_S
    assert info.boot_id == Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    assert info.mounting == "ground"
    assert {"python", "numpy", "ur-rtde", "eclipse-zenoh"} <= info.versions.keys()
    assert info.firmware == arm.recording.context.firmware
    configuration = daemon.state.configuration
    assert info.configuration_digest == digest(configuration)
    assert digest(replace(configuration, path=Path("elsewhere.toml"))) == info.configuration_digest
    for changed in (
        replace(configuration, bus=replace(configuration.bus, live_rate_hz=7.0)),
        replace(configuration, robot=replace(configuration.robot, payload_kg=1.0)),
        replace(configuration, excitation=replace(configuration.excitation, repetitions=7)),
        replace(configuration, replay=replace(configuration.replay, cell=None)),
    ):
        assert digest(changed) != info.configuration_digest


def test_an_alert_is_acknowledged_and_shelved_by_name_and_stays_so_through_a_restart(cell, tmp_path):
    """Person, time and reason are in the alert, the log of transitions and the history. A later daemon publishes the same."""
    daemon, store, arm, endpoint = cell
    raise_alert(daemon, arm.clock_unix_s)
    with Client(endpoint, "lab", "cell-1") as client:
        done = client.acknowledge(3, "wear_rising", by="Ada", why="grease is ordered")
        assert (done.acknowledged_by, done.acknowledged_why) == ("Ada", "grease is ordered")
        shelved = client.shelve(3, "wear_rising", hours=48.0, by="Ada")
        assert (shelved.shelved_until - shelved.acknowledged_at).total_seconds() == 48 * 3600
        (alert,) = client.alerts()
        assert alert.acknowledged_by == "Ada"
        assert [event.kind for event in client.events().events][-3:] == ["raised", "acknowledged", "shelved"]
        with pytest.raises(BadInput, match="no active alert j4/wear_rising; active: j3/wear_rising"):
            client.acknowledge(4, "wear_rising", by="Ada")
    daemon.__exit__(None, None, None)
    with Daemon(daemon.state.configuration, store, now=arm.now, play=arm.play), Client(endpoint, "lab", "cell-1") as client:
        (alert,) = client.alerts()
        assert (alert.acknowledged_by, alert.shelved_by) == ("Ada", "Ada")


@pytest.mark.parametrize("selector", ["**", "cmd/*", "cmd/**", "*/ack", "cmd/a$*"])
def test_a_wildcard_never_acknowledges_anything_nor_moves_an_arm(cell, selector):
    """With any payload: no answer of a command, no change, no transition."""
    daemon, store, arm, endpoint = cell
    raise_alert(daemon, arm.clock_unix_s)
    before = store.events.range()
    with Client(endpoint, "lab", "cell-1") as client:
        for payload in (None, {}, {"joint": 3, "condition": "wear_rising", "by": "a bus explorer"}):
            assert not any(message.key.startswith("cmd") for message in client.get(selector, payload))
        assert client.alerts()[0].acknowledged_at is None
    assert store.events.range() == before
    assert not daemon.state.requests.take_request()


@pytest.mark.parametrize(
    ("key", "payload", "says"),
    [
        ("cmd/ack", {}, "joint: Field required; condition: Field required; by: Field required"),
        ("cmd/ack", {"joint": 3, "condition": "wear_rising", "by": " "}, "by:"),
        ("cmd/ack", {"joint": 0, "condition": "wear_rising", "by": "ada"}, "joint:"),
        ("cmd/ack", {"joint": "3", "condition": "wear_rising", "by": "ada"}, "joint: Input should be a valid integer"),
        ("cmd/ack", {"joint": 3, "condition": "wear_rising", "by": "ada", "whyy": ""}, "whyy: Extra inputs are not permitted"),
        ("cmd/shelve", {"joint": 3, "condition": "wear_rising", "by": "ada", "hours": 0}, "hours: Input should be greater than 0"),
        ("cmd/shelve", {"joint": 3, "condition": "wear_rising", "by": "ada", "hours": 1e6}, "hours:"),
        ("cmd/replay", {"why": "now"}, "by: Field required"),
    ],
)
def test_a_command_with_a_wrong_payload_does_nothing_and_names_every_mistake(cell, key, payload, says):
    """The error reply names the field, and alert and history stay unchanged."""
    daemon, store, arm, endpoint = cell
    raise_alert(daemon, arm.clock_unix_s)
    before = store.events.range()
    with Client(endpoint, "lab", "cell-1") as client:
        with pytest.raises(BadInput) as refused:
            client.get(key, payload)
        assert says in str(refused.value)
        assert client.alerts()[0].acknowledged_at is None
    assert store.events.range() == before


def test_history_comes_in_pages_of_whole_replays(cell):
    """Pages of any size give all rows once and in order, also by joint and by time. Wrong parameters are named."""
    _, _, _, endpoint = cell
    with Client(endpoint, "lab", "cell-1") as client:
        everything = list(client.history())
        assert [(row.replay, row.joint) for row in everything] == [(replay, joint) for replay in (1, 2, 3) for joint in range(1, 7)]
        paged, after = [], 0
        while after is not None:
            page = client.get(f"history?limit=7;after={after}")[0].document
            assert 6 <= len(page["rows"]) <= 7
            paged += [(row["replay"], row["joint"]) for row in page["rows"]]
            after = page["next"]
        assert paged == [(row.replay, row.joint) for row in everything]
        assert [row.replay for row in client.history(joint=3, since="2026-01-06T00:00:00Z")] == [2, 3]
        for wrong, says in (("joint=9", "whole number from 1 to 6"), ("from=yesterday", "2026-01-31T03:00:00Z"), ("jiont=1", "known are")):
            with pytest.raises(BadInput, match=says):
                client.get(f"history?{wrong}")


def test_a_replay_is_requested_by_name_and_refused_with_a_reason(cell):
    """It is accepted with a scheduler, and refused during a replay and where motion is not allowed."""
    daemon, _, _, endpoint = cell
    with Client(endpoint, "lab", "cell-1") as client:
        scheduled, daemon.state.requests = daemon.state.requests, None
        with pytest.raises(BadInput, match="schedules no replays"):
            client.request_replay(by="ada")
        daemon.state.requests = scheduled
        assert client.request_replay(by="ada", why="new tool") == "accepted"
        assert daemon.state.requests.take_request()
        with daemon.state.replaying, pytest.raises(BadInput, match="a replay is under way"):
            client.request_replay(by="ada")
        daemon.state.configuration = replace(
            daemon.state.configuration, replay=replace(daemon.state.configuration.replay, allow_motion=False)
        )
        with pytest.raises(BadInput, match="allow_motion is false"):
            client.request_replay(by="ada")


def test_a_watcher_that_was_disconnected_gets_what_it_missed_once_and_in_order(cell, tmp_path):
    """Transitions happen while the daemon is away. After its return the watcher has every number once, without a gap."""
    daemon, store, arm, endpoint = cell
    raise_alert(daemon, arm.clock_unix_s)
    first = store.events.range()[1]
    seen: list[int] = []
    begun, enough = threading.Event(), threading.Event()

    def watch() -> None:
        with Client(endpoint, "lab", "cell-1") as client:
            for message in client.watch("**", until=enough.is_set):
                begun.set()
                if message.key == "event":
                    seen.append(message.document["seq"])
                    if len(seen) == 4:
                        enough.set()

    watcher = threading.Thread(target=watch)
    watcher.start()
    assert begun.wait(10.0)
    raise_alert(daemon, arm.clock_unix_s, joint=1)
    daemon.__exit__(None, None, None)
    for joint in (2, 4):  # as after a crash between commit and publication
        store.events.revise(daemon.state.health.as_document(), [{"kind": "raised", **_document(daemon, joint)}], arm.clock_unix_s)
    with Daemon(daemon.state.configuration, store, now=arm.now, play=arm.play) as later:
        enough.wait(3.0)
        raise_alert(later, arm.clock_unix_s, joint=5)
        enough.wait(20.0)
        enough.set()
        watcher.join()
    assert seen == [first + 1, first + 2, first + 3, first + 4]


def test_live_torque_has_the_measured_and_the_predicted_torque(cell):
    """Rows of a replay as a listener gets them: the residual is measured minus predicted, with the right standard deviation.

    Of a normal residual 90 % lie within 1.64 standard deviations. Each joint has at least 75 %, because the residual is not white.
    """
    daemon, _, arm, endpoint = cell
    robot, recording = daemon.state.configuration.robot_description, arm.recording
    moving = [n for n in range(100, recording.samples, 20) if min(abs(recording.qd[n])) > 0.05]
    documents = []
    with Client(endpoint, "lab", "cell-1") as client:
        for n in moving:
            daemon.live.sample(recording.q[n], recording.qd[n], recording.target_qdd[n], recording.current[n], recording.temperature_c[n])
            documents.append(as_json(daemon.bus.last_values()["torque/live"]))
        assert client.get("torque/live")[0].document == documents[-1]
    measured, predicted, residual, std = (
        np.array([row[f"{name}_nm"] for row in documents]) for name in ("measured", "predicted", "residual", "std")
    )
    assert len(documents) > 20
    assert measured == pytest.approx(recording.current[moving] * robot.drive_gain_nm_per_a)
    assert residual == pytest.approx(measured - predicted)
    within = (np.abs(residual) < 1.64 * std).mean(axis=0)
    assert np.all(within >= 0.75), within
    assert np.all(std < 0.25 * np.abs(measured).max(axis=0)), "a deviation that says nothing"


class Heard:
    """The rows of an arm at rest at the rate that was requested from the controller."""

    def __init__(self, rate_hz: float, state) -> None:
        self.reachable, self.problem = True, None
        self._period_s, self._state, self._next = 1.0 / rate_hz, state, time.monotonic()

    def wait(self, timeout_s):
        time.sleep(max(0.0, min(self._next - time.monotonic(), timeout_s)))
        return True

    def poll(self):
        rows = []
        while self._next <= time.monotonic():
            rows.append(self._state)
            self._next += self._period_s
        return rows

    def latest(self):
        return self._state


def test_live_torque_comes_at_the_configured_rate(cell, monkeypatch):
    """For any rate of the controller: some two seconds, with a tolerance of one sample and of a quarter for a busy machine."""
    daemon, store, arm, _ = cell
    row, configuration = arm.recording, daemon.state.configuration
    names = ("q", "qd", "target_qdd", "current", "temperature_c")
    state = SimpleNamespace(robot_mode=7, **{name: getattr(row, name)[0] for name in names})
    problems = Problems(time.time)
    maintenance = Housekeeping(store, lambda: configuration.store, problems, time.time)
    scheduler = Scheduler(daemon.monitor, store, problems, daemon.state.requests)
    workers = Workers(
        scheduler=scheduler,
        housekeeping=maintenance,
        document=MonitorDocument(store, problems, time.time),
        reloader=Reloader(daemon.monitor, scheduler),
        problems=problems,
        heartbeats=Heartbeats(),
    )
    for rate_hz, asked_hz in ((10.0, 10.0), (2.0, 10.0), (0.4, 1.0)):
        daemon.state.configuration = replace(configuration, bus=replace(configuration.bus, live_rate_hz=rate_hz))
        samples: list[TorqueLive] = []

        def said(each: Document, *, samples: list[TorqueLive] = samples, done: object = None) -> None:
            if isinstance(each, TorqueLive):
                samples.append(each)

        monkeypatch.setattr(daemon.publisher, "say", said)
        daemon.state.stopping.clear()
        threading.Timer(2.0, daemon.state.stopping.set).start()
        began = time.monotonic()
        MainLoop(daemon, Heard(asked_hz, state), workers, threading.Event()).run()
        lasted_s = time.monotonic() - began  # longer than the timer's where the machine has other work
        assert abs(len(samples) - lasted_s * rate_hz) <= 0.25 * lasted_s * rate_hz + 1.0, (rate_hz, lasted_s)


def test_after_a_reload_info_has_the_digest_of_the_settings_in_force(cell):
    """A change of any setting changes the digest as soon as the setting is in force, without a restart."""
    daemon, _, _, endpoint = cell
    with Client(endpoint, "lab", "cell-1") as client:
        before = client.info().configuration_digest
        assert before == digest(daemon.state.configuration)
        daemon.monitor.reconfigure(replace(daemon.state.configuration, schedule=ScheduleSettings(cron="0 4 * * *")))
        daemon.publisher.health()
        assert client.info().configuration_digest == digest(daemon.state.configuration) != before


def test_a_wildcard_anywhere_in_the_key_never_acts(cell):
    """Neither from a plain session, nor above the robot's prefix, nor with a valid payload."""
    daemon, store, arm, endpoint = cell
    raise_alert(daemon, arm.clock_unix_s)
    before = store.events.range()
    keys = ("joint-monitor/**", "**", "joint-monitor/v1/*/*/cmd/ack", "joint-monitor/v1/lab/*/cmd/replay", f"{PREFIX}/cmd/re$*")
    with zenoh.open(session_config(mode="client", connect=(endpoint,))) as session:
        for key in keys:
            for payload in ({"joint": 3, "condition": "wear_rising", "by": "explorer"}, {"by": "explorer"}, None):
                replies = list(session.get(key, payload=None if payload is None else json.dumps(payload), timeout=5.0))
                assert all(reply.ok and "/cmd/" not in str(reply.ok.key_expr) for reply in replies)
    assert store.events.range() == before
    assert not daemon.state.requests.take_request()


def test_a_watcher_of_event_alone_gets_transitions_and_nothing_else(cell):
    """The answer to a question about the log is no transition."""
    daemon, _, arm, endpoint = cell
    raise_alert(daemon, arm.clock_unix_s)
    with Client(endpoint, "lab", "cell-1") as client:
        watch = client.watch("event")
        later = threading.Timer(0.5, raise_alert, (daemon, arm.clock_unix_s, 5))
        later.start()
        message = next(watch)
        watch.close()
        later.join()
    assert (message.document["joint"], message.document["kind"]) == (5, "raised")


def _document(daemon: Daemon, joint: int) -> dict:
    from monitor.judge.alerts.health import alert_document

    return {**alert_document(daemon.state.health.alerts[0]), "joint": joint}


def test_a_week_without_replays_makes_the_state_stale_until_the_next_one(cell):
    """Arm and joints are stale on the bus, in the lines of `watch` and of systemd, and in metrics. The state itself stays."""
    from monitor.publish.metrics import families
    from monitor.views.terminal.watch import line

    daemon, _, arm, endpoint = cell

    def published_health(client):
        daemon.publisher.health()
        health = client.health()
        assert {joint.stale for joint in health.joints} == {health.stale}
        (gauge,) = (family for family in families(daemon.bus.last_values()) if family.name == "joint_monitor_stale")
        assert {sample.value for sample in gauge.samples} == {float(health.stale)}
        assert {sample.labels["joint"] for sample in gauge.samples} == {"arm", *"123456"}
        assert ("STALE" in daemon.monitor.health_state) is health.stale
        assert ("STALE" in line("health", health.model_dump(mode="json")).plain) is health.stale
        return health

    with Client(endpoint, "lab", "cell-1") as client:
        fresh = published_health(client)
        assert (fresh.stale, fresh.stale_why) == (False, None)
        arm.clock_unix_s += 5.9 * DAY_S  # the last replay was a day before the clock
        assert published_health(client).stale is False
        arm.clock_unix_s += 0.2 * DAY_S
        old = published_health(client)
        assert old.stale is True
        assert old.state == fresh.state
        assert old.stale_why.startswith("STALE: all joints: nothing was learnt for 7 days")
        assert old.joints[0].learnt_at.timestamp() == pytest.approx(START_UNIX_S + 2 * DAY_S, abs=1.0)
        assert daemon.monitor.perform(arm.clock_unix_s).state == "assessed"
        assert published_health(client).stale is False


def test_the_production_residual_is_published_with_health(cell, monkeypatch: pytest.MonkeyPatch):
    """Health has the change, its standard deviation, the number of samples and the probability of that joint, by the schema."""
    from monitor.judge.torque.production_residual import initial, production_evidence

    daemon, _, _, endpoint = cell
    one = np.array([1.0, 0, 0, 0, 0, 0])
    residuals = initial(6, 1)._replace(later_observations=4.0 * one, change=np.where(one > 0, 0.12, np.nan))
    settings = daemon.state.configuration.assess.residual
    monkeypatch.setattr(daemon.state.production_motion, "evidence", lambda: production_evidence(residuals, settings))
    daemon.publisher.health()
    with Client(endpoint, "lab", "cell-1") as client:
        (each,) = client.health().production
    assert (each.joint, each.change, each.observations) == (1, 0.12, 4)
    assert each.std > 0
    assert 0.5 < each.probability < 1.0
