"""The unchanged examples of deploy/zenoh with certificates of the test: who may read, who may command, who gets nothing."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trustme
import zenoh
from published import raw

from monitor.errors import BadInput, BusError
from monitor.publish.bus import Bus, QueryHandler
from monitor.publish.client import Client
from monitor.publish.permit import Asker
from monitor.publish.session import BusSettings, prefix, session_config

DEPLOY = Path(__file__).parents[2] / "deploy" / "zenoh"
ETC = "/etc/joint-monitor"


@pytest.fixture(scope="module")
def etc(tmp_path_factory):
    """The /etc/joint-monitor of a site: the shipped examples, certificates of its own authority, and one of another."""
    folder = tmp_path_factory.mktemp("etc")
    (folder / "tls").mkdir()
    ours, theirs = trustme.CA(), trustme.CA()
    ours.cert_pem.write_to_path(folder / "tls" / "ca.pem")
    for name, authority in (
        ("monitor", ours),
        ("router", ours),
        ("viewer", ours),
        ("maintenance", ours),
        ("guest", ours),
        ("cell", ours),
        ("forger", theirs),
    ):
        issued = authority.issue_cert("127.0.0.1", common_name="maintenance" if name == "forger" else name)
        issued.private_key_pem.write_to_path(folder / "tls" / f"{name}.key")
        (folder / "tls" / f"{name}.pem").write_bytes(b"".join(blob.bytes() for blob in issued.cert_chain_pems))
    for example in DEPLOY.glob("*.json5"):
        (folder / example.name).write_text(example.read_text("utf-8").replace(ETC, str(folder)), "utf-8")
    for name in ("guest", "forger", "cell"):
        text = (folder / "viewer.json5").read_text("utf-8")
        (folder / f"{name}.json5").write_text(text.replace("viewer.pem", f"{name}.pem").replace("viewer.key", f"{name}.key"), "utf-8")
    return folder


@pytest.fixture
def bus(etc, free_port):
    """A daemon's bus behind TLS, with one command that records its callers."""
    endpoint, called = f"tls/127.0.0.1:{free_port}", []
    answers = {"cmd/ack": QueryHandler("answer", lambda request: raw("answer", called.append(request) or {"done": "acknowledged"}))}
    with Bus(BusSettings(listen=(endpoint,), zenoh=str(etc / "daemon.json5")), prefix("lab", "cell-1"), answers) as bus:
        bus.say(raw("health", {"state": "NORMAL"}))
        yield bus, endpoint, called


def client(etc, endpoint, who):
    return Client(endpoint, "lab", "cell-1", timeout_s=2.0, zenoh_file=str(etc / f"{who}.json5"))


def test_maintenance_may_read_and_command(etc, bus):
    """Its certificate is of the site's authority, and its name is on the list."""
    _, endpoint, called = bus
    with client(etc, endpoint, "maintenance") as session:
        assert session.get("health")[0].document == {"state": "NORMAL"}
        assert session.get("cmd/ack", {"by": "ada"})[0].document == {"done": "acknowledged"}
    assert called == [{"by": "ada"}]


def test_a_viewer_may_read_and_not_command(etc, bus):
    """It gets last values, also by wildcard. Its command does not reach the daemon."""
    _, endpoint, called = bus
    with client(etc, endpoint, "viewer") as session:
        assert session.get("health")[0].document == {"state": "NORMAL"}
        assert session.get("**")[0].document == {"state": "NORMAL"}
        assert session.get("cmd/ack", {"by": "eve"}) == []
    assert called == []


def test_a_viewer_cannot_publish_for_the_monitor(etc, bus):
    """What a viewer publishes under the monitor's keys reaches nobody."""
    _, endpoint, _ = bus
    received = []
    with (
        client(etc, endpoint, "maintenance") as listener,
        zenoh.open(session_config(mode="client", connect=(endpoint,), zenoh_file=str(etc / "viewer.json5"))) as liar,
    ):
        listener._session.declare_subscriber("joint-monitor/v1/lab/cell-1/health", received.append)
        assert listener.get("health")
        liar.put("joint-monitor/v1/lab/cell-1/health", json.dumps({"state": "FAILURE"}))
        assert [reply.ok.payload.to_bytes() for reply in liar.get("joint-monitor/v1/lab/cell-1/health", timeout=5.0)]
        bus[0].say(raw("health", {"state": "OFF_SPEC"}))
        assert eventually(lambda: received or None)
    assert [json.loads(sample.payload.to_bytes())["state"] for sample in received] == ["OFF_SPEC"]


def permitting(etc, endpoint, who, answer):
    """A session that answers whether the arm may move."""
    session = zenoh.open(session_config(mode="client", connect=(endpoint,), zenoh_file=str(etc / f"{who}.json5")))

    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, json.dumps(answer))

    session.declare_queryable("joint-monitor/v1/lab/cell-1/permit/replay", reply)
    list(session.get("joint-monitor/v1/lab/cell-1/health", timeout=5.0))  # whoever answers knows the queryable by then
    return session


