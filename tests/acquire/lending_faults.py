"""A fault at a phase of a borrowed arm's replay: what must follow, and a harness that checks it on one cell, case after case."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from fault_cases import restore
from lending_cell import Cell
from processes import ROOT, alive, children

from monitor.acquire.ur.node_script import STATE, TAKEN

STOP_WITHIN_S = 0.25  # of the arm's own clock, from the fault to the stop
STANDS_WITHIN_S = 0.35  # from the stop to standstill, as in `fault_cases`
LATER_S = 1.2  # a watchdog or a thread that was left behind would have stopped the program by then
PHASES = ("node", "approach", "play", "return", "settle", "finish")  # `settle`: after the return; in `finish` the arm is given back
PARENT = """
import subprocess, sys, types
sys.path[:0] = [sys.argv[2]]
sys.modules["prepared"] = types.SimpleNamespace(Process=subprocess.Popen, run=subprocess.run, waiting=set)  # its child bears its own name
from excitations import short
from lending_cell import settings
from monitor.acquire.replay import replay
from monitor.acquire.watch import Caller
from monitor.errors import MonitorError, ReplayAborted
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.acquire.settings import Installation
from monitor.simulate.arm.physics import drive_gain
last = [None]
def show(at):
    if at.phase != last[0]:
        last[0] = at.phase
        print("phase", at.phase, flush=True)
robot = sys.argv[3]
gains = Installation(gains_nm_per_a=tuple(drive_gain(load_robot(robot)).tolist()))
try:
    replay(short(robot=robot), load_robot(robot), settings(sys.argv[1]), context=Context(payload_kg=0.0), installation=gains,
           caller=Caller(on_progress=show))
    print("ended done", flush=True)
except ReplayAborted as error:
    print("ended", error.cause, "borrowed" if error.borrowed else "own", "person" if error.needs_a_person else "nobody", error, flush=True)
except MonitorError as error:
    print("ended", type(error).__name__, "own nobody", error, flush=True)
