"""A gap in which nobody saw the arm asks for a person, whatever happened in it, unless it is explained."""

import random
import socket
import threading
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import pytest
from cutting_proxy import CuttingProxy, cutting_proxy
from excitations import short
from fault_cases import DISTURBED, moved_again, restore, stand_aside
from hypothesis import given
from hypothesis import strategies as st
from simulated_arm import simulated_arm
from test_guard import ready_state

from monitor.acquire.driver import History, usual_driver
from monitor.acquire.ending import CLOCKS_APART_S, LONGEST_GAP_S, NO_CONNECTION, STOPS_WITHIN_S, UNKNOWN_GAP_S, look_after, unexplained
from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.dashboard import Dashboard
from monitor.acquire.watch import Caller, ReplayProgress
from monitor.errors import LastSeen, ReplayAborted, RobotUnreachable
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.simulate.remote import Remote

UR5 = load_robot("ur5")
QUICK = short(period_s=1.5)


# --- which gap is explained --------------------------------------------------------------------------------------

AFTER = ready_state(host_s=5000.0, controller_s=700.0)


def seen(gap_s, *, clock_s=0.0, moved_rad=0.0, speed_rad_s=0.0, payload_kg=AFTER.payload_kg):
    """The arm as it was last seen gap_s before AFTER, where its clock went on by clock_s more than the host's."""
    q = AFTER.q - moved_rad * np.eye(len(AFTER.q))[2]
    return LastSeen(AFTER.host_s - gap_s, AFTER.controller_s - gap_s - clock_s, tuple(q), (speed_rad_s,) * len(q), payload_kg)


TOLD = History(known=True)  # and nothing speaks against it


def code(before, *, clean=False, after=AFTER, history=TOLD):
    found = unexplained(before, after, history, clean=clean)
    return None if found is None else found.code


@given(
    st.floats(0.0, LONGEST_GAP_S - 1e-6),
    st.floats(-0.99 * CLOCKS_APART_S, 0.99 * CLOCKS_APART_S),
    st.floats(0.0, 3.0),
    st.floats(0.0, 1.0),
)
def test_a_short_gap_in_which_the_arm_came_to_rest_is_explained(gap_s, clock_s, speed_rad_s, share):
    assert code(seen(gap_s, clock_s=clock_s, moved_rad=share * STOPS_WITHIN_S * speed_rad_s, speed_rad_s=speed_rad_s)) is None


@given(st.floats(0.0, 1e4), st.floats(CLOCKS_APART_S + 1e-6, 1e5), st.sampled_from([-1.0, 1.0]))
def test_no_gap_is_explained_in_which_the_controllers_clock_did_not_go_on_by_the_hosts_time(gap_s, off_s, sign):
    """A restart, a clock that somebody set, a host that slept."""
    assert code(seen(gap_s, clock_s=sign * off_s)) == "gap_of_clocks"


def test_clocks_that_do_not_go_together_are_told_with_every_cause_that_they_may_have():
    """A monitor that was stopped reads late what the arm sent before: neither a restart nor a clock that somebody set."""
    told = str(unexplained(seen(0.3, clock_s=4.0), AFTER, TOLD, clean=False))
    assert "0.3 s by the clock of this machine, and 4.3 s by the controller's" in told
    assert all(cause in told for cause in ("stood still", "a clock was set", "restarted"))


@given(st.floats(LONGEST_GAP_S + 1e-6, 1e6))
def test_no_long_gap_is_explained_by_a_clock_that_went_on(gap_s):
    assert code(seen(gap_s)) == "gap_too_long"


def test_an_arm_that_was_never_seen_or_is_elsewhere_or_carries_another_load_is_looked_at():
    assert code(None) == "gap_not_seen"
    assert code(seen(0.3, moved_rad=0.06)) == "gap_moved"
    assert code(seen(0.3, moved_rad=float("nan"))) == "gap_moved"
    assert code(seen(0.3, payload_kg=1.0), after=replace(AFTER, payload_kg=1.5)) == "gap_payload"
    assert code(seen(0.3), after=replace(AFTER, controller_s=float("nan"))) == "gap_of_clocks"


