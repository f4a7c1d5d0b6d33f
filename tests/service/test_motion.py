"""Motions in the history: every ending that is not known to be good waits for a person, whatever ended it."""

import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from excitations import short
from prepared import run
from test_driver import DONE, WAITING, MovingSession, ScriptedDriver, ScriptedSession, phase, row
from test_guard import ready_state
from typer.testing import CliRunner

from monitor.acquire.state import Identity
from monitor.acquire.watch import Caller
from monitor.cli.main import app
from monitor.config.load import load
from monitor.config.schema import Configuration
from monitor.errors import MotionRefused, ReplayAborted, StoreError, StoreUnavailable
from monitor.service.motion import check_conditions, move
from monitor.store.store import Store

PLAY = [phase("control"), phase("play"), row(1), row(2)]
LATE = {"kind": "failed", "cause": "late", "text": "a target came late"}


@pytest.fixture
def configuration(tmp_path: Path, free_port: int) -> Configuration:
    """Of an arm that needs no first pass."""
    (tmp_path / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n'
        '[replay]\nallow_motion = true\nfirst_pass = false\ncell = "unchecked"\nconfirm_timeout_s = 1.0\n'
        f'[bus]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n'
    )
    return load(tmp_path / "cell.toml")


def arm(*frames, after: Callable[[], object] = ready_state, identity: Identity | None = None) -> ScriptedDriver:
    """A driver whose session sends these frames after `go`; `after` is the arm's state after the motion, None: it does not answer."""
    driver = ScriptedDriver(ScriptedSession(WAITING, [*PLAY, *frames], exit_code=-9), identity=identity)
    driver.state = lambda *_: after()
    return driver


def moved(configuration: Configuration, store: Store, driver: ScriptedDriver, caller: Caller | None = None, **more) -> ReplayAborted | None:
    """The abort with which a motion ended; None where it was complete."""
    try:
        move(
            configuration,
            store,
            short(),
            configuration.context,
            caller=caller or Caller(),
            first_pass_path=configuration.state_directory / "first.parquet",
            driver=driver,
            **more,
        )
    except ReplayAborted as error:
        return error
    return None


def causes(store: Store) -> list[str]:
    return [stop.cause for stop in store.stops.waiting()]


def test_a_harmless_end_is_harmless_only_where_the_arm_was_seen_in_order_after_it(configuration: Configuration):
    """At rest, powered, normal, without a program: the next window moves. Anything else, or no answer at all, asks for a person."""
    state = ready_state()
    cases = [
        (lambda: state, None, ""),
        (lambda: None, "late", "whether it has power"),  # the main switch
        (lambda: replace(state, safety_mode=3, safety_bits=0b100_0000_0100), "protective_stop", "safety mode is 3"),
        (lambda: replace(state, robot_mode=3), "robot_mode", "power off"),
        (lambda: replace(state, runtime_state=2), "late", "a program is playing"),
        (lambda: replace(state, qd=state.qd + 0.1), "late", "does not stand still"),
        (lambda: replace(state, qd=state.qd * float("nan")), "late", "does not stand still"),
    ]
    for after, cause, text in cases:
        with Store.open(configuration.state_directory) as store:
            error = moved(configuration, store, arm(LATE, after=after))
            assert error is not None
            assert error.needs_a_person == (cause is not None)
            assert text in str(error)
            assert causes(store) == ([] if cause is None else [cause])
            assert store.motions.left_over() == []
            store.stops.allow("Ada", "looked", 1.0)


def test_a_stop_that_was_not_confirmed_waits_for_a_person_also_where_the_arm_is_seen_at_rest(configuration: Configuration):
    """Its text says: look at the arm. It said so, and the same window moved the arm again."""
    for after in (ready_state, lambda: None):
        with Store.open(configuration.state_directory) as store:
            driver = arm(after=after)
            driver.stop_program = lambda host, ours: "not_shown"
            error = moved(configuration, store, driver)
            assert error is not None
            assert "DID NOT CONFIRM" in str(error)
            assert error.needs_a_person
            assert len(causes(store)) == 1
            store.stops.allow("Ada", "looked", 1.0)


