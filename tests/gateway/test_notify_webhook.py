"""Signed webhooks and apprise, through a real HTTP server; the receiver knows the documentation alone."""

import base64
import hashlib
import hmac
import json
import logging
import re
from pathlib import Path

import pytest
from http_server import HttpServer
from small_plant import DAY_S

from monitor.errors import BadConfiguration, BadInput
from monitor.gateway import connection
from monitor.gateway.connection import SIGNATURE, Refused
from monitor.gateway.notify.messages import Message
from monitor.gateway.notify.services import LONGEST
from monitor.gateway.outbox import Outbox
from monitor.gateway.settings import check_all

ROOT = Path(__file__).parents[2]
SECRET = "whsec_" + base64.b64encode(b"a key of thirty-two bytes, or so").decode()


def documented_receiver():
    """The function of docs/gateway.md, as a reader copies it."""
    text = (ROOT / "docs/gateway.md").read_text("utf-8")
    code = re.search(r"```python\n(import base64.*?)```", text, re.DOTALL)[1]
    namespace = {}
    exec(code, namespace)
    return namespace["is_ours"]


def hook(url, more=""):
    table = f'name = "hook"\nwebhook = "{url}/in?key=t0p-secret"\nwebhook_secret = "credential:hook"'
    return f"[notify]\ngather_s = 0\n[[notify.to]]\n{table}\n{more}"


def test_a_receiver_that_knows_the_documentation_alone_verifies_and_takes_each_message_once(plant, caplog):
    """Answers that are lost or refused have the same message come again: same id, same body, a signature that holds."""
    caplog.set_level("INFO")  # as the service logs: httpx tells each request with its address, and that may hold a secret
    is_ours, key = documented_receiver(), base64.b64decode(SECRET.removeprefix("whsec_"))
    answers = iter([None, (503, {"Retry-After": "1200"}, b""), (204, {}, b""), (200, {}, b"")])
    plant.arm("hall/cell-1")
    with HttpServer(lambda *_: next(answers)) as server, plant.gateway(hook(server.url), {"hook": SECRET}) as running:
        plant.lives(running)
        plant.now += 60.0
        plant.happens("hall/cell-1")
        plant.lives(running, 900.0)
        assert len(server.asked) == 2
        owed = Outbox(plant.database, plant.clock).owed("webhook")
        assert owed[0].error == "hook: answers 503 Service Unavailable"
        assert "t0p-secret" not in str(owed)
        plant.lives(running, 900.0)
        plant.happens("hall/cell-1", "cleared", raised_unix_s=plant.now - 1800.0)
        plant.lives(running, DAY_S, 3600.0)
    assert len(server.asked) == 4
    assert "t0p-secret" not in caplog.text
    for method, path, headers, body in server.asked:
        assert (method, path) == ("POST", "/in?key=t0p-secret")
        assert is_ours(key, headers, body)
        assert not is_ours(key, headers, body + b" ")
        assert not is_ours(key, {**headers, "webhook-timestamp": "1"}, body)
    ids = [headers["webhook-id"] for _, _, headers, _ in server.asked]
    assert ids[0] == ids[1] == ids[2] != ids[3]
    assert server.asked[0][3] == server.asked[2][3]
    assert [headers["idempotency-key"] for _, _, headers, _ in server.asked] == ids
    said = json.loads(server.asked[0][3])
    assert (said["kind"], said["type"], said["id"]) == ("joint-monitor.notification.v1", "alert", ids[0])
    first, last = said["transitions"][0], json.loads(server.asked[3][3])["transitions"][0]
    assert (first["site"], first["robot"], first["joint"], first["condition"]) == ("hall", "cell-1", 3, "wear_rising")
    assert (first["kind"], first["before"], first["after"], first["at"]) == ("raised", "none", "wear", "2026-06-01T08:01:00Z")
    assert (last["kind"], last["before"], last["after"]) == ("cleared", "wear", "none")
    assert first["alert_id"] == last["alert_id"]
    assert first["event"]["text"] == "Joint 3 turns heavier."


def test_one_webhook_that_is_away_holds_up_no_other_one_and_the_rest_is_one_message_afterwards(plant):
    """While one message does not get through, nothing is gathered for its receiver."""
    away = [True]
    plant.arm("hall/cell-1")
    with HttpServer(lambda *_: None if away[0] else (204, {}, b"")) as ill, HttpServer() as well:
        second = f'[[notify.to]]\nname = "well"\nwebhook = "{well.url}"\nwebhook_secret = "credential:hook"\n'
        with plant.gateway(hook(ill.url, second), {"hook": SECRET}) as running:
            plant.lives(running)
            for joint in (1, 2, 3, 4):
                plant.now += 3600.0
                plant.happens("hall/cell-1", joint=joint)
                plant.lives(running)
            assert len(well.asked) == 4
            away[0] = False
            ill.asked.clear()
            plant.lives(running, 3600.0)
            assert [len(json.loads(body)["transitions"]) for *_, body in ill.asked] == [1, 3]
            assert {finding.step for finding in check_all(running.configuration)} == {"name", "tcp", "authorisation"}


