"""The command: a service that runs until SIGTERM, what check and status print, and that the page shows the same."""

import json
import os
import re
import signal
import socket
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from mail_server import MailServer
from test_notify_mail import notify, to
from test_tickets import CREDENTIALS, Maintenance, tickets
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.gateway.run import serve
from monitor.gateway.settings import load_gateway

ROOT = Path(__file__).parents[2]


@pytest.fixture
def server(tmp_path):
    with MailServer(tmp_path) as made:
        yield made


def asked(*words):
    """Exit code and output of a command."""
    result = CliRunner().invoke(app, ["gateway", *map(str, words)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def shape(line):
    """A line without what differs from run to run."""
    line = re.sub(r"https?://[^ ]*|(?<!@)\b(127\.0\.0\.1|192\.0\.2\.\d+|\w+\.plant\.example)(:\d+)?", "HOST", line)
    return re.sub(r"\d{4}-\d\d-\d\dT[\d:]+Z|\d+", "0", line)


def shown(command):
    """What the page shows of a command."""
    text = (ROOT / "docs/gateway.md").read_text("utf-8")
    return re.search(rf"\$ {re.escape(command)}\n(.*?)```", text, re.DOTALL)[1].splitlines()


def test_check_and_status_print_what_the_page_shows(plant, server, monkeypatch):
    """One line a step, with what to do; 3 where one gets nowhere; what is owed, with the reason; the ticket of each alert."""
    plant.arm("hall/cell-1")
    server.refused = {"bob@plant.example"}
    people = notify(server, to("ada"), to("bob"))
    with Maintenance() as orders:
        text = tickets(orders, f'check_url = "{orders.url}/api/orders?reference=x"\n') + people
        with plant.gateway(text, CREDENTIALS) as running:
            monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(plant.path.parent / "credentials"))
            plant.lives(running)
            plant.now = time.time()
            running._not_before_unix_s = 0.0
            plant.happens("hall/cell-1")
            running._heartbeat_at = -1e9
            plant.lives(running)
            plant.lives(running)
            running._heartbeat_at = -1e9
            plant.lives(running)
            code, printed = asked("check", "--config", plant.path.parent / "plant.toml")
            assert code == 3
            assert [shape(line) for line in printed.splitlines()] == [shape(line) for line in shown("joint-monitor gateway check")]
            monkeypatch.delenv("CREDENTIALS_DIRECTORY")
            code, printed = asked("status", "--config", plant.path.parent / "plant.toml")
            assert code == 0
            assert [shape(line) for line in printed.splitlines()] == [shape(line) for line in shown("joint-monitor gateway status")]
            code, printed = asked("status", "--json", "--config", plant.path.parent / "plant.toml")
            said = json.loads(printed)
            assert said["tickets"][0]["number"] == "4711"
            assert [line["recipient"] for line in said["owed"]] == ["bob@plant.example"]
            refused = CliRunner().invoke(app, ["gateway", "check", "--config", str(plant.path.parent / "plant.toml")])
            assert "asks for the credential cmms" in str(refused.exception)
            monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(plant.path.parent / "credentials"))
            taken = len(server.taken)
            code, printed = asked("check", "--send", "--json", "--config", plant.path.parent / "plant.toml")
            assert [each["ok"] for each in json.loads(printed) if each["step"] == "message"] == [True, False]
            assert server.taken[taken][1]["Subject"] == "Test message of joint-monitor"


def test_the_service_tells_systemd_that_it_runs_delivers_and_ends_at_sigterm(plant, server, tmp_path, monkeypatch):
    """In this process: its threads, its watchdog, its clock."""
    plant.arm("hall/cell-1")
    (tmp_path / "plant.toml").write_text(f'[plant]\ndatabase = "{plant.address}"\n{notify(server, to("ada"))}')
    said = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "300000")
        before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

        def world():
            try:
                while not said or not said[-1].startswith("READY=1"):
                    said.append(manager.recv(1000).decode())
                plant.now = time.time() + 1.0
                plant.happens("hall/cell-1")
                until = time.monotonic() + 60.0
                manager.settimeout(0.02)
                while not server.taken and time.monotonic() < until:  # it reads on: the kernel keeps ten datagrams, then the service waits
                    with suppress(TimeoutError):
                        said.append(manager.recv(1000).decode())
            finally:
                os.kill(os.getpid(), signal.SIGTERM)

        thread = threading.Thread(target=world)
        thread.start()
        try:
            serve(load_gateway(tmp_path / "plant.toml", {}))
        finally:
            thread.join()
            for number, handler in before.items():
                signal.signal(number, handler)
        manager.setblocking(False)
        try:
            while True:
                said.append(manager.recv(1000).decode())
        except BlockingIOError:
            pass
    assert next(each for each in said if "READY" in each).startswith("READY=1\nSTATUS=1 arms; mail: 1 address,")
    assert "WATCHDOG=1" in said
    assert said[-1] == "STOPPING=1"
    assert server.subjects() == ["[wear] hall/cell-1: Elbow turns 9 % heavier than at the beginning."]


def test_a_wrong_configuration_ends_with_78_and_so_does_one_without_a_channel(tmp_path):
    """systemd does not start it again; --only-check says which channels there are."""
    path = tmp_path / "plant.toml"
    path.write_text("[notify]\ngather_s = -1.0\n")
    code, printed = asked("--config", path)
    assert (code, "gather_s = -1.0" in printed) == (78, True)
    path.write_text("")
    for words in (("run",), ("run", "--only-check"), ("--only-check",)):
        code, printed = asked(*words, "--config", path)
        assert (code, "no channel is configured; expected one of [notify], [tickets]" in printed) == (78, True)
    assert asked("check", "--config", path) == (3, f"no channel is configured in {path}: nobody is notified\n")
    path.write_text('[mqtt]\nhost = "broker.plant.example"\n')
    assert asked("run", "--config", path, "--only-check") == (0, f"{path} is right; channels: mqtt\n")


@pytest.mark.skipif(os.geteuid() != 0, reason="NOT ROOT: nothing of root's can be handed over, which is not tested")
def test_status_that_root_asks_leaves_the_services_files_to_the_service(plant):
    """As `plant status` does: a file of root's beside the database would keep plant and gateway from writing."""
    folder = plant.path.parent
    (folder / "plant.toml").write_text('[plant]\ndirectory = "."\n')
    os.chown(folder, 65534, 65534)
    code, printed = asked("status", "--config", folder / "plant.toml")
    assert code == 0, printed
    owners = {path.name: path.stat().st_uid for path in folder.rglob("*")}
    assert any(name.startswith(plant.path.name) for name in owners)
    assert set(owners.values()) == {65534}, owners
