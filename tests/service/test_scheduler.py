"""The scheduler's thread with failing clocks, disks and processes: no window twice or late, and it continues by itself."""

import logging
import os
import sqlite3
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from test_backups_and_retention import configuration, lived, recordings  # noqa: F401 - a fixture

from monitor.acquire.schedule.needed import Need, Told, need
from monitor.errors import StoreError
from monitor.recording import Recording
from monitor.service.history.assess_and_store import EstimatorState, load_state
from monitor.service.history.recompute import roll_back
from monitor.service.problems import Problems
from monitor.service.scheduler import Clocks, Scheduler, too_little_room
from monitor.service.shared_state import ReplayRequests
from monitor.store.history.ledger import LedgerRow
from monitor.store.store import Store

DAY = 86_400.0
START = 1_780_272_000.0  # 2026-06-01T00:00Z


class Arm:
    """A daemon with replays of no duration and a real ledger."""

    def __init__(self, folder: Path, store: Store, **schedule: Any) -> None:
        self.configuration = configuration(folder, schedule=schedule)
        self.store, self.clock = store, [START, 0.0]
        self.problems = Problems(lambda: self.clock[0])
        self.replayed: list[float] = []
        self.due: float | None = None
        self.mended = self.rewound = 0
        self.fails: Exception | None = None
        self.outcome = "rejected"
        self.told = Told()
        self.known_rows: set[int] = set()
        self.requests = ReplayRequests()
        self.scheduler = self.started()

    def started(self) -> Scheduler:
        return Scheduler(self, self.store, self.problems, self.requests, Clocks(now=lambda: self.clock[0], monotonic=lambda: self.clock[1]))

    def perform(self, window_unix_s: float, kind: str = "scheduled", closes_unix_s: float | None = None) -> LedgerRow | None:
        if self.fails is not None:
            raise self.fails
        ledger_id = self.store.ledger.claim(window_unix_s, kind, self.clock[0])
        if ledger_id is None:
            return None
        self.replayed.append(window_unix_s)
        self.due_meanwhile = getattr(self, "due", None)
        self.store.ledger.end(ledger_id, self.outcome, "a test", self.clock[0])
        return self.store.ledger.row(ledger_id)

    def skip(self, window_unix_s: float, reason: str, kind: str = "scheduled") -> None:
        ledger_id = self.store.ledger.claim(window_unix_s, kind, self.clock[0])
        if ledger_id is not None:
            self.store.ledger.end(ledger_id, "skipped", reason, self.clock[0])

    def recover(self) -> None:
        self.mended += 1
        self.store.ledger.repair(self.clock[0])

    def roll_back(self) -> bool:
        self.rewound += 1
        return roll_back(self.store, self.clock[0]) is not None

    def next_due(self, unix_s: float | None) -> None:
        self.due = unix_s

    def needed(self) -> Need:
        return need(self.configuration.schedule, self.told)

    def missing_row(self, temperature_c: Sequence[float]) -> int | None:
        """Each row of 5 K is known after one replay."""
        row = round(temperature_c[0] / 5.0)
        return None if row in self.known_rows else row

    def passes(self, seconds: float, step: float = 240.0) -> None:
        """Advance both clocks, with one tick of the scheduler in each step."""
        while seconds > 0:
            by = min(step, seconds)
            self.clock[0] += by
            self.clock[1] += by
            seconds -= by
            self.scheduler.tick()

    def states(self) -> list[tuple[str, str]]:
        return [(row.state, row.reason_text or "") for row in self.store.ledger.rows()]


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Arm]:
    with Store.open(tmp_path / "history") as store:
        yield Arm(tmp_path / "history", store, cron="0 3 * * *", grace_s=600.0)


def test_a_week_has_a_replay_a_day_and_the_next_one_is_published(arm: Arm):
    """The replay is at 03:00, with the first tick after it."""
    arm.passes(7 * DAY)
    assert arm.replayed == [START + day * DAY + 3 * 3600.0 for day in range(7)]
    assert arm.due == START + 7 * DAY + 3 * 3600.0
    assert arm.scheduler.lag_s is not None
    assert arm.scheduler.lag_s <= 240.0


