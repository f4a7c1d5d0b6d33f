"""Where a program lends the arm, a window makes a replay due until the arm was had: over restarts, closings and other windows."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from published import last_values
from test_backups_and_retention import configuration
from test_scheduler import DAY, START, Arm

from monitor.acquire.schedule.needed import Told
from monitor.errors import MonitorError, MotionRefused
from monitor.judge.alerts.condition import ServiceSituation, Standing
from monitor.judge.alerts.conditions import SERVICE_CONDITIONS
from monitor.publish.documents import as_json
from monitor.publish.metrics import families
from monitor.reason import Reason, reason_of
from monitor.recording import Recording
from monitor.service.daemon import Daemon
from monitor.service.lending import BorrowedWindow, DueReplay
from monitor.service.monitor_document import borrowed_document, status_line
from monitor.service.problems import Problems
from monitor.service.shared_state import ReplayRequests
from monitor.store.history.ledger import LedgerRow
from monitor.store.store import Store
from monitor.views.terminal.arm import borrowed_text

HOUR = 3600.0
THREE = START + 3 * HOUR


class LentArm(Arm):
    """A program that reaches its node at certain times, an arm that may be refused there, and replays of no duration."""

    def __init__(self, folder: Path, store: Store, replay: dict[str, Any] | None = None, **schedule: Any) -> None:
        self.configuration = configuration(folder, schedule=schedule, replay={"hand_over": "script_node", **(replay or {})})
        self.store, self.clock = store, [START, 0.0]
        self.problems = Problems(lambda: self.clock[0])
        self.replayed: list[float] = []
        self.due: float | None = None
        self.fails: Exception | None = None
        self.outcome = "assessed"
        self.nodes: list[float] = []  # when the program is at its node
        self.refused = ""  # at a node
        self.unheard = ""  # before any node
        self.waiting: DueReplay | None = None
        self.asked = 0
        self.told = Told()
        self.requests = ReplayRequests()
        self.scheduler = self.started()

    def note_due(self, due: DueReplay | None) -> None:
        self.waiting = due

    def borrow(self, due: DueReplay, waits: Callable[[], bool], passed: Callable[[Reason], None]) -> LedgerRow | Reason:
        """Wait as the monitor does: ten minutes pass between two looks."""
        self.asked += 1
        if self.unheard:
            return reason_of(self.unheard)
        self.nodes = [at for at in self.nodes if at > self.clock[0] - 1200.0]  # the program was there, and went on
        while waits():
            self.clock[0] += 600.0
            self.clock[1] += 600.0
            reached = [at for at in self.nodes if at <= self.clock[0]]
            self.nodes = [at for at in self.nodes if at > self.clock[0]]
            if reached and self.refused:
                passed(reason_of(self.refused))
            elif reached:
                ledger_id = self.store.ledger.claim(due.key_unix_s, due.kind, self.clock[0])
                assert ledger_id is not None
                self.replayed.append(self.clock[0])
                self.store.ledger.end(ledger_id, self.outcome, "a test", self.clock[0])
                return self.store.ledger.row(ledger_id)
        return reason_of("stopped on request")

    def passes(self, seconds: float, step: float = 480.0) -> None:
        """Until so much time has passed, of which the waiting takes its part."""
        until = self.clock[0] + seconds
        while self.clock[0] < until:
            by = min(step, until - self.clock[0])
            self.clock[0] += by
            self.clock[1] += by
            self.scheduler.tick()


@pytest.fixture
def lent(tmp_path: Path) -> Iterator[Callable[..., LentArm]]:
    with Store.open(tmp_path / "history") as store:
        yield lambda **settings: LentArm(tmp_path / "history", store, **{"cron": "0 3 * * *", "grace_s": 600.0, **settings})


def test_a_window_makes_the_replay_due_until_the_program_is_at_its_node(lent):
    """The window closes at 03:10; the cell begins to work at 06:00, and the arm is had at its first node then. Once."""
    arm = lent()
    arm.nodes = [START + HOUR, START + 6 * HOUR, START + 7 * HOUR]
    arm.passes(4 * HOUR)
    assert arm.replayed == []
    assert arm.waiting is not None
    assert arm.waiting.since_unix_s == THREE
    assert arm.waiting.waits_for.text == "waiting for the program's node; none was reached yet"
    arm.passes(6 * HOUR)
    (at,) = arm.replayed
    assert START + 6 * HOUR <= at < START + 6 * HOUR + 1200.0
    (row,) = arm.store.ledger.rows()
    assert (row.window_unix_s, row.state) == (THREE, "assessed")
    assert arm.waiting is None
    assert arm.scheduler.lag_s == pytest.approx(3 * HOUR, abs=1200.0)


def test_windows_that_open_meanwhile_join_the_one_that_is_due(lent):
    """A weekend without production: on Monday one replay serves three windows, and the ledger says so of each."""
    arm = lent()
    arm.nodes = [START + 3 * DAY]
    arm.passes(3 * DAY + 2 * HOUR)
    assert len(arm.replayed) == 1
    rows = {row.window_unix_s: (row.state, row.reason_text) for row in arm.store.ledger.rows()}
    assert rows[THREE][0] == "assessed"
    for day in (1, 2):
        assert rows[THREE + day * DAY][0] == "skipped"
        assert "one replay serves this window and that of 2026-06-01T03:00" in rows[THREE + day * DAY][1]
    arm.nodes = [THREE + 3 * DAY + 60.0]
    arm.passes(4 * HOUR)
    assert len(arm.replayed) == 2


def test_what_is_due_stays_due_over_a_restart(lent):
    """Since the same moment, with the tries that it had; a replay that was under way when the monitor ended is not begun again."""
    arm = lent()
    arm.passes(5 * HOUR)
    before = arm.waiting
    arm.waiting = None
    arm.scheduler = arm.started()
    assert arm.waiting is not None
    assert (arm.waiting.since_unix_s, arm.waiting.key_unix_s) == (before.since_unix_s, before.key_unix_s)
    arm.store.ledger.claim(before.key_unix_s, "scheduled", arm.clock[0])
    arm.scheduler = arm.started()
    arm.recover = lambda: arm.store.ledger.repair(arm.clock[0])
    arm.nodes = [arm.clock[0] + HOUR]
    arm.passes(2 * HOUR)
    assert arm.replayed == []
    assert arm.waiting is None


def test_a_request_is_due_at_once_and_joins_what_is_due(lent):
    """`run --now` and the bus: due since then, whatever the schedule says; together with a window it is one replay."""
    arm = lent()
    arm.requests.request()
    arm.passes(600.0)
    assert arm.waiting is not None
    assert arm.waiting.kind == "requested"
    arm.nodes = [START + 4 * HOUR]
    arm.passes(5 * HOUR)
    assert len(arm.replayed) == 1
    assert sorted(row.kind for row in arm.store.ledger.rows()) == ["requested", "scheduled"]


def test_a_program_without_a_node_is_told_and_ends_in_the_ledger(lent):
    """After replay.hand_over_wait_h the window is skipped, and says why: here a condition at the last node. The next one is due."""
    arm = lent(replay={"hand_over_wait_h": 48.0})
    arm.passes(2 * DAY)
    arm.refused = "payload: 0.4 kg more than configured"
    arm.nodes = [START + 2 * DAY + HOUR]
    arm.passes(DAY)
    assert arm.waiting is not None
    first = next(row for row in arm.store.ledger.rows() if row.window_unix_s == THREE)
    assert first.state == "skipped"
    assert first.reason_text == "hand_over: at the last node: payload: 0.4 kg more than configured"
    assert arm.waiting.since_unix_s > THREE


def test_nothing_is_asked_of_the_program_on_a_blackout_day_or_without_room(lent):
    """It stays due, and says what it waits for; the next day the arm is had."""
    arm = lent(blackout=("2026-06-02",), cron="0 3 1 * *")
    arm.passes(DAY + 600.0)
    asked = arm.asked
    arm.nodes = [START + DAY + 12 * HOUR, START + 2 * DAY + HOUR]
    arm.passes(20 * HOUR)
    assert arm.asked == asked
    assert arm.waiting is not None
    assert arm.waiting.waits_for.text == "not offered to the program: blackout: nothing is replayed today"
    arm.passes(DAY)
    assert len(arm.replayed) == 1
    assert arm.replayed[0] > START + 2 * DAY


def test_a_refusal_before_any_node_is_said_and_tried_again(lent):
    """A controller that is off: no row of the ledger for each attempt, and the arm is had once it is there."""
    arm = lent()
    arm.unheard = "127.0.0.1: no answer"
    arm.passes(5 * HOUR)
    assert arm.waiting is not None
    assert arm.waiting.waits_for.text == "not offered to the program: 127.0.0.1: no answer"
    assert arm.store.ledger.rows() == []
    arm.unheard, arm.nodes = "", [START + 6 * HOUR]
    arm.passes(2 * HOUR)
    assert len(arm.replayed) == 1


def test_a_replay_that_ended_early_is_due_again_as_often_as_the_schedule_allows(lent):
    """Three tries of its own rows; after a stop that needs a person there is none."""
    arm = lent(tries=3, cron="0 3 1 * *")
    arm.outcome = "aborted"
    arm.nodes = [START + hours * HOUR for hours in range(4, 12)]
    arm.passes(14 * HOUR)
    assert len(arm.replayed) == 3
    assert [row.state for row in arm.store.ledger.rows()] == ["aborted"] * 3
    assert arm.waiting is None


def test_a_stop_that_waits_for_a_person_ends_what_is_due(lent):
    """Nobody has looked at the arm: it is not taken again when the program comes to its node."""
    arm = lent(cron="0 3 1 * *")
    arm.outcome = "aborted"
    arm.store.stops.add("astray", "the arm is elsewhere", START)
    arm.nodes = [START + 4 * HOUR, START + 5 * HOUR]
    arm.passes(8 * HOUR)
    assert len(arm.replayed) == 1
    assert arm.waiting is None


def test_evidence_is_over_with_its_span(lent):
    """The site allows an early replay between 22:00 and 05:00 alone: at 05:00 it is not due any longer."""
    arm = lent(cron="", evidence_windows=("22:00-05:00",))
    arm.passes(HOUR)
    arm.requests.evidence(arm.clock[0])
    arm.passes(HOUR)
    assert arm.waiting is not None
    assert arm.waiting.why == "evidence"
    arm.nodes = [START + 6 * HOUR]
    arm.passes(8 * HOUR)
    assert arm.replayed == []
    assert arm.waiting is None
    (row,) = arm.store.ledger.rows()
    assert row.reason_text == "hand_over: the program reached no node"


def test_a_disk_that_fails_while_the_node_is_waited_for_ends_nothing(lent):
    """The problem is the disk's; the due replay stays."""
    arm = lent()
    arm.passes(4 * HOUR)
    asked = arm.asked

    def fails(*_: object) -> str:
        raise MonitorError("the disk is full")

    arm.borrow = fails
    with pytest.raises(MonitorError):
        arm.passes(HOUR)
    assert arm.waiting is not None
    assert arm.asked == asked


