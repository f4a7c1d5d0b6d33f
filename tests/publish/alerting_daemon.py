"""A daemon with a steady stream of alerts, for the tests of restarts: `python alerting_daemon.py DIRECTORY ENDPOINT [quiet]`.

Ten times a second it makes at most one transition: first stored, then published. So a kill in between loses nothing.
"""

import sys
import threading
from dataclasses import replace
from pathlib import Path

from monitor.config.load import from_document
from monitor.judge.alerts.health import Alert
from monitor.reason import reason_of
from monitor.service.daemon import Daemon
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.store import Store

PERIOD_S = 0.1


def play(excitation, context, should_stop, window):
    recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), replace(excitation, repetitions=1))
    return replace(recording, context=replace(context, firmware=recording.context.firmware))


def main() -> None:
    directory, endpoint = Path(sys.argv[1]), sys.argv[2]
    document = {
        "robot": {"model": "ur5", "site": "lab", "id": "cell-1"},
        "store": {"directory": str(directory)},
        "bus": {"connect": [endpoint], "listen": []},
    }
    configuration = from_document(document, directory / "cell.toml")
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), stop.set()), daemon=True).start()
    with Store.open(directory) as store:
        seen = store.events.range()
        number = seen[1] if seen else 0
        with Daemon(configuration, store, now=lambda: 1.0e9 + number, play=play) as daemon:
            if store.assessments.state() is None:
                daemon.monitor.perform(1.0e9)
            print("up", flush=True)
            while not stop.wait(None if sys.argv[3:] == ["quiet"] else PERIOD_S):
                number += 1
                joint = number % 6 + 1
                alert = Alert(
                    joint=joint, condition="wear_rising", tier="wear", raised_at_unix_s=1.0e9, updated_at_unix_s=1.0e9 + number,
                    change=number / 1e6, probability=0.99, text=reason_of(f"transition {number}"), action=reason_of("inspect"),
                )  # fmt: skip
                others = tuple(other for other in daemon.state.health.alerts if other.joint != joint)
                with daemon.state.revising:
                    health = replace(daemon.state.health, alerts=(*others, alert))
                    daemon.alerts.keep(health, "updated", alert, 1.0e9 + number)
    print(f"down {number}", flush=True)


main()
