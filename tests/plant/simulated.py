"""Small simulated plants, and what a copy of them must hold."""

from types import SimpleNamespace

import orjson
import sqlalchemy as sa

from monitor.errors import BadInput, BusError
from monitor.plant.database import Database
from monitor.plant.pull import pull
from monitor.plant.tables import arm, friction, history, transition
from monitor.publish.documents import Document, encoded
from monitor.service.handlers import Handlers
from monitor.store.store import Store

BEGIN_UNIX_S = 1_767_571_200.0  # 2026-01-05
ALERT = {
    **{"kind": "raised", "joint": 1, "condition": "wear_rising", "tier": "wear", "active": True, "text": "a\0b", "action": ""},
    **{"raised_at_unix_s": 1.0, "updated_at_unix_s": 1.0, "change": 0.1, "probability": 0.99},
}


class Way:
    """A way to arms without a bus: answers come from functions, as a handler of a daemon gives them."""

    def __init__(self, answers):
        self.answers = answers  # by key below the prefix
        self.asked = []

    def ask(self, key):
        self.asked.append(key)
        selector, _, parameters = key.partition("?")
        name = selector.rsplit("/", 1)[-1]
        if name not in self.answers:
            raise BusError("no answer")
        answer = self.answers[name](dict(part.partition("=")[::2] for part in parameters.split(";")))
        return encoded(answer) if isinstance(answer, Document) else orjson.dumps(answer)


def refusing(text):
    def refuse(_):
        raise BadInput(text)

    return refuse


def copy(database, folder, names):
    """Copy arms' histories by their own handlers."""
    for name in names:
        with Store.open(folder / name) as store:
            handlers = Handlers(SimpleNamespace(robot=SimpleNamespace(joints=6), store=store), None)
            way = Way({"history": handlers.history, "event": handlers.events})
            pull(database, way, f"joint-monitor/v1/{name}", *name.split("/"), lambda: 5.0)


def plant_file(folder, address):
    path = folder / "plant.toml"
    path.write_text(f'[plant]\ndatabase = "{address}"\n')
    return path


def copied(database: Database) -> dict[str, tuple[list[int], list[tuple[int, int]]]]:
    """By arm: the numbers of its present history's transitions in the order of their times, and (replay, joint) likewise."""
    found = {}
    with database.read() as connection:
        for number, site, robot, at in connection.execute(sa.select(arm.c.id, arm.c.site, arm.c.robot, arm.c.history)).all():
            of = (transition.c.arm == number) & (transition.c.history == at)
            events = connection.execute(sa.select(transition.c.seq).where(of).order_by(transition.c.at, transition.c.seq)).scalars().all()
            of = (friction.c.arm == number) & (friction.c.history == at)
            rows = connection.execute(
                sa.select(friction.c.replay, friction.c.joint).where(of).order_by(friction.c.recorded_at, friction.c.joint)
            )
            found[f"{site}/{robot}"] = (list(events), [tuple(row) for row in rows])
    return found


def cursors(database: Database) -> list[tuple]:
    with database.read() as connection:
        columns = (history.c.arm, history.c.number, history.c.event_cursor, history.c.change_cursor, history.c.why)
        return [tuple(row) for row in connection.execute(sa.select(*columns).order_by(history.c.arm, history.c.number))]
