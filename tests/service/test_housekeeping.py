"""The maintenance of the monitor, and the report of its own state: document, file and metrics."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import pytest
from published import last_values
from test_backups_and_retention import HISTORY, configuration, torn
from test_store import DAY, commit, replayed

from monitor.errors import StoreUnavailable
from monitor.publish.documents import ArmLink, Waiting, as_json
from monitor.publish.metrics import families
from monitor.publish.registry import schema
from monitor.publish.timestamps import utc
from monitor.service.housekeeping import Housekeeping
from monitor.service.monitor_document import MonitorDocument, OfOthers, not_watched, read_monitor_document, silent_s
from monitor.service.problems import Problems
from monitor.store.backup import backups
from monitor.store.store import Store
from monitor.views.terminal.arm import print_status

MORE = OfOthers(
    reload=None,
    next_replay_due=utc(1.8e9),
    next_replay_why="cron",
    due=None,
    lag_s=0.7,
    arm=ArmLink(heard=True),
    bus=Waiting(to_send=1, to_answer=2, dropped=3),
    workers={"replays": 0.1},
    overrides=[],
)


@pytest.fixture
def maintenance(tmp_path: Path) -> Iterator[tuple[Housekeeping, Store, Problems, list[float]]]:
    """The maintenance of a history of fifteen replays, with a clock that a test may set."""
    clock = [1.7e9]
    with Store.open(tmp_path) as store:
        for n in range(15):
            commit(store, replayed(store, 1.6e9 + n * DAY))
        problems = Problems(lambda: clock[0])
        yield Housekeeping(store, lambda: configuration(tmp_path).store, problems, lambda: clock[0]), store, problems, clock


def document_of(store: Store, problems: Problems, clock: list[float]) -> MonitorDocument:
    return MonitorDocument(store, problems, lambda: clock[0])


def test_starts_make_at_most_one_backup_an_hour(maintenance):
    """A service that restarts repeatedly makes one backup an hour."""
    maintenance, store, _, _ = maintenance
    maintenance.check()
    made = backups(store.directory)
    assert len(made) == 1
    maintenance.maintain()
    assert backups(store.directory) == made
    old = made[0].with_name("history-20260101T000000Z.sqlite")
    made[0].rename(old)
    maintenance.maintain()
    assert len(backups(store.directory)) == 2


def test_damage_found_at_run_time_ends_the_service_and_changes_no_backup(maintenance):
    """The next start restores the history. Until then the problem is reported."""
    maintenance, store, problems, _ = maintenance
    maintenance.check()
    good = backups(store.directory)
    store.database.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    torn(store.directory / HISTORY)
    maintenance.maintain()
    assert maintenance.damaged
    assert "store" in problems
    assert backups(store.directory) == good


def test_a_clock_behind_the_history_is_a_problem_until_it_has_caught_up(maintenance):
    """The clock is a year ahead, and then right again."""
    maintenance, _, problems, clock = maintenance
    clock[0] = 1.6e9 - 365 * DAY
    maintenance.check()
    assert "set back" in problems.listed()[0].text
    clock[0] = 1.7e9
    maintenance.check()
    assert "clock_behind" not in problems


def test_rejected_replays_do_not_keep_the_clock_behind(maintenance):
    """Replays that were rejected because of a wrong clock are not waited for."""
    maintenance, store, problems, clock = maintenance
    commit(store, replayed(store, 1.9e9))
    clock[0] = 1.8e9
    maintenance.check()
    assert "clock_behind" in problems
    store.ledger.end(replayed(store, 2.0e9), "rejected", "a test", 2.0e9)
    store.database.connection.execute("UPDATE ledger SET state = 'rejected' WHERE window_unix_s = 1.9e9")
    maintenance.check()
    assert "clock_behind" not in problems


def test_a_stop_is_a_problem_until_a_person_has_checked_the_arm(maintenance):
    """The monitor's state reports that nothing moves, the reason, and what to do."""
    maintenance, store, problems, _ = maintenance
    store.stops.add("protective_stop", "the arm met something", 1.6e9)
    maintenance.check()
    (trouble,) = [each for each in problems.listed() if each.name == "stop"]
    assert "the arm met something" in trouble.text
    assert "joint-monitor allow" in trouble.text
    store.stops.allow("Ada", "a box; it is gone", 1.6e9)
    maintenance.check()
    assert "stop" not in problems


