"""Work on a joint, declared on the bus and without a daemon: what it changes, how it lasts, and how it is taken back."""

import dataclasses
import json
import shutil
from pathlib import Path

import jsonschema
import pytest
from test_alert_commands import client, shell  # noqa: F401
from test_daemon_on_the_bus import DAY_S, Arm, cell, history, raise_alert, recording, settled  # noqa: F401
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import BadInput
from monitor.judge.belief import belief_from_document
from monitor.judge.inspection import InspectionSettings
from monitor.publish.queries import InspectedRequest, UndoInspectedRequest
from monitor.publish.registry import schema
from monitor.service.daemon import Daemon
from monitor.service.history.recompute import recompute
from monitor.service.history.report import report
from monitor.service.history.status import status_document
from monitor.store.store import Store


@pytest.fixture
def shell_of(history):  # noqa: F811
    """Runs the command line on a copy of the history, without a daemon; returns its output."""

    def run(folder: Path, port: int, command: str, *arguments: str) -> str:
        shutil.copytree(history, folder / "history")
        text = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n'
        (folder / "cell.toml").write_text(f'{text}[bus]\nlisten = ["tcp/127.0.0.1:{port}"]\n')
        return CliRunner().invoke(app, [command, "--config", str(folder / "cell.toml"), *arguments], catch_exceptions=False).output

    return run


def later(daemon: Daemon, arm: Arm, replays: int) -> None:
    """So many replays more, one a day."""
    for _ in range(replays):
        arm.clock_unix_s += DAY_S
        assert daemon.monitor.perform(arm.clock_unix_s).state == "assessed"


def test_a_replaced_joint_is_declared_on_the_bus_and_everybody_hears_of_it(cell, client):  # noqa: F811
    """The answer says what it means; alert, transition, health and work are published, by their schemas, and are still known later."""
    daemon, store, arm, _ = cell
    raise_alert(daemon, daemon.alerts._now())
    answer = client.serviced(3, "replaced", by="Ada", why="gearbox noisy")
    assert answer.maintenance.outcome == "new_joint"
    assert any("learnt anew" in sentence for sentence in answer.text)
    assert any(sentence.startswith("j3/wear_rising (wear, at its gravest +6.0%): cleared, serviced") for sentence in answer.text)
    assert not client.alerts()
    [alert] = client.alerts(cleared=True)
    assert (alert.serviced_kind, alert.serviced_by, alert.gravest.tier) == ("replaced", "Ada", "wear")
    last = client.events().events[-1]
    assert (last.kind, last.by, last.why) == ("cleared", "Ada", "gearbox noisy")
    [message] = client.get("joint/3/maintenance")
    jsonschema.validate(message.document, schema("maintenance"))
    assert client.health().joints[2].state == "NORMAL"
    row = client.friction()[2]
    assert (row.wear, row.reference_torque_nm, row.remaining_life.p50_days) == (0.0, None, None), "the old joint's"
    assert store.assessments.state().belief["maintenance"][0]["kind"] == "replaced"
    later(daemon, arm, 2)
    assert recompute(store)["identical"] == 5


def test_a_greased_joint_waits_for_its_proof(cell, client):  # noqa: F811
    """Its alert is active and CHECK_FUNCTION until three replays have judged the work; the report has it with its day and outcome."""
    daemon, store, arm, _ = cell
    raise_alert(daemon, daemon.alerts._now())
    answer = client.serviced(3, "greased", by="Ada", why="200 h service", at="2026-01-07")
    assert answer.maintenance.outcome is None
    [alert] = client.alerts()
    assert alert.awaiting_proof
    told = status_document(daemon.state.configuration, arm.clock_unix_s)
    assert [each["awaiting_proof"] for each in told["health"]["alerts"] if each["active"]] == [True]
    assert told["maintenance"][0]["text"].startswith("Elbow (joint 3) was greased on 2026-01-07 (Ada: 200 h service)")
    assert client.health().joints[2].state == "CHECK_FUNCTION"
    assert client.health().state == "CHECK_FUNCTION"
    later(daemon, arm, 4)
    [row] = store.maintenance.rows()
    assert row.document["outcome"] == "new_reference"
    assert not client.alerts()
    assert recompute(store)["identical"] == 7
    document = report(daemon.state.configuration, store, None, None, arm.clock_unix_s)
    [act] = document["maintenance"]
    assert (act["kind"], act["outcome"], act["at"]) == ("greased", "new_reference", "2026-01-07T00:00:00Z")