def test_what_the_robot_does_not_tell_of_must_be_shorter_and_what_it_tells_asks_for_a_person():
    assert code(seen(UNKNOWN_GAP_S - 0.01), history=History()) is None
    assert code(seen(UNKNOWN_GAP_S + 0.01), history=History()) == "gap_too_long"
    assert code(seen(0.3), history=History(known=True, found=NO_CONNECTION(host="x", why="y"))) == "gap_told"
    assert code(seen(0.3), history=History(known=False, found=NO_CONNECTION(host="x", why="y"))) == "gap_told"


def test_a_program_that_took_over_an_arm_that_was_seen_at_rest_may_move_it():
    """Production that asked for its arm begins at once."""
    assert code(seen(0.3, moved_rad=0.3), clean=True, after=replace(AFTER, runtime_state=2)) is None
    assert code(seen(0.3, moved_rad=0.3), clean=True) == "gap_moved"


# --- gaps at a simulated controller ------------------------------------------------------------------------------

PHASES = {"approach": 0.3, "play": 1.2, "settle": 0.1, "return": 0.3}  # each with the latest moment in it
WHAT = ("nothing", "reboot", "power_cut", "protective_stop", "safeguard_stop", "teach_button", "foreign_program", "jog", "payload", "clock")


@dataclass
class Hole:
    """A gap in one replay, and what happens in it."""

    what: str
    phase: str
    at_s: float  # into the phase
    gap_s: float

    def __str__(self):
        return f"{self.what}, {self.at_s:.2f} s into {self.phase}, for {self.gap_s:.1f} s"


def script(host, line):
    with socket.create_connection((host, 30002), timeout=2.0) as wire:
        wire.sendall(line.encode() + b"\n")
        time.sleep(0.05)


def happen(hole: Hole, controller: str) -> None:
    """What happens at the controller while nobody sees it; it is over, and the arm in order, when the gap is."""
    until = time.monotonic() + hole.gap_s
    with Remote(controller) as remote:
        match hole.what:
            case "reboot":
                remote.fault("restart", seconds=min(0.5, hole.gap_s / 2), power="on")
            case "power_cut":
                remote.fault("power_cut", seconds=max(0.1, min(0.5, hole.gap_s / 4)), connections="silent")
                time.sleep(hole.gap_s / 2)
                with Dashboard(controller) as dashboard:
                    dashboard.ask("power on")
                    dashboard.ask("brake release")
            case "protective_stop":
                remote.fault("protective_stop", runtime="stopped")
                time.sleep(hole.gap_s / 2)
                script(controller, "set unlock protective stop")
            case "safeguard_stop":
                remote.fault("safeguard_stop", seconds=hole.gap_s / 2)
            case "teach_button":
                remote.fault("teach_button", state="on")
                time.sleep(hole.gap_s / 2)
                remote.fault("teach_button", state="off")
            case "foreign_program":
                remote.fault("program_stop")
                remote.fault("foreign_program", when="now", seconds=hole.gap_s / 2)
            case "jog":
                remote.fault("program_stop")
                q = np.array(remote.truth()["q"]) + 0.3
                script(controller, f"movej({q.tolist()}, a=3.0, v=1.0)")
            case "payload":
                remote.fault("payload_changed", kg=1.0)
            case "clock":
                remote.fault("clock_jump", seconds=-200.0)
    time.sleep(max(until - time.monotonic(), 0.0))