def test_the_monitor_reports_its_state_although_the_history_cannot_be_read(maintenance, monkeypatch: pytest.MonkeyPatch):
    """A failing disk is a problem like others: the state is published, and the watchdog is notified."""
    _, store, problems, clock = maintenance

    def failing(*_: object, **__: object) -> None:
        raise StoreUnavailable("disk I/O error")

    monkeypatch.setattr(store.ledger, "rows", failing)
    document = as_json(document_of(store, problems, clock).collect(MORE))
    jsonschema.validate(document, schema("monitor"), format_checker=jsonschema.FormatChecker())
    assert document["last_replay"] is None
    assert [trouble["name"] for trouble in document["troubles"]] == ["store"]


def test_status_reports_a_monitor_that_no_longer_publishes(maintenance, capsys: pytest.CaptureFixture[str]):
    """`status` distinguishes a monitor that ended weeks ago from one that runs."""
    _, store, problems, clock = maintenance
    clock[0] = 1.7e9
    document = document_of(store, problems, clock).collect(MORE)
    assert silent_s(document, 1.7e9 + 30.0) is None
    assert silent_s(document, 1.7e9 + 3 * DAY) == 3 * DAY
    status = {"robot": "cell-1", "model_revision": 0, "health": None, "friction": [], "ledger": [], "monitor": as_json(document)}
    print_status({**status, "not_watched": not_watched(document, 1.7e9 + 3 * DAY).text})
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith("NOT WATCHED: the monitor does not run, or cannot write: it wrote last at 20")
    assert "3 days ago" in first
    assert "NORMAL" not in second or "NORMAL then" in second
    about = document_of(store, problems, clock)
    about.write(document)
    about.write_end()
    assert not_watched(read_monitor_document(store.directory), 1.7e9 + 5.0).text == "the monitor was stopped at 2023-11-14T22:13:20Z"
    running = document.model_copy(update={"said_at": utc(1.7e9)})
    assert not_watched(running, 1.7e9 + 5.0) is None
    with subprocess.Popen([sys.executable, "-c", ""]) as killed:
        pass
    gone = running.model_copy(update={"process": running.process.model_copy(update={"pid": killed.pid})})
    assert not_watched(gone, 1.7e9 + 5.0).text == "the monitor was killed, or its host restarted, after 2023-11-14T22:13:20Z"
    elsewhere = gone.model_copy(update={"process": gone.process.model_copy(update={"pid_namespace": "another host's"})})
    assert not_watched(elsewhere, 1.7e9 + 5.0) is None  # its processes cannot be seen from here
    for odd in ("[]", "{", '{"said_at": 3}', '{"said_at": "2026-10-18T03:00:00Z"}'):
        (store.directory / "monitor.json").write_text(odd)
        assert read_monitor_document(store.directory) is None
    assert "no monitor has run" in not_watched(None, 0.0).text
    print_status({**status, "not_watched": None})
    assert "NOT WATCHED" not in capsys.readouterr().out


def test_the_monitor_document_is_valid_by_its_schema_and_printed_by_status(maintenance):
    """The document is complete, or everything in it is unknown."""
    _, store, problems, clock = maintenance
    problems.report("disk", "full")
    document = as_json(document_of(store, problems, clock).collect(MORE))
    jsonschema.validate(document, schema("monitor"), format_checker=jsonschema.FormatChecker())
    assert document["last_replay"]["state"] == "assessed"
    document_of(store, problems, clock).write(document_of(store, problems, clock).collect(MORE))
    written = read_monitor_document(store.directory)
    same = ("version", "started_at", "last_replay", "troubles", "next_replay_due", "arm", "bus", "reload")
    assert {name: as_json(written)[name] for name in same} == {name: document[name] for name in same}
    assert read_monitor_document(store.directory / "nowhere") is None


def test_the_monitor_document_is_in_the_metrics_too(maintenance):
    """Every known figure is there under its name, and so is every problem."""
    maintenance, store, problems, clock = maintenance
    maintenance.check()
    problems.report("backup", "no room")
    info = last_values({"info": {"robot": {"site": "lab", "id": "cell-1"}, "version": "1"}})
    last = {**info, "monitor": document_of(store, problems, clock).collect(MORE)}
    samples = {sample.name: sample for family in families(last) for sample in family.samples}
    assert samples["joint_monitor_arm_heard"].value == 1.0
    assert samples["joint_monitor_documents_dropped"].value == 3.0
    assert samples["joint_monitor_trouble"].labels["name"] == "backup"
    assert samples["joint_monitor_last_replay"].labels["state"] == "assessed"
    assert abs(samples["joint_monitor_last_backup_timestamp_seconds"].value - time.time()) < 60.0
    assert samples["joint_monitor_disk_free_bytes"].value > 0
    assert not {name for name in (sample.name for family in families({}) for sample in family.samples) if "trouble" in name}
