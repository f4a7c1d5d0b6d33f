"""The commands `schedule`, `history`, `export`, `import`, `assess --from-store` and `check` on the history of an arm."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from command_line import printed
from test_backups_and_retention import configuration, lived, recordings  # noqa: F401 - a fixture

from monitor.errors import BadInput, MonitorError
from monitor.recording import Context, Recording
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.store.store import Store

DAY_S = 86_400.0


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
    """Windows are given in local time and in UTC; the last ones with their outcome."""
    document = json.loads(printed("schedule", "--config", str(cell), "--count", "3", "--json"))
    assert [window["local"][-5:] for window in document["windows"]] == ["02:30"] * 3
    assert all(window["opens"].endswith(("00:30:00Z", "01:30:00Z")) for window in document["windows"])
    assert [row["state"] for row in document["last"]] == ["assessed"] * 3
    assert "none on 2026-12-24..2027-01-02" in printed("schedule", "--config", str(cell))


def test_history_prints_what_was_learnt_and_how_much_it_left_out(cell: Path):
    """It prints the newest rows, those of one joint, or those of a span of time."""
    document = json.loads(printed("history", "--config", str(cell), "--joint", "3", "--json"))
    assert [row["replay"] for row in document["rows"]] == [1, 2, 3]
    assert "fc [Nm]" in printed("history", "--config", str(cell), "--limit", "2")
    none = printed("history", "--config", str(cell), "--from", "2030-01-01")
    assert "no replay" in none
    with pytest.raises(BadInput, match="2026-01-31T03:00:00Z"):
        printed("history", "--config", str(cell), "--from", "yesterday")


def test_what_is_exported_can_be_read_by_others_and_a_recording_be_imported_again(cell: Path, tmp_path: Path):
    """CSV and Parquet hold the same figures, and an exported recording holds the stored ones."""
    for name in ("friction.csv", "friction.parquet", "ledger.csv"):
        printed("export", "--config", str(cell), "-o", str(tmp_path / name), "--what", name.split(".")[0])
    parquet = pd.read_parquet(tmp_path / "friction.parquet")
    assert len(parquet) == 18
    assert str(parquet["recorded_at"].dt.tz) == "UTC"
    assert parquet["remaining_life.verdict"].notna().all()
    with (tmp_path / "friction.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["coulomb_nm"]) for row in rows] == list(parquet["coulomb_nm"])
    assert all(cell[:1] not in {"[", "{"} for row in rows for cell in row.values())  # no list in a cell
    assert {"remaining_revolutions.p10", "remaining_revolutions.p50", "remaining_revolutions.p90"} <= set(rows[0])
    for what, full in (("friction", parquet), ("ledger", pd.read_csv(tmp_path / "ledger.csv"))):
        printed("export", "--config", str(cell), "-o", str(tmp_path / "none.csv"), "--what", what, "--from", "2100-01-01", "--force")
        none = pd.read_csv(tmp_path / "none.csv")
        assert len(none) == 0
        assert set(none.columns) <= set(full.columns)
    printed("export", "--config", str(cell), "-o", str(tmp_path / "one.csv"), "--what", "recording", "--replay", "2")
    stored = read_recording(cell.parent / "history" / "recordings" / "replay-000002.parquet")
    assert (read_recording(tmp_path / "one.csv").q == stored.q).all()
    with pytest.raises(BadInput, match="no recording"):
        printed("export", "--config", str(cell), "-o", str(tmp_path / "x.csv"), "--what", "recording", "--replay", "9")
    with pytest.raises(BadInput, match=r"ends in \.csv"):
        printed("export", "--config", str(cell), "-o", str(tmp_path / "x.xls"))


def test_recordings_made_elsewhere_become_history_and_are_marked(tmp_path: Path, recordings: list[Recording]):  # noqa: F811
    """They are judged in time order, and are known the second time; one made before 1970, in the future, or out of order is refused."""
    config = tmp_path / "cell.toml"
    config.write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n')
    files = []
    for day in (3, 1, 2):
        context = Context(robot="ur5", recorded_at_unix_s=1.0e9 + day * DAY_S)
        files.append(tmp_path / f"day-{day}.parquet")
        write_recording(files[-1], replace(recordings[day - 1], context=context, source=""))
    for wrong in (4.0e9, 1.0e15):
        context = Context(robot="ur5", recorded_at_unix_s=wrong)
        write_recording(tmp_path / "to-come.parquet", replace(recordings[0], context=context, source=""))
        with pytest.raises(BadInput, match="between 1970 and now"):
            printed("import", "--config", str(config), str(tmp_path / "to-come.parquet"))
    document = json.loads(printed("import", "--config", str(config), *map(str, files[:2]), "--json"))
    assert (document["assessed"], document["rejected"], document["known_already"]) == (2, [], 0)
    assert "1 assessed" not in printed("import", "--config", str(config), str(files[0]))
    with pytest.raises(BadInput, match="time order"):
        printed("import", "--config", str(config), str(files[2]))
    with Store.reader(tmp_path / "history") as store:
        assert [(row.kind, row.state) for row in store.ledger.rows()] == [("imported", "assessed")] * 2
        assert store.ledger.began_unix_s() is None  # the learning phase begins with the arm's own replays
    assert "the same" in printed("assess", "--from-store", "--config", str(config))


def test_a_recording_that_the_history_holds_is_refused_under_another_date(tmp_path: Path, recordings: list[Recording]):  # noqa: F811
    """In a later import, and as CSV beside the Parquet of then: it would count as a second measurement."""
    config = tmp_path / "cell.toml"
    config.write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n')
    first = tmp_path / "day-1.parquet"
    write_recording(first, replace(recordings[0], context=Context(robot="ur5", recorded_at_unix_s=1.0e9), source=""))
    printed("import", "--config", str(config), str(first))
    printed("export", "--config", str(config), "-o", str(tmp_path / "again.csv"), "--what", "recording", "--replay", "1")
    (tmp_path / "days.csv").write_text("file,recorded_at\nagain.csv,2001-09-20\n")
    with pytest.raises(BadInput, match=r"again.csv: is replay 1 of 2001-09-09T01:46:40Z once more, under another date"):
        printed("import", "--config", str(config), "--manifest", str(tmp_path / "days.csv"))
    assert "0 assessed, 0 rejected, 1 known already" in printed("import", "--config", str(config), str(first))


def imported_names(config: Path, files: list[Path]) -> list[str | None]:
    """The names of the trajectories in the history, after each file was imported alone."""
    for file in files:
        assert json.loads(printed("import", "--config", str(config), str(file), "--json"))["assessed"] == 1
    with Store.reader(config.parent / "history") as store:
        return [read_recording(store.recordings.path(row.id)).context.trajectory_digest for row in store.ledger.rows()]


def test_imported_recordings_of_one_motion_share_a_name_and_a_shorter_motion_has_its_own(tmp_path: Path, recordings: list[Recording]):  # noqa: F811
    """Also where each comes alone: a shorter motion reads friction differently, and must not be held against the baseline of another."""
    config = tmp_path / "cell.toml"
    config.write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[store]\ndirectory = "history"\n')
    files = []
    for day, rows in enumerate((slice(None), slice(None), slice(0, recordings[2].samples * 7 // 10))):
        made, context = recordings[day], Context(robot="ur5", recorded_at_unix_s=1.0e9 + day * DAY_S)
        columns = ("t_s", "q", "qd", "qdd", "current", "torque", "target_current", "temperature_c")
        cut = {name: value[rows] for name in columns if (value := getattr(made, name)) is not None}
        files.append(tmp_path / f"day-{day}.parquet")
        write_recording(files[-1], Recording(**cut, context=context))
    first, again, shorter = imported_names(config, files)
    assert first is not None
    assert first == again
    assert shorter not in (first, None)


def test_every_past_verdict_is_recomputed_from_the_store(cell: Path):
    """All verdicts come out the same; an option beside --config is refused."""
    document = json.loads(printed("assess", "--from-store", "--config", str(cell), "--json"))
    assert (document["identical"], document["different"]) == (3, 0)
    with pytest.raises(BadInput, match="nothing else beside it"):
        printed("assess", "--from-store", "--config", str(cell), "--robot", "ur5")


def test_check_reports_whether_the_service_could_run(cell: Path, tmp_path: Path):
    """It checks configuration, history, disk and clock. An arm that does not answer does not prevent the service."""
    document = json.loads(printed("check", "--config", str(cell), "--json", code=3))
    assert {each["name"]: each["holds"] for each in document["service"]} == {
        "configuration": True,
        "history": True,
        "disk": True,
        "clock": True,
        "socket_lock": True,
        "schedule": True,
    }
    assert document["may_run"]
    assert not document["may_move"]
    assert document["gateway"] is None
    (tmp_path / "history").mkdir()
    (tmp_path / "history" / "history.sqlite").write_bytes(b"no database" * 1000)
    (tmp_path / "cell.toml").write_text(cell.read_text())
    document = json.loads(printed("check", "--config", str(tmp_path / "cell.toml"), "--json", code=3))
    assert [each["name"] for each in document["service"] if not each["holds"]] == ["history"]
    assert not document["may_run"]


def test_check_says_how_far_the_channels_get_whose_file_lies_beside_the_arm_s(cell: Path, tmp_path: Path):
    """Each by its steps; a file that is wrong is told. Neither speaks against the service."""
    (tmp_path / "cell.toml").write_text(cell.read_text())
    for text, step, says in (
        ('[mqtt]\nhost = "127.0.0.1"\nport = 9\ntls = false\n', "tcp", "127.0.0.1:9: nobody listens there"),
        ('[mqtt]\nhost = "h"\npassword = "credential:absent"\n', "settings", "the credential absent"),
    ):
        (tmp_path / "plant.toml").write_text(text)
        document = json.loads(printed("check", "--config", str(tmp_path / "cell.toml"), "--json", code=3))
        assert document["gateway"]["file"] == str(tmp_path / "plant.toml")
        last = document["gateway"]["findings"][-1]
        assert (last["step"], last["ok"], says in last["text"], document["may_run"]) == (step, False, True, True)
    assert "gateway, gateway: settings: FAILED:" in printed("check", "--config", str(tmp_path / "cell.toml"), code=3)


def test_a_new_arm_does_not_cost_the_report_of_the_others(cell: Path, tmp_path: Path):
    """It is named with its reason, on the page, in the JSON and on the terminal; alone it is a mistake as before."""
    new = tmp_path / "new.toml"
    new.write_text('[robot]\nmodel = "ur5"\nsite = "lab"\nid = "new"\n[store]\ndirectory = "nothing"\n')
    text = printed("report", "--config", str(cell), "--config", str(new), "-o", str(tmp_path / "report.html"))
    assert "not in it: lab/new: " in text
    assert "no history yet" in text
    assert "no history yet" in (tmp_path / "report.html").read_text("utf-8")
    document = json.loads(printed("report", "--config", str(new), "--config", str(cell), "--json"))
    assert [one["id"] for one in document["left_out"]] == ["new"]
    assert len(document["reports"]) == 1
    with pytest.raises(MonitorError, match="no history yet"):
        printed("report", "--config", str(new), "-o", str(tmp_path / "none.html"))
