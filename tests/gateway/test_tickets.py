"""Work orders through a real HTTP server: one ticket an alert, closed at its end, acknowledged from the other side."""

import json
import socket
import threading
import urllib.error
import urllib.request
from dataclasses import replace

import pytest
import sqlalchemy as sa
from answering_arm import AnsweringArm
from http_server import HttpServer
from small_plant import DAY_S, alert

from monitor.errors import BadConfiguration
from monitor.gateway.connection import signed
from monitor.gateway.outbox import Outbox
from monitor.gateway.settings import check_all
from monitor.gateway.status import as_lines, gateway_status
from monitor.gateway.tickets.listener import check
from monitor.gateway.tickets.settings import filled, filled_address, pointed
from monitor.plant.screen.fleet import Fleet
from monitor.plant.tables import audit

SECRET, TOKEN = "a secret of the listener", "Bearer t0p-secret-token"
HOUR_S = 3600.0


class Maintenance(HttpServer):
    """A maintenance system: opens, finds, changes tickets; keeps idempotency keys or does not."""

    def __init__(self, *, keeps_keys=True, says_where=False):
        super().__init__(self._answered)
        self._one_at_a_time = threading.Lock()
        self.keeps_keys, self.says_where = keeps_keys, says_where
        self.tickets, self.keys = {}, {}
        self.loses = 0  # answers that are lost after the ticket is there
        self.fails = 0  # times that it answers 503

    def _answered(self, *asked):
        with self._one_at_a_time:
            return self._answer_to(*asked)

    def _answer_to(self, method, path, headers, body):
        if headers.get("authorization") != TOKEN:
            return 401, {}, b'{"message": "who are you?"}'
        if self.fails:
            self.fails -= 1
            return 503, {}, b"busy"
        number = path.rpartition("/")[2]
        if method == "GET":
            reference = path.partition("reference=")[2]
            found = [{"id": int(at), **ticket} for at, ticket in self.tickets.items() if ticket["reference"] == reference]
            return 200, {}, json.dumps(found).encode()
        if method == "PATCH":
            self.tickets[number] |= json.loads(body)
            return 204, {}, b""
        key = headers["idempotency-key"]
        number = self.keys.get(key) if self.keeps_keys else None
        if number is None:
            number = self.keys[key] = str(4711 + len(self.tickets))
            self.tickets[number] = json.loads(body)
        if self.loses:
            self.loses -= 1
            return None
        if self.says_where:
            return 201, {"Location": f"/api/orders/{number}"}, b""
        return 201, {}, json.dumps({"data": {"id": int(number)}}).encode()


def tickets(server, more=""):
    return (
        f'[gateway]\nlink = "https://plant.example"\n[tickets]\nopen_url = "{server.url}/api/orders"\nnumber = "/data/id"\n'
        'authorization = "credential:cmms"\n'
        f'close_url = "{server.url}/api/orders/{{number}}"\nupdate_url = "{server.url}/api/orders/{{number}}"\n'
        f'web = "{server.url}/orders/{{number}}"\n{more}'
    )


CREDENTIALS = {"cmms": TOKEN, "listener": SECRET}


def test_an_alert_opens_one_ticket_which_follows_it_to_its_end(plant):
    """Advisory: none; wear: one; limit: its priority; cleared: closed. The number stands in the status."""
    plant.arm("hall/cell-1", info={"robot": {"model": "ur5e"}, "serial": "20195500001"})
    fields = (
        '[tickets.fields]\ntitle = "{headline}"\nreference = "{key}"\nasset = {site = "{site}", serial = "{serial}"}\njoint = "{joint}"\n'
        'how = ["{tier}", "{change_percent} %"]\npriority = "{priority}"\n[tickets.priority]\nwear = 3\nlimit = 1\n'
    )
    with Maintenance() as server, plant.gateway(tickets(server, fields), CREDENTIALS) as running:
        plant.lives(running)
        raised = plant.now = plant.now + 60.0
        plant.happens("hall/cell-1", tier="advisory")
        plant.lives(running)
        assert server.tickets == {}
        for kind, tier in (("updated", "wear"), ("updated", "wear"), ("updated", "limit")):
            plant.now += HOUR_S
            plant.happens("hall/cell-1", kind, tier=tier, raised_unix_s=raised)
            plant.lives(running)
            ticket = server.tickets["4711"]
            assert ticket["priority"] == {"wear": 3, "limit": 1}[tier]
        assert ticket["title"] == "Elbow turns 9\u00a0% heavier than at the beginning."
        assert ticket["asset"] == {"site": "hall", "serial": "20195500001"}
        assert (ticket["joint"], ticket["how"]) == (3, ["wear", "9.1 %"])
        assert "hall/cell-1 joint 3 wear_rising: ticket 4711" in "\n".join(as_lines(gateway_status(plant.database, plant.now)))
        plant.happens("hall/cell-1", "cleared", tier="limit", raised_unix_s=raised, text="It is over.")
        plant.lives(running, HOUR_S)
    assert list(server.tickets) == ["4711"]
    assert (server.tickets["4711"]["status"], server.tickets["4711"]["comment"]) == ("closed", "It is over.")
    assert "ticket 4711" not in "\n".join(as_lines(gateway_status(plant.database, plant.now)))


