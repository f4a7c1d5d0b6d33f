"""One connection alone is cut, by FIN or RST, in each phase: the arm stops in time and never goes on by itself.

What happened is judged by the simulated controller's own logbook: programs, motions and stops on its clock.
"""

import random
import statistics
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from cutting_proxy import CONNECTIONS, CONTROL, RECEIVE, SCRIPT, CuttingProxy, cutting_proxy
from excitations import short
from processes import children
from simulated_arm import ASIDE, simulated_arm

from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.dashboard import Dashboard
from monitor.acquire.watch import Caller
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time

UR5 = load_robot("ur5")
PHASES = {"control": 0.15, "approach": 0.5, "settle": 0.1, "play": 0.9, "return": 0.4, "finish": 0.35}  # within: the cut, at the latest
TAKING_CONTROL_S = 0.4  # from the first program that is sent to the second
# the connection on which programs are sent is ended by ourselves before anything moves
PHASES_OF = dict.fromkeys(CONNECTIONS, PHASES) | {SCRIPT: {"control": TAKING_CONTROL_S}}
NEEDED = {RECEIVE, CONTROL}  # without these the motion must end; the others are not needed once the program runs
STOP_WITHIN_S = 0.25
LOST = {
    "connection_lost",
    "no_control",
    "no_watchdog",
}  # how a cut may be named: before the arm moves it may show as either of the last two
BUSY = {"late", "stalled", "timeout"}  # causes by which other work of the machine ends a replay
IN_FLIGHT_S = 0.1  # a program that was sent just before the cut may begin so much later; nothing moves then
DONE = "done"
GOES_ON = {DONE, "parent_asked_to_stop"}  # how a replay ends whose cut connection it does not need
PROGRAMS = 2  # of one replay: that with which the watchdog is tried, and that of the motion
PARTS, PART = 5, 100  # of the soak, for each connection: parts, and cuts in a part
QUICK = short(period_s=1.5)  # the same way as `short()` in half its time, with the same calls of ur-rtde and the same connections


@dataclass
class Cut:
    """One cut, and what followed."""

    connection: str
    reset: bool
    phase: str
    after_s: float
    begun_s: float = 0.0  # the controller's clock before the replay
    at_s: float | None = None  # … and at the cut
    hit: int = 0  # connections that were there to be cut
    cause: str = ""
    text: str = ""  # what the end of the replay said
    stop_s: float | None = None  # from the cut to the stop in force
    left_over: bool = False  # a control program without targets
    programs_after: int = 0
    motions_after: int = 0
    wrong: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        stop = "" if self.stop_s is None else f" stop {self.stop_s:.3f} s"
        kind = "RST" if self.reset else "FIN"
        return (
            f"{self.connection} {kind} {self.after_s:.2f} s into {self.phase}: {self.cause}, {self.hit} cut{stop} {self.wrong} {self.text}"
        )


def threads_that_may_connect() -> list[str]:
    """Threads of the streaming process that the kernel would let open a socket, by /proc."""
    tasks = [task for pid in children() for task in Path(f"/proc/{pid}/task").iterdir()]
    return [task.name for task in tasks if "Seccomp:\t2" not in (task / "status").read_text()]


def run_cut(cut: Cut, host: str, controller: str, proxy: CuttingProxy) -> Cut:
    """One replay with its cut. Other ends than by the cut are left to the caller."""
    stop = threading.Event()
    timer: list[threading.Timer] = []
    with Remote(controller) as remote:
        cut.begun_s = remote.truth()["clock_s"]

    def act() -> None:
        if cut.phase in {"approach", "play"} and (free := threads_that_may_connect()):
            cut.wrong.append(f"threads without the filter: {free}")
        with Remote(controller) as remote:
            cut.at_s = remote.truth()["clock_s"]
        cut.hit = proxy.cut(cut.connection, reset=cut.reset)
        if cut.connection not in NEEDED or not cut.hit:
            time.sleep(0.3)
            stop.set()  # the replay goes on; the rest of it would show nothing more

    def on_progress(progress) -> None:
        # the end is too short to be seen: it is reckoned from the end of the return
        begins_s = {"finish": progress.duration_s}.get(cut.phase, 0.0)
        if progress.phase == {"finish": "return"}.get(cut.phase, cut.phase) and not timer:
            timer.append(threading.Timer(max(begins_s + cut.after_s - progress.elapsed_s, 0.0), act))
            timer[0].start()

    settings = ReplaySettings(host=host, allow_motion=True, first_pass=False, approach_speed_rad_s=1.0, max_approach_rad=6.0)
    try:
        replay(QUICK, UR5, settings, context=Context(payload_kg=0.0), caller=Caller(on_progress=on_progress, should_stop=stop.is_set))
        cut.cause = DONE
    except ReplayAborted as error:
        cut.cause, cut.text = error.cause, str(error)
    except (MotionRefused, RobotUnreachable) as error:
        cut.cause = type(error).__name__
    if timer:
        timer[0].join()
    judge(cut, controller)
    return cut