def eventually(ask, within_s=10.0):
    """The first answer that is no error."""
    deadline = time.monotonic() + within_s
    while (answer := ask()) is None and time.monotonic() < deadline:
        time.sleep(0.1)
    return answer


def test_only_the_cell_answers_whether_the_arm_may_move(etc, bus):
    """The cell may publish on that key alone. A viewer's yes does not arrive, and the cell can neither publish nor command otherwise."""
    ours, endpoint, called = bus
    with permitting(etc, endpoint, "viewer", {"allow": True, "why": "let it move"}):
        assert ours.ask_permit({}, 1.0) is None
    with permitting(etc, endpoint, "cell", {"allow": True, "why": "parked"}) as cell:
        assert eventually(lambda: ours.ask_permit({}, 1.0)).allowed
        received = []
        with client(etc, endpoint, "maintenance") as listener:
            listener._session.declare_subscriber("joint-monitor/v1/lab/cell-1/health", received.append)
            assert listener.get("health")
            cell.put("joint-monitor/v1/lab/cell-1/health", json.dumps({"state": "FAILURE"}))
            assert [reply.ok.payload.to_bytes() for reply in cell.get("joint-monitor/v1/lab/cell-1/health", timeout=5.0)]
            assert list(cell.get("joint-monitor/v1/lab/cell-1/cmd/ack", payload=b'{"by": "cell"}', timeout=2.0)) == []
            ours.say(raw("health", {"state": "OFF_SPEC"}))
            assert eventually(lambda: received or None)
        assert [json.loads(sample.payload.to_bytes())["state"] for sample in received] == ["OFF_SPEC"]
    assert called == []


def test_a_manual_replay_asks_for_its_permit_over_tls_too(etc, free_port):
    """Without a daemon, the command asks in its place, with its certificate."""
    endpoint = f"tls/127.0.0.1:{free_port}"
    settings = BusSettings(listen=(endpoint,), zenoh=str(etc / "daemon.json5"), client_zenoh=str(etc / "maintenance.json5"))
    with Asker(settings, prefix("lab", "cell-1")) as asker, permitting(etc, endpoint, "cell", {"allow": False, "why": "door open"}):
        answer = eventually(lambda: asker.ask({}, 1.0))
    assert not answer.allowed
    assert "door open" in answer.text


@pytest.mark.parametrize("who", ["guest", "forger", "nobody"])
def test_clients_that_are_not_listed_get_nothing(etc, bus, who):
    """A certificate with another name, one of another authority, or none: no value and no command."""
    _, endpoint, called = bus
    if who == "guest":  # a certificate of the site's authority, with a name that is not listed
        with client(etc, endpoint, who) as session:
            assert session.get("**") == []
            assert session.get("cmd/ack", {"by": "eve"}) == []
    else:
        with pytest.raises(BusError, match="does it ask for a certificate"):
            Client(endpoint, "lab", "cell-1", timeout_s=2.0) if who == "nobody" else client(etc, endpoint, who).get("**")
    assert called == []


def test_through_the_router_of_the_example(etc, free_port):
    """With a router of the shipped configuration between monitor and clients, the permissions are the same."""
    endpoint = f"tls/127.0.0.1:{free_port}"
    script = (
        "import json, sys, time, zenoh\n"
        "config = zenoh.Config.from_file(sys.argv[1])\n"
        "config.insert_json5('listen/endpoints', json.dumps([sys.argv[2]]))\n"
        "with zenoh.open(config):\n"
        "    print('up', flush=True)\n"
        "    time.sleep(120)\n"
    )
    router = subprocess.Popen([sys.executable, "-c", script, str(etc / "router.json5"), endpoint], stdout=subprocess.PIPE, text=True)
    try:
        assert router.stdout.readline() == "up\n"
        answers = {"cmd/ack": QueryHandler("answer", lambda request: raw("answer", {"done": "acknowledged"}))}
        settings = BusSettings(listen=(), connect=(endpoint,), zenoh=str(etc / "daemon.json5"))
        with Bus(settings, prefix("lab", "cell-1"), answers) as bus:
            bus.say(raw("health", {"state": "NORMAL"}))
            with client(etc, endpoint, "maintenance") as session:
                deadline = time.monotonic() + 10.0
                while not session.get("health") and time.monotonic() < deadline:
                    time.sleep(0.1)
                assert session.get("health")[0].document == {"state": "NORMAL"}
                assert session.get("cmd/ack", {"by": "ada"})[0].document == {"done": "acknowledged"}
            with client(etc, endpoint, "viewer") as session:
                assert session.get("health")[0].document == {"state": "NORMAL"}
                assert session.get("cmd/ack", {"by": "eve"}) == []
            with client(etc, endpoint, "guest") as session:
                assert session.get("**") == []
            with permitting(etc, endpoint, "cell", {"allow": True, "why": "parked"}):
                assert eventually(lambda: bus.ask_permit({}, 1.0)).allowed
    finally:
        router.kill()
        router.wait()


