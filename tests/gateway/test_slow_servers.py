"""Servers that answer a letter at a time, without an end: each keeps its own messages waiting, and its channel goes on."""

import asyncio
import re
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from http_server import HttpServer
from mail_server import MailServer
from test_notify_mail import notify, to
from test_notify_webhook import hook
from test_tickets import CREDENTIALS, tickets

from monitor.gateway import connection
from monitor.gateway.notify import mail, services
from monitor.gateway.outbox import Outbox
from monitor.gateway.settings import check_all, load_gateway
from monitor.gateway.status import as_lines, gateway_status
from monitor.gateway.tickets import channel


class Dripping:
    """A server whose answer to whoever connects never ends, a letter now and then. `begins` comes at once."""

    def __init__(self, begins=b"", letter=b"2"):
        self._begins, self._letter, self._closing = begins, letter, threading.Event()

    def __enter__(self):
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self._thread = threading.Thread(target=self._accept)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._closing.set()
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join()

    def _accept(self):
        while True:
            try:
                connection = self._socket.accept()[0]
            except OSError:
                return
            threading.Thread(target=self._drip, args=(connection,), daemon=True).start()

    def _drip(self, connection):
        with connection:
            try:
                connection.sendall(self._begins)
                while not self._closing.wait(0.02):
                    connection.sendall(self._letter)
            except OSError:
                return


def a_day_passes(plant, running):
    plant.lives(running)
    plant.now += 60.0
    plant.happens("hall/cell-1")
    plant.lives(running)


@pytest.fixture(autouse=True)
def soon(monkeypatch, plant):
    for module in (mail, connection, services):
        monkeypatch.setattr(module, "WHOLE_S", 1.0)  # enough for what does answer, also on a busy machine
    monkeypatch.setattr(mail, "GOODBYE_S", 0.1)
    plant.arm("hall/cell-1")


def test_a_mail_server_that_never_ends_its_greeting_is_the_channel_s_trouble(plant):
    """Everything waits, and the status says since when, why, and when it is tried again; the check names the step."""
    with Dripping(b"220-") as server, plant.gateway(notify(server, to("ada"))) as running:
        a_day_passes(plant, running)
        assert "does not answer in time" in running.workers[0].trouble
        running._heartbeat_at = -1e9
        running.step()
        line = as_lines(gateway_status(plant.database, plant.now))[0]
        about, _, why = line.partition(": mail server 127.0.0.1:")
        assert about == "mail: TROUBLE since 2026-06-01T08:01:00Z"
        assert why.partition(": ")[2] == "does not answer in time; tried again at 2026-06-01T08:01:05Z"
        found = check_all(load_gateway(plant.path.parent / "plant.toml", {}))
        assert (found[-1].step, found[-1].ok) == ("smtp", False)


def test_a_mail_server_that_never_ends_its_answer_to_one_message_keeps_no_other_person_waiting(plant, tmp_path):
    """That message has an attempt that failed; the next connection carries the other's."""
    with MailServer(tmp_path) as server, plant.gateway(notify(server, to("ada"), to("bob"))) as running:
        server.drips = {"ada@plant.example"}
        a_day_passes(plant, running)
        (owed,) = Outbox(plant.database, plant.clock).owed("mail")
        assert (owed.recipient, owed.attempts) == ("ada@plant.example", 1)
        assert "does not answer in time" in owed.error
        assert "bob@plant.example" in [message["To"] for _, message in server.taken]


