"""Every fault of the simulator, at any moment of a replay: what must follow, and a harness that checks it.

One arm plays one replay after the other, so the replay of each case proves that the case before left an arm that works.
"""

import math
import socket
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from processes import children

from monitor.acquire.driver import usual_driver
from monitor.acquire.ending import look_after
from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.dashboard import Dashboard
from monitor.acquire.ur.stream import STOP_RAMP_S
from monitor.acquire.watch import Caller, ReplayProgress
from monitor.errors import ReplayAborted, RobotUnreachable
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Context
from monitor.simulate.arm.damage import DAMAGES
from monitor.simulate.remote import Remote

STOP_WITHIN_S = 0.25  # of the simulated arm's own clock, from the fault to the stop
STANDS_WITHIN_S = (
    0.35  # from the stop to standstill: the fastest joint's 2.5 rad/s at the 15 rad/s² of a program stop, and the servo's settling
)
REPORTED_WITHIN_S = 2.0
TICK_S = 0.008
IN_PHASE_S = 0.3  # into the approach or the return
# where a fault meets an arm that is stalled or gone, the cause is the one that was seen first
# causes by which a busy machine ends a replay before its fault; by the last a program that answers late while control is taken
DISTURBED = frozenset({"late", "stalled", "following_error", "timeout", "no_control"})
ATTEMPTS = 4
ALONG_THE_PATH = frozenset({"local_control"})  # after these the arm comes to rest along its path, and its rows go on until then
HELD = frozenset({"following_error", "protective_stop", "torque_band"})  # something holds the arm up
LOST = frozenset({"connection_lost", "stalled", "controller_restarted"})


@dataclass(frozen=True)
class Case:
    """One fault and the causes by which it may end a replay; without a cause the replay must succeed."""

    name: str
    arguments: dict[str, Any] = field(default_factory=dict)
    causes: frozenset[str] = frozenset()
    shows_within_s: float = 0.0  # from the command until the fault is there
    may_succeed: bool = False  # the replay may also be over before the fault shows
    person: bool | None = None  # whether a person must allow the next motion; None where it depends on what was seen
    phase: str = "play"  # of the replay; before and after the play the fault comes 0.3 s after the phase has begun
    theirs: bool = False  # somebody else's program plays after ours, which nobody of us may stop

    @property
    def description(self) -> str:
        where = [] if self.phase == "play" else [f"in the {self.phase}"]
        return " ".join([self.name, *(f"{key}={value}" for key, value in self.arguments.items()), *where])


def _case(name: str, *causes: str, **arguments: Any) -> Case:
    return Case(name, arguments, frozenset(causes))


def _person(name: str, *causes: str, **arguments: Any) -> Case:
    """A fault after which a person must look at the arm."""
    return Case(name, arguments, frozenset(causes), person=True)


