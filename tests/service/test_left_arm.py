"""An arm that a motion left on its trajectory: the next motion brings it back, or a person is asked at once. Never a silent standstill."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitations import short
from test_driver import DONE, WAITING, ScriptedDriver, ScriptedSession, phase, row
from test_guard import ready_state
from test_motion import causes
from typer.testing import CliRunner

from monitor.acquire.ur.driver import UniversalRobots
from monitor.acquire.watch import Caller
from monitor.cli.main import app
from monitor.config.load import load
from monitor.config.schema import Configuration
from monitor.errors import DOES_NOT_HOLD, MotionRefused, ReplayAborted
from monitor.service.left_arm import MOST_FAILED, away
from monitor.service.motion import check_conditions, move
from monitor.store.store import Store

FAR = short(period_s=6.0, amplitude_rad=1.2)  # its first joint leaves the start by more than `max_approach_rad` of the configuration below
START = FAR.at(np.zeros(1)).q[0]
AWAY = FAR.at(np.array([3.8])).q[0]
PAGE = Path(__file__).parent.parent.parent / "docs" / "supervision.md"


@pytest.fixture
def configuration(tmp_path: Path, free_port: int) -> Configuration:
    (tmp_path / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n'
        '[replay]\nallow_motion = true\nfirst_pass = false\ncell = "unchecked"\nconfirm_timeout_s = 1.0\nmax_approach_rad = 1.0\n'
        f'[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
    )
    return replace(load(tmp_path / "cell.toml"), excitation=FAR)


def failed(cause: str) -> dict:
    return {"kind": "failed", "cause": cause, "text": "ended by the test"}


def moved(configuration: Configuration, *frames, at=START, left_at=AWAY, control=True) -> tuple[ReplayAborted | None, ScriptedDriver]:
    """One motion of an arm that stands there, in a monitor of its own; how it ended, and the driver that it went through."""
    frames = [row(2, actual_q=left_at, target_q=left_at) if isinstance(frame, np.ndarray) else frame for frame in frames]
    waiting = [*WAITING[:2], {"kind": "state", "row": row(0, actual_q=at, target_q=at).tolist()}]
    driver = ScriptedDriver(ScriptedSession(waiting, [*([phase("control")] if control else []), *frames]))
    driver.state = lambda *_: ready_state(q=left_at, target_q=left_at)
    with Store.open(configuration.state_directory) as store:
        try:
            move(
                configuration,
                store,
                FAR,
                configuration.context,
                caller=Caller(),
                first_pass_path=configuration.state_directory / "first.parquet",
                driver=driver,
            )
        except ReplayAborted as error:
            return error, driver
    return None, driver


def waiting_causes(configuration: Configuration) -> list[str]:
    with Store.open(configuration.state_directory) as store:
        return causes(store)


PLAYED = (phase("approach"), phase("play"), row(1), row(2))


@pytest.mark.parametrize("cause", sorted(ReplayAborted.HARMLESS))
def test_after_each_harmless_cause_an_arm_far_from_its_start_is_brought_back_or_a_person_is_asked_at_once(configuration, cause):
    """Never an arm that is refused at every window without a word. Where it is near, no cause of these asks for anybody."""
    error, _ = moved(configuration, *PLAYED, failed(cause))
    assert error is not None
    assert error.needs_a_person == (cause not in ReplayAborted.BROUGHT_BACK)
    if error.needs_a_person:
        assert waiting_causes(configuration) == [cause]
        assert "jog the arm near the start" in str(error)
        return
    assert waiting_causes(configuration) == []
    error, driver = moved(configuration, phase("way_back"), *PLAYED[1:], DONE, at=AWAY, left_at=START)
    assert error is None
    assert driver.task.left.on_path
    assert np.allclose(driver.task.left.home_q, START)
    error, driver = moved(configuration, *PLAYED, failed(cause), left_at=START + 0.1)  # the next ends near the start
    assert driver.task.left is None
    assert waiting_causes(configuration) == []


@pytest.mark.parametrize("cause", ["protective_stop", "torque_band", "following_error", "payload", "internal"])
def test_after_a_cause_that_needs_a_person_nothing_is_brought_back_although_the_person_allows_motion(configuration, cause):
    """The way back is free only where a person says so of the way."""
    moved(configuration, *PLAYED, failed(cause))
    with Store.open(configuration.state_directory) as store:
        store.stops.allow("Ada", "looked", 1.0)
    with pytest.raises(MotionRefused, match=r"approach_near: .* allow --way-back"):
        moved(configuration, *PLAYED, DONE, at=AWAY)


def test_the_way_back_that_fails_again_and_again_asks_for_a_person(configuration):
    """Each of these ends is harmless; that it happens every time is not."""
    moved(configuration, *PLAYED, failed("late"))
    for number in range(1, MOST_FAILED + 1):
        error, _ = moved(configuration, phase("way_back"), failed("late"), at=AWAY)
        assert error is not None
        assert error.needs_a_person == (number == MOST_FAILED)
    assert "in vain" in str(error)
    assert waiting_causes(configuration) == ["late"]


def test_a_motion_that_was_refused_or_ended_before_it_moved_leaves_what_is_known_of_the_arm(configuration):
    """No watchdog, a program of somebody else, a refusal: the arm still stands on its trajectory."""
    moved(configuration, *PLAYED, failed("late"))
    error, _ = moved(configuration, failed("no_control"), at=AWAY)
    assert error is not None
    assert not error.needs_a_person
    with pytest.raises(MotionRefused):
        moved(configuration, {"kind": "refused", "text": "payload"}, at=AWAY, control=False)
    _, driver = moved(configuration, phase("way_back"), *PLAYED[1:], DONE, at=AWAY)
    assert driver.task.left is not None


def test_an_arm_that_somebody_jogged_is_not_brought_back_and_the_refusal_says_what_to_do(configuration):
    """A restart keeps what is known, and compares it with where the arm stands now."""
    moved(configuration, *PLAYED, failed("late"))
    with pytest.raises(MotionRefused, match="jog the arm near the start"):
        moved(configuration, *PLAYED, DONE, at=AWAY + 0.05)
    error, _ = moved(configuration, *PLAYED, DONE, at=START + 0.2, left_at=START)  # jogged near the start
    assert error is None


def test_a_crash_in_mid_motion_forgets_how_the_arm_was_left(configuration):
    """What became of the arm after it nobody knows: a person is asked, and the old place does not count."""
    moved(configuration, *PLAYED, failed("late"))
    with Store.open(configuration.state_directory) as store, store.motions.turn(1.0):
        store.motions.begin(ledger_id=None, host="127.0.0.1", serial="7", configured=False, first_pass=False, at_unix_s=1.0)
    with Store.open(configuration.state_directory) as store:
        store.motions.give_up_left_over(2.0)
        assert causes(store) == ["unknown_end"]
        assert store.motions.left() is None


def test_another_arm_that_a_person_accepts_was_not_left_by_us(configuration):
    """How the arm before it was left says nothing of this one."""
    moved(configuration, *PLAYED, failed("late"))
    with Store.open(configuration.state_directory) as store:
        store.stops.add_another_arm("8", "the controller's serial number is 8, expected 7", 1.0)
        assert store.motions.left() is not None
        store.stops.allow("Ada", "exchanged", 2.0)
        assert store.motions.left() is None


def test_a_person_lets_the_arm_be_brought_back_and_the_history_keeps_who_and_why(configuration, monkeypatch):
    """`allow --way-back`; an arm that does not stand on its trajectory has no way back along it."""
    path = configuration.path
    monkeypatch.setattr("monitor.config.load.find_excitation", lambda *_: FAR, raising=False)
    moved(configuration, *PLAYED, failed("torque_band"))
    command = ["allow", "--config", str(path), "--by", "Ada", "--why", "a cable, removed", "--way-back"]
    monkeypatch.setattr("monitor.cli.motion.load_configuration", lambda _: configuration)
    for stands, code in ((AWAY + 0.5, 2), (AWAY, 0)):
        monkeypatch.setattr(UniversalRobots, "state", lambda *_, q=stands: ready_state(q=q, target_q=q))
        done = CliRunner().invoke(app, command)
        assert (done.exit_code == 0) == (code == 0), done.output
    assert "brought back over the way it came" in done.output
    with Store.open(configuration.state_directory) as store:
        assert [(stop.cause, stop.allowed_by) for stop in store.stops.rows()] == [("torque_band", "Ada"), ("way_back", "Ada")]
    _, driver = moved(configuration, phase("way_back"), *PLAYED[1:], DONE, at=AWAY)
    assert np.allclose(driver.task.left.home_q, START)


def test_windows_that_are_refused_because_the_arm_stands_elsewhere_are_a_problem_from_the_first_on(configuration):
    """Without a stop, as where somebody jogged the arm away. It ends with the next window that moves or is refused for another reason."""
    with Store.open(configuration.state_directory) as store:
        for hour, reason, windows in (
            (0, DOES_NOT_HOLD(condition="approach_near", why="jog it"), 1),
            (1, DOES_NOT_HOLD(condition="approach_clear", why="a wall"), 2),
            (2, DOES_NOT_HOLD(condition="no_other_program", why="one plays"), 0),
        ):
            ledger_id = store.ledger.claim(3600.0 * hour, "scheduled", 3600.0 * hour)
            store.ledger.end(ledger_id, "skipped", reason, 3600.0 * hour)
            problem = away(store)
            assert (problem is not None) == (windows > 0)
            if problem is not None:
                text = problem.text
                assert "since 1970-01-01T00:00:00Z" in text
                assert reason.text in text
                assert (f"each of {windows} windows" in text) == (windows > 1)


def test_check_says_that_the_arm_will_be_brought_back(configuration, monkeypatch):
    moved(configuration, *PLAYED, failed("parent_asked_to_stop"))
    monkeypatch.setattr(UniversalRobots, "state", lambda *_: ready_state(q=AWAY, target_q=AWAY))
    (near,) = [each for each in check_conditions(configuration) if each.name == "approach_near"]
    assert near.holds
    assert "brought back over the way it came" in near.text


def test_the_page_has_each_harmless_cause_and_says_of_the_right_ones_that_the_arm_is_brought_back():
    """The table is what an integrator reads; it must be what the program does."""
    section = PAGE.read_text("utf-8").split("### How a motion ends")[1].split("\n### ")[0]
    rows = re.findall(r"^\| (`.*?) \| next \| (\[?brought back|a person)", section, re.MULTILINE)
    said = {name: then for names, then in rows for name in re.findall(r"`(\w+)`", names)}
    assert {name for name, then in said.items() if then.endswith("brought back")} == set(ReplayAborted.BROUGHT_BACK)
    assert {name for name, then in said.items() if then == "a person"} == set(ReplayAborted.HARMLESS - ReplayAborted.BROUGHT_BACK)
