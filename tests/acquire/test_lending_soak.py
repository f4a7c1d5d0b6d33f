"""The long proof of the hand-over: cycles of a production program with replays among them, and each fault at each phase."""

import random
import time

import pytest
from excitations import short
from lending_cell import lending_cell
from lending_faults import FAULTS, PHASES, play, run_fault
from simulated_arm import known_gains

from monitor.acquire.replay import replay
from monitor.acquire.ur.node_script import OFFER
from monitor.errors import ReplayAborted, RobotUnreachable
from monitor.model.robot import load_robot

GENERATIONS = (("ur5", "3.15.8"), ("ur5e", "5.11.0"), ("ur5e", "5.22.0"), ("ur5e", "10.12.0"))
SPAN_S = {"node": 1.0, "approach": 0.2, "play": 2.6, "return": 0.15, "settle": 0.5, "finish": 0.1}  # of a phase, for a fault
EARLY = ("late", "stalled", "timeout")  # a busy machine ends a replay before the fault


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("robot", "version"), GENERATIONS)
@pytest.mark.parametrize("local", [False, True])
def test_two_hundred_cycles_with_twenty_replays_go_on_at_the_next_node(robot, version, local, tmp_path, soak_row, capsys):
    """Every cycle goes on within 1 mrad of where the arm was before the node, and no program is stopped, also 60 s after the last.

    A replay that a busy machine ends leaves a program that has ended, as it must; somebody starts it again, and it is told.
    """
    done = disturbed = stops = 0
    with lending_cell("127.0.2.70", tmp_path, "--robot", robot, "--polyscope", version, rest_s=0.02) as cell:
        if local:
            cell.fault("remote", state="off")
        while done < 20:
            try:
                replay(short(robot=robot), load_robot(robot), cell.settings(), installation=known_gains(robot), driver=cell.driver)
            except RobotUnreachable:  # the machine again: nothing was taken, and the service asks again too
                assert len(cell.truth["stops"]) == stops
                continue
            except ReplayAborted as error:
                if error.cause not in EARLY or not error.borrowed:
                    raise
                disturbed += 1
                cell.fault("remote", state="on")
                play(cell)
                cell.fault("remote", state="off" if local else "on")
                stops = len(cell.truth["stops"])
                continue
            done += 1
            until = cell.cycles + 9
            while cell.cycles < until:
                time.sleep(0.1)
            assert len(cell.truth["stops"]) == stops
        time.sleep(60.0)
        truth, cycles, astray = cell.truth, cell.cycles, cell.astray
    name = f"{robot} {version}{', local' if local else ''}"
    with capsys.disabled():
        print(f"{name}: {done} replays in {cycles} cycles, {astray} astray, {disturbed} more ended by the machine's other work")
    soak_row(f"hand-over, {name}: {done} replays in {cycles} cycles", f"{astray} astray", "0 astray")
    assert cycles >= 200
    assert astray == 0
    assert disturbed <= done // 2
    assert len(truth["stops"]) == stops
    assert truth["output_integers"][OFFER] >= cycles


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("turn", [1, 2, 3])
@pytest.mark.parametrize("local", [False, True])
def test_each_fault_at_each_phase_of_a_borrowed_arm(turn, local, tmp_path, soak_row, capsys):
    """In a seeded order at seeded moments: the program never goes on from a wrong pose, and whoever must look is asked."""
    rng = random.Random(turn)
    cases = [(fault, phase) for fault in FAULTS for phase in PHASES]
    rng.shuffle(cases)
    outcomes = []
    with lending_cell("127.0.2.71", tmp_path, "--robot", "ur5") as cell:
        for fault, phase in cases:
            for _ in range(4):
                outcome = run_fault(cell, fault, phase, rng.random() * SPAN_S[phase], "ur5", local=local)
                if outcome.wrong != ("ended before the fault",):  # by a busy host, or in a phase that was over
                    break
            outcomes.append(outcome)
            with capsys.disabled():
                print(outcome.line, flush=True)
    wrong = [outcome.line for outcome in outcomes if outcome.wrong]
    stops = [outcome.stop_s for outcome in outcomes if outcome.stop_s is not None]
    soak_row(f"borrowed arm{', local' if local else ''}, round {turn}: {len(outcomes)} cases", f"{len(wrong)} wrong", "0 wrong")
    soak_row("  slowest stop in force, arm's clock", f"{max(stops):.3f} s", "0.25 s")
    assert not wrong, "\n" + "\n".join(wrong)