STOPPING = (
    _case("stall", "stalled", seconds=1.0),
    _case("stall", "stalled", "connection_lost", seconds=3.5),  # beyond ur-rtde's own patience
    _case("close", "connection_lost", service="rtde"),
    _case("reset", "connection_lost", service="rtde"),
    _case("close", "connection_lost", service="all"),
    _case("reset", "connection_lost", service="all"),
    _person("restart", *LOST, seconds=0.5, power="on"),
    _case("freeze", "stalled", seconds=0.6),
    _case("late", "stalled", seconds=0.4, share=1.0),
    _case("skip", "stalled", share=1.0),
    _case("program_stop", "program_stopped"),
    _case("recover", "program_stopped"),
    _case("mute", "program_stopped", "servo_refused"),  # targets do not arrive: the arm's watchdog stops it
    _person("protective_stop", "protective_stop", runtime="paused"),
    _person("protective_stop", "protective_stop", runtime="stopped"),
    _person("protective_stop", "protective_stop", runtime="playing"),
    _person("safeguard_stop", "safeguard_stop", seconds=0.15),  # the program would play on, were it not stopped by then
    _person("safeguard_stop", "safeguard_stop", seconds=0.0),
    _person("emergency_stop", "emergency_stop"),
    Case(
        "temperature_glitch", {"joint": 4, "value": 200.0}, frozenset({"joint_temperature"}), shows_within_s=32 * TICK_S
    ),  # one tick of 32
    # asked five times a second; then the arm slows down along its path, settles, and ends its program
    Case("remote", {"state": "off"}, frozenset({"local_control"}), shows_within_s=1.0),
    # one connection alone, in the order in which the session opens them
    *(_case(fault, "connection_lost", service="rtde", connection=number) for fault in ("close", "reset") for number in (1, 2)),
    _person("power_cut", *LOST, seconds=1.0, connections="silent"),
    _person("power_cut", *LOST, seconds=1.0, connections="reset"),
    _person("clock_jump", "controller_restarted", "stalled", seconds=5.0),
    _person("clock_jump", "controller_restarted", "stalled", seconds=-5.0),
    Case(
        "foreign_program",
        {"when": "now", "seconds": 4.0},
        frozenset({"program_stopped", "following_error", "speed_scaling", "torque_band"}),
        theirs=True,
    ),
    _person("teach_button", "teach_button"),
    _case("speed_slider", "speed_scaling", fraction=0.5),
    _case("payload_changed", "payload", kg=2.0),
    _person("reduced", "safety"),
    _person("stuck", "following_error", "protective_stop", "torque_band", joint=2),
    _person("obstacle", "torque_band", "following_error", "protective_stop", joint=2, torque=120.0),
    _person("brake", "robot_mode", "following_error", "protective_stop", joint=3),
    *(Case("close", {"service": "rtde", "connection": 2}, frozenset({"connection_lost"}), phase=phase) for phase in ("approach", "return")),
    *(Case("stuck", {"joint": 2}, HELD, person=True, phase=phase) for phase in ("approach", "return")),
    Case("obstacle", {"joint": 2, "torque": 120.0}, HELD, person=True, phase="approach"),
    Case("power_cut", {"seconds": 1.0, "connections": "silent"}, LOST, person=True, phase="approach"),
    Case("safeguard_stop", {"seconds": 0.15}, frozenset({"safeguard_stop"}), person=True, phase="return"),
    _person("obstacle", "torque_band", joint=2, torque=90.0),
    Case(  # a spring, against which torque grows only as the joint moves: at the start of a play it is slow
        "obstacle", {"joint": 3, "stiffness": 1500.0, "seconds": 1.0}, HELD, shows_within_s=0.2, person=True
    ),
    # the current of a joint that stays as it is shows once another torque is expected
    Case("current_stuck", {"joint": 1}, frozenset({"torque_band"}), shows_within_s=3.0, may_succeed=True),
    _case("encoder_offset", "following_error", "protective_stop", joint=2, value=0.2),
)
HARMLESS = (
    _case("listener_gone", service="rtde"),
    _case("listener_gone", service="dashboard"),
    _case("close", service="dashboard"),
    _case("close", service="secondary"),
    *(_case(fault, service="realtime", connection=1) for fault in ("close", "reset")),  # the script has been sent; nothing more goes there
    _case("text_at_connect"),
    _case("registers_in_use"),
    _case("version", version="5.3.0"),
    _case("not_found", names="payload"),
    _case("digital_input", number=3, state="on"),
    _case("emergency_release"),
    _case("temperatures_frozen"),
    # ten times the noise from one tick to the next may be taken for a contact before the band has measured it: the arm stops then
    Case("current_noise", {"factor": 10.0}, frozenset({"torque_band"}), shows_within_s=0.3, may_succeed=True, person=True),
    _case("skip", share=0.02),
    _case("obstacle", joint=2, torque=1.0),  # less than friction varies
    _case("never_ready", "stalled", "timeout"),  # the next target waits for it, and so does the process that streams
    _case("watchdog_dead"),  # it was tested before the motion, and nothing asks it to act
    Case("foreign_program", {"when": "after_ours", "delay": 0.15, "seconds": 1.0}, theirs=True),
    _case("payload_changed", kg=0.0, x=0.1),  # conditions before a motion compare it, and the motion itself is the same
    _case("tcp_changed", z=0.1),
    _case("wrist_turned", turns=0),  # by no turn: an arm in motion cannot be turned by hand
    *(_case(name, joint=3, severity=0.3) for name in DAMAGES),  # damage by which a joint moves on
    _case("clear"),
)
FAULTS = (*STOPPING, *HARMLESS)


