"""Everything between an arm's alert and a person, in processes that are killed: a process that has imported all of it forks one a line.

python killed_world.py FOLDER: a line `ROLE` begins one of its kind, whose number is the answer. What a real one keeps over its death is
in files of the folder: the arms' transitions, the mails that were taken, the tickets that are open. The clock is a file, too.
"""

import asyncio
import ctypes
import json
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import httpx  # noqa: F401 - imported here once, and not in each process
import paho.mqtt.client  # noqa: F401
import zenoh
from mail_server import MailServer
from test_tickets import Maintenance

from monitor.errors import BusError
from monitor.gateway import run as gateway_run
from monitor.gateway.mqtt import channel as mqtt
from monitor.gateway.notify import messages, people
from monitor.gateway.settings import load_gateway
from monitor.gateway.tickets import channel as tickets
from monitor.plant import arm as plant_arms
from monitor.plant import links
from monitor.plant import run as plant_run
from monitor.plant.settings import load_plant
from monitor.publish.session import session_config
from monitor.publish.timestamps import rfc3339
from monitor.studies.plant import PlantOnBus, SimulatedPlant

ADDRESS = "127.28.7.1"  # nobody else's: while a server is away no other program gets its port
ROUTER, MAIL, ORDERS = 7447, 2525, 8080
ARMS = 8
PR_SET_PDEATHSIG = 1  # linux/prctl.h


def clock(folder):
    """Of this small world: seconds since 1970."""

    def now():
        while not (text := (folder / "clock").read_text()):
            time.sleep(0.001)
        return float(text)

    return now


def lines(path):
    """The whole lines of a file: whoever wrote the last one may have been killed."""
    with suppress(FileNotFoundError):
        return [json.loads(line) for line in path.read_bytes().split(b"\n")[:-1]]
    return []


def append(path, document):
    """One line, at once: it is there when this returns, and stays when this process is killed."""
    with path.open("ab", buffering=0) as file:
        file.write(json.dumps(document).encode() + b"\n")


class Histories:
    """What arms hold on their disks: transitions, and the alerts that follow from them."""

    def __init__(self, path):
        self._path, self._read = path, 0
        self.arms, self.joints, self.begin_unix_s = ARMS, 6, 0.0
        self.fleet = SimpleNamespace(settings=SimpleNamespace(robot="ur5e"))
        self.transitions, self.replays = [[] for _ in range(ARMS)], [[] for _ in range(ARMS)]
        self._active = [{} for _ in range(ARMS)]

    def read(self):
        """The transitions that are new, as (arm, seq)."""
        found, new = lines(self._path), []
        for said in found[self._read :]:
            k, event = said["arm"], said["event"]
            self.transitions[k].append(event)
            self._active[k].pop((event["joint"], event["condition"]), None)
            if event["active"]:
                self._active[k][event["joint"], event["condition"]] = event
            new.append((k, len(self.transitions[k])))
        self._read = len(found)
        return new

    def event(self, k, seq):
        return {"seq": seq, **self.transitions[k][seq - 1]}

    def health(self, k):
        alerts = [{name: event[name] for name in event if name not in ("kind", "at", "by")} for event in self._active[k].values()]
        return {
            **{"state": "MAINTENANCE_REQUIRED" if alerts else "NORMAL", "why": "as it is", "since": rfc3339(1.0), "joints": []},
            **{"alerts": alerts, "next_replay_due": None, "stale": False},
        }


def live_arms(folder):
    """The monitors of all arms, until they are killed."""
    histories = Histories(folder / "transitions")
    histories.read()
    settings = SimulatedPlant(arms=ARMS, sites=1, connect=(f"tcp/{ADDRESS}:{ROUTER}",))
    while True:
        try:
            arms = PlantOnBus(settings, histories, clock(folder))
            break
        except BusError:  # no router yet
            time.sleep(0.02)
    told_at = 0.0
    while True:
        for k, seq in histories.read():
            arms.say(k, "event", histories.event(k, seq))
            arms.say(k, "health", arms.health(k))
        if time.monotonic() - told_at > 0.5:
            told_at = time.monotonic()
            for k in range(ARMS):
                arms.say(k, "monitor", arms.monitor(k))
        time.sleep(0.02)


