"""Configurations by name, several at once, times where people are, and outputs that are not replaced unasked."""

import json
import re
from zoneinfo import ZoneInfo

import pytest
from command_line import ended
from heard_documents import ALERT, whole

from monitor.judge.alerts.conditions import NOTHING_MOVES
from monitor.reason import reason_of, with_reasons
from monitor.views.terminal.arm import print_alerts, print_status
from monitor.views.terminal.figures import local_times
from monitor.views.terminal.progress import progress, progress_text

STOPPED = {"joint": None, "condition": "stopped", "tier": "advisory", "action": "Look at the arm.", "change": 0.0}


@pytest.fixture
def arms(tmp_path, monkeypatch, replayed):
    """Two configurations of the service's folder, one of which has a history, in the time zone of Berlin."""
    monkeypatch.setattr("monitor.cli.options.FOR_ALL", tmp_path)
    monkeypatch.setattr("monitor.cli.daemon.FOR_ALL", tmp_path)
    for name in ("cell-1", "cell-2"):
        text = (
            f'[robot]\nmodel = "ur5"\nsite = "hall"\nid = "{name}"\n[schedule]\ntimezone = "Europe/Berlin"\n[store]\ndirectory = "{name}"\n'
        )
        (tmp_path / f"{name}.toml").write_text(text)
    (tmp_path / "days.csv").write_text(f"file,recorded_at\n{replayed[0]},2026-07-18T01:30:35Z\n")
    assert ended("import", "--config", "cell-1", "--manifest", tmp_path / "days.csv").returncode == 0
    return tmp_path


def test_a_configuration_is_named_by_its_name_by_a_variable_and_several_at_once(arms, monkeypatch):
    """status cell-1 reads /etc/joint-monitor/cell-1.toml; without a name all are shown, and the one without a history is named."""
    assert "cell-1: CHECK_FUNCTION then" in ended("status", "cell-1").stdout
    monkeypatch.setenv("JOINT_MONITOR_CONFIG", str(arms / "cell-1.toml"))
    assert "cell-1: CHECK_FUNCTION then" in ended("status").stdout
    assert ended("history", "--json").returncode == 0
    monkeypatch.delenv("JOINT_MONITOR_CONFIG")
    both = ended("status", "--json")
    assert [each["robot"] for each in json.loads(both.stdout)["robots"]] == ["cell-1"]
    assert both.returncode == 2
    assert "cell-2" in both.stderr
    twice = ended("status", "--config", arms / "cell-1.toml", "--config", "cell-1")
    assert twice.stdout.count("cell-1: CHECK_FUNCTION then") == 2


def test_times_are_those_of_the_schedules_zone(arms):
    """01:30 UTC in July is 03:30 in Berlin; documents keep UTC."""
    assert "2026-07-18 03:30:35 CEST" in ended("status", "cell-1").stdout.replace("\n", " ")
    assert "2026-07-18T01:30:35Z" in ended("status", "cell-1", "--json").stdout
    assert local_times(["at 2026-01-01T00:00:00Z"], ZoneInfo("UTC")) == ["at 2026-01-01T00:00:00Z"]


def test_a_reason_that_repeats_is_said_once(capsys):
    """Seven windows in a row that were skipped for the same reason are one line."""
    ledger = [{"replay": n, "window": f"2026-01-{n:02d}T03:00:00Z", "state": "skipped", "reason": "too far"} for n in range(1, 8)]
    ledger.append({"replay": 8, "window": "2026-01-08T03:00:00Z", "state": "assessed", "reason": None})
    document = {
        "said_at": "2026-01-09T00:00:00Z",
        "robot": "a",
        "health": None,
        "model_revision": 0,
        "friction": [],
        "ledger": ledger,
        "monitor": None,
    }
    print_status(document)
    shown = capsys.readouterr().out
    assert "replay 7  2026-01-07T03:00:00Z  skipped and 6 before it  too far" in shown
    assert shown.count("too far") == 1
    text = NOTHING_MOVES(since_unix_s=0.0, why=reason_of("too far"))
    health = whole("health", state="CHECK_FUNCTION", alerts=[with_reasons(STOPPED, text=text)])
    print_status(document | {"health": health})
    shown = capsys.readouterr().out
    assert shown.count("too far") == 1
    assert "skipped and 6 before it  as above" in shown


WORN = {**ALERT, "action": "Plan an inspection.", "change": 0.17}