def test_declared_production_can_be_taken_back_also_after_replays(cell, client):  # noqa: F811
    """The alert is active again, and the state is to the bit that of a history without the declaration."""
    daemon, store, arm, _ = cell
    raise_alert(daemon, daemon.alerts._now())
    before = store.assessments.state()
    client.serviced(3, "replaced", by="Ada", why="wrong joint")
    answer = client.undo_serviced(3, by="Bob", why="it was joint 4")
    assert "Active again: j3/wear_rising (wear)." in answer.text
    now = store.assessments.state()
    assert now.belief == before.belief
    assert now.health == before.health
    assert client.alerts()[0].active
    with pytest.raises(BadInput, match="no declared work on Elbow"):
        client.undo_serviced(3, by="Bob")
    client.serviced(3, "replaced", by="Ada", why="wrong joint")
    later(daemon, arm, 2)
    assert any("2 replays since then were judged once more" in sentence for sentence in client.undo_serviced(3, by="Bob").text)
    assert belief_from_document(store.assessments.state().belief).learnt_replays.tolist() == [5.0] * 6
    later(daemon, arm, 1)
    assert recompute(store)["identical"] == 6


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ({"joint": 7, "kind": "greased"}, "the arm has 6 joints"),
        ({"joint": 3, "kind": "greased", "at": "2030-01-01"}, "yet to come"),
        ({"joint": 3, "kind": "greased", "at": "2020-01-01"}, "the history begins"),
        ({"joint": 3, "kind": "greased", "at": "yesterday"}, "not a date"),
    ],
)
def test_production_that_does_not_fit_the_arm_is_refused_with_the_reason(cell, client, request_, says):  # noqa: F811
    """Nothing is changed by it."""
    with pytest.raises(BadInput, match=says):
        client.serviced(**request_, by="Ada", why="x")
    assert not cell[1].maintenance.rows()


def test_the_command_asks_a_running_daemon_by_the_joints_number_or_name(cell, shell):  # noqa: F811
    """What it means is said; what names no joint, or no kind of work, is refused."""
    daemon, *_ = cell
    raise_alert(daemon, daemon.alerts._now())
    said = shell("serviced", "--joint", "elbow", "--greased", "--by", "Ada", "--why", "200 h")
    assert "cell-1: Elbow (joint 3) was greased on 2026-01-08 (Ada: 200 h)." in said
    assert "waits for its proof" in said
    said = json.loads(shell("serviced", "--joint", "J3", "--undo", "--by", "Ada", "--why", "not yet", "--json"))
    assert said["done"] == "taken back"
    for wrong in (["--joint", "7"], ["--joint", "hip"]):  # this arm has six joints
        with pytest.raises(BadInput, match=r"expected 1 to 6, or one of base, shoulder, elbow, wrist 1, wrist 2, wrist 3$"):
            shell("serviced", *wrong, "--greased", "--by", "Ada", "--why", "x")
    with pytest.raises(BadInput, match="expected one of --replaced"):
        shell("serviced", "--joint", "3", "--by", "Ada", "--why", "x")


def test_production_declared_while_no_daemon_runs_is_published_by_the_next_one(tmp_path, shell_of, free_port, recording):  # noqa: F811
    """The transition waits in the history as unpublished; the joint is a new one for the next replay."""
    said = shell_of(tmp_path, free_port, "serviced", "--joint", "wrist 1", "--replaced", "--by", "Ada", "--why", "brake")
    assert "Wrist 1 (joint 4) was replaced" in said
    arm = Arm(recording)
    arm.clock_unix_s = 4e9
    with (
        Store.open(tmp_path / "history") as store,
        Daemon(settled(tmp_path, f"tcp/127.0.0.1:{free_port}"), store, now=arm.now, play=arm.play) as daemon,
    ):
        assert daemon.monitor.perform(arm.clock_unix_s).state == "assessed"
        assert daemon.state.estimator.belief.learnt_replays.tolist() == [4, 4, 4, 1, 4, 4]
        assert [row.document["outcome"] for row in store.maintenance.rows()] == ["new_joint"]


def test_a_check_is_recorded_on_the_bus_and_everybody_hears_of_it(cell, client):  # noqa: F811
    """An arm without checks refuses it by name; one with them publishes its document at once."""
    daemon, store, _, _ = cell
    with pytest.raises(BadInput, match="no check of this arm"):
        client.inspected(InspectedRequest(item="flat rings", by="Ada", why="as new"))
    settings = InspectionSettings(plan="universal-robots")
    daemon.state.use(dataclasses.replace(daemon.state.configuration, inspection=settings))
    answer = client.inspected(InspectedRequest(item="flat rings", by="Ada", why="as new"))
    assert answer.inspection.state == "done"
    [message] = client.get("inspection")
    jsonschema.validate(message.document, schema("inspection"))
    assert [item["last_by"] for item in message.document["items"] if item["name"] == "flat rings"] == ["Ada"]
    client.inspected(UndoInspectedRequest(item="flat rings", by="Ada", why="another arm"))
    [row] = store.duties.inspections()
    assert (row.undone_by, row.undone_why) == ("Ada", "another arm")


def test_a_check_is_recorded_from_a_computer_without_the_history(cell, tmp_path):  # noqa: F811
    """The daemon is asked, as for work on a joint; where none answers either, nobody has begun."""
    daemon, store, _, endpoint = cell
    daemon.state.use(dataclasses.replace(daemon.state.configuration, inspection=InspectionSettings(plan="universal-robots")))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    text = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "none"\n[bus]\nlisten = ["{}"]\n'
    command = ["inspected", "flat rings", "--by", "Ada", "--why", "as new", "--config", str(elsewhere / "cell.toml")]
    (elsewhere / "cell.toml").write_text(text.format(endpoint))
    done = CliRunner().invoke(app, command, catch_exceptions=False)
    assert done.output.startswith("cell-1: flat rings: due 20")
    assert [row.done_by for row in store.duties.inspections()] == ["Ada"]
    (elsewhere / "cell.toml").write_text(text.format("tcp/127.0.0.1:9"))
    nobody = CliRunner().invoke(app, command)
    assert "no history yet; the first start" in str(nobody.exception)
    assert not (elsewhere / "none").exists()
