"""`joint-monitor try`: the daemon itself, with a clock that is handed in, beside a simulated arm that ages with it."""

import json
import re
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from command_line import ended
from prepared import run

from monitor.config.load import load
from monitor.simulate.faults import FAULTS, parse
from monitor.simulate.remote import Remote
from monitor.studies.trial import TrialArm, TrialClock, trial_file

pytestmark = pytest.mark.timeout(300)  # seconds on an idle machine; the physics of a UR5e runs at 500 Hz


def tried(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """`joint-monitor try` in a process of its own."""
    return run([sys.executable, "-m", "monitor", "try", *map(str, arguments)], 280.0)


def test_days_pass_in_seconds_and_no_window_is_missed(tmp_path):
    """Every day has its replay, the arm ages with the daemon's clock, and the kept history answers the commands of a person."""
    result = tried("--days", 2, "--speed", 200_000, "--keep", tmp_path / "kept")
    assert result.returncode == 0, result.stderr
    lines = re.findall(r"^\w{3} (2026-01-\d\d) 03:00  assessed", result.stdout, re.MULTILINE)
    assert lines == ["2026-01-05", "2026-01-06"]
    assert "replays are stepped" in result.stdout  # it is said that no replay goes through the wire while nothing is broken
    assert "missed" not in result.stdout + result.stderr
    path = tmp_path / "kept" / "try.toml"
    status = json.loads(ended("status", "--config", path, "--json").stdout)
    late = ended("serviced", "--config", path, "--joint", "elbow", "--greased", "--by", "Ada", "--why", "too late").stdout
    assert "was greased on 2026-01-" in late  # the history that stays goes on by the trial's clock, not by this machine's
    assert status["monitor_silent_s"] is None
    assert [row["state"] for row in status["ledger"]] == ["assessed", "assessed"]
    again = ended("try", "--keep", tmp_path / "kept")
    assert again.returncode == 2
    assert "holds a trial already" in again.stderr


@pytest.mark.soak
def test_the_e_series_path_of_the_documentation_yields_a_verdict(tmp_path):
    """`init` for a UR5e, and the daemon judges its replay: currents times the gains that `init` wrote."""
    path = tmp_path / "cell-1.toml"
    made = ended("init", path, "--model", "ur5e", "--host", "-", "--no-input", "--allow-motion")
    assert made.returncode == 0, made.stderr
    path.write_text(path.read_text("utf-8").replace("[replay]\n", "[replay]\nrepetitions = 1\n"))  # a short replay is quicker
    result = tried("--config", path, "--days", 1, "--speed", 200_000)
    assert result.returncode == 0, result.stderr
    assert re.search(r"03:00  assessed  \w+", result.stdout), result.stdout


def test_an_arm_that_a_program_lends_is_tried_without_one(tmp_path):
    """The simulated arm plays no program: the clock would wait for ever at the first window, and the daemon's port is taken."""
    lent = {"robot": {"model": "ur5", "site": "hall", "id": "cell-1"}, "replay": {"hand_over": "external_control", "permit": "zenoh"}}
    tried = load(trial_file(tmp_path, lent, "127.0.77.1", 7447, 8080))
    assert tried.replay.lent is None
    assert tried.replay.permit == "none"


@pytest.mark.parametrize(
    ("option", "value", "expected"), [("--speed", 0, "expected 1 to"), ("--days", -1, "more than 0"), ("--scenario", "x", "known are")]
)
def test_a_wrong_option_is_said_before_anything_starts(option, value, expected):
    """One sentence, exit code 2."""
    result = ended("try", option, value)
    assert result.returncode == 2
    assert expected in result.stderr


def test_declared_production_is_done_on_the_simulated_arm():
    """A replaced joint is as new and wears like a healthy one; grease takes four fifths away and leaves the pace."""

    class Worn:
        def __init__(self):
            self.calls = []

        def truth(self):
            return {"wear_coulomb": [1.0, 2.0], "wear_viscous": [1.0, 1.5], "wear_per_revolution": [1e-9, 1e-5]}

        def wear(self, joint, **factors):
            self.calls.append((joint, factors))

    worn = Worn()
    arm = TrialArm(worn, TrialClock(0.0, 1.0))
    arm.repair(2, "replaced")
    arm.repair(2, "greased")
    arm.repair(2, "polished")
    (_, new), (_, greased) = worn.calls
    assert new == {"coulomb_factor": 1.0, "viscous_factor": 1.0, "per_revolution": 1e-9}
    assert greased == pytest.approx({"coulomb_factor": 1.2, "viscous_factor": 1.1, "per_revolution": None})


def test_the_clock_waits_at_a_window_and_stands_while_the_arm_moves():
    """Time passes at the pace, up to the moment that is set; a motion adds its own duration."""
    host = [0.0]
    clock = TrialClock(1000.0, 100.0, lambda: host[0])
    clock.stop_at(2000.0)
    host[0] = 5.0
    assert clock.now() == 1500.0
    with clock.held():
        host[0] = 8.0
        assert clock.now() == 1500.0
        clock.add(10.0)
    assert clock.now() == 1510.0
    host[0] = 100.0
    assert clock.now() == 2000.0
    clock.stop_at(1800.0)
    assert clock.now() == 2000.0
    assert clock.monotonic() == 1000.0


class Trial:
    """A trial that runs, and what it has said."""

    def __init__(self, process, folder):
        self.process, self.path, self.lines = process, folder / "try.toml", []
        threading.Thread(target=lambda: self.lines.extend(process.stdout), daemon=True).start()

    def until(self, words, after=0, seconds=150.0):
        """The first line from `after` on in which one of these words stands."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.process.poll() is None:
            found = next((line for line in self.lines[after:] if re.search(words, line)), None)
            if found is not None:
                return found
            time.sleep(0.1)
        raise AssertionError(f"no line with {words} after {self.lines[after:]}")

    def allow(self):
        return ended("allow", "--config", self.path, "--by", "ada", "--why", "nothing was hit")


@contextmanager
def trial_runs(folder):
    command = [sys.executable, "-m", "monitor", "try", "--speed", "40000", "--keep", str(folder)]
    environment = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "bufsize": 1}
    with subprocess.Popen(command, cwd=Path(__file__).parents[2], **environment) as process:
        try:
            trial = Trial(process, folder)
            trial.until("assessed")
            host = re.search(r"--bind (\S+) --fault", "".join(trial.lines))[1]
            with Remote(host) as remote:
                yield trial, remote
        finally:
            process.terminate()
            process.wait(30.0)


ENDED = r" 0\d:\d\d  (assessed|skipped|aborted|rejected)"


def test_a_stop_in_a_trial_ends_as_on_a_real_arm_and_is_over_when_somebody_has_recovered_the_arm(tmp_path):
    """`simulate --fault protective_stop` beside `try`: a window is skipped by its condition, and no fault of the monitor's own is told."""
    with trial_runs(tmp_path / "kept") as (trial, remote):
        remote.protective_stop()
        assert "skipped" in trial.until(ENDED, len(trial.lines))
        assert "safety mode is 3 (protective stop)" in trial.until("skipped")
        assert remote.fault("clear")  # a stop is no fault that lasts: somebody must end it
        assert "safety mode is 3" in trial.until(ENDED, len(trial.lines))
        assert remote.fault("recover")
        assert trial.allow().returncode == 0
        trial.until("assessed", len(trial.lines))
        said = "".join(trial.lines)
        assert "internal" not in said
        assert "Traceback" not in said


WITH = {  # arguments of those faults that need some
    "stall": "seconds=20", "freeze": "seconds=20", "late": "seconds=1", "not_found": "names=payload", "speed_slider": "fraction=0.5",
    "version": "version=5.3.0", "clock_jump": "seconds=50", "encoder_offset": "joint=2 value=0.2", "current_noise": "factor=10",
    "digital_input": "number=3", "stuck": "joint=2", "brake": "joint=2", "temperature_glitch": "joint=4 value=200",
    "current_stuck": "joint=1", "obstacle": "joint=2 torque=120", "robot_api": "answer=silent",
}  # fmt: skip


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_every_fault_of_the_simulator_is_played_through_in_a_trial(tmp_path):
    """Each before a window: it ends as a replay over RTDE does, in words of the arm; recovered and allowed, the arm is judged again."""
    with trial_runs(tmp_path / "kept") as (trial, remote):
        for fault in FAULTS:
            name, arguments = parse(f"{fault} {WITH.get(fault, '')}")
            remote.fault(name, **arguments)
            line = trial.until(ENDED, len(trial.lines), 300.0)
            assert "internal" not in line, (fault, line)
            time.sleep(3.0)  # a protective stop is unlocked after some seconds, and a controller starts again
            remote.fault("recover")
            trial.allow()
            trial.until("assessed", len(trial.lines), 300.0)
        said = "".join(trial.lines)
        assert "internal" not in said
        assert "Traceback" not in said
