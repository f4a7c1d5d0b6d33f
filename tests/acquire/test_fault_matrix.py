"""Every fault of the simulator, at the start, in the middle and at the end of a replay; the ordinary suite runs a seeded sample."""

import inspect
import json
import random
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import fault_cases
import pytest
import test_polyscope_x
from excitations import short
from fault_cases import FAULTS, HARMLESS, STOPPING, Case, Outcome, most_rows, run_case, table
from simulated_arm import simulated_arm

from monitor.acquire.protocol import Event, Order, Phase, Program, State
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur import stream
from monitor.acquire.ur.failures import Stopped
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import load_robot
from monitor.simulate.faults import FAULTS as KNOWN

pytestmark = pytest.mark.real_time

ROOT = Path(__file__).parent.parent.parent
UR5 = load_robot("ur5")
LAST = Case("clear")  # changes nothing: the replay after the last fault
ONLY_POLYSCOPE_X = {  # the arm of the matrix has a dashboard, no Robot API, and is in no operational mode: the test that injects each
    "robot_api": test_polyscope_x.test_a_robot_api_that_fails_in_the_middle_ends_the_motion_and_the_arm_comes_to_rest,
    "manual_mode": test_polyscope_x.test_a_stop_or_a_lost_connection_ends_the_motion_by_its_cause,
}


class OnTime:
    """An arm without faults, whose rows come in every tick, and which is asked to stop at a time of the play."""

    tick_s = step_s = 0.008
    stop_cause = "local_control"

    def __init__(self, stop_at_s):
        self.stop_at_s, self.rows = stop_at_s, 0

    @property
    def state(self):
        return State(Phase.PLAY, Program.OURS, Order.STOP if self.rows * self.tick_s > self.stop_at_s else Order.GO)

    def say(self, event, **_):
        assert event is Event.PLAY

    def next_row(self):
        return None

    def count_cycle(self, advance_s):
        pass

    def cycle(self, target, row, phase_s):
        pass

    def tell(self, row):
        self.rows += 1


def test_a_play_that_slows_down_near_its_end_has_rows_for_half_the_ramp_longer_and_no_more():
    """The bound on rows by which a case is judged is what the stream does: 1268 rows in 10 s were called wrong, and are right."""
    rows = []
    for tick in range(1000, 1250):
        arm = OnTime(tick * OnTime.tick_s)
        with suppress(Stopped):
            stream.stream(arm, Event.PLAY, 10.0, lambda _: None, keep=True)
        rows.append(arm.rows)
    assert 1268 in rows
    assert max(rows) == most_rows(10.0, along_the_path=True)
    never = OnTime(10.0)
    stream.stream(never, Event.PLAY, 10.0, lambda _: None, keep=True)
    assert never.rows == most_rows(10.0, along_the_path=False)


def settings(host):
    return ReplaySettings(host=host, allow_motion=True, first_pass=False, approach_speed_rad_s=1.0, max_approach_rad=6.0)


@pytest.mark.parametrize(
    ("name", "causes", "runs"),
    [
        ("current_noise", ["late", "stalled", None], 3),  # it ends some plays, and neither of these is how
        ("current_noise", ["torque_band"], 1),
        ("current_noise", ["late"] * 9, fault_cases.ATTEMPTS),
        ("close", ["late"], 1),  # it ends every play: that is no cause of it
    ],
)
def test_a_play_that_a_busy_machine_ended_is_repeated_where_the_fault_need_not_end_one(name, causes, runs, monkeypatch):
    """The harness itself: one that a fault must end is judged by the cause that was told."""
    left = list(causes)
    monkeypatch.setattr(fault_cases, "restore", lambda host: None)
    monkeypatch.setattr(fault_cases, "_run_once", lambda case, at_s, *_: Outcome(case, at_s, left.pop(0), None, None, 0.1, ()))
    case = next(case for case in FAULTS if case.name == name)
    assert run_case(case, 1.0, short(), UR5, settings("127.0.0.1")).disturbed == runs - 1


