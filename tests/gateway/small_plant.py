"""A plant's database as the gateway finds it, filled by the plant's own functions."""

from datetime import UTC, datetime

from empty_plant import empty_plant
from heard_documents import whole

from monitor.gateway.run import Gateway
from monitor.gateway.settings import load_gateway
from monitor.plant.cursor import Cursor, Entry
from monitor.plant.database import Database
from monitor.plant.ingest import add_transitions, enter, keep_last_values, known
from monitor.publish.documents import Event
from monitor.publish.timestamps import rfc3339

DAY_S = 86_400.0
NOW_UNIX_S = 1_780_300_800.0  # 2026-06-01T08:00:00Z, a Monday


def alert(joint=3, condition="wear_rising", tier="wear", *, raised_unix_s=NOW_UNIX_S, active=True, change=0.091, **more):
    """An alert as an arm says it."""
    return {
        **{"joint": joint, "condition": condition, "tier": tier, "active": active, "raised_at": rfc3339(raised_unix_s)},
        **{"updated_at": rfc3339(raised_unix_s), "change": change, "probability": 0.99, "action": "Plan an inspection of this joint."},
        **{"text": f"Joint {joint} turns heavier.", "severity": "medium", **more},
    }


class SmallPlant:
    """A database with arms, and a clock that a test sets."""

    def __init__(self, path):
        self.path = path
        self.address = f"sqlite:///{path}"
        path.write_bytes(empty_plant())
        self.database = Database(self.address)
        self.now = NOW_UNIX_S
        self.seq = {}

    def close(self):
        self.database.close()

    def clock(self):
        return self.now

    def arm(self, name, **documents):
        """An arm, and what it says."""
        site, _, robot = name.partition("/")
        number = enter(self.database, [(site, robot)], self.now)[site, robot]
        values = {(number, key): (self.now, whole(key, **document)) for key, document in documents.items()}
        keep_last_values(self.database, values)
        return number

    def happens(
        self, name, kind="raised", joint=3, condition="wear_rising", tier="wear", *, raised_unix_s=None, at_unix_s=None, by=None, **more
    ):
        """A transition of an alert, copied by the plant; health follows."""
        site, _, robot = name.partition("/")
        at = self.now if at_unix_s is None else at_unix_s
        raised = at if raised_unix_s is None else raised_unix_s
        where = known(self.database, site, robot, self.now)
        seq = where.event.seq + 1
        said = alert(joint, condition, tier, raised_unix_s=raised, active=kind != "cleared", **more)
        event = Event.model_validate({**said, "seq": seq, "at": datetime.fromtimestamp(at, UTC), "kind": kind, "by": by})
        add_transitions(self.database, where, [Entry(seq, "", event)], Cursor(seq, f"m{seq}"), "h1")
        return said

    def gateway(self, text, credentials=None):
        """A gateway with this configuration, whose threads are not started: `lives` lets it act."""
        file = self.path.parent / "plant.toml"
        file.write_text(f'[plant]\ndatabase = "{self.address}"\n{text}')
        folder = self.path.parent / "credentials"
        folder.mkdir(exist_ok=True)
        for name, secret in (credentials or {}).items():
            (folder / name).write_text(secret)
        return Gateway(load_gateway(file, {"CREDENTIALS_DIRECTORY": str(folder)}), now=self.clock)

    def lives(self, running, seconds=0.0, step_s=60.0):
        """Let the gateway and its channels act for so long by the plant's clock, without their threads."""
        end = self.now + seconds
        while True:
            running.step()
            for worker in running.workers:
                worker.once()
            if self.now >= end:
                return
            self.now = min(self.now + step_s, end)