"""


@dataclass(frozen=True)
class Fault:
    """One fault, and how somebody ends it again before a person restores the cell."""

    name: str
    strike: Callable[[Cell, int], None]  # with the id of the process that replays
    end: Callable[[Cell], None] = lambda cell: None
    harmless: bool = False  # the replay goes on
    lasting: bool = True  # the program itself cannot play on, whether we have its arm or not


def _kill_child(cell: Cell, parent: int) -> None:
    for child in children(parent, "monitor.acquire.ur.stream"):
        os.kill(child, signal.SIGKILL)


def _cable_out(cell: Cell, parent: int) -> None:
    cell.fault("skip", share=1.0)
    cell.fault("mute")


def _resume(cell: Cell) -> None:
    """Somebody lets a paused program play on; one that has ended is not begun again."""
    if cell.dashboard("programState").startswith("PAUSED"):
        cell.tell("play")


def _of_arm(name: str, **arguments: object) -> Callable[[Cell, int], None]:
    return lambda cell, parent: cell.fault(name, **arguments)


FAULTS = (
    Fault("kill -9 of the child", _kill_child, lasting=False),
    Fault("kill -9 of the daemon", lambda cell, parent: os.kill(parent, signal.SIGKILL), lasting=False),
    Fault("end of the server", lambda cell, parent: cell.server.close(), lambda cell: cell.serve(), harmless=True, lasting=False),
    Fault("cable out", _cable_out, lambda cell: cell.fault("clear"), lasting=False),
    Fault("connections cut", _of_arm("close", service="all"), lasting=False),
    Fault("connections reset", _of_arm("reset", service="all"), lasting=False),
    Fault("packets 0.4 s late", _of_arm("late", seconds=0.4, share=1.0), lambda cell: cell.fault("clear"), lasting=False),
    Fault("words to the node lost", _of_arm("mute"), lambda cell: cell.fault("clear"), lasting=False),
    Fault("pendant pause", lambda cell, parent: cell.tell("pause"), _resume),
    Fault("speed slider", _of_arm("speed_slider", fraction=0.5), lambda cell: cell.fault("speed_slider", fraction=1.0), lasting=False),
    Fault("safeguard stop", _of_arm("safeguard_stop", seconds=0.5)),
    Fault("protective stop", _of_arm("protective_stop")),
)


@dataclass(frozen=True)
class Outcome:
    """What followed one fault."""

    fault: Fault
    phase: str
    ended: str  # what the replaying process said last; empty: it was killed
    stop_s: float | None
    went_on: bool  # the program plays
    wrong: tuple[str, ...]

    @property
    def line(self) -> str:
        stop = "-" if self.stop_s is None else f"{self.stop_s:.3f}"
        state = "plays" if self.went_on else "ended"
        return f"{self.fault.name:<24} {self.phase:<9} {state:<6} stop {stop:>6} {self.ended[:70]:<70} {'; '.join(self.wrong)}"


def run_fault(cell: Cell, fault: Fault, phase: str, delay_s: float, robot: str, *, local: bool = False) -> Outcome:
    """The fault, so long after the phase began, on a cell whose program plays; then what was seen until it was over.

    `local`: the controller is in local control, where the dashboard acts for nobody, and whoever pauses the program cannot be told from us.
    """
    play(cell)
    if local and "pendant" not in fault.name:
        cell.fault("remote", state="off")
    before, wrong = cell.truth, []
    command = [sys.executable, "-c", PARENT, cell.host, str(ROOT / "tests" / "acquire"), robot]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT)
    try:
        early = _until(parent, phase)
        if early:
            return Outcome(fault, phase, early, None, True, ("ended before the fault",))
        family = children(parent.pid)
        time.sleep(delay_s)
        truth = cell.truth
        struck_s, lent = truth["clock_s"], truth["output_integers"][STATE] == TAKEN  # the arm may have been taken since the phase began
        borrowed = bool(children(parent.pid, "monitor.acquire.ur.stream"))
        fault.strike(cell, parent.pid)
        time.sleep(0.6)
        fault.end(cell)
        ended = _ended(parent)
    finally:
        parent.kill()
        parent.wait()
    time.sleep(LATER_S)
    truth = cell.truth
    plays = truth["runtime_state"] == 2
    stops = [stop["at_s"] - struck_s for stop in truth["stops"][len(before["stops"]) :] if stop["at_s"] >= struck_s - 0.008]
    if any(alive(pid) for pid in family):
        wrong.append("processes left")
    if cell.astray:
        wrong.append(f"WENT ON FROM A WRONG POSE {cell.astray} times")
    good = ended.startswith("done")
    if good and not plays and not (fault.lasting or phase == "node"):
        wrong.append(f"the program was stopped after it got its arm back: {truth['stops'][-1:]}")
    moving = phase in {"approach", "play", "return"}
    if moving and not fault.harmless and (good or plays):
        wrong.append("the fault was not noticed" if good else "the program plays on")
    if moving and not fault.harmless and ended and " borrowed person" not in ended:
        wrong.append("nobody is asked")
    if fault.harmless and not good:
        wrong.append(f"ended by {ended}")
    if phase == "node" and not lent and not fault.lasting and not plays and " borrowed person" not in ended:
        wrong.append(f"production was stopped: {truth['stops'][-1:]}")
    if (lent or phase in {"settle", "finish"}) and not fault.lasting and not plays and ended and " borrowed person" not in ended:
        wrong.append("the program has ended, and nobody is asked")
    if plays and " borrowed person" in ended:
        wrong.append("told as a program that has ended, and it plays")
    stop_s = _stood(truth, struck_s) if moving and not fault.harmless and borrowed else None
    if stop_s is not None and stop_s > STOP_WITHIN_S + STANDS_WITHIN_S:
        wrong.append(f"stood only after {stop_s:.2f} s; stops {stops[:2]}")
    if moving and not fault.lasting and not fault.harmless and stops and min(stops) > STOP_WITHIN_S:
        wrong.append(f"stopped after {min(stops):.3f} s")
    return Outcome(fault, phase, ended, min(stops) if moving and stops and not fault.harmless else None, plays, tuple(wrong))


def _stood(truth: dict, struck_s: float) -> float | None:
    """How long after the fault the arm stood first; None where it moves."""
    stood = [motion["stood_s"] - struck_s for motion in truth["motions"] if motion["stood_s"] and motion["stood_s"] >= struck_s]
    return min(stood) if stood else (None if not truth["standing"] else 0.0)


def play(cell: Cell) -> None:
    """A cell whose program plays, whatever was before."""
    truth = cell.truth
    with contextlib.suppress(OSError):
        cell.fault("clear")
        cell.fault("remote", state="on")
        cell.fault("speed_slider", fraction=1.0)
    if truth["runtime_state"] == 2 and truth["safety_mode"] == 1 and not truth["popup"]:
        return
    restore(cell.host)
    assert cell.dashboard("play") == "Starting program"
    time.sleep(0.3)


def _until(parent: "subprocess.Popen[str]", phase: str) -> str:
    """Read until the process tells this phase, the last of its name; what it said where it ended before."""
    assert parent.stdout is not None
    returned = False
    for line in parent.stdout:
        kind, _, rest = line.strip().partition(" ")
        if kind == "ended":
            return rest
        returned = returned or (kind == "phase" and rest == "return")
        if kind == "phase" and rest == phase and (phase != "settle" or returned):
            return ""
    return "nothing"


def _ended(parent: "subprocess.Popen[str]") -> str:
    """The last word of the process; empty where it was killed."""
    try:
        printed, _ = parent.communicate(timeout=25.0)
    except subprocess.TimeoutExpired:
        return "never"
    lines = [line for line in (printed or "").splitlines() if line.startswith("ended ")]
    return lines[-1].removeprefix("ended ") if lines else ""