@dataclass(frozen=True)
class Outcome:
    """What one case led to; `wrong` is empty where everything is as it must be."""

    case: Case
    at_s: float  # into the play
    cause: str | None
    stop_s: float | None  # from the fault to the stop in force, the arm's clock
    stand_s: float | None  # from there to standstill
    reported_s: float | None  # until the parent raised, the host's clock
    wrong: tuple[str, ...]
    person: bool | None = None  # whether a person must allow the next motion
    disturbed: int = 0  # replays before this one that ended before any fault, because of the machine's other work


RESTED_S = 0.3


def restore(host: str) -> None:
    """End every fault, unlock the protective stop and switch the power on, as a person would; returns once the arm is ready.

    It has to be so for RESTED_S: an arm that a spring has let go passes through standstill, and moves on.
    """
    deadline, ready_since = time.monotonic() + 20.0, None
    with Remote(host) as remote:
        remote.fault("clear")
        remote.fault("emergency_release")
        remote.fault("program_stop")  # somebody else may end their own
    while time.monotonic() < deadline:
        with Remote(host) as remote:
            truth = remote.truth()
        if truth["robot_mode"] == 7 and truth["safety_mode"] == 1 and truth["standing"] and truth["program"] is None:
            ready_since = ready_since or time.monotonic()
            if time.monotonic() - ready_since >= RESTED_S:
                return
            time.sleep(0.05)
            continue
        ready_since = None
        if truth["safety_mode"] == 3:  # by a script, which the controller takes at once; the dashboard keeps a person waiting for 5 s
            with socket.create_connection((host, 30002), timeout=2.0) as wire:
                wire.sendall(b"set unlock protective stop\n")
                time.sleep(0.1)
        elif truth["robot_mode"] != 7:
            with Dashboard(host) as dashboard:
                dashboard.ask("power on")
                dashboard.ask("brake release")
        time.sleep(0.1)
    raise AssertionError(f"{host}: the simulated arm did not become ready again")


def stand_aside(host: str, excitation: Excitation) -> None:
    """Move the arm 0.4 rad away from the start of the trajectory, so that there is a way to it."""
    aside = excitation.at(np.zeros(1)).q[0] + 0.4
    with socket.create_connection((host, 30002), timeout=2.0) as wire:
        wire.sendall(f"movej({aside.tolist()}, a=2.0, v=1.0)\n".encode())
        time.sleep(0.3)
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:
        with Remote(host) as remote:
            truth = remote.truth()
        if truth["standing"] and truth["program"] is None and np.max(np.abs(np.array(truth["q"]) - aside)) < 0.01:
            return
        time.sleep(0.05)
    raise AssertionError(f"{host}: the simulated arm did not go aside")


def run_case(case: Case, at_s: float, excitation: Excitation, robot: Robot, settings: ReplaySettings) -> Outcome:
    """One fault in one replay, and its outcome; a replay that other work of the machine ended before the fault is repeated."""
    disturbed = 0
    while True:
        restore(settings.host)
        if case.phase != "play":
            stand_aside(settings.host, excitation)
        outcome = _run_once(case, at_s, excitation, robot, settings)
        unshown = not case.causes or (case.may_succeed and outcome.cause not in case.causes)  # the fault ends none, or had not shown yet
        before_the_fault = outcome.reported_s is None or unshown
        if outcome.cause not in DISTURBED or not before_the_fault or disturbed == ATTEMPTS - 1:
            return replace(outcome, disturbed=disturbed)
        disturbed += 1