def test_the_days_that_remain_count_from_the_replay_that_found_them(arms, capsys):
    """Read days later, or beside a trial whose clock is not the host's, the day by which to inspect is the same."""
    document = json.loads(ended("status", "cell-1", "--json").stdout)
    assert {row["recorded_at"] for row in document["friction"]} == {"2026-07-18T01:30:35Z"}
    health = document["health"] | {"alerts": [WORN | {"text": "Friction rose."}]}
    for row in document["friction"]:
        row["remaining_life"] = {"trend_probability": 0.9, "verdict": "trend", "p10_days": 13.0, "p50_days": 15.0, "p90_days": 18.0}
    for said_at in ("2026-07-18T02:00:00Z", "2026-07-26T02:00:00Z"):
        print_status(document | {"said_at": said_at, "health": health})
        assert "Inspect by 31 July." in " ".join(capsys.readouterr().out.split())


def test_a_cleared_alert_says_when_it_cleared_and_asks_for_nothing(capsys):
    """Its advice was for as long as it was active."""
    times = {"raised_at": "2026-01-24T03:00:10Z", "acknowledged_at": None, "shelved_until": None}
    print_alerts([WORN | times | {"active": False, "cleared_at": "2026-02-17T03:00:00Z", "text": "The joint was replaced."}])
    shown = capsys.readouterr().out
    assert "cleared since 2026-02-17T03:00:00Z, raised 2026-01-24T03:00:10Z" in shown
    assert "Plan an inspection" not in shown


def test_a_reason_is_not_called_that_of_another_window(capsys):
    """`as above` means the reason that was named last: another one between them, and it is said in full."""
    reasons = ("protective stop", "the program was stopped", "protective stop")
    row = {"window": "2026-01-01T03:00:00Z", "state": "aborted"}
    ledger = [row | {"replay": n, "reason": reason} for n, reason in enumerate(reasons, start=1)]
    print_status({"said_at": "2026-01-09T00:00:00Z", "robot": "a", "model_revision": 0, "health": None, "friction": [], "ledger": ledger})
    shown = capsys.readouterr().out
    assert shown.count("aborted  protective stop") == 2
    assert "as above" not in shown


def test_a_joint_that_the_arm_lacks_is_named(arms):
    """With the number of joints that it has."""
    refused = ended("history", "--joint", 7, "--config", "cell-1")
    assert refused.returncode == 2
    assert "--joint '7': expected 1 to 6, or one of base" in refused.stderr


def test_a_damaged_history_says_what_becomes_of_it(arms):
    """A person who only looks learns that the next start restores it, and does not repair it by hand."""
    (arms / "cell-1" / "history.sqlite").write_bytes(b"no database" * 1000)
    looked = ended("status", "cell-1")
    assert looked.returncode == 1
    assert "puts the newest good backup in its place" in looked.stderr


def test_an_output_is_not_replaced_unasked(arms):
    """Export and report refuse a file that exists; --force replaces it."""
    for command, name in (("export", "a.csv"), ("report", "a.html")):
        output = arms / name
        output.write_text("mine")
        refused = ended(command, "--config", "cell-1", "-o", output)
        assert refused.returncode == 2
        assert "--force" in refused.stderr
        assert output.read_text("utf-8") == "mine"
        assert ended(command, "--config", "cell-1", "-o", output, "--force").returncode == 0
        assert output.read_text("utf-8") != "mine"
    for command in ("replay", "record"):
        (arms / "a.parquet").write_text("mine")
        assert "--force" in ended(command, "--config", "cell-1", "-o", arms / "a.parquet").stderr


def test_the_list_of_commands_is_not_cut_and_models_are_listed():
    """Every sentence of --help is whole, and every model says whether its gains are known."""
    shown = ended("--help").stdout
    assert "..." not in shown.partition("Commands:")[2]
    assert "Moves nothing." in re.sub(r"\s+", " ", shown)
    assert "--install-completion" in shown
    listed = ended("models").stdout
    assert "ur5e" in listed
    assert re.search(r"ur3 .*published", listed)


def test_progress_says_what_is_under_way_and_how_much_is_left(capsys, monkeypatch):
    """Also where there is no terminal: a line every five seconds."""
    assert progress_text("replay", "slow first pass", 40.2, 52.0) == "replay: slow first pass, 40 s of 52"
    clock = [0.0]
    monkeypatch.setattr("monitor.views.terminal.progress.time.monotonic", lambda: clock[0])
    with progress("replay") as show:
        show("way to the start", 0.5, 4.0)
        clock[0] = 6.0
        show("slow first pass", 2.0, 40.0)
    assert capsys.readouterr().err == "replay: slow first pass, 2 s of 40\n"