@pytest.mark.parametrize("keeps_keys", [True, False])
def test_a_lost_answer_a_busy_server_and_a_day_s_outage_make_no_second_ticket(plant, keeps_keys):
    """By the idempotency key where the system keeps it, else by asking for the reference before an attempt is repeated."""
    plant.arm("hall/cell-1")
    with Maintenance(keeps_keys=keeps_keys) as server:
        find = "" if keeps_keys else f'find_url = "{server.url}/api/orders?reference={{key}}"\n'
        with plant.gateway(tickets(server, find), CREDENTIALS) as running:
            plant.lives(running)
            raised = plant.now = plant.now + 60.0
            server.loses, server.fails = 1, 2
            plant.happens("hall/cell-1", raised_unix_s=raised)
            plant.happens("hall/cell-1", "cleared", raised_unix_s=raised)
            plant.lives(running, DAY_S, 600.0)
    assert list(server.tickets) == ["4711"]
    assert server.tickets["4711"]["status"] == "closed"
    assert Outbox(plant.database, plant.clock).owed("tickets") == []


def test_the_plant_s_screen_shows_the_ticket_with_its_alert(plant):
    """Of the alert that has one, as long as it is not over."""
    plant.arm("hall/cell-1", health={"state": "MAINTENANCE_REQUIRED", "alerts": [alert(), alert(joint=1)]})
    with Maintenance() as server, plant.gateway(tickets(server), CREDENTIALS) as running:
        plant.lives(running)
        raised = plant.now = plant.now + 60.0
        plant.happens("hall/cell-1")
        plant.lives(running)
        shown = {each["joint"]: each.get("ticket") for each in json.loads(Fleet(plant.database).document("en"))["arms"][0]["alerts"]}
        assert shown == {3: {"number": "4711", "url": f"{server.url}/orders/4711"}, 1: None}
        plant.happens("hall/cell-1", "cleared", raised_unix_s=raised)
        plant.lives(running)
        over = json.loads(Fleet(plant.database).document("en"))["arms"][0]["alerts"]
        assert [each["ticket"] for each in over] == [None, None]


def test_a_ticket_s_number_may_stand_in_the_address_that_the_answer_names(plant):
    """The header Location, where the answer has no body."""
    plant.arm("hall/cell-1")
    with Maintenance(says_where=True) as server, plant.gateway(tickets(server), CREDENTIALS) as running:
        plant.lives(running)
        plant.now += 60.0
        plant.happens("hall/cell-1")
        plant.lives(running)
        assert [each.answer for each in running.outbox.answered("tickets", "open")] == [
            {"number": "4711", "url": f"{server.url}/orders/4711"}
        ]


def test_a_refusal_is_told_without_the_token_and_the_check_says_what_is_wrong(plant):
    """401 is authentication; the check opens nothing."""
    plant.arm("hall/cell-1")
    with Maintenance() as server:
        text = tickets(server, f'check_url = "{server.url}/api/orders?reference=none"\n')
        with plant.gateway(text, CREDENTIALS) as running:
            assert [(each.step, each.ok) for each in check_all(running.configuration)] == [
                *(("name", True), ("tcp", True), ("tls", True), ("authorisation", True))
            ]
            listens = running.configuration.sections["tickets"]
            there = replace(listens, listen=server.url.removeprefix("http://"), webhook_secret="s" * 8, role="acknowledge")
            elsewhere = replace(there, listen="192.0.2.1:8410")
            said = [check(each, running.configuration.plant)[-1] for each in (there, elsewhere)]
            assert [(each.step, each.ok) for each in said] == [("address", True), ("address", False)]
            assert "is it an address of this host?" in said[1].text
        with plant.gateway(text, {**CREDENTIALS, "cmms": TOKEN[::-1]}) as running:
            found = check_all(running.configuration)[-1]
            assert (found.step, found.ok) == ("authentication", False)
            plant.lives(running)
            plant.now += 60.0
            plant.happens("hall/cell-1")
            plant.lives(running)
            said = "\n".join(as_lines(gateway_status(plant.database, plant.now))) + running.status() + repr(running.configuration)
            assert "answers 401 Unauthorized" in said
            assert TOKEN[::-1] not in said + found.text
        assert server.tickets == {}


