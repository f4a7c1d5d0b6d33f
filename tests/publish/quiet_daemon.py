"""A daemon with one replay in its history that waits for queries: `python quiet_daemon.py DIRECTORY ENDPOINT`.

A line on standard input ends it. It then prints how many transitions its history has, and how often a replay was requested.
"""

import sys
from dataclasses import replace
from pathlib import Path

from monitor.config.load import from_document
from monitor.service.daemon import Daemon
from monitor.service.shared_state import ReplayRequests
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.store import Store


def play(excitation, context, should_stop, window):
    recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), replace(excitation, repetitions=1))
    return replace(recording, context=replace(context, firmware=recording.context.firmware))


def main() -> None:
    directory, endpoint = Path(sys.argv[1]), sys.argv[2]
    document = {
        "robot": {"model": "ur5", "site": "lab", "id": "cell-1"},
        "replay": {"allow_motion": True},
        "store": {"directory": str(directory)},
        "bus": {"listen": [endpoint]},
    }
    requests = ReplayRequests()
    with (
        Store.open(directory) as store,
        Daemon(from_document(document, directory / "cell.toml"), store, now=lambda: 1.0e9, play=play, requests=requests) as daemon,
    ):
        daemon.monitor.perform(1.0e9)
        print("up", flush=True)
        sys.stdin.readline()
        seen = store.events.range()
    print(f"down {seen[1] if seen else 0} {int(requests.take_request())}", flush=True)


main()
