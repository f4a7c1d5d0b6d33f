"""`check` and the bus: each failure of a connection has its own message. Routers and certificates are real."""

import json
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
import trustme
from published import raw

from monitor.errors import BadInput
from monitor.publish.bus import Bus, QueryHandler
from monitor.publish.diagnosis import reach
from monitor.publish.session import BusSettings, prefix

DEPLOY = Path(__file__).parents[2] / "deploy" / "zenoh"
PREFIX = prefix("lab", "cell-1")
ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config.from_file(sys.argv[1]) if sys.argv[1] else zenoh.Config()
for key, value in json.loads(sys.argv[2]).items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config):
    print("up", flush=True)
    time.sleep(120)
"""
BASE = {"mode": "router", "scouting/multicast/enabled": False, "scouting/gossip/enabled": False}


@pytest.fixture(scope="module")
def etc(tmp_path_factory):
    """The shipped examples with certificates that are valid, of another authority, expired, and for another host."""
    folder = tmp_path_factory.mktemp("etc")
    (folder / "tls").mkdir()
    ours, theirs = trustme.CA(), trustme.CA()
    ours.cert_pem.write_to_path(folder / "tls" / "ca.pem")
    theirs.cert_pem.write_to_path(folder / "tls" / "other-ca.pem")
    for name, authority, host in (
        ("monitor", ours, "127.0.0.1"),
        ("router", ours, "127.0.0.1"),
        ("viewer", ours, "127.0.0.1"),
        ("maintenance", ours, "127.0.0.1"),
        ("guest", ours, "127.0.0.1"),
        ("forger", theirs, "127.0.0.1"),
    ):
        issued = authority.issue_cert(host, common_name=name)
        issued.private_key_pem.write_to_path(folder / "tls" / f"{name}.key")
        (folder / "tls" / f"{name}.pem").write_bytes(b"".join(blob.bytes() for blob in issued.cert_chain_pems))
    expired = ours.issue_cert("127.0.0.1", common_name="viewer", not_after=datetime(2020, 1, 1, tzinfo=UTC))
    expired.private_key_pem.write_to_path(folder / "tls" / "expired.key")
    (folder / "tls" / "expired.pem").write_bytes(b"".join(blob.bytes() for blob in expired.cert_chain_pems))
    for example in DEPLOY.glob("*.json5"):
        (folder / example.name).write_text(example.read_text("utf-8").replace("/etc/joint-monitor", str(folder)), "utf-8")
    viewer = (folder / "viewer.json5").read_text("utf-8")
    for name in ("guest", "forger", "expired"):
        (folder / f"{name}.json5").write_text(viewer.replace("viewer.", f"{name}."), "utf-8")
    (folder / "mistrustful.json5").write_text(viewer.replace("/ca.pem", "/other-ca.pem"), "utf-8")
    (folder / "misplaced.json5").write_text(viewer.replace("viewer.key", "nowhere.key"), "utf-8")
    (folder / "anonymous.json5").write_text(
        "{transport: {link: {tls: {root_ca_certificate: " + json.dumps(str(folder / "tls" / "ca.pem")) + "}}}}", "utf-8"
    )
    return folder


@pytest.fixture
def router():
    """Start routers that end with the test."""
    started = []

    def start(file: str = "", **more: object) -> None:
        settings = BASE | {key.replace("__", "/"): value for key, value in more.items()}
        process = subprocess.Popen([sys.executable, "-c", ROUTER, file, json.dumps(settings)], stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout.readline() == "up\n"

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def seen(endpoint: str, **more):
    return reach(endpoint, PREFIX, who="commands", timeout_s=1.5, **more)


def test_a_closed_port_an_unknown_name_and_an_invalid_address_have_their_messages(free_port):
    """Nobody listens at the port, the name is unknown, or the address is invalid."""
    found = seen(f"tcp/127.0.0.1:{free_port}")
    assert found.cause == "nobody"
    assert "joint-monitor run" in found.text
    assert seen("tcp/no-such-host.invalid:7447").cause == "no_address"
    assert seen("tcp/127.0.0.1").cause == "no_address"


def test_a_daemon_without_secrets_is_reached_and_may_be_acted_on(free_port):
    """Plain TCP on loopback. The check has no effect on the daemon."""
    endpoint, called = f"tcp/127.0.0.1:{free_port}", []
    with Bus(
        BusSettings(listen=(endpoint,)),
        PREFIX,
        {"cmd/ack": QueryHandler("answer", lambda asked: raw("answer", called.append(asked) or {}))},
    ) as bus:
        assert seen(endpoint).cause == "denied"  # a bus without documents has no daemon of this robot
        bus.say(raw("info", {}))
        found = seen(endpoint)
    assert (found.cause, found.text) == ("reached", "connected, may look and act")
    assert called == []


def test_every_failure_of_tls_has_its_message(etc, free_port):
    """The daemon has the shipped configuration. Its certificate, the client's, a missing file or the protocol is wrong."""
    endpoint, called = f"tls/127.0.0.1:{free_port}", []
    answers = {"cmd/ack": QueryHandler("answer", lambda asked: raw("answer", called.append(asked) or {}))}
    with Bus(BusSettings(listen=(endpoint,), zenoh=str(etc / "daemon.json5")), PREFIX, answers) as bus:
        bus.say(raw("info", {}))

        def by(name: str):
            return seen(endpoint, zenoh_file=str(etc / f"{name}.json5"))

        assert by("maintenance").text == "connected, may look and act"
        assert by("viewer").text == "connected, may look, may not act (acknowledge, shelve, ask for a replay)"
        for name, cause, word in (
            ("mistrustful", "their_certificate", "other-ca.pem"),
            ("forger", "own_certificate", "forger.pem"),
            ("expired", "own_certificate", "certificate expired"),
            ("anonymous", "no_certificate", "viewer.json5"),
            ("misplaced", "certificate_files", "nowhere.key"),
            ("guest", "denied", "the name in our certificate"),
        ):
            found = by(name)
            assert (name, found.cause) == (name, cause), found.text
            assert word in found.text
        assert seen(endpoint.replace("tls/", "tcp/")).cause == "is_tls"
        assert seen(endpoint.replace("127.0.0.1", "localhost"), zenoh_file=str(etc / "viewer.json5")).cause == "their_certificate"
    assert called == []