def test_missed_windows_are_reported_and_never_replayed_later(arm: Arm):
    """The host is off for four nights and starts at noon: four rows are skipped, and the fifth night has its replay."""
    arm.passes(DAY)
    arm.clock[0] += 3 * DAY + 12 * 3600.0
    arm.scheduler = arm.started()
    arm.passes(12 * 3600.0 + 4 * 3600.0)
    assert [state for state, _ in arm.states()] == ["rejected", *["skipped"] * 4, "rejected"]
    assert "not running" in arm.states()[1][1]


def test_a_clock_set_back_repeats_no_window_and_one_set_forward_waits_before_it_counts(arm: Arm):
    """Two days back: the ledger has those windows. A year forward: an hour passes without motion, then the clock is accepted."""
    arm.passes(3 * DAY)
    before = list(arm.replayed)
    arm.clock[0] -= 2 * DAY
    arm.passes(2 * DAY)
    assert arm.replayed == before
    arm.passes(DAY)
    assert len(arm.replayed) == len(before) + 1
    arm.clock[0] += 365 * DAY + 3 * 3600.0 - 60.0  # into a window
    arm.scheduler.tick()
    assert "clock" in arm.problems
    assert arm.scheduler.coming(1)[0].opens_unix_s > arm.clock[0] + 3500.0  # no window is announced for that hour
    arm.passes(300.0)
    assert len(arm.replayed) == len(before) + 1
    arm.passes(2 * DAY)
    assert "clock" not in arm.problems
    assert len(arm.replayed) == len(before) + 3


def test_replays_of_a_clock_that_was_a_year_ahead_are_rejected_automatically(tmp_path: Path, recordings: list[Recording]):  # noqa: F811
    """A replay is learnt while the clock is ahead. When it is set back, that replay is rejected and the windows open again."""
    with Store.open(tmp_path / "history") as store:
        arm = Arm(tmp_path / "history", store, cron="0 3 * * *")
        arm.clock[0] = 1.0e9 + 2 * DAY
        arm.scheduler = arm.started()
        before = lived(store, arm.configuration, recordings, range(2))
        arm.passes(3600.0)
        arm.clock[0] += 365 * DAY
        arm.passes(2 * 3600.0)
        lived(store, arm.configuration, recordings, range(368, 370))
        assert load_state(store).belief.at_unix_s > arm.clock[0]
        arm.clock[0] -= 365 * DAY
        arm.scheduler.tick()
        after = load_state(store)
        assert after.belief.as_document() == before.belief.as_document()
        assert after.health.as_document() == before.health.as_document()
        assert [state for state, _ in arm.states()].count("assessed") == 2
        assert "dated in the future" in arm.states()[-1][1]
        arm.passes(2 * DAY)
        assert len(arm.replayed) >= 1


def test_a_clock_that_was_only_set_back_rejects_no_replay(tmp_path: Path, recordings: list[Recording]):  # noqa: F811
    """The history is right and the clock is wrong, so nothing of the history is rejected."""
    with Store.open(tmp_path / "history") as store:
        arm = Arm(tmp_path / "history", store, cron="0 3 * * *")
        arm.clock[0] = 1.0e9 + 2 * DAY
        arm.scheduler = arm.started()
        lived(store, arm.configuration, recordings, range(2))
        arm.passes(3600.0)
        arm.clock[0] -= 365 * DAY
        arm.passes(3600.0)
        assert [state for state, _ in arm.states()].count("assessed") == 2
        arm.clock[0] += 365 * DAY
        arm.passes(3 * 3600.0)
        assert [state for state, _ in arm.states()].count("assessed") == 2
        assert isinstance(load_state(store), EstimatorState)


def test_while_the_store_fails_nothing_moves_and_it_is_tried_again(arm: Arm):
    """The failure is reported as a problem until the store works again. The window is used while it is still open."""
    stopping = threading.Event()
    arm.clock[0] = START + 3 * 3600.0
    arm.fails = StoreError("the disk is full")
    ticks = [0]

    def beat() -> None:
        ticks[0] += 1
        arm.clock[0] += 60.0
        arm.clock[1] += 60.0
        if ticks[0] == 3:
            assert "store" in arm.problems
            arm.fails = None
        if ticks[0] == 6:
            stopping.set()
        arm.scheduler.reconsider()

    arm.scheduler.run(stopping, beat)
    assert arm.mended >= 1
    assert "store" not in arm.problems
    assert arm.replayed == [START + 3 * 3600.0]