def test_a_controller_that_was_restarted_in_the_gap_waits_for_a_person(configuration: Configuration):
    """It came back with power, and the same window moved the arm a minute later."""
    with Store.open(configuration.state_directory) as store:
        error = moved(configuration, store, arm(LATE, after=lambda: ready_state(controller_s=3.0)))
        assert error is not None
        assert error.needs_a_person
        assert "-7.0 s by the controller's" in str(error)
        assert causes(store) == ["late"]
        with pytest.raises(MotionRefused, match="previous_stop"):
            moved(configuration, store, arm(DONE))


def test_a_complete_replay_leaves_nothing_and_a_stop_after_it_waits(configuration: Configuration):
    """A program of the cell that runs already is no fault. An emergency stop in the last moment keeps the recording, and waits."""
    state = ready_state()
    with Store.open(configuration.state_directory) as store:
        assert moved(configuration, store, arm(DONE, after=lambda: replace(state, runtime_state=2, qd=state.qd + 0.3))) is None
        assert [motion.ending for motion in store.motions.rows()] == ["done"]
        assert causes(store) == []
        assert moved(configuration, store, arm(DONE, after=lambda: replace(state, safety_mode=7))) is None
        assert causes(store) == ["emergency_stop"]
        with pytest.raises(MotionRefused, match="previous_stop"):
            moved(configuration, store, arm(DONE))


class Lent:
    """A window of the ledger that is entered when the arm is taken."""

    def __init__(self, store: Store) -> None:
        self.store, self.steps = store, []

    def enter(self) -> int:
        self.steps.append("entered")
        return self.store.ledger.claim(1.0, "scheduled", 1.0) or self.store.ledger.rows(limit=1)[0].id

    def taken(self) -> None:
        self.steps.append("taken")

    def given_back(self) -> None:
        self.steps.append("given back")


def test_a_lent_arm_enters_its_window_when_it_is_taken_and_its_program_may_move_it_afterwards(configuration: Configuration):
    """Nothing is in the history before that, because days may pass. A program that goes on with its arm is no fault."""
    state, lending = ready_state(), replace(configuration, replay=replace(configuration.replay, hand_over="script_node"))
    lent = [phase("connect"), phase("node"), {"kind": "taken", "number": 7}, phase("ready")]
    before = [*lent, {"kind": "state", "row": row(0, runtime_state=2).tolist()}]
    driver = ScriptedDriver(ScriptedSession(before, [*PLAY, phase("finish"), {"kind": "given_back"}, DONE]))
    driver.state = lambda *_: replace(state, runtime_state=2, qd=state.qd + 0.3)
    with Store.open(configuration.state_directory) as store:
        window = Lent(store)
        assert moved(lending, store, driver, window=window) is None
        assert window.steps == ["taken", "entered", "given back"]
        assert [motion.ending for motion in store.motions.rows()] == ["done"]
        assert causes(store) == []


def test_a_full_disk_keeps_the_arm_where_it_is_or_asks_for_a_person(configuration: Configuration, monkeypatch: pytest.MonkeyPatch):
    """Before the motion: nothing moves. At its end: the motion keeps no end, and the next one is refused."""

    def full(*_: object, **__: object) -> None:
        raise StoreUnavailable("no space is left")

    with Store.open(configuration.state_directory) as store:
        driver = arm(DONE)
        with monkeypatch.context() as patched:
            patched.setattr(store.motions, "begin", full)
            with pytest.raises(StoreError, match="no space"):
                moved(configuration, store, driver)
        assert driver.session.sent == []
        with monkeypatch.context() as patched:
            patched.setattr(store.motions, "end", full)
            assert moved(configuration, store, arm(DONE)) is None
        with pytest.raises(MotionRefused, match="was under way"):
            moved(configuration, store, arm(DONE))
        assert causes(store) == ["unknown_end"]


DYING = """
import os, signal, sys
from pathlib import Path
sys.path[:] = sys.argv[2:]
from monitor.service.motion import Claimed
from test_motion import *
configuration = load(Path(sys.argv[1]))
class Dying(MovingSession):
    def frames(self, timeout_s):
        if self.tick == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().frames(timeout_s)
with Store.open(configuration.state_directory) as store:
    moved(configuration, store, ScriptedDriver(Dying()), window=Claimed(store.ledger.claim(1.0, "scheduled", 1.0)))
"""