def test_a_message_that_the_other_side_never_takes_holds_up_no_later_one_for_longer_than_an_hour(plant):
    """One that the receiver cannot read would keep everything from him for `give_up_days`; an outage makes two messages at most."""
    plant.arm("hall/cell-1")

    def answer(_method, _path, _headers, body):
        return (422 if json.loads(body)["transitions"][0]["joint"] == 1 else 204, {}, b"")

    with HttpServer(answer) as server, plant.gateway(hook(server.url), {"hook": SECRET}) as running:
        plant.lives(running)
        plant.now += 60.0
        plant.happens("hall/cell-1", joint=1)
        plant.lives(running, 60.0, 30.0)
        plant.happens("hall/cell-1", joint=2)
        plant.lives(running, 60.0, 30.0)
        assert {json.loads(body)["transitions"][0]["joint"] for *_, body in server.asked} == {1}
        plant.lives(running, 3600.0, 240.0)
        plant.happens("hall/cell-1", joint=3)
        plant.lives(running, 60.0, 30.0)
        joints = [[each["joint"] for each in json.loads(body)["transitions"]] for *_, body in server.asked]
        assert [each for each in joints if each != [1]] == [[2], [3]]
        assert [each.error for each in Outbox(plant.database, plant.clock).owed("webhook")] == ["hook: answers 422 Unprocessable Entity"]


def test_apprise_takes_a_message_and_its_refusal_is_told_without_the_address_s_secret(plant):
    """By apprise's own client for JSON over HTTP; an address that it does not know is refused at the beginning."""
    pytest.importorskip("apprise")
    status = [500]
    plant.arm("hall/cell-1")
    with HttpServer(lambda *_: (status[0], {}, b"no")) as server:
        address = server.url.replace("http://", "json://user:t0p-secret@") + "/chan-t0p-secret"
        text = '[notify]\ngather_s = 0\n[[notify.to]]\nname = "chat"\napprise = "credential:chat"\n'
        with plant.gateway(text, {"chat": address}) as running:
            plant.lives(running)
            plant.now += 60.0
            plant.happens("hall/cell-1")
            plant.lives(running)
            owed = Outbox(plant.database, plant.clock).owed("apprise")
            assert "chat: not taken" in owed[0].error
            assert "t0p-secret" not in str(owed) + repr(running.configuration)
            status[0] = 200
            plant.lives(running, 600.0)
            assert Outbox(plant.database, plant.clock).owed("apprise") == []
            assert [finding.ok for finding in check_all(running.configuration)] == [True]
        said = json.loads(server.asked[-1][3])
        assert said["title"] == "[wear] hall/cell-1: Elbow turns 9 % heavier than at the beginning."
        with (
            pytest.raises(BadConfiguration, match="'chat': apprise: is no address") as refused,
            plant.gateway(text, {"chat": "nonsense://t0p-secret"}),
        ):
            pass
        assert "t0p-secret" not in str(refused.value)


def test_a_long_refusal_of_a_chat_ends_with_no_part_of_a_secret(plant):
    """What it says is cut after the secrets are black, and a secret that is a part of another one does not show the rest of it."""
    pytest.importorskip("apprise")
    plant.arm("hall/cell-1")

    class Target:
        def notify(self, **_):
            logging.getLogger("apprise").warning("%s t0p-secret", self.before * "x")
            return False

    people = (f'[[notify.to]]\nname = "{name}"\napprise = "json://h/{part}"\n' for name, part in (("a", "secret"), ("chat", "t0p-secret")))
    with plant.gateway("[notify]\n" + "".join(people)) as running:
        way, target = running.workers[0].channel._way, Target()
        way._targets["chat"] = target
        for target.before in range(LONGEST - 30, LONGEST):
            with pytest.raises(Refused) as refused:
                way.send(Message(name="a", kind="alert", recipient="chat", subject="s", text="t", made_at_unix_s=0.0))
            assert "t0p" not in str(refused.value)