def test_a_lock_that_somebody_holds_on_the_history_is_one_line_and_its_end_another(arm: Arm, caplog):
    """What is locked can still be read: that alone is no end, or each write of 5 s would be a pair of lines."""
    caplog.set_level(logging.INFO)
    arm.store.database.connection.execute("PRAGMA busy_timeout = 20")
    with closing(sqlite3.connect(arm.store.directory / "history.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        for _ in range(4):
            arm.problems.report("store", "locked")  # by a thread that had to write
            with pytest.raises(StoreError, match="locked"):
                arm.scheduler.tick()
        other.execute("ROLLBACK")
    arm.scheduler.tick()
    assert [record.message for record in caplog.records if "trouble" in record.message] == [
        "trouble=store: locked",
        "trouble=store is over, after 0 s",
    ]


def test_while_a_replay_lasts_the_next_one_is_that_after_it(arm: Arm):
    """Who looks at the page meanwhile reads neither the time that has come nor `none`."""
    arm.clock[0] = START + 3 * 3600.0
    arm.scheduler.tick()
    assert arm.replayed == [START + 3 * 3600.0]
    assert arm.due_meanwhile == START + 3 * 3600.0 + DAY


def test_after_a_restored_backup_no_earlier_window_is_used_again(tmp_path: Path):
    """The ledger of the last hours is lost with the damaged file, and their windows may have been replayed."""
    with Store.open(tmp_path / "history") as store:
        Arm(tmp_path / "history", store, cron="0 3 * * *").passes(DAY)
        store.back_up(3)
    (tmp_path / "history" / "history.sqlite").write_bytes(b"nothing of a database" * 1000)
    with Store.open(tmp_path / "history") as store:
        arm = Arm(tmp_path / "history", store, cron="0 3 * * *", grace_s=7200.0)
        arm.clock[0] = START + DAY + 3 * 3600.0 + 600.0  # within the window that may have been used just before the crash
        arm.scheduler = arm.started()
        arm.passes(7000.0)
        assert arm.replayed == []
        arm = Arm(tmp_path / "history", store, cron="0 3 * * *", grace_s=7200.0)  # another start, after it
        arm.clock[0] = START + DAY + 4 * 3600.0
        arm.scheduler = arm.started()
        arm.passes(1800.0)
        assert arm.replayed == []
        arm.passes(DAY)
        assert arm.replayed == [START + 2 * DAY + 3 * 3600.0]


def test_a_window_waits_for_a_warm_arm_and_is_skipped_with_a_reason_where_it_stays_cold(tmp_path: Path):
    """In the first night the arm is steady after twenty minutes. In the next one it warms up during the whole window."""
    with Store.open(tmp_path / "history") as store:
        arm = Arm(tmp_path / "history", store, cron="0 3 * * *", grace_s=3600.0, after_warm_up=True)

        def night(kelvin_a_minute: float) -> None:
            arm.passes(DAY - arm.clock[0] % DAY + 3 * 3600.0, 600.0)
            for minute in range(120):
                for _ in range(6):
                    arm.passes(10.0)
                    arm.scheduler.observe(True, (30.0 + kelvin_a_minute * minute,) * 6)

        night(0.0)
        assert len(arm.replayed) == 1
        assert 600.0 <= arm.scheduler.lag_s <= 1300.0
        night(0.2)
        assert len(arm.replayed) == 1
        assert "temperatures were not steady" in arm.states()[-1][1]


def test_evidence_and_a_cold_start_advance_a_replay_once(tmp_path: Path):
    """The site allows the time. Repeated requests give one replay."""
    with Store.open(tmp_path / "history") as store:
        arm = Arm(tmp_path / "history", store, cron="", evidence_windows=("22:00-05:00",), cold_start_after_h=4.0, grace_s=900.0)
        arm.passes(12 * 3600.0)
        for _ in range(3):
            arm.requests.evidence(arm.clock[0])
            arm.passes(60.0)
        assert arm.replayed == []
        arm.passes(12 * 3600.0)
        assert len(arm.replayed) == 1
        arm.scheduler.observe(True, None)
        for _ in range(6):
            arm.passes(3600.0, 3600.0)
            arm.scheduler.observe(False, None)
        arm.scheduler.observe(True, None)
        arm.passes(60.0)
        arm.scheduler.observe(True, None)
        arm.passes(3600.0)
        assert len(arm.replayed) == 2


def test_a_missing_temperature_opens_a_window_where_the_site_allows_it_and_once_a_day_for_each(tmp_path: Path):
    """Cold in the morning, warm after work, known in between: a replay each in the allowed hours, and none at other hours or unasked."""
    allowed = ("05:30-06:30", "16:00-17:00")
    with Store.open(tmp_path / "history") as store:
        arm = Arm(tmp_path / "history", store, cron="", evidence_windows=allowed, seek_temperatures=True, grace_s=900.0)
        arm.known_rows = {5}

        def day() -> int:
            before = len(arm.replayed)
            for hour, celsius in ((5.8, 12.0), (12.0, 25.0), (14.0, 40.0), (16.2, 40.0)):
                arm.passes((3600.0 * hour - arm.clock[0]) % DAY, 3600.0)
                for _ in range(20):  # 10 min
                    arm.scheduler.observe(True, (celsius,) * 6)
                    arm.passes(30.0, 30.0)
                arm.scheduler.observe(False, None)
            return len(arm.replayed) - before

        assert day() == 2
        arm.known_rows |= {2}
        assert day() == 1
        arm.known_rows |= {8}
        assert day() == 0
    with Store.open(tmp_path / "other") as store:
        arm = Arm(tmp_path / "other", store, cron="", evidence_windows=allowed, grace_s=900.0)
        assert day() == 0


def test_a_window_at_a_missing_temperature_replays_though_work_tells_enough(tmp_path: Path):
    """`when_needed` leaves a window out; where the joints are at a temperature that is missing, it replays."""
    for missing in (False, True):
        with Store.open(tmp_path / f"history-{missing}") as store:
            arm = Arm(
                tmp_path / f"history-{missing}",
                store,
                cron="0 3 * * *",
                grace_s=600.0,
                replay="when_needed",
                evidence_windows=("22:00-22:01",),
                seek_temperatures=True,
            )
            arm.known_rows = set() if missing else {6}
            arm.told = Told(began_unix_s=START - 60 * DAY, replayed_unix_s=START, joints_unix_s=(START,) * 6)
            for _ in range(24):
                arm.scheduler.observe(True, (30.0,) * 6)
                arm.passes(300.0 if arm.clock[0] % DAY > 2.9 * 3600.0 else 3600.0, 30.0)
            assert bool(arm.replayed) is missing


def test_a_requested_replay_runs_at_once_and_beside_the_schedule(arm: Arm):
    """The window of the replay begins at the request."""
    arm.passes(60.0)
    arm.requests.request("a person")
    arm.passes(60.0)
    assert len(arm.replayed) == 1
    assert arm.store.ledger.rows()[0].kind == "requested"


def test_while_the_first_replay_is_made_the_next_window_is_told(tmp_path: Path):
    """`run --now`: what the page shows as next is that of tomorrow, not none."""
    with Store.open(tmp_path / "first") as store:
        arm = Arm(tmp_path, store, cron="0 3 * * *")
        arm.requests.request("a person")
        arm.passes(1.0)
        assert len(arm.replayed) == 1
        assert arm.due_meanwhile == min(window.opens_unix_s for window in arm.scheduler.coming(1))


def test_a_requested_replay_serves_the_window_beside_it(tmp_path: Path):
    """`run --now` two minutes before the window, or while it is open: one replay, and the row of the window says which."""
    for begins_s, outcome, replays in ((-120.0, "assessed", 1), (120.0, "assessed", 1), (-120.0, "rejected", 2), (-3600.0, "assessed", 2)):
        with Store.open(tmp_path / f"{begins_s}{outcome}") as store:
            arm = Arm(tmp_path, store, cron="0 3 * * *", grace_s=600.0)
            arm.outcome = outcome
            arm.clock[0] += 3 * 3600.0 + begins_s
            arm.scheduler = arm.started()
            arm.requests.request()
            arm.passes(1.0)
            arm.outcome = "assessed"
            arm.passes(2 * 3600.0)
            assert len(arm.replayed) == replays, (begins_s, outcome)
            if replays == 1:
                assert ("skipped", "one replay serves this window and the request of") in [(a, b[:48]) for a, b in arm.states()]


def test_a_requested_replay_leaves_a_dense_schedule_the_windows_that_lie_ahead(tmp_path: Path):
    """Every five minutes, each open for ten: `run --now` at 02:52 serves the open ones and that of 02:55; 03:00 has its own."""
    with Store.open(tmp_path / "dense") as store:
        arm = Arm(tmp_path, store, cron="*/5 * * * *", grace_s=600.0)
        arm.clock[0] += 3 * 3600.0 - 480.0
        arm.scheduler = arm.started()
        arm.outcome = "assessed"
        arm.requests.request()
        arm.passes(1.0)
        arm.passes(20 * 60.0)
        assert len(arm.replayed) == 4  # asked for, and 03:00, 03:05, 03:10


def test_two_requests_give_one_replay_and_none_where_it_could_not_be_recorded(arm: Arm):
    """Without room for a recording nothing moves, and the refused request is reported."""
    arm.requests.request()
    arm.requests.request()
    arm.passes(240.0)
    assert len(arm.replayed) == 1
    arm.configuration = replace(arm.configuration, store=replace(arm.configuration.store, least_free_mb=1e12))
    arm.requests.request()
    arm.passes(240.0)
    assert len(arm.replayed) == 1
    (_, row) = arm.store.ledger.rows()
    assert (row.kind, row.state) == ("requested", "skipped")
    assert "MB are free" in (row.reason_text or "")


def test_a_host_whose_clock_restarts_at_every_boot_keeps_its_history(arm: Arm):
    """With a dead battery it is 2019 at every boot until the network sets the clock. The true time is not rejected as wrong."""
    true, wrong = START, 1_546_300_800.0
    for boot in range(3):
        arm.clock[0] = wrong + 120.0 * boot  # the boots take different times
        arm.scheduler = arm.started()
        arm.passes(60.0, step=10.0)
        arm.clock[0] = true = max(true, arm.store.ledger.newest_unix_s() or 0.0) + 5 * DAY
        ledger_id = arm.store.ledger.claim(true, "requested", true)
        arm.store.recordings.path(ledger_id).write_bytes(b"PAR1")
        arm.store.ledger.mark_recorded(ledger_id)  # the replay waits for its assessment and is part of the history
        arm.scheduler.tick()
        arm.passes(2 * DAY)
        assert arm.rewound == 0, boot
        assert "clock" not in arm.problems
    assert arm.replayed


def test_before_the_clock_has_been_set_nothing_is_replayed(tmp_path: Path):
    """A host without a clock begins in 1970: it is reported, and no window or request runs. The right time is accepted at once."""
    with Store.open(tmp_path / "history") as store:
        arm = Arm(tmp_path / "history", store, cron="*/10 * * * *", grace_s=600.0)
        arm.clock[0] = 100.0
        arm.scheduler = arm.started()
        arm.requests.request()
        arm.passes(3600.0)
        assert arm.replayed == []
        assert "1970" in arm.problems.listed()[0].text
        arm.clock[0] = START
        arm.passes(240.0)
        assert len(arm.replayed) >= 1
        assert "clock" not in arm.problems


def test_a_thousand_missed_days_are_reported_in_a_few_rows_and_at_once(arm: Arm):
    """The newest sixty windows have rows, and the next night has its replay."""
    arm.passes(DAY)
    arm.clock[0] += 1000 * DAY
    arm.scheduler = arm.started()
    arm.passes(DAY)
    states = [state for state, _ in arm.states()]
    assert states.count("skipped") <= 60
    assert states.count("rejected") == 2


needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="NOT ROOT: no disk of its own can be mounted, so a full one is not tested")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 3 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "none", str(folder)], capture_output=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"NO DISK OF ITS OWN, a full one is not tested: {done.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@needs_root
def test_with_a_full_disk_nothing_moves_and_the_problem_ends_when_there_is_room(small_disk: Path):
    """The window is skipped with the reason, if the ledger can still be written. The next window has its replay."""
    with Store.open(small_disk / "history") as store:
        arm = Arm(small_disk / "history", store, cron="0 * * * *", grace_s=600.0)
        arm.configuration = replace(arm.configuration, store=replace(arm.configuration.store, least_free_mb=1.0))
        arm.passes(3600.0)
        before = len(arm.replayed)
        filler = small_disk / "filler"
        subprocess.run(["dd", "if=/dev/zero", f"of={filler}", "bs=4k"], capture_output=True, check=False)  # until the disk is full
        assert "MB are free" in str(too_little_room(store, 1.0) or "")
        stopping = threading.Event()
        ticks = [0]

        def beat() -> None:
            ticks[0] += 1
            arm.clock[0] += 600.0
            arm.clock[1] += 600.0
            arm.scheduler.reconsider()
            if ticks[0] == 20:
                stopping.set()

        arm.scheduler.run(stopping, beat)
        assert len(arm.replayed) == before
        filler.unlink()
        arm.passes(2 * 3600.0)
        assert len(arm.replayed) >= before + 1
        assert "store" not in arm.problems