def post(url, document, secret=SECRET, name="m1", at=None):
    body = json.dumps(document).encode()
    request = urllib.request.Request(url + "acknowledge", data=body, headers=signed(secret, name, at, body), method="POST")
    try:
        with urllib.request.urlopen(request, timeout=90) as answer:
            return answer.status, json.loads(answer.read())
    except urllib.error.HTTPError as error:
        return error.code, json.loads(error.read())


def test_an_acknowledgement_comes_back_by_a_signed_webhook_goes_to_the_arm_once_and_is_audited(plant, monkeypatch):
    """By the ticket's number or the alert's name; the arm itself decides; each refusal stands in the audit."""
    monkeypatch.setattr("monitor.gateway.commands.WAIT_S", 60.0)  # for the router, on a busy machine
    plant.arm("hall/cell-1")
    listen = 'listen = "127.0.0.1:0"\nwebhook_secret = "credential:listener"\nrole = "acknowledge"\n'
    with Maintenance() as server, AnsweringArm("hall/cell-1") as arm:
        text = tickets(server, listen).replace("[gateway]", f'connect = ["{arm.endpoint}"]\n[gateway]', 1)
        with plant.gateway(text, CREDENTIALS) as running:
            plant.lives(running)
            plant.now += 60.0
            plant.happens("hall/cell-1")
            plant.lives(running)
            url, now = running.workers[1].channel._server.url, plant.now
            named = {"ticket": 4711, "by": "Ada", "why": "grease is ordered\0"}  # PostgreSQL stores no NUL
            assert post(url, named, "another", at=now)[0] == 401
            assert post(url, named, at=now - 400.0)[0] == 401
            assert post(url, {**named, "by": ""}, at=now)[0] == 400
            assert post(url, "rubbish", at=now)[0] == 400
            assert post(url, {**named, "ticket": "1"}, at=now) == (409, {"error": "ticket 1 is none of ours"})
            done = {"robot": "hall/cell-1", "joint": 3, "condition": "wear_rising"}
            assert post(url, named, at=now) == (200, {"done": "acknowledged", **done})
            assert post(url, named, at=now) == (200, {"done": "already", **done})
            arm.refuses = "no such alert is active"
            by_name = {"site": "hall", "robot": "cell-1", "condition": "stopped", "by": "Bob"}
            assert post(url, by_name, name="m2", at=now) == (409, {"error": "no such alert is active"})
            arm.refuses = None
            assert post(url, by_name, name="m3", at=now)[0] == 200
            assert "listens on" in running.status()
    assert arm.asked == [
        ("ack", {"joint": 3, "condition": "wear_rising", "why": "grease is ordered", "by": "Ada"}),
        ("ack", {"joint": None, "condition": "stopped", "why": "", "by": "Bob"}),
    ]
    with plant.database.read() as connection:
        lines = [tuple(row) for row in connection.execute(sa.select(audit.c.who, audit.c.act, audit.c.robot, audit.c.text))]
    assert ("Ada", "ack", "hall/cell-1", "by tickets: joint 3, condition wear_rising, why grease is ordered") in lines
    assert any(who == "Bob" and "refused: no such alert" in text for who, _, _, text in lines)
    assert any(who == "nobody (127.0.0.1)" and "not that of our secret" in text for who, _, _, text in lines)
    assert ("Ada", "ack", None, "by tickets: refused: ticket 1 is none of ours") in lines
    assert ("tickets", "ack", None, "by tickets: refused: by: String should have at least 1 character") in lines
    assert any(who == "tickets" and "refused: the body: " in text for who, _, _, text in lines)


def test_an_address_that_another_program_has_is_the_trouble_of_the_listener_alone(plant):
    """Tickets are opened all the same, and it listens as soon as it can."""
    plant.arm("hall/cell-1")
    with Maintenance() as server, socket.create_server(("127.0.0.1", 0)) as taken:
        listen = f'listen = "127.0.0.1:{taken.getsockname()[1]}"\nwebhook_secret = "credential:listener"\nrole = "acknowledge"\n'
        with plant.gateway(tickets(server, listen), CREDENTIALS) as running:
            plant.lives(running)
            plant.now += 60.0
            plant.happens("hall/cell-1")
            plant.lives(running)
            assert list(server.tickets) == ["4711"]
            assert "another program listens there" in running.status()
            taken.close()
            plant.lives(running)
            assert "acknowledgements: listens on" in running.status()