def after_rest(controller: str) -> dict[str, Any]:
    """What the arm is once it stands, or 1 s later. Some 0.2 s after a hard stop its servo settles once more, at 12 mrad/s."""
    time.sleep(0.2)
    deadline = time.monotonic() + 0.8
    with Remote(controller) as remote:
        while not (truth := remote.truth())["standing"] and time.monotonic() < deadline:
            time.sleep(0.02)
    return truth


def judge(cut: Cut, controller: str) -> None:
    """What the controller's own logbook says of the time after the cut."""
    truth = after_rest(controller)
    if children():
        cut.wrong.append(f"processes left: {children()}")
    if not truth["standing"]:
        cut.wrong.append("it moves")
    if truth["program"] is not None:
        # a program that was on its way when its process ended runs without targets; no one may take it for ours, so it stays
        cut.left_over = True
        if cut.phase != "control":
            cut.wrong.append("a program runs")
        with Dashboard(controller) as dashboard:
            dashboard.ask("stop")
    if cut.at_s is None:
        return
    if cut.connection not in NEEDED or not cut.hit:
        judge_what_goes_on(cut, truth)
        return
    programs = [run for run in truth["programs"] if run["began_s"] > cut.at_s + IN_FLIGHT_S]
    motions = [motion for motion in truth["motions"] if motion["began_s"] > cut.at_s]
    cut.programs_after = len(programs)
    if programs:
        cut.wrong.append("a program began again")
    stops = [each["at_s"] - cut.at_s for each in truth["stops"] if each["at_s"] >= cut.at_s]
    if stops:
        cut.stop_s = min(stops)
        if cut.stop_s > STOP_WITHIN_S:
            cut.wrong.append(f"stopped after {cut.stop_s:.3f} s")
    # a motion that was under way when the connection was cut may still begin before the stop, or in the next tick or two
    cut.motions_after = sum(motion["began_s"] > cut.at_s + max(0.02, cut.stop_s or 0.0) for motion in motions)
    if cut.motions_after:
        cut.wrong.append("the arm moved again")
    if cut.cause not in LOST and not (cut.phase == "finish" and cut.cause == DONE):
        cut.wrong.append(f"cause {cut.cause}")


def judge_what_goes_on(cut: Cut, truth: dict[str, Any]) -> None:
    """After a cut that ends no motion: the replay has its two programs and no other, and nothing moves once the last one has ended."""
    programs = [run for run in truth["programs"] if run["began_s"] > cut.begun_s]
    ended_s = max((run["ended_s"] for run in programs if run["ended_s"] is not None), default=cut.at_s)
    motions = [motion for motion in truth["motions"] if motion["began_s"] > ended_s]
    cut.programs_after, cut.motions_after = max(len(programs) - PROGRAMS, 0), len(motions)
    if cut.programs_after:
        cut.wrong.append(f"{len(programs)} programs in one replay")
    if motions:
        cut.wrong.append("the arm moved again")
    expected = GOES_ON | BUSY | (LOST if cut.connection == SCRIPT else set())
    if cut.hit and cut.cause not in expected:
        cut.wrong.append(f"cause {cut.cause}")


def run_cuts(cases: list[Cut], host: str, controller: str, observe=None) -> list[Cut]:
    """Every case on one arm, each again where other work of the machine ended its replay before the cut."""
    made = []
    with simulated_arm(controller, "--personality", "recorded", ASIDE), cutting_proxy(host, controller) as proxy:
        for case in cases:
            for _ in range(4):
                cut = run_cut(Cut(case.connection, case.reset, case.phase, case.after_s), host, controller, proxy)
                if cut.at_s is not None or cut.cause not in BUSY:
                    break
            made.append(cut)
            if observe:
                observe(cut)
    return made