def test_tls_to_a_plain_tcp_router_has_its_message(etc, free_port, router):
    """The endpoint begins with tls/, and the router uses tcp/."""
    router(listen__endpoints=[f"tcp/127.0.0.1:{free_port}"])
    found = seen(f"tls/127.0.0.1:{free_port}", zenoh_file=str(etc / "viewer.json5"))
    assert found.cause == "no_tls"
    assert "tcp/…" in found.text


def test_a_missing_and_a_wrong_password_have_their_messages(tmp_path, free_port, router):
    """No password, a wrong one, and the right one."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    (tmp_path / "users.txt").write_text("ada:secret\n")
    auth = {"dictionary_file": str(tmp_path / "users.txt"), "user": "router", "password": "its own"}
    router(listen__endpoints=[endpoint], transport__auth__usrpwd=auth)

    def as_ada(password: str) -> str:
        path = tmp_path / f"{password}.json5"
        path.write_text(json.dumps({"transport": {"auth": {"usrpwd": {"user": "ada", "password": password}}}}))
        return str(path)

    assert seen(endpoint).cause == "password"
    assert "asks for a user and password" in seen(endpoint).text
    wrong = seen(endpoint, zenoh_file=as_ada("guessed"))
    assert wrong.cause == "password"
    assert "'ada'" in wrong.text
    assert seen(endpoint, zenoh_file=as_ada("secret")).cause == "nothing_said"  # no monitor is connected to that router
    assert seen(endpoint, zenoh_file=as_ada("secret"), answers=False).text == "connected"


def test_each_failure_through_a_router_has_its_message(etc, free_port, router):
    """The shipped router: the monitor is not connected, or it is; and a client that access control does not list."""
    endpoint = f"tls/127.0.0.1:{free_port}"
    router(str(etc / "router.json5"), listen__endpoints=[endpoint])
    viewer, guest = (str(etc / f"{name}.json5") for name in ("viewer", "guest"))
    absent = seen(endpoint, zenoh_file=viewer)
    assert absent.cause == "nothing_said"
    assert "not connected to that router" in absent.text
    settings = BusSettings(listen=(), connect=(endpoint,), zenoh=str(etc / "daemon.json5"))
    with Bus(settings, PREFIX, {"cmd/ack": QueryHandler("answer", lambda _: raw("answer", {}))}) as bus:
        bus.say(raw("info", {}))
        for _ in range(10):
            if (found := seen(endpoint, zenoh_file=viewer)).reached:
                break
        assert found.reached, found.text
        assert seen(endpoint, zenoh_file=guest).cause == "nothing_said"
        assert seen(endpoint, zenoh_file=str(etc / "daemon.json5"), answers=False).text == "connected"


def test_an_invalid_configuration_is_a_mistake(tmp_path):
    """It is a BadConfiguration and not an unreachable bus."""
    (tmp_path / "z.json5").write_text("{")
    with pytest.raises(BadInput, match="is no Zenoh configuration"):
        seen("tcp/127.0.0.1:1", zenoh_file=str(tmp_path / "z.json5"))