def test_the_alert_stale_and_the_status_line_name_what_is_waited_for():
    """Nothing is learnt because no node is reached: whoever looks at the alert reads that, and not the reason of an older window."""
    due = DueReplay(
        key_unix_s=THREE, since_unix_s=THREE, until_unix_s=THREE + DAY, passed_by=reason_of("payload: 0.4 kg more than configured")
    )
    situation = ServiceSituation(
        now_unix_s=START + 3 * DAY,
        unlearnt=Standing(START, reason_of("an older reason"), START + 2 * DAY),
        due=Standing(due.since_unix_s, due.waits_for),
    )
    (stale,) = [condition for condition in SERVICE_CONDITIONS if condition.name == "stale"]
    text = stale.service(situation).text
    waited = "waiting for the program's node; at the last one: payload: 0.4 kg more than configured"
    assert text.endswith(f"A replay is due since 2026-06-01 03:00 UTC, {waited}.")
    assert "older reason" not in text
    monitor = last_values({"monitor": {"last_replay": None, "next_replay_due": None, "arm": {"heard": True}, "troubles": []}})["monitor"]
    document = monitor.model_copy(update={"due": due.document()})
    assert f"due since 2026-06-01T03:00:00Z, {waited}" in status_line("NORMAL", document)
    (heard,) = [family for family in families({"monitor": document}) if family.name == "joint_monitor_due_since_timestamp_seconds"]
    assert [sample.value for sample in heard.samples] == [THREE]