@needs_root
def test_a_disk_that_becomes_read_only_is_reported_and_survived(small_disk: Path):
    """As after a disk error: nothing moves, and the schedule continues when the disk is writable."""
    with Store.open(small_disk / "history") as store:
        arm = Arm(small_disk / "history", store, cron="0 * * * *", grace_s=600.0)
        arm.configuration = replace(arm.configuration, store=replace(arm.configuration.store, least_free_mb=1.0))
        arm.passes(3600.0)
        before = len(arm.replayed)
        # only this mount point is read-only, because a file system with open files cannot become so
        remount = ["mount", "-o", "remount,ro,bind", str(small_disk)]
        subprocess.run(["mount", "--bind", str(small_disk), str(small_disk)], check=True)
        try:
            subprocess.run(remount, check=True)
            assert "only be read" in str(too_little_room(store, 1.0) or "")
            arm.passes(3600.0)
            assert len(arm.replayed) == before
            assert "only be read" in arm.states()[-1][1]
        finally:
            subprocess.run(["umount", "-l", str(small_disk)], check=True)
        arm.passes(3600.0)
        assert len(arm.replayed) == before + 1


def test_a_window_in_which_no_replay_is_needed_is_left_out_and_says_why(tmp_path):
    """Work has told of every joint until today: a week passes, the window after `unobserved_days` replays, and none is a refusal."""
    with Store.open(tmp_path / "history") as store:
        arm = Arm(
            tmp_path / "history", store, cron="0 3 * * *", grace_s=600.0, replay="when_needed", at_most_days=30.0, unobserved_days=7.0
        )
        arm.told = Told(START - 60 * DAY, START - DAY, (START,) * 6)
        assert arm.scheduler.coming(1)[0].opens_unix_s == START + 7 * DAY + 3 * 3600
        arm.passes(7.5 * DAY)
        states = arm.states()
        assert [state for state, _ in states] == ["skipped"] * 7 + ["rejected"]
        assert states[0][1].startswith("not needed before 2026-06-08 (work does not tell enough of joints 1, 2, 3, 4, 5, 6")
        assert store.ledger.refused_in_a_row() is None


def test_wear_that_production_alone_has_found_makes_the_next_window_replay(tmp_path):
    with Store.open(tmp_path / "history") as store:
        arm = Arm(tmp_path / "history", store, cron="0 3 * * *", grace_s=600.0, replay="when_needed")
        arm.told = Told(START - 60 * DAY, START - DAY, (START,) * 6, (2,))
        arm.passes(DAY)
        assert arm.replayed == [START + 3 * 3600]