def test_our_signature_is_that_of_the_specification_s_own_library():
    """What the package standardwebhooks 1.1.0 makes of this message."""
    made = connection.signed("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    assert made[SIGNATURE] == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_a_signature_is_refused_for_each_reason(plant):
    """Missing headers, another secret, another body, too old, no time, no base64."""
    now, body = plant.now, b'{"a": 1}'
    good = connection.signed(SECRET, "m1", now, body)
    assert connection.verified(SECRET, {**good, SIGNATURE: "v1,bm9uZQ== " + good[SIGNATURE]}, body, now + 60.0) == "m1"
    # independently of our function, from the specification's text
    expected = base64.b64encode(hmac.new(base64.b64decode(SECRET[6:]), f"m1.{int(now)}.".encode() + body, hashlib.sha256).digest()).decode()
    assert good[SIGNATURE] == f"v1,{expected}"
    for headers, given, at, why in (
        ({}, body, now, "header webhook-id is missing"),
        (good, body + b" ", now, "not that of our secret"),
        (connection.signed("another", "m1", now, body), body, now, "not that of our secret"),
        ({**good, SIGNATURE: "v1a," + good[SIGNATURE][3:]}, body, now, "not that of our secret"),
        (good, body, now + 301.0, "signed more than 300 s ago"),
        ({**good, connection.TIMESTAMP: "now"}, body, now, "is no time"),
    ):
        with pytest.raises(BadInput, match=why):
            connection.verified(SECRET, headers, given, at)
    with pytest.raises(BadInput, match="no base64"):
        connection.key_of("whsec_???")


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ('smtp = "here"\n[[notify.to]]\nname = "a"\nmail = ["a@b.c"]\n', "smtp = 'here'"),
        ('[[notify.to]]\nname = "a"\nmail = ["a@b.c"]\n', "no mail server"),
        ('smtp = "h:25"\n[[notify.to]]\nname = "a"\nmail = ["a@b.c"]\n', "sender = ''"),
        ('[[notify.to]]\nname = "a"\n', "no way to reach it"),
        ('[[notify.to]]\nname = "a"\nmail = ["a"]\n', "'a' is no address"),
        ('[[notify.to]]\nname = "a"\nwebhook = "https://h"\n', "without webhook_secret"),
        ('[[notify.to]]\nname = "a"\napprise = "x"\ntiers = ["grave"]\n', "tiers: 'grave'; expected of advisory, wear, limit"),
        ('[[notify.to]]\nname = "a"\napprise = "x"\ntiers = []\n', "tiers = []: without escalation or reports"),
        ('[[notify.to]]\nname = "a"\napprise = "x"\nsites = []\n', "sites = []: nothing would ever be told"),
        ('[[notify.to]]\nname = "a"\napprise = "x"\nquiet = "22-6"\n', 'time of day, e.g. "07:00"'),
        (
            '[[notify.to]]\nname = "a"\napprise = "x"\ntime_zone = "Mars/Base"\n',
            "'Mars/Base': expected a name such as UTC or Europe/Berlin",
        ),
        ('[[notify.to]]\nname = "a"\napprise = "x"\nteirs = ["wear"]\n', "did you mean tiers?"),
        ('[[notify.to]]\nname = "a"\napprise = "x"\nreports = ["weekly"]\n', "reports: go by mail"),
        (
            '[[notify.to]]\nname = "a"\napprise = "x"\nquiet_days = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"]\n',
            "every day is quiet",
        ),
        ('smtp = "h.example:25"\ntls = "none"\nuser = "u"\npassword = "pw-pw-pw"\nsender = "a@b.c"\n', "everybody on the way could read"),
        ('smtp = "h.example:25"\nuser = "u"\npassword = "pw-pw-pw-ü"\nsender = "a@b.c"\n', "letters that are not ASCII"),
        ("gather_s = -1.0\n", "greater than or equal to 0"),
    ],
)
def test_a_mistake_in_the_section_is_named_with_what_would_be_right(plant, lines, why):
    """No secret is in the message."""
    with pytest.raises(BadConfiguration) as refused, plant.gateway(f"[notify]\n{lines}"):
        pass
    assert why in str(refused.value)
    assert "pw-pw-pw" not in str(refused.value)


def test_a_mistake_in_a_recipient_is_named_with_its_line(plant):
    """Of the second table of a list; a secret that is not there as well."""
    first = '[notify]\n[[notify.to]]\nname = "a"\napprise = "json://localhost"\n\n'
    text = f'{first}[[notify.to]]\nname = "b"\nteirs = ["wear"]\napprise = "credential:gone"\n'
    with pytest.raises(BadConfiguration) as refused, plant.gateway(text):
        pass
    assert "plant.toml:10: notify.to.1.teirs: unknown key (did you mean tiers?)" in str(refused.value)
    assert "plant.toml:11: notify.to.1.apprise: the credential gone cannot be read" in str(refused.value)