def _run_once(case: Case, at_s: float, excitation: Excitation, robot: Robot, settings: ReplaySettings) -> Outcome:
    host, wrong = settings.host, []
    fault: dict[str, float] = {}
    began_before = [0]  # the programs that had begun when the fault came
    rows = [0]

    def on_progress(progress: ReplayProgress) -> None:
        rows[0] = progress.rows
        since_s = at_s if case.phase == "play" else IN_PHASE_S
        if progress.phase == case.phase and progress.elapsed_s >= since_s and not fault:
            with Remote(host) as remote:
                truth = remote.truth()
                began_before[0] = max((run["number"] for run in truth["programs"]), default=0)
                fault["clock_s"] = truth["clock_s"]
                fault["at"] = time.monotonic()
                remote.fault(case.name, **case.arguments)

    cause, recording, person, reported_s = None, None, False, None
    driver = usual_driver()
    witness = driver.witness(host)
    try:
        caller = Caller(on_progress=on_progress)
        recording = replay(excitation, robot, settings, context=Context(payload_kg=0.0), caller=caller, witness=witness)
    except RobotUnreachable:
        cause = "stalled"  # before it moved
    except ReplayAborted as error:
        cause, reported_s = error.cause, time.monotonic() - fault["at"] if fault else None
        if case.person is not None:  # as the service judges an end: after a look at the arm
            person = look_after(driver, settings, error, witness=witness)[0].needs_a_person
        if "DID NOT CONFIRM" in str(error) and case.name not in {"restart", "freeze", "mute", "power_cut", "foreign_program"}:
            wrong.append("the stop was not confirmed")
    finally:
        witness.close()
    if fault and reported_s is None:
        reported_s = time.monotonic() - fault["at"]
    if children():
        wrong.append(f"processes left: {children()}")
    if not fault:
        return Outcome(case, at_s, cause, None, None, None, (f"ended by {cause} before the fault", *wrong))
    if not case.causes or (case.may_succeed and cause is None):
        if recording is None:
            wrong.append(f"aborted by {cause}, expected none the worse")
        else:
            wrong += wrong_rows(recording, excitation)
        if case.theirs:
            wrong += stopped_by_us(host, began_before[0])
        return Outcome(case, at_s, cause, None, None, None, tuple(wrong))
    if cause not in case.causes:
        wrong.append(f"cause {cause}, expected {' or '.join(sorted(case.causes))}")
    if reported_s is not None and reported_s > REPORTED_WITHIN_S:
        wrong.append(f"told after {reported_s:.2f} s")
    if rows[0] > most_rows(excitation.duration_s, along_the_path=cause in ALONG_THE_PATH):
        wrong.append(f"{rows[0]} rows in {excitation.duration_s:g} s")
    if case.person is not None and person != case.person:
        wrong.append(f"a person is {'' if person else 'not '}asked")
    if case.theirs:
        wrong += stopped_by_us(host, began_before[0])
        return Outcome(case, at_s, cause, None, None, reported_s, tuple(wrong), person)
    stop_s, stand_s = standstill(case, host, fault["clock_s"], wrong)
    return Outcome(case, at_s, cause, stop_s, stand_s, reported_s, tuple(wrong), person)


def most_rows(duration_s: float, *, along_the_path: bool) -> int:
    """As many rows as a play of this duration has at most; where it slows down along its path, it may end half the ramp later."""
    return math.floor((duration_s + (STOP_RAMP_S / 2.0 if along_the_path else 0.0)) / TICK_S + 1e-6) + 1


def stopped_by_us(host: str, began_before: int) -> list[str]:
    """What is wrong where somebody else's program plays after the first `began_before` programs: it was stopped, or never came."""
    time.sleep(1.0)  # it may begin only now, and we may do something late
    with Remote(host) as remote:
        programs = remote.truth()["programs"]
    theirs = [run for run in programs if run["owner"] == "somebody else" and run["number"] > began_before]
    if not theirs:
        return ["somebody else's program never began"]
    by = theirs[-1]["stopped_by"]
    return [] if by in ("", "itself") else [f"somebody else's program was stopped by {by}"]