def test_a_webhook_that_drips_and_one_whose_answer_has_no_end_fail_and_the_others_get_through(plant, monkeypatch):
    """In the head as in the body; at most a megabyte of it is read."""
    with Dripping(b"HTTP/1.1 200 OK\r\nx: ") as server, plant.gateway(hook(server.url), {"hook": "s3cret-of-the-hook"}) as running:
        a_day_passes(plant, running)
        assert [each.error for each in Outbox(plant.database, plant.clock).owed("webhook")] == ["hook: does not answer in time"]
    monkeypatch.setattr(connection, "WHOLE_S", 30.0)
    client = connection.HttpClient(connection.ssl.create_default_context())
    with Dripping(b"HTTP/1.1 200 OK\r\ncontent-length: 100000000\r\n\r\n" + 2_000_000 * b"x") as server:
        answer = client.request("GET", server.url, {}, None)
        assert (answer.is_success, len(answer.content) < 1_200_000) == (True, True)
        client.close()


def test_a_request_is_made_from_a_thread_whose_own_event_loop_runs(monkeypatch):
    """As in a program that drives a browser, and in a notebook: asyncio refuses a second loop there."""
    monkeypatch.setattr(connection, "WHOLE_S", 30.0)

    async def within():
        client = connection.HttpClient(connection.ssl.create_default_context())
        answer = client.request("GET", server.url, {}, None)
        client.close()
        return answer.status

    with HttpServer() as server, ThreadPoolExecutor(1) as thread:  # another test's browser may have a loop that runs in this one
        assert thread.submit(asyncio.run, within()).result() == 204


def test_a_maintenance_system_that_drips_is_asked_again_and_told_in_the_status(plant):
    """The status says when."""
    with Dripping(b"HTTP/1.1 ") as server, plant.gateway(tickets(server), CREDENTIALS) as running:
        a_day_passes(plant, running)
        (owed,) = Outbox(plant.database, plant.clock).owed("tickets")
        assert (owed.attempts, owed.error) == (1, "the maintenance system: does not answer in time")
        line = as_lines(gateway_status(plant.database, plant.now))[-2]
        assert re.search(r"1 attempt, the next one at 2026-06-01T08:01:\d\dZ: the maintenance system: does not answer in time$", line)


def test_a_maintenance_system_that_drips_at_each_of_many_tickets_does_not_make_a_step_long(plant, monkeypatch):
    """The service manager takes a long step for one that hangs. The others follow in the next step."""
    monkeypatch.setattr(channel, "LONGEST_S", 0.2)
    with Dripping(b"HTTP/1.1 ") as server, plant.gateway(tickets(server), CREDENTIALS) as running:
        plant.lives(running)
        plant.now += 60.0
        for joint in (1, 2, 3):
            plant.happens("hall/cell-1", joint=joint)
        running.step()
        outbox, before = Outbox(plant.database, plant.clock), 0
        while before < 3:
            pause_s, attempts = running.workers[0].once(), [each.attempts for each in outbox.owed("tickets")]
            assert sum(attempts) <= before + 1
            assert sum(attempts) == 3 or pause_s == 0.0
            before = sum(attempts)
        assert attempts == [1, 1, 1]


def test_a_chat_that_drips_is_waited_for_for_a_while_and_an_answer_that_comes_late_counts(plant):
    """The message is not handed over twice while nobody knows."""
    apprise = pytest.importorskip("apprise")
    del apprise
    asked, go = [], threading.Event()

    class Target:
        def notify(self, **message):
            asked.append(message)
            go.wait(60.0)
            return True

    text = '[notify]\ngather_s = 0\n[[notify.to]]\nname = "chat"\napprise = "json://127.0.0.1:9"\n'
    with plant.gateway(text) as running:
        running.workers[0].channel._way._targets["chat"] = Target()
        a_day_passes(plant, running)
        (owed,) = Outbox(plant.database, plant.clock).owed("apprise")
        assert owed.error == "chat: apprise: the service does not answer in time"
        plant.lives(running, 60.0)
        assert len(asked) == 1
        go.set()
        while running.workers[0].channel._way._attempts["chat"].is_alive():
            time.sleep(0.01)
        plant.lives(running, 3600.0)
        assert (len(asked), Outbox(plant.database, plant.clock).owed("apprise")) == (1, [])