def test_the_ledger_says_from_whom_an_arm_was_borrowed_and_for_how_long(tmp_path: Path):
    """One row a window; taken and given back twice where a first pass came before; lost where the program ended."""
    due = DueReplay(key_unix_s=THREE, since_unix_s=START, until_unix_s=START + DAY)
    with Store.open(tmp_path) as store:
        lock = threading.Lock()
        with BorrowedWindow(store, lock, due, lambda: START + 60.0, ask_program=lambda: "cell.urp") as window:
            assert not lock.locked()  # nobody knows when the node is reached
            for _ in range(2):
                window.taken()
                assert window.enter() == 1
                window.given_back()
            assert lock.locked()
        assert not lock.locked()
        (row,) = store.ledger.rows()
        borrow = store.borrows.of([row])[1]
        assert (borrow.program, borrow.due_since_unix_s, borrow.taken_at_unix_s) == ("cell.urp", START, START + 60.0)
        assert borrow.given_back
        assert 0.0 < borrow.waited_s < 5.0
        with BorrowedWindow(store, lock, due.another_try(START + 90.0), lambda: START + 120.0) as window:
            window.taken()
            number = window.enter()
            window.lost()
        assert store.borrows.of(store.ledger.rows())[number].waited_s is None
        assert borrowed_text(as_json(borrowed_document(store.borrows.of(store.ledger.rows())[number]))).endswith("the program has ended")
        with BorrowedWindow(store, lock, due, lambda: START) as window, pytest.raises(MotionRefused, match="has this window already"):
            window.enter()
        assert not lock.locked()


