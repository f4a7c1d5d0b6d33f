"""The commands of a service that lasts, as a user types them: schedule, history, export, import, assess --from-store, status, check."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from test_backups_and_retention import configuration, lived, recordings  # noqa: F401 - a fixture
from typer.testing import CliRunner

from monitor.cli.main import app
from monitor.errors import MonitorError
from monitor.recording import Context, Recording
from monitor.store.recordings import read_recording, write_recording
from monitor.store.store import Store

DAY = 86_400.0


def run(*arguments: str, code: int = 0) -> str:
    done = CliRunner().invoke(app, arguments)  # in this process: the interpreter's start would be most of the test
    ended, said = done.exit_code, done.stdout
    if isinstance(done.exception, MonitorError):
        ended, said = done.exception.exit_code, str(done.exception)
    assert ended == code, (done.exception, done.output)
    return said


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory, recordings: list[Recording]) -> Path:  # noqa: F811
    """The configuration of an arm with three days of history."""
    folder = tmp_path_factory.mktemp("cell")
    config = folder / "cell.toml"
    config.write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\nhost = "127.0.89.1"\n[store]\ndirectory = "history"\n'
        '[schedule]\ntimezone = "Europe/Berlin"\ncron = "30 2 * * *"\nblackout = ["2026-12-24..2027-01-02"]\n'
        "[replay]\nstartup_timeout_s = 1.0\n"
    )
    with Store.open(folder / "history") as store:
        lived(store, configuration(folder / "history"), recordings, range(3))
    return config


def test_schedule_lists_the_next_windows_in_the_sites_own_time(cell: Path):
    """Local and UTC, and what became of the last ones."""
    told = json.loads(run("schedule", "--config", str(cell), "--count", "3", "--json"))
    assert [window["local"][-5:] for window in told["windows"]] == ["02:30"] * 3
    assert all(window["opens"].endswith(("00:30:00Z", "01:30:00Z")) for window in told["windows"])
    assert [row["state"] for row in told["last"]] == ["assessed"] * 3
    assert "none on 2026-12-24..2027-01-02" in run("schedule", "--config", str(cell))


def test_history_tells_what_was_learnt_and_says_what_it_left_out(cell: Path):
    """Newest rows by default; one joint; a span of time."""
    told = json.loads(run("history", "--config", str(cell), "--joint", "3", "--json"))
    assert [row["replay"] for row in told["rows"]] == [1, 2, 3]
    assert "fc [Nm]" in run("history", "--config", str(cell), "--limit", "2")
    none = run("history", "--config", str(cell), "--from", "2030-01-01")
    assert "no replay" in none
    assert "2026-01-31T03:00:00Z" in run("history", "--config", str(cell), "--from", "yesterday", code=2)


def test_what_is_exported_can_be_read_by_others_and_a_recording_be_imported_again(cell: Path, tmp_path: Path):
    """CSV and Parquet say the same; the recording's figures are the stored ones."""
    for name in ("friction.csv", "friction.parquet", "ledger.csv"):
        run("export", "--config", str(cell), "-o", str(tmp_path / name), "--what", name.split(".")[0])
    parquet = pd.read_parquet(tmp_path / "friction.parquet")
    assert len(parquet) == 18
    assert str(parquet["recorded_at"].dt.tz) == "UTC"
    assert parquet["remaining_life.verdict"].notna().all()
    with (tmp_path / "friction.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["coulomb_nm"]) for row in rows] == list(parquet["coulomb_nm"])
    for what, full in (("friction", parquet), ("ledger", pd.read_csv(tmp_path / "ledger.csv"))):
        run("export", "--config", str(cell), "-o", str(tmp_path / "none.csv"), "--what", what, "--from", "2100-01-01")
        none = pd.read_csv(tmp_path / "none.csv")
        assert len(none) == 0
        assert set(none.columns) <= set(full.columns)
    run("export", "--config", str(cell), "-o", str(tmp_path / "one.csv"), "--what", "recording", "--replay", "2")
    stored = read_recording(cell.parent / "history" / "recordings" / "replay-000002.parquet")
    assert (read_recording(tmp_path / "one.csv").q == stored.q).all()
    assert "no recording" in run(
        "export", "--config", str(cell), "-o", str(tmp_path / "x.csv"), "--what", "recording", "--replay", "9", code=2
    )
    assert "ends in .csv" in run("export", "--config", str(cell), "-o", str(tmp_path / "x.xls"), code=2)


def test_recordings_made_elsewhere_become_history_and_are_marked(tmp_path: Path, recordings: list[Recording]):  # noqa: F811
    """In time order whatever the order of the files; a second time they are known; none is taken of before or of a time to come."""
    config = tmp_path / "cell.toml"
    config.write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n')
    files = []
    for day in (3, 1, 2):
        context = Context(robot="ur5", recorded_at_unix_s=1.0e9 + day * DAY)
        files.append(tmp_path / f"day-{day}.parquet")
        write_recording(files[-1], replace(recordings[day - 1], context=context, source=""))
    for wrong in (4.0e9, 1.0e15):
        context = Context(robot="ur5", recorded_at_unix_s=wrong)
        write_recording(tmp_path / "to-come.parquet", replace(recordings[0], context=context, source=""))
        assert "between 1970 and now" in run("import", "--config", str(config), str(tmp_path / "to-come.parquet"), code=2)
    told = json.loads(run("import", "--config", str(config), *map(str, files[:2]), "--json"))
    assert (told["assessed"], told["rejected"], told["known_already"]) == (2, [], 0)
    assert "1 assessed" not in run("import", "--config", str(config), str(files[0]))
    assert "time order" in run("import", "--config", str(config), str(files[2]), code=2)
    with Store.reader(tmp_path / "history") as store:
        assert [(row.kind, row.state) for row in store.ledger.rows()] == [("imported", "assessed")] * 2
        assert store.ledger.began_unix_s() is None  # the learning phase begins with the arm's own replays
    assert "the same" in run("assess", "--from-store", "--config", str(config))


def test_every_past_verdict_is_recomputed_from_the_store(cell: Path):
    """All the same: exit 0; one altered: exit 3, named."""
    told = json.loads(run("assess", "--from-store", "--config", str(cell), "--json"))
    assert (told["identical"], told["different"]) == (3, 0)
    assert "nothing else beside it" in run("assess", "--from-store", "--config", str(cell), "--robot", "ur5", code=2)


def test_check_says_whether_the_service_could_run(cell: Path, tmp_path: Path):
    """Configuration, history, disk, clock; an arm that does not answer is its own matter."""
    said = run("check", "--config", str(cell), "--json", code=3)
    told = json.loads(said)
    assert {each["name"]: each["holds"] for each in told["service"]} == {
        "configuration": True,
        "history": True,
        "disk": True,
        "clock": True,
    }
    assert told["may_run"]
    assert not told["may_move"]
    (tmp_path / "history").mkdir()
    (tmp_path / "history" / "history.sqlite").write_bytes(b"no database" * 1000)
    (tmp_path / "cell.toml").write_text(cell.read_text())
    said = run("check", "--config", str(tmp_path / "cell.toml"), "--json", code=3)
    told = json.loads(said)
    assert [each["name"] for each in told["service"] if not each["holds"]] == ["history"]
    assert not told["may_run"]
