"""The daemon of one arm tells people by itself: a real daemon, a simulated arm, a real SMTP server."""

import signal
import time
from pathlib import Path

import pytest
from command_line import ended
from mail_server import MailServer
from test_daemon import Cell, cell, eventually, moving, stop  # noqa: F401 - a fixture

from monitor.gateway.own import own_configuration
from monitor.gateway.source import Source
from monitor.plant.arm import ArmName
from monitor.plant.database import Database
from monitor.store.store import Store

LEAST = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n'
NOTIFY = """
[notify]
smtp = "127.0.0.1:{port}"
tls = "none"
sender = "monitor@plant.example"
gather_s = 0.0
[[notify.to]]
name = "maintenance"
mail = ["ada@plant.example"]
"""


@pytest.fixture
def server(tmp_path: Path):
    with MailServer(tmp_path) as made:
        yield made


def killed(process) -> None:
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=20)


def settled(cell: Cell) -> None:  # noqa: F811
    """The daemon runs, and its gateway has looked at the history: what comes now is told as it comes."""
    cell.client().__exit__()
    database = Database(own_configuration(loaded(cell)).plant.database)
    known = "SELECT count(*) FROM delivery WHERE channel = 'gateway' AND kind = 'known'"

    def copied() -> bool:
        if not database.exists:
            return False
        with database.read() as connection:
            return bool(connection.exec_driver_sql("SELECT name FROM sqlite_master WHERE name = 'delivery'").all()) and bool(
                connection.exec_driver_sql(known).scalar_one()
            )

    try:
        assert eventually(copied, 30.0)
    finally:
        database.close()


def loaded(cell: Cell):  # noqa: F811
    from monitor.config.load import load

    return load(cell.config)


def troubles(client) -> dict[str, str]:
    (said,) = client.get("monitor")
    return {each["name"]: each["text"] for each in said.document["troubles"]}


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.timeout(180)
@pytest.mark.xdist_group("daemon")
def test_an_alert_of_a_real_daemon_is_one_mail_whatever_is_killed_or_away(cell, server):  # noqa: F811
    """The mail server is away, the daemon is killed between alert and mail, and once more after it. The end is a mail in its thread."""
    one, remote = cell
    server.stop()
    one.config.write_text(one.config.read_text() + NOTIFY.format(port=server.port))
    daemon = one.daemon()
    settled(one)
    with one.client() as client:
        client.request_replay(by="Ada")
        assert eventually(lambda: moving(remote), 40.0)
        remote.protective_stop()
        assert eventually(lambda: any(alert.condition == "stopped" for alert in client.alerts()), 20.0)
        assert eventually(lambda: "notify" in troubles(client), 30.0)
        why = troubles(client)["notify"]
    assert why.startswith("what is owed to people waits, and is tried again: mail: mail server 127.0.0.1:")
    killed(daemon)
    said = ended("gateway", "status", "--config", str(one.config)).stdout
    assert "owed: 1\n  mail to ada@plant.example: alert, lab/cell-1" in said

    server.start()
    daemon = one.daemon()
    assert eventually(lambda: bool(server.taken), 40.0)
    with one.client() as client:
        assert eventually(lambda: "notify" not in troubles(client), 30.0)
        client.acknowledge(None, "stopped", by="Ada", why="seen")
        assert eventually(lambda: heard(one).alert(None, "stopped").acknowledged_by == "Ada", 10.0)
    killed(daemon)
    daemon = one.daemon()
    settled(one)
    time.sleep(8.0)  # some looks of the gateway and of its mail
    assert len(server.taken) == 1
    stop(daemon)

    allowed = ended("allow", "--config", str(one.config), "--by", "Ada", "--why", "looked at it")
    assert allowed.returncode == 0, allowed.stderr
    daemon = one.daemon()
    assert eventually(lambda: len(server.taken) > 1, 40.0)
    stop(daemon)
    (_, first), (_, second) = server.taken
    assert first["Subject"] == "[notice] lab/cell-1: Nothing moves, and nothing will until a person has put it right."
    assert second["Subject"].startswith("[over] lab/cell-1: ")
    assert first["References"] == second["References"]


def heard(cell: Cell):  # noqa: F811
    """The arm as its gateway has heard it last."""
    database = Database(own_configuration(loaded(cell)).plant.database)
    try:
        source = Source(database)
        source.refresh()
        return source.arms()[ArmName("lab", "cell-1")]
    finally:
        database.close()


def test_a_mistake_in_notify_of_an_arm_is_refused_with_its_line_before_anything_runs(tmp_path: Path):
    file = tmp_path / "cell-1.toml"
    file.write_text(LEAST + '[notify]\nsmtp = "127.0.0.1"\nsendr = "x"\n[[notify.to]]\nname = "ada"\n')
    refused = ended("run", "--only-check", "--config", file)
    assert refused.returncode == 78
    assert "cell-1.toml:7: notify.sendr: unknown key (did you mean sender?)" in refused.stderr
    hook = 'name = "x"\nwebhook = "https://x.example"\nwebhook_secret = "abcdef"\n'
    file.write_text(f'{LEAST}[notify]\nca_file = "gone.pem"\n[[notify.to]]\n{hook}')
    refused = ended("run", "--only-check", "--config", file)
    assert refused.returncode == 78
    assert "gone.pem" in refused.stderr


def test_only_what_runs_and_what_sends_needs_the_secrets_of_notify(tmp_path: Path, monkeypatch):
    """A person who asks for the status has no credential of the service."""
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    file = tmp_path / "cell-1.toml"
    file.write_text(LEAST + NOTIFY.format(port=9).replace('tls = "none"\n', 'user = "a"\npassword = "credential:smtp"\n'))
    with Store.open(tmp_path / "var/joint-monitor"):
        pass
    assert ended("status", "--config", file).returncode == 0
    refused = ended("gateway", "check", "--config", file)
    assert refused.returncode == 2
    assert "notify.password: asks for the credential smtp" in refused.stderr
    nothing = ended("gateway", "status", "--config", file)
    assert nothing.returncode == 1
    assert "nothing was told yet" in nothing.stderr


def test_a_test_message_reaches_everybody_whom_the_file_of_an_arm_names(tmp_path: Path, server):
    file = tmp_path / "cell-1.toml"
    file.write_text(LEAST + NOTIFY.format(port=server.port))
    sent = ended("gateway", "check", "--send", "--config", file)
    assert sent.returncode == 0, sent.stdout + sent.stderr
    assert "mail: message: ada@plant.example: a test message is taken" in sent.stdout
    assert server.subjects() == ["Test message of joint-monitor"]
    refused = ended("gateway", "run", "--config", file)
    assert refused.returncode == 78
    assert "its daemon tells people by itself: joint-monitor run" in refused.stderr


def test_what_notify_says_anew_waits_for_a_restart_and_is_said_so(tmp_path: Path):
    from monitor.config.load import load
    from monitor.config.reload import reloaded

    file = tmp_path / "cell-1.toml"
    file.write_text(LEAST)
    before = load(file)
    file.write_text(LEAST + NOTIFY.format(port=25))
    after = reloaded(before, load(file))
    assert after.configuration.notify == before.notify
    assert "waiting for a restart: notify" in after.text