def cases(connection: str, part: int) -> list[Cut]:
    """A part of the cuts of one connection: every phase, FIN and RST in turn, at seeded moments, in a seeded order."""
    rng, phases = random.Random(f"{connection} {part}"), PHASES_OF[connection]
    numbers = range(PART * (part - 1), PART * part)
    made = [
        Cut(connection, reset=bool(n // len(phases) % 2), phase=phase, after_s=rng.uniform(0.0, phases[phase]))
        for n, phase in ((n, list(phases)[n % len(phases)]) for n in numbers)
    ]
    rng.shuffle(made)
    return made


def table(cuts: list[Cut]) -> str:
    """Counts by connection, kind and phase; times; causes."""
    lines = [f"{'connection':<12}{'kind':<5}{'phase':<10}{'cuts':>5}{'hit':>5}{'again':>6}{'stop p50':>10}{'max':>8}  causes"]
    for connection in CONNECTIONS:
        for reset in (False, True):
            for phase in PHASES:
                some = [cut for cut in cuts if (cut.connection, cut.reset, cut.phase) == (connection, reset, phase)]
                if not some:
                    continue
                stops = [cut.stop_s for cut in some if cut.stop_s is not None]
                times = f"{statistics.median(stops):>10.3f}{max(stops):>8.3f}" if stops else f"{'–':>10}{'–':>8}"
                again = sum(cut.programs_after + cut.motions_after for cut in some)
                causes = ", ".join(f"{cause} {count}" for cause, count in Counter(cut.cause for cut in some).items())
                line = f"{connection:<12}{'RST' if reset else 'FIN':<5}{phase:<10}{len(some):>5}{sum(c.hit > 0 for c in some):>5}{again:>6}"
                lines.append(f"{line}{times}  {causes}")
    return "\n".join(lines)


def test_a_sample_of_cuts_of_single_connections_stops_the_arm_for_good():
    """Control and receiving, by FIN and by RST, in the approach and in the play; `make soak` cuts each connection 500 times.

    The one on which programs are sent is cut between the first program and the second: that one is not sent to nobody.
    """
    sample = [Cut(RECEIVE, reset=True, phase="approach", after_s=0.3), Cut(CONTROL, reset=False, phase="play", after_s=0.8)]
    sample += [Cut(SCRIPT, reset=False, phase="control", after_s=0.0)]
    sample += [Cut(CONTROL, reset=True, phase="play", after_s=0.5), Cut(RECEIVE, reset=False, phase="play", after_s=0.7)]
    cuts = run_cuts(sample, "127.0.71.1", "127.0.72.1")
    assert not any(cut.wrong for cut in cuts), "\n" + "\n".join(map(str, cuts))
    assert [cut.hit for cut in cuts] == [1, 1, 1, 1, 1], "\n" + "\n".join(map(str, cuts))
    assert {cut.cause for cut in cuts} == {"connection_lost"}


@pytest.mark.soak
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("part", range(1, PARTS + 1))
@pytest.mark.parametrize("connection", CONNECTIONS)
def test_five_hundred_cuts_of_each_connection_never_make_an_arm_go_on(connection, part, soak_row, capsys):
    """FIN and RST, in each phase, in parts of a hundred, each on an arm of its own: several parts may run at once."""
    begun, number = time.monotonic(), PARTS * CONNECTIONS.index(connection) + part

    def observe(cut: Cut) -> None:
        if cut.wrong:
            with capsys.disabled():
                print(f"WRONG: {cut}", flush=True)

    cuts = run_cuts(cases(connection, part), f"127.0.71.{number + 1}", f"127.0.72.{number + 1}", observe)
    stops = [cut.stop_s for cut in cuts if cut.stop_s is not None]
    with capsys.disabled():
        print("\n" + table(cuts), flush=True)
    again = sum(cut.programs_after + cut.motions_after for cut in cuts)
    took_s = time.monotonic() - begun
    what = f"{sum(cut.hit > 0 for cut in cuts)} of {len(cuts)} cuts of {connection}, part {part}, {took_s / len(cuts):.1f} s each"
    soak_row(what, f"{again} resumptions", "0")
    if stops:
        soak_row("  slowest stop in force, arm's clock", f"{max(stops):.3f} s", f"{STOP_WITHIN_S} s")
    assert not any(cut.wrong for cut in cuts), "\n" + "\n".join(str(cut) for cut in cuts if cut.wrong)