def run(hole: Hole, host: str, controller: str, proxy: CuttingProxy) -> ReplayAborted | None:
    """The end of a replay with this gap, as the service judges it; None where none came to its end so."""
    acting: list[threading.Thread] = []

    def act() -> None:
        proxy.hold()
        try:
            happen(hole, controller)
        finally:
            proxy.let_go()

    def on_progress(progress: ReplayProgress) -> None:
        if progress.phase == hole.phase and progress.elapsed_s >= hole.at_s and not acting:
            acting.append(threading.Thread(target=act))
            acting[0].start()

    settings = ReplaySettings(host=host, allow_motion=True, first_pass=False, approach_speed_rad_s=1.0, max_approach_rad=6.0)
    ended: ReplayAborted | None = None
    driver = usual_driver()
    with closing(driver.witness(host)) as witness:
        try:
            replay(QUICK, UR5, settings, context=Context(payload_kg=0.0), caller=Caller(on_progress=on_progress), witness=witness)
        except RobotUnreachable:
            pass
        except ReplayAborted as error:
            if acting or error.cause not in DISTURBED:
                ended, _ = look_after(driver, settings, error, witness=witness)
    if acting:
        acting[0].join()
        return ended
    return None


def wrong(hole: Hole, ended: ReplayAborted) -> str:
    """What is wrong with that end; empty: nothing."""
    explained = hole.what == "nothing" and hole.gap_s < LONGEST_GAP_S
    if not ended.needs_a_person and not explained:
        return f"{hole}: nobody is asked: {ended.cause}: {ended}"
    if "look at the arm" in str(ended) and not ended.needs_a_person:
        return f"{hole}: a person is told to look, and nobody is asked: {ended}"
    return ""


def holes(seed: int, count: int) -> list[Hole]:
    """A seeded sample: everything that may happen, in every phase, in short and long gaps."""
    rng, kinds = random.Random(seed), [(what, phase) for what in WHAT for phase in PHASES]
    rng.shuffle(kinds)
    made = []
    for n in range(count):
        what, phase = kinds[n % len(kinds)]
        made.append(Hole(what, phase, rng.uniform(0.02, PHASES[phase]), rng.choice((rng.uniform(0.3, 2.0), rng.uniform(2.1, 5.0)))))
    return made


def played(address: str, cases: list[Hole], personality: str) -> tuple[list[str], Counter[str]]:
    """What is wrong with these gaps on one arm, and how often each ended how."""
    said, causes = [], Counter()
    controller, host = f"127.0.{address}", f"127.1.{address}"
    with simulated_arm(controller, "--personality", personality), cutting_proxy(host, controller) as proxy:
        for hole in cases:
            restore(controller)
            stand_aside(controller, QUICK)
            ended = run(hole, host, controller, proxy)
            if ended is None:
                causes["not in this phase"] += 1
                continue
            causes[f"{hole.what}: {ended.cause}{' person' if ended.needs_a_person else ''}"] += 1
            said += [text] if (text := wrong(hole, ended)) else []
            time.sleep(0.2)
            with Remote(controller) as remote:
                truth = remote.truth()
            said += [f"{hole}: {each}" for each in moved_again(truth, truth["clock_s"] - 0.2)]
    return said, causes


@pytest.mark.real_time
def test_after_a_gap_in_which_anything_may_have_happened_a_person_is_asked_and_after_another_nobody():
    """Reboot, a stop that somebody unlocked, a guard; and a network that was away for a moment."""
    something = [
        Hole("reboot", "play", 0.4, 2.0),
        Hole("protective_stop", "approach", 0.2, 1.5),
        Hole("safeguard_stop", "return", 0.1, 1.5),
    ]
    said, causes = played("23.1", [*something, Hole("nothing", "play", 0.4, 0.3)], "recorded")
    assert not said, "\n".join(said)
    assert causes["nothing: stalled"] == 1, causes


@pytest.mark.soak
@pytest.mark.real_time
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range(5))
@pytest.mark.parametrize("personality", ["ideal", "recorded"])
def test_in_five_hundred_gaps_on_each_personality_nobody_is_left_unasked(personality, part, soak_row, capsys):
    """A hundred gaps a part: what happened × phase × moment × length."""
    said, causes = played(f"{24 + part}.{1 if personality == 'ideal' else 2}", holes(100 + part, 100), personality)
    with capsys.disabled():
        print(f"\n{personality}, part {part}: {dict(causes)}", *said, sep="\n")
    soak_row(f"gaps, {personality}, part {part}: {sum(causes.values())} gaps", f"{len(said)} wrong", "0 wrong")
    assert not said, "\n".join(said)