def test_users_and_passwords_from_credentials(etc, tmp_path, free_port, monkeypatch):
    """The shipped example with passwords: maintenance commands, a viewer reads, and a wrong or missing password gets nothing."""
    users = {"monitor": "m0nitor", "viewer": 'look "only"', "maintenance": "grease"}
    endpoint, called = f"tls/127.0.0.1:{free_port}", []

    def credentials(who: str, password: str) -> None:
        folder = tmp_path / who
        folder.mkdir(exist_ok=True)
        (folder / "zenoh-users").write_text("".join(f"{name}:{word}\n" for name, word in users.items()))
        (folder / "zenoh-password").write_text(f"{password}\n")
        monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(folder))

    text = (etc / "maintenance-password.json5").read_text("utf-8")
    (etc / "viewer-password.json5").write_text(text.replace('"maintenance"', '"viewer"'), "utf-8")
    credentials("monitor", users["monitor"])
    answers = {"cmd/ack": QueryHandler("answer", lambda request: raw("answer", called.append(request) or {"done": "acknowledged"}))}
    settings = BusSettings(listen=(endpoint,), zenoh=str(etc / "daemon-passwords.json5"))
    with Bus(settings, prefix("lab", "cell-1"), answers) as bus:
        bus.say(raw("health", {"state": "NORMAL"}))
        for who, done in (("maintenance", [{"done": "acknowledged"}]), ("viewer", [])):
            credentials(who, users[who])
            with client(etc, endpoint, f"{who}-password") as session:
                assert session.get("health")[0].document == {"state": "NORMAL"}
                assert [message.document for message in session.get("cmd/ack", {"by": who})] == done
        credentials("eve", "guessed")
        for name in ("maintenance-password", "anonymous"):
            (etc / "anonymous.json5").write_text(text.replace("auth:", "// auth:"), "utf-8")
            with pytest.raises(BusError):
                client(etc, endpoint, name)
    assert called == [{"by": "maintenance"}]
    (tmp_path / "eve" / "zenoh-password").unlink()
    with pytest.raises(BadInput, match="the credential 'zenoh-password' cannot be read"):
        client(etc, endpoint, "maintenance-password")


LOGGING = """
import sys
from monitor.publish.bus import Bus
from monitor.publish.session import BusSettings, log_refusals, prefix
settings = BusSettings(listen=(sys.argv[1],), zenoh=sys.argv[2])
log_refusals(settings)
with Bus(settings, prefix("lab", "cell-1")):
    print("up", flush=True)
    sys.stdin.readline()
"""


@pytest.mark.parametrize(
    ("daemon", "who", "words"),
    [
        ("daemon", "guest", ["127.0.0.1", "Common Name: guest", "did not match any configured ACL subject"]),
        ("daemon", "forger", ["invalid peer certificate: UnknownIssuer"]),
        ("daemon-passwords", "maintenance-password", ["Invalid password"]),
    ],
)
def test_refused_clients_are_logged(etc, tmp_path, free_port, monkeypatch, daemon, who, words):
    """As in `run`: the daemon's output names the client and its refusal, without escape sequences."""
    (tmp_path / "zenoh-users").write_text("maintenance:grease\n")
    (tmp_path / "zenoh-password").write_text("guessed\n")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(DEPLOY.parents[1]))
    endpoint = f"tls/127.0.0.1:{free_port}"
    command = [sys.executable, "-c", LOGGING, endpoint, str(etc / f"{daemon}.json5")]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        while process.stdout.readline() != "up\n":
            assert process.poll() is None
        try:
            with client(etc, endpoint, who) as session:
                assert session.get("**") == []
        except BusError:
            assert who != "guest"
        output, _ = process.communicate("\n", timeout=30.0)
    finally:
        process.kill()
        process.wait()
    for word in words:
        assert word in output
    assert "\x1b" not in output


def test_credentials_come_from_the_service_manager(etc, tmp_path, free_port, monkeypatch):
    """`${CREDENTIALS_DIRECTORY}` is replaced. If it is not set, the message names it."""
    text = (etc / "daemon.json5").read_text("utf-8").replace(str(etc / "tls"), "${CREDENTIALS_DIRECTORY}")
    (tmp_path / "daemon.json5").write_text(text, "utf-8")
    settings = BusSettings(listen=(f"tls/127.0.0.1:{free_port}",), zenoh=str(tmp_path / "daemon.json5"))
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    with pytest.raises(BadInput, match="CREDENTIALS_DIRECTORY"):
        Bus(settings, prefix("lab", "cell-1"))
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(etc / "tls"))
    with Bus(settings, prefix("lab", "cell-1")), client(etc, settings.listen[0], "viewer") as session:
        assert session.get("**") == []  # the client is admitted, and nothing has been published yet


def test_an_invalid_zenoh_configuration_is_refused(tmp_path):
    """The message has the name of the file and Zenoh's reason."""
    for text, says in (("{", "is no Zenoh configuration"), ("{nonsense: 1}", "is no Zenoh configuration")):
        (tmp_path / "z.json5").write_text(text)
        with pytest.raises(BadInput, match=says):
            session_config(mode="client", connect=("tcp/127.0.0.1:1",), zenoh_file=str(tmp_path / "z.json5"))
    with pytest.raises(BadInput, match="cannot be read"):
        session_config(mode="client", zenoh_file=str(tmp_path / "nowhere.json5"))