def test_sigkill_or_a_power_cut_in_mid_motion_waits_for_a_person(configuration: Configuration):
    """A protective stop 20 ms before would be unknown to everybody: so any such end counts as one. `check` says it at once."""
    done = run([sys.executable, "-c", DYING, str(configuration.path), *sys.path], 100.0)
    assert done.returncode == -signal.SIGKILL
    found = {each.name: each for each in check_conditions(configuration)}
    assert not found["previous_stop"].holds
    assert "whether the arm came to rest" in found["previous_stop"].text
    with Store.open(configuration.state_directory) as store:
        with pytest.raises(MotionRefused, match="previous_stop"):
            moved(configuration, store, ScriptedDriver(MovingSession()))
        (stop,) = store.stops.waiting()
        assert (stop.cause, stop.ledger_id) == ("unknown_end", 1)


def test_an_error_of_this_program_in_mid_motion_waits_for_a_person(configuration: Configuration):
    """Also in a replay by hand, where no window has it."""
    session = MovingSession()

    def forbidden() -> str | None:
        if session.tick > 3:
            raise ZeroDivisionError
        return None

    with Store.open(configuration.state_directory) as store:
        with pytest.raises(ZeroDivisionError):
            moved(configuration, store, ScriptedDriver(session), caller=Caller(forbidden=forbidden))
        assert causes(store) == ["internal"]


def test_another_arm_at_the_address_waits_for_a_person_and_begins_slowly(configuration: Configuration):
    """The serial number met first is expected. The other one is named, once; a person allows it, and it must begin with a first pass."""
    other = Identity("UR5", "8", "3.15.8", True)
    with Store.open(configuration.state_directory) as store:
        assert moved(configuration, store, arm(DONE)) is None
        assert store.motions.expected_serial() == "7"
        store.first_passes.add("digest", {}, 1.0)
        for refusal in ("expected 7", "previous_stop"):
            with pytest.raises(MotionRefused, match=refusal):
                moved(configuration, store, arm(DONE, identity=other))
        (stop,) = store.stops.waiting()
        assert (stop.cause, stop.serial) == ("another_arm", "8")
        assert "serial number is 8, expected 7" in stop.text
        store.stops.allow("Ada", "the arm was replaced", 1.0)
        assert not store.first_passes.is_latest("digest")
        assert moved(configuration, store, arm(DONE, identity=other)) is None
        with pytest.raises(MotionRefused, match="expected 8"):
            moved(configuration, store, arm(DONE))
        with pytest.raises(MotionRefused, match="previous_stop"):
            moved(configuration, store, arm(DONE, identity=Identity("UR5", None, "3.15.8", True)))


def test_a_serial_number_in_the_configuration_is_what_a_person_says(configuration: Configuration):
    """It replaces the one met before, and another one is refused without a stop: the file says what is right."""
    named = replace(configuration, robot=replace(configuration.robot, serial="8"))
    with Store.open(configuration.state_directory) as store:
        assert moved(configuration, store, arm(DONE)) is None
        with pytest.raises(MotionRefused, match="is 7, expected 8"):
            moved(named, store, arm(DONE))
        assert causes(store) == []
        assert moved(named, store, arm(DONE, identity=Identity("UR5", "8", "3.15.8", True))) is None
        assert store.motions.expected_serial() == "8"


def test_allow_names_the_arm_that_is_expected_from_now_on(configuration: Configuration):
    """A person reads its number when it is accepted."""
    arguments = ["--config", str(configuration.path), "--by", "Ada", "--why", "the arm was replaced"]
    with Store.open(configuration.state_directory) as store:
        store.stops.add_another_arm("20185500002", "the controller's serial number is 20185500002", 1.0)
    done = CliRunner().invoke(app, ["allow", *arguments])
    assert "from now on the arm with the serial number 20185500002 is expected; its first pass is slow" in done.stdout
    with Store.reader(configuration.state_directory) as store:
        assert store.motions.expected_serial() == "20185500002"
    assert "no stop is waiting" in CliRunner().invoke(app, ["allow", *arguments]).stdout
