"""A window that this machine or the network spoilt is tried again while it is open."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from monitor.acquire.ur.control import ARM_IN_USE
from monitor.acquire.ur.node import REGISTERS_IN_USE
from monitor.config.load import load
from monitor.errors import AT_HOST, MotionRefused, ReplayAborted, RobotUnreachable
from monitor.service.daemon import Daemon
from monitor.service.history.status import status_document
from monitor.store.store import Store

NOON = 1.78e9
LATE = ReplayAborted("127.0.0.1: late in the phase 'play': a target came late", "late", moved=True)


@pytest.fixture
def daemon(tmp_path: Path, free_port: int) -> Iterator[Callable[..., Daemon]]:
    """Makes a daemon whose replays end as listed, one after the other."""
    (tmp_path / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n[schedule]\ntry_again_after_s = 1.0\n'
        f'[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
    )
    configuration = load(tmp_path / "cell.toml")
    with Store.open(configuration.state_directory) as store:
        made: list[Daemon] = []

        def make(*endings: Exception, **schedule: object) -> Daemon:
            waiting = list(endings)

            def play(*_: object) -> None:
                raise waiting.pop(0)

            changed = replace(configuration, schedule=replace(configuration.schedule, **schedule))
            made.append(Daemon(changed, store, now=lambda: NOON, play=play))
            made[-1].waiting = waiting
            return made[-1].__enter__()

        try:
            yield make
        finally:
            for each in made:
                each.__exit__()


def states(daemon: Daemon) -> list[tuple[str, list[str]]]:
    """How each window ended, and the causes of its earlier tries."""
    ledger = daemon._store.ledger
    return [(row.state, [each.cause for each in ledger.tries([row])[row.id]]) for row in ledger.rows()]


def test_a_late_target_is_tried_again_in_the_same_window_and_each_try_is_in_the_ledger(daemon):
    """Two tries are late, the third is refused: the window ends as the last try that moved, and the ledger has all of them."""
    made = daemon(LATE, LATE, MotionRefused("time_window: it closes"))
    row = made.monitor.perform(NOON, closes_unix_s=NOON + 60.0)
    assert made.waiting == []
    assert row.state == "aborted"
    assert "the next try was refused: time_window" in row.reason_text
    assert states(made) == [("aborted", ["late", "late"])]
    shown = status_document(made.monitor.configuration, NOON)["ledger"]
    assert [each["cause"] for each in shown[0]["tries"]] == ["late", "late"]


def test_tries_are_bounded_in_number_and_by_the_windows_end(daemon):
    """Three as configured; none where the window closes before the pause is over; none where it is configured so."""
    for number, (schedule, closes_s, left) in enumerate((({}, 60.0, 1), ({}, 0.5, 3), ({"tries": 1}, 60.0, 3))):
        made = daemon(LATE, LATE, LATE, LATE, **schedule)
        made.monitor.perform(NOON + number, closes_unix_s=NOON + closes_s)
        assert len(made.waiting) == left
        made.bus.close()


def test_an_arm_that_is_not_reached_is_tried_again_while_the_window_is_open(daemon):
    """On a busy machine the first data may come too late. The window is skipped only where no try reached the arm."""
    silent = RobotUnreachable("127.0.0.1: RTDE answers but sends no data")
    made = daemon(silent, MotionRefused("remote_control: off"))
    assert made.monitor.perform(NOON, closes_unix_s=NOON + 60.0).reason_text == "remote_control: off"
    assert states(made) == [("skipped", ["unreachable"])]
    made.bus.close()
    again = daemon(silent, silent, silent)
    row = again.monitor.perform(NOON + 1.0, closes_unix_s=NOON + 61.0)
    assert (row.reason_text, again.waiting) == (str(silent), [])
    assert states(again)[1] == ("skipped", ["unreachable", "unreachable"])


@pytest.mark.parametrize("sentence", [ARM_IN_USE, REGISTERS_IN_USE])
def test_registers_that_another_client_holds_are_tried_again_in_the_same_window(daemon, sentence):
    """It may be a connection that has just ended. Three tries as of every other; nothing moved, so the window is skipped at last."""
    held = MotionRefused(
        AT_HOST(host="127.0.0.1", why=sentence(first=20, last=22, why="One of the RTDE input registers are already in use!"))
    )
    made = daemon(held, MotionRefused("remote_control: off"))
    assert made.monitor.perform(NOON, closes_unix_s=NOON + 60.0).reason_text == "remote_control: off"
    assert states(made) == [("skipped", [sentence.code])]
    made.bus.close()
    again = daemon(held, held, held)
    row = again.monitor.perform(NOON + 1.0, closes_unix_s=NOON + 61.0)
    assert again.waiting == []
    assert row.reason_text.startswith("127.0.0.1: another RTDE client holds")
    assert "ur-rtde cannot tell which, and names fieldbuses alone: 'One of" in row.reason_text


def test_a_try_that_moved_is_told_where_a_later_one_does_not_reach_the_arm(daemon):
    """The window is aborted, as the try that moved was."""
    made = daemon(LATE, RobotUnreachable("127.0.0.1: no answer"), RobotUnreachable("127.0.0.1: still none"))
    row = made.monitor.perform(NOON, closes_unix_s=NOON + 60.0)
    assert row.state == "aborted"
    assert str(LATE) in row.reason_text
    assert "still none" in row.reason_text
    assert states(made) == [("aborted", ["late", "unreachable"])]


@pytest.mark.parametrize(
    "ending",
    [
        ReplayAborted("stopped", "protective_stop", moved=True),
        ReplayAborted("late", "late", moved=True, unknown="it is not known whether the arm came to rest"),
        ReplayAborted("stopped at the pendant", "program_stopped", moved=True),
        ReplayAborted("SIGTERM", "parent_asked_to_stop", moved=True),
    ],
)
def test_what_a_person_must_see_or_has_done_is_never_tried_again(daemon, ending):
    """A stop, an end that is not known to be good, and the will of somebody else."""
    made = daemon(ending, LATE)
    made.monitor.perform(NOON, closes_unix_s=NOON + 60.0)
    assert made.waiting == [LATE]
    assert states(made) == [("aborted", [])]


def test_a_monitor_that_is_asked_to_stop_does_not_wait_for_the_next_try(daemon):
    """The window ends as its last try did."""
    made = daemon(LATE, LATE, try_again_after_s=600.0)
    made.state.stopping.set()
    assert made.monitor.perform(NOON, closes_unix_s=NOON + 3600.0).state == "aborted"
    assert made.waiting == [LATE]
