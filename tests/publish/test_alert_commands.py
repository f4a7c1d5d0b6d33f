"""What people do to alerts over a real daemon on the bus, and take back; short names on the command line."""

import pytest
from test_daemon_on_the_bus import cell, history, raise_alert, recording  # noqa: F401
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import BadInput
from monitor.publish.client import Client


@pytest.fixture
def client(cell):  # noqa: F811
    """A client of the cell's daemon."""
    with Client(cell[3], "lab", "cell-1") as connected:
        yield connected


@pytest.fixture
def shell(cell, tmp_path):  # noqa: F811
    """Runs the command line against the cell's daemon; returns its exit code and output."""
    daemon, *_ = cell
    [endpoint] = daemon.state.configuration.bus.listen
    text = f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n[bus]\nlisten = ["{endpoint}"]\n'
    (tmp_path / "cell.toml").write_text(text)

    def run(command: str, *arguments: str) -> str:
        return CliRunner().invoke(app, [command, "--config", str(tmp_path / "cell.toml"), *arguments], catch_exceptions=False).output

    return run


def test_a_second_acknowledgement_is_appended_and_both_can_be_taken_back(cell, client):  # noqa: F811
    """Documents and transitions name everyone: the first acknowledgement counts, Cid takes both back."""
    daemon, *_ = cell
    raise_alert(daemon, daemon.alerts._now())
    client.acknowledge(3, "wear_rising", by="Ada", why="grease is ordered")
    second = client.acknowledge(3, "wear_rising", by="Bob", why="seen too")
    assert (second.acknowledged_by, second.acknowledged_why) == ("Ada", "grease is ordered")
    assert [one.by for one in second.acknowledgements] == ["Ada", "Bob"]
    client.shelve(3, "wear_rising", hours=4, by="Ada")
    taken_back = client.unacknowledge(3, "wear_rising", by="Cid", why="it was joint 4")
    assert taken_back.acknowledged_by is None
    assert [(one.by, one.undone_by) for one in taken_back.acknowledgements] == [("Ada", "Cid"), ("Bob", "Cid")]
    assert client.unshelve(3, "wear_rising", by="Cid").shelved_until is None
    with pytest.raises(BadInput, match="not acknowledged"):
        client.unacknowledge(3, "wear_rising", by="Cid")
    last = client.events().events[-4:]
    assert [(event.kind, event.by) for event in last] == [
        ("acknowledged", "Bob"), ("shelved", "Ada"), ("unacknowledged", "Cid"), ("unshelved", "Cid"),
    ]  # fmt: skip


def test_an_alert_that_waits_for_nothing_but_a_person_clears_with_the_acknowledgement(cell, client):  # noqa: F811
    """`store_restored` is cleared in the answer already, and not at some later round."""
    daemon, *_ = cell
    daemon.alerts.restored = "the history was damaged"
    daemon.alerts.raise_restored()
    done = client.acknowledge(None, "store_restored", by="Ada")
    assert not done.active
    assert (done.acknowledged_by, done.cleared_why) == ("Ada", "its condition is gone, and it was acknowledged")
    assert not client.alerts()


def test_the_command_line_takes_the_beginning_of_an_alerts_name(cell, shell):  # noqa: F811
    """`j3/wear` and `j3` name the one active alert that begins so; otherwise the message lists the active ones."""
    daemon, *_ = cell
    raise_alert(daemon, daemon.alerts._now())
    assert "j3/wear_rising: acknowledged by Ada" in shell("ack", "j3/wear", "--by", "Ada")
    assert "acknowledged before by Ada" in shell("ack", "j3", "--by", "Bob")
    assert "waits for a person again" in shell("unack", "J3", "--by", "Ada")
    assert "shelved by Ada" in shell("shelve", "j3/wear", "--hours", "2", "--by", "Ada")
    assert "shown again" in shell("unshelve", "j3/wear", "--by", "Ada")
    with pytest.raises(BadInput, match=r"'j3/step' names no active alert; active: j3/wear_rising"):
        shell("ack", "j3/step", "--by", "Ada")
    with pytest.raises(BadInput, match="expected j1/CONDITION"):
        shell("ack", "3/wear", "--by", "Ada")


def test_what_a_request_lacks_is_named_before_it_is_sent(cell, client):  # noqa: F811
    """As the daemon names it: an empty name, a shelving for no time, a joint that is none."""
    for wrong, says in (
        (lambda: client.request_replay(by=""), "cmd/replay: by: "),
        (lambda: client.shelve(3, "wear_rising", hours=0.0, by="Ada"), "cmd/shelve: hours: "),
        (lambda: client.serviced(0, "greased", by="Ada", why="noise"), "cmd/serviced: joint: "),
    ):
        with pytest.raises(BadInput, match=says):
            wrong()