def test_every_fault_of_the_simulator_is_among_the_cases():
    """A fault that is added to the simulator must have a case here, or a test that injects it on the only controller that can have it."""
    assert {case.name for case in FAULTS} | set(ONLY_POLYSCOPE_X) == set(KNOWN)
    assert not {case.name for case in FAULTS} & set(ONLY_POLYSCOPE_X)
    for fault, test in ONLY_POLYSCOPE_X.items():
        assert f'"{fault}"' in inspect.getsource(test), f"{test.__name__} does not inject {fault}"


def test_a_sample_of_faults_in_the_middle_of_a_replay_stops_the_arm_and_is_named():
    """Of the data, of the connection, of the arm, and a harmless one, one after the other: it stops, with the cause, and plays again."""
    once = {"stall", "reset", "protective_stop"}
    rng = random.Random(6)
    cases = [rng.choice([case for case in STOPPING if case.name == name]) for name in sorted(once)]
    cases.append(rng.choice(HARMLESS))
    outcomes = []
    with simulated_arm("127.0.2.24", "--personality", "recorded") as host:
        for case in cases:
            outcomes.append(run_case(case, 1.4, short(), UR5, settings(host)))
    assert not any(outcome.wrong for outcome in outcomes), "\n" + table(outcomes)


def ten_seconds():
    document = json.loads((ROOT / "config" / "excitation" / "ur5-ground.json").read_text())
    return replace(excitation_from_document(document), repetitions=1)


@pytest.mark.soak
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("moment", [("start", 0.3), ("middle", 5.0), ("end", 9.5)], ids=lambda moment: moment[0])
@pytest.mark.parametrize("turn", [1, 2, 3])
@pytest.mark.parametrize("personality", ["ideal", "recorded"])
def test_every_fault_at_every_moment_of_a_replay_is_survived(personality, turn, moment, soak_row, capsys):
    """Replays of 10 s with the faults in a seeded order; the replay after the last fault works."""
    name, at_s = moment
    order = list(FAULTS)
    random.Random(turn).shuffle(order)
    excitation, outcomes = ten_seconds(), []
    address = f"127.0.{7 if personality == 'ideal' else 8}.{10 * turn + int(at_s)}"
    with simulated_arm(address, "--seed", str(turn), "--personality", personality) as host:
        for case in order:
            outcomes.append(run_case(case, at_s, excitation, UR5, settings(host)))
            with capsys.disabled():
                print(table(outcomes[-1:]).splitlines()[1], flush=True)
        last = run_case(LAST, at_s, excitation, UR5, settings(host))
    assert last.wrong == ()
    with capsys.disabled():
        print(f"\n{personality}, round {turn}, fault at the {name} of the play\n{table([*outcomes, last])}")
    stopped = [(outcome.stop_s, outcome.case.shows_within_s) for outcome in outcomes if outcome.stop_s is not None]
    at_once = [stop_s for stop_s, shows_s in stopped if not shows_s]
    later = [stop_s - shows_s for stop_s, shows_s in stopped if shows_s]  # asked five times a second, or without effect at first
    reported = [outcome.reported_s for outcome in outcomes if outcome.reported_s is not None]
    wrong = [outcome for outcome in outcomes if outcome.wrong]
    soak_row(f"faults, {personality}, round {turn}, {name}: {len(outcomes)} cases", f"{len(wrong)} wrong", "0 wrong")
    soak_row("  slowest stop in force of a fault that shows at once, arm's clock", f"{max(at_once):.3f} s", "0.25 s")
    soak_row("  of another one, after it must have shown", f"{max(*later, 0.0):.3f} s", "0.25 s")
    soak_row("  slowest right cause told", f"{max(reported):.2f} s", "2 s")
    assert not wrong, "\n" + table(wrong)