def raised_untold(plant):
    """When an alert was raised of whose tier the settings of then told nobody; that gateway has ended."""
    plant.arm("hall/cell-1")
    with Maintenance() as server, plant.gateway(tickets(server, 'tiers = ["limit"]\n'), CREDENTIALS) as running:
        plant.lives(running)
        raised = plant.now = plant.now + 60.0
        plant.happens("hall/cell-1", tier="wear")
        plant.lives(running)
        assert server.tickets == {}
    return raised


def test_an_alert_that_becomes_graver_and_has_no_ticket_yet_gets_one_and_only_one(plant):
    """Its first tier was told to nobody: it was raised before, or other settings held then."""
    raised = raised_untold(plant)
    with Maintenance() as server, plant.gateway(tickets(server), CREDENTIALS) as running:
        for tier in ("limit", "wear", "limit"):
            plant.now += HOUR_S
            plant.happens("hall/cell-1", "updated", tier=tier, raised_unix_s=raised)
            plant.lives(running, HOUR_S)
        assert [ticket["priority"] for ticket in server.tickets.values()] == ["high"]


def test_an_alert_that_becomes_graver_and_ends_at_once_gets_its_first_ticket_closed(plant):
    """Both happened while no gateway ran: the ticket that is opened in place of the change comes before the end, which waits for it."""
    raised = raised_untold(plant)
    with Maintenance() as server, plant.gateway(tickets(server), CREDENTIALS) as running:
        for kind in ("updated", "cleared"):
            plant.now += HOUR_S
            plant.happens("hall/cell-1", kind, tier="limit", raised_unix_s=raised)
        plant.lives(running, HOUR_S)
        assert [ticket.get("status") for ticket in server.tickets.values()] == ["closed"]
    assert Outbox(plant.database, plant.clock).owed("tickets") == []


def test_templates_keep_figures_and_no_value_changes_an_address_or_the_form_of_the_body():
    """A text that is one place alone becomes the value; pointers are those of RFC 6901."""
    values = {"joint": 3, "number": "a/../b?x=1", "text": '"}, {"'}
    assert filled({"a": "{joint}", "b": ["joint {joint}", 7, None], "c": {"d": "{text}"}}, values) == {
        **{"a": 3, "b": ["joint 3", 7, None], "c": {"d": '"}, {"'}}
    }
    assert filled_address("https://h/{number}", values) == "https://h/a%2F..%2Fb%3Fx%3D1"
    document = {"foo": ["bar", "baz"], "": 0, "a/b": 1, "m~n": 8, "d": {"": {"x": 2}}}
    for pointer, found in (
        ("/foo/0", "bar"),
        ("/", 0),
        ("/a~1b", 1),
        ("/m~0n", 8),
        ("/d//x", 2),
        ("/foo/2", None),
        ("/foo/01", None),
        ("/x/y", None),
    ):
        assert pointed(document, pointer) == found


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ('open_url = "cmms"\n', "open_url: expected https://"),
        ('close_url = "https://h/{number}"\n', "without it no ticket is opened"),
        ('open_url = "https://h"\nnumber = "id"\n', "number = 'id'"),
        ('open_url = "https://h/{nmber}"\n', "{nmber} is no placeholder"),
        ('open_url = "https://h"\n[tickets.fields]\na = {b = ["{headlin}"]}\n', "{headlin} is no placeholder"),
        ('open_url = "https://h"\n[tickets.fields]\na = "{number}"\n', "known only after the ticket is open"),
        ('open_url = "https://h"\nlisten = "127.0.0.1:1"\n', "listen, but not both"),
        ('open_url = "https://h"\nauthorization = "a\\nb: c-very-secret"\n', "cannot be sent"),
        ('open_url = "https://h"\nopen_method = "GET"\n', "open_method"),
        ('open_url = "https://h"\ntiers = []\n', "tiers = []: no alert would ever open a ticket"),
        ('open_url = "https://h"\nrobots = []\n', "robots = []: no alert would ever open a ticket"),
    ],
)
def test_a_mistake_in_the_section_is_named_with_what_would_be_right(plant, lines, why):
    """No secret is in the message."""
    with pytest.raises(BadConfiguration) as refused, plant.gateway(f"[tickets]\n{lines}"):
        pass
    assert why in str(refused.value)
    assert "very-secret" not in str(refused.value)
