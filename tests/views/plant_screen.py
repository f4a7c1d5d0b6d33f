"""A plant's screen over a database that a test fills, with arms that answer without a bus."""

import http.client
import json
import time
from unittest.mock import patch
from urllib.parse import urlsplit

import orjson
from heard_documents import whole

from monitor import __version__
from monitor.errors import BusError
from monitor.plant.database import Database
from monitor.plant.ingest import RUNNING, enter, keep_last_values, set_note
from monitor.plant.screen.app import ScreenServer
from monitor.plant.screen.people import line_of, new_user, role_named
from monitor.plant.screen.settings import ScreenSettings

NOW = 1_767_571_200.0  # 2026-01-05
ALERT = {
    "joint": 3,
    "condition": "wear_rising",
    "tier": "wear",
    "text": "friction of joint 3 is +9 % against its beginning",
    "active": True,
    "raised_at": "2026-01-02T05:00:00Z",
    "updated_at": "2026-01-04T05:00:00Z",
    "change": 0.09,
    "probability": 0.999,
    "action": "plan an inspection of this joint",
}


class Subscriber:
    def undeclare(self):
        pass


class ArmsOfATest:
    """Instead of the sessions: what was asked, and the answers of arms that are up."""

    up = True

    def __init__(self):
        self.asked = []
        self.down = set()

    def ask(self, key, payload=None):
        self.asked.append((key, None if payload is None else orjson.loads(payload)))
        if any(f"/{name}/" in key for name in self.down):
            raise BusError("no answer within 10 s")
        return orjson.dumps({"done": "done"})

    def watch(self, arm, heard):
        heard("alert/j3/wear_rising", orjson.dumps(ALERT))
        return Subscriber()


def joints(state="NORMAL"):
    return [
        {"joint": k + 1, "state": state if k == 2 else "NORMAL", "why": "friction of joint 3 rises", "since": "2026-01-01T00:00:00Z"}
        for k in range(6)
    ]


def filled(database, arms):
    """arms : by (site, robot), the documents of the arm."""
    numbers = enter(database, list(arms), NOW)
    rows = {(numbers[name], key): (NOW, whole(key, **document)) for name, documents in arms.items() for key, document in documents.items()}
    keep_last_values(database, rows)
    set_note(database, RUNNING, time.time(), {"ways": {"tcp/127.0.0.1:7447": True}, "copying": 0})


def documents(state="NORMAL", model="ur5e", alerts=()):
    return {
        "health": {"state": state, "why": "friction of joint 3 rises", "joints": joints(state), "alerts": list(alerts)},
        "info": {"robot": {"model": model, "mounting": "ground", "payload_kg": 1.0, "tool": "gripper"}, "version": __version__},
    }


ARMS = {
    ("hall-1", "cell-1"): documents(),
    ("hall-1", "cell-2"): documents("MAINTENANCE_REQUIRED", alerts=[ALERT]),
    ("hall-2", "cell-1"): documents(model="ur10e"),
}


class PlantOfATest:
    """A database, arms and a screen. A context manager."""

    def __init__(self, folder, settings=None, arms=ARMS, roles=()):
        """roles : of users who are made, each named as his role; move@hall-1: at this site alone."""
        self.tokens = {}
        lines = []
        for role in roles:
            name, _, site = role.partition("@")
            user, self.tokens[role] = new_user(f"{name}er{site}", role_named(name), [site] if site else [])
            lines.append(line_of(user))
        if roles:
            (folder / "users").write_text("\n".join(lines) + "\n")
        self.database = Database(f"sqlite:///{folder / 'plant.sqlite'}")
        self.database.migrate()
        filled(self.database, arms)
        self.link = ArmsOfATest()
        settings = settings or ScreenSettings(listen="127.0.0.1:0", users_file="users" if roles else "")
        self._running = patch("monitor.plant.status.SILENT_S", 1e9)  # nobody says again that this plant runs
        self._running.start()
        self.server = ScreenServer(settings, folder, self.database, lambda _: [self.link])
        self.url = self.server.url

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._running.stop()
        self.server.__exit__()
        self.database.close()

    def audit(self):
        import sqlalchemy as sa

        from monitor.plant.tables import audit

        with self.database.read() as connection:
            return [tuple(row)[2:] for row in connection.execute(sa.select(audit).order_by(audit.c.id))]


class Browser:
    """Requests of one person, with the cookie and the page's token as a browser keeps them."""

    def __init__(self, url, **headers):
        self.at = urlsplit(url).netloc
        self.headers = {"Host": self.at, **{name.replace("_", "-"): value for name, value in headers.items()}}

    def ask(self, method, path, body=None, **headers):
        connection = http.client.HTTPConnection(self.at, timeout=20)
        try:
            connection.request(method, path, body=body, headers={**self.headers, **headers})
            answer = connection.getresponse()
            return answer.status, answer.read().decode(), answer
        finally:
            connection.close()

    def sign_in(self, token):
        origin = {"Origin": f"http://{self.at}", "Content-Type": "application/x-www-form-urlencoded"}
        status, _, answer = self.ask("POST", "/login", f"token={token}", **origin)
        if status == 303:
            self.headers["Cookie"] = answer.getheader("Set-Cookie").partition(";")[0]
        return status

    def command(self, arm, command, document, *, page_token=None):
        if page_token is None:
            _, page, _ = self.ask("GET", "/")
            page_token = page.partition('name="page-token" content="')[2].partition('"')[0]
        headers = {"Origin": f"http://{self.at}", "Content-Type": "application/json", "X-Page-Token": page_token}
        status, text, _ = self.ask("POST", f"/arms/{arm}/api/cmd/{command}", json.dumps(document), **headers)
        return status, text