def live_router(_folder):
    while True:
        try:
            session = zenoh.open(session_config(mode="router", listen=(f"tcp/{ADDRESS}:{ROUTER}",)))
            break
        except zenoh.ZError:  # the one before is not gone yet
            time.sleep(0.02)
    while session is not None:
        time.sleep(60.0)


def live_plant(folder):
    plant_run.time = SimpleNamespace(time=clock(folder), monotonic=time.monotonic)
    plant_run.HEARTBEAT_S, plant_run.LONGEST_PAUSE_S = 1.0, 0.2
    plant_arms.AGAIN_S, plant_arms.SELDOM_S = 0.2, 1.0
    links.TIMEOUT_S, links.REFUSED_S = 1.0, (0.05, 0.2)
    with plant_run.Plant(load_plant(folder / "plant.toml", {})) as plant:
        while True:
            plant.step()
            time.sleep(0.02)


def live_gateway(folder):
    """Pauses between steps are short: only they are in real time."""
    people.STEP_S = tickets.STEP_S = gateway_run.WAIT_S = 0.02
    gateway_run.TROUBLE_PAUSE_S, gateway_run.LONGEST_PAUSE_S, mqtt.PAUSE_S = (0.02, 0.1), 0.2, 0.05
    messages.LISTED = 10_000  # every event is told in full, so that the test finds it
    configuration = load_gateway(folder / "plant.toml", {"CREDENTIALS_DIRECTORY": str(folder)})
    with gateway_run.Gateway(configuration, now=clock(folder)) as gateway:
        while True:
            gateway.step()
            if gateway.trouble is None:
                gateway.start()
            time.sleep(0.02)


class KeptMail(MailServer):
    """What it has taken is on its disk before it says so."""

    folder: Path

    async def handle_DATA(self, server, session, envelope):
        append(self.folder / "mails", {"to": envelope.rcpt_tos, "content": envelope.content.decode()})
        await asyncio.sleep(0.01)  # here it may be killed: it has the mail, and its client does not know
        return "250 taken"


def live_mail(folder):
    server = KeptMail(folder, address=ADDRESS)
    server.folder, server.port = folder, MAIL
    while True:
        try:
            server.start()
            break
        except OSError:
            time.sleep(0.02)
    threading.Event().wait()


class KeptOrders(Maintenance):
    """Tickets on a disk; it keeps no idempotency keys, so it must be asked before a request is repeated."""

    def __init__(self, folder):
        super().__init__(keeps_keys=False)
        self._folder = folder
        for line in lines(folder / "tickets"):
            self.tickets.setdefault(line["number"], {}).update(line["fields"])

    def _answer_to(self, method, path, headers, body):
        before = {number: dict(ticket) for number, ticket in self.tickets.items()}
        answer = super()._answer_to(method, path, headers, body)
        for number, ticket in self.tickets.items():
            if before.get(number) != ticket:
                append(self._folder / "tickets", {"number": number, "new": number not in before, "fields": ticket})
                time.sleep(0.01)  # here it may be killed
        return answer


def live_orders(folder):
    while True:
        try:
            with KeptOrders(folder).at(ADDRESS, ORDERS):
                threading.Event().wait()
        except OSError:
            time.sleep(0.02)


ROLES = {
    **{"router": live_router, "arms": live_arms, "plant": live_plant, "gateway": live_gateway},
    **{"mail": live_mail, "orders": live_orders},
}


def main(folder):
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # whoever is killed leaves nothing behind
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # nothing outlives a test that is ended
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            sys.stdin.close()
            ROLES[line.strip()](folder)
        sys.stdout.write(f"{child}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