def moved_again(truth: dict[str, Any], since_clock_s: float) -> list[str]:
    """What began after the first stop at or after this time: another program, or a stretch of motion under one.

    Without a program the arm moves only where something outside lets it go.
    """
    programs = [run for run in truth["programs"] if run["boot"] == truth["boot"]]
    motions = [motion for motion in truth["motions"] if motion["boot"] == truth["boot"]]
    ends = [run["ended_s"] for run in programs if run["ended_s"] is not None and run["ended_s"] >= since_clock_s - TICK_S]
    if not ends:
        return []
    began = [f"program {run['number']}" for run in programs if run["began_s"] >= ends[0]]
    stood = [motion["stood_s"] for motion in motions if motion["stood_s"] is not None and motion["stood_s"] >= ends[0]]
    began += [
        f"motion at {motion['began_s']:.2f} s"
        for motion in motions
        if stood and motion["began_s"] > stood[0] and motion["program"] is not None
    ]
    return [f"began again: {', '.join(began)}"] if began else []


def standstill(case: Case, host: str, since_clock_s: float, wrong: list[str]) -> tuple[float | None, float | None]:
    """Times from fault to stop and from stop to standstill, by the arm's clock; adds to `wrong` what is wrong."""
    deadline = time.monotonic() + 5.0
    while True:
        try:
            with Remote(host) as remote:
                truth = remote.truth()
        except Exception:  # it may be dead for a moment, on command
            truth = None
        if truth is not None and truth["standing"]:
            break
        if time.monotonic() > deadline:
            wrong.append("still moving after 5 s")
            return None, None
        time.sleep(0.02)
    before = np.array(truth["q"])
    time.sleep(0.3)
    with Remote(host) as remote:
        again = remote.truth()
    if np.max(np.abs(np.array(again["q"]) - before)) > 4e-3:  # rad: a servo settles by less, an arm that is sent about goes on by 0.1
        wrong.append("moves again")
    if again["program"] is not None and again["runtime_state"] == 2:
        wrong.append("a program runs")
    if case.name in {"restart", "power_cut"}:
        return None, None  # the controller that could tell is gone; its successor found the arm braked
    stops = [stop for stop in truth["stops"] if stop["at_s"] >= since_clock_s - TICK_S]
    wrong += moved_again(again, since_clock_s)
    if not stops:
        wrong.append("no stop was noted")
        return None, None
    stop_s = stops[0]["at_s"] - since_clock_s
    stand_s = None if stops[0]["stood_at_s"] is None else stops[0]["stood_at_s"] - stops[0]["at_s"]
    if stop_s > STOP_WITHIN_S + case.shows_within_s:
        wrong.append(f"stopped after {stop_s:.3f} s")
    if stand_s is not None and stand_s > STANDS_WITHIN_S:
        wrong.append(f"stood {stand_s:.3f} s after that")
    return stop_s, stand_s


def wrong_rows(recording: Any, excitation: Excitation) -> list[str]:
    """What is wrong with the rows: they are doubled, lie between ticks, or are more or fewer than the motion has."""
    wrong = []
    ticks = (recording.t_s - recording.t_s[0]) / TICK_S
    if np.max(np.abs(ticks - np.round(ticks))) > 1e-3:
        wrong.append("rows between ticks")
    if np.any(np.diff(np.round(ticks)) < 1):
        wrong.append("doubled rows")
    expected = round((excitation.duration_s + recording.quality["slipped_s"]) / TICK_S) + 1
    if abs(recording.samples + recording.quality["missed_ticks"] - expected) > 2:
        wrong.append(f"{recording.samples} rows and {recording.quality['missed_ticks']} missed, expected {expected}")
    return wrong


def table(outcomes: list[Outcome]) -> str:
    """The outcomes as a table for a person."""

    def number(value: float | None) -> str:
        return "     –" if value is None else f"{value:6.3f}"

    lines = [f"{'fault':<54}{'at':>6} {'cause':<22}{'stop':>7}{'stands':>8}{'told':>7}"]
    for o in outcomes:
        line = f"{o.case.description:<54}{o.at_s:6.1f} {o.cause or '–':<22}"
        line += f"{number(o.stop_s):>7}{number(o.stand_s):>8}{number(o.reported_s):>7}"
        line += "  person" if o.person else ""
        line += f"  (played {o.disturbed + 1} times)" if o.disturbed else ""
        lines.append(line + (f"  WRONG: {'; '.join(o.wrong)}" if o.wrong else ""))
    return "\n".join(lines)