def test_a_window_that_cannot_be_entered_holds_nothing_and_is_no_borrowing(tmp_path: Path):
    """The ledger refuses it at the node: the arm goes back, whoever asks again does not wait, and no row says that an arm was lent."""
    due = DueReplay(key_unix_s=THREE, since_unix_s=START, until_unix_s=START + DAY)
    with Store.open(tmp_path) as store:
        store.ledger.claim(due.key_unix_s, due.kind, START)
        lock = threading.Lock()
        with BorrowedWindow(store, lock, due, lambda: START + 60.0) as window:
            window.taken()
            for _ in range(2):
                with pytest.raises(MotionRefused, match="has this window already"):
                    window.enter()
                assert not lock.locked()
            window.given_back()
            assert store.borrows.of(store.ledger.rows()) == {}


def test_a_fault_before_the_arm_was_taken_is_in_the_ledger_and_is_no_borrowing(tmp_path: Path, free_port: int):
    """Nobody's program waited: the row says what happened, and not from whom an arm was borrowed."""
    settings = configuration(tmp_path / "history", bus={"listen": [f"tcp/127.0.0.1:{free_port}"]})
    due = DueReplay(key_unix_s=THREE, since_unix_s=START, until_unix_s=START + DAY)

    def fails(*_: object) -> Recording:
        raise TypeError("a fault")

    with (
        Store.open(tmp_path / "history") as store,
        Daemon(settings, store, now=lambda: START, play=fails) as daemon,
    ):
        row = daemon.monitor.borrow(due, lambda: True, lambda _: None)
        assert (row.state, row.reason_text) == ("aborted", "internal: TypeError: a fault")
        assert store.borrows.of([row]) == {}
