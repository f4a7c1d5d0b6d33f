"""Record one document of every kind from today's daemon: `python tests/publish/record_v1.py NAME` fills recorded_v1/NAME/.

The recorded documents are kept, because readers of v1 must be able to read them. The arm is simulated, and the host's name replaced.
"""

import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import zenoh

from monitor.config.load import from_document
from monitor.judge.alerts.health import Alert
from monitor.publish.documents import FromProduction, JointFromProduction, NextReplay
from monitor.publish.registry import KINDS, schema
from monitor.publish.session import session_config
from monitor.publish.timestamps import utc
from monitor.reason import reason_of
from monitor.service.daemon import Daemon
from monitor.service.housekeeping import Housekeeping
from monitor.service.main_loop import Reloader, Workers, monitor_document
from monitor.service.monitor_document import MonitorDocument
from monitor.service.problems import Problems
from monitor.service.scheduler import Scheduler
from monitor.service.shared_state import ReplayRequests
from monitor.service.systemd import Heartbeats
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.store import Store

ENDPOINT = "tcp/127.0.88.4:7452"
PREFIX = "joint-monitor/v1/lab/cell-1"
START_UNIX_S = 1_767_582_000.0
ASKED = {
    "torque": {"q": [0.1] * 6, "qd": [0.5] * 6},
    "cmd/ack": {"joint": 3, "condition": "wear_rising", "by": "ada", "why": "grease is ordered"},
    "cmd/shelve": {"joint": 3, "condition": "wear_rising", "by": "ada", "hours": 2.0},
    "cmd/unshelve": {"joint": 3, "condition": "wear_rising", "by": "ada"},
    "cmd/unack": {"joint": 3, "condition": "wear_rising", "by": "ada"},
    "cmd/unserviced": {"joint": 2, "by": "ada"},
    "cmd/serviced": {"joint": 2, "kind": "greased", "by": "ada", "why": "200 h"},
    "cmd/uninspected": {"item": "gripper", "by": "ada"},
    "cmd/inspected": {"item": "gripper", "by": "ada", "why": "no play"},
    "cmd/replay": {"by": "ada"},
    "history?limit=2": None,
    "event": None,
}


def play(excitation, context, should_stop, window):
    recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), replace(excitation, repetitions=1))
    return replace(recording, context=replace(context, firmware=recording.context.firmware))


def spoken(folder: Path) -> list[tuple[str, zenoh.Sample | zenoh.ReplyError]]:
    """Keys with the samples and answers of a daemon with one replay and one alert."""
    document = {
        "robot": {"model": "ur5", "site": "lab", "id": "cell-1"},
        "store": {"directory": str(folder / "history")},
        "bus": {"listen": [ENDPOINT]},
        "inspection": {"plan": "universal-robots"},
    }
    messages = []
    with (
        Store.open(folder / "history") as store,
        Daemon(from_document(document, folder / "cell.toml"), store, now=lambda: START_UNIX_S, play=play) as daemon,
        zenoh.open(session_config(mode="client", connect=(ENDPOINT,))) as session,
    ):
        events = session.declare_subscriber(f"{PREFIX}/event", zenoh.handlers.FifoChannel(16))
        daemon.monitor.perform(START_UNIX_S)
        alert = Alert(
            joint=3, condition="wear_rising", tier="wear", raised_at_unix_s=START_UNIX_S, updated_at_unix_s=START_UNIX_S,
            change=0.06, probability=0.99, text=reason_of("Joint 3: friction rose"), action=reason_of("inspect"),
        )  # fmt: skip
        daemon.alerts.keep(replace(daemon.state.health, alerts=(alert,)), "raised", alert, START_UNIX_S)
        daemon.live.sample(*(np.full(6, x) for x in (0.1, 0.2, 0.3, 1.0, 30.0)))
        daemon.bus.ask("cmd/serviced", ASKED["cmd/serviced"])
        joint = JointFromProduction(joint=3, known=True, share=1.2, learnt_from_replays=1, learnt_from_production=1)
        period = {"period_began_at": utc(START_UNIX_S - 86_400.0), "period_ended_at": utc(START_UNIX_S), "seen_s": 3600.0}
        said = {"observations": 1, "left_out_s": {"standing": 60.0}, "asks": [], "joints": [joint]}
        daemon.publisher.say(FromProduction(**period, **said, next_replay=NextReplay(replay="when_needed", why="every window")))
        daemon.publisher.health()
        problems = Problems(lambda: START_UNIX_S)
        maintenance = Housekeeping(store, lambda: daemon.state.configuration.store, problems, lambda: START_UNIX_S)
        link = SimpleNamespace(reachable=True, problem=None)
        scheduler = Scheduler(daemon.monitor, store, problems, ReplayRequests())
        workers = Workers(
            scheduler=scheduler,
            housekeeping=maintenance,
            document=MonitorDocument(store, problems, lambda: START_UNIX_S),
            reloader=Reloader(daemon.monitor, scheduler),
            problems=problems,
            heartbeats=Heartbeats(),
        )
        daemon.publisher.say(monitor_document(daemon, link, workers))
        messages.append(("event", events.recv()))
        messages += [(str(reply.ok.key_expr).removeprefix(f"{PREFIX}/"), reply.ok) for reply in session.get(f"{PREFIX}/**", timeout=5.0)]
        for key, payload in ASKED.items():
            (reply,) = session.get(f"{PREFIX}/{key}", payload=None if payload is None else json.dumps(payload), timeout=5.0)
            messages.append((key, reply.ok or reply.err))
    return messages


def main() -> None:
    """Write one file for each document, and today's schemas."""
    into = Path(__file__).parent / "recorded_v1" / sys.argv[1]
    into.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as folder:
        for key, sample in spoken(Path(folder)):
            kind = str(sample.encoding).removeprefix("application/json;joint-monitor.").removesuffix(".v1")
            if kind == "friction" and not key.startswith("joint/1/"):
                continue
            document = json.loads(sample.payload.to_bytes())
            if kind == "info":
                document |= {"host": "monitor-1"} | ({"boot_id": "0" * 32} if "boot_id" in document else {})
            path = into / f"{kind}{key.replace('/', '-').split('?')[0].join(('.', ''))}.json"
            path.write_text(json.dumps({"key": key, "kind": kind, "document": document}, ensure_ascii=False) + "\n", "utf-8")
    for key, payload in ASKED.items():
        if payload is not None:
            kind = {"torque": "torque"}.get(key, key.removeprefix("cmd/")) + "-request"
            (into / f"{kind}.json").write_text(json.dumps({"key": key, "kind": kind, "document": payload}) + "\n", "utf-8")
    (into / "schemas.json").write_text(json.dumps({kind: schema(kind) for kind in KINDS}, sort_keys=True) + "\n", "utf-8")


main()
