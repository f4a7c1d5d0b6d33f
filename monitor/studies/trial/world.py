"""The world of a trial: a simulated arm that ages with the clock, and a configuration that a person's commands can read."""

import dataclasses
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from monitor.config.first_file import toml_text
from monitor.errors import BadInput
from monitor.model.fourier import Excitation
from monitor.recording import Context, Recording
from monitor.simulate.remote import Remote
from monitor.studies.demo.replays import known_facts
from monitor.studies.trial.clock import TrialClock

HOUR_S = 3600.0
TAKEN_AWAY = {"replaced": 1.0, "overhauled": 0.95, "greased": 0.8}  # share of a joint's wear, by the kind of work
LEAST_STEP_S = 300.0  # heat and wear change little within five minutes


class TrialArm:
    """A simulated arm that is as old as the clock says. Its methods may be called from any thread."""

    def __init__(self, remote: Remote, clock: TrialClock) -> None:
        self._remote, self._clock = remote, clock
        self._lock = threading.Lock()
        self._unix_s = clock.now()
        self.obstacle = ""  # why the arm does not age: a protective stop, a program of somebody else

    def follow(self, least_s: float = LEAST_STEP_S) -> None:
        """Let pass for the arm what has passed by the clock: heat, wear, and the events of its scenario."""
        with self._lock:
            passed_s = self._clock.now() - self._unix_s
            if passed_s < least_s:
                return
            try:
                self._remote.advance(hours=passed_s / HOUR_S)
            except BadInput as error:
                self.obstacle = str(error)
                return
            self._unix_s += passed_s
            self.obstacle = ""

    def play(self, excitation: Excitation, context: Context, should_stop: Callable[[], bool]) -> Recording:
        """One replay, stepped by the simulator's physics in a fraction of its time; the clock stands meanwhile, then it is as much later.

        Raises BadInput as MotionRefused would be where the simulated controller does not let a program run.
        """
        del should_stop  # a stepped replay is over before anybody could ask
        with self._clock.held():
            self.follow(0.0)
            with self._lock:
                recording = self._remote.play(excitation)
                self._clock.add(recording.duration_s)
                self._unix_s += recording.duration_s
        return dataclasses.replace(recording, context=dataclasses.replace(recording.context, **known_facts(context)))

    def repair(self, joint: int, kind: str) -> None:
        """The work on one joint (from 1) that a person has declared, done on the simulated arm; unknown kinds change nothing."""
        if kind not in TAKEN_AWAY:
            return
        with self._lock:
            truth = self._remote.truth()
            left = 1.0 - TAKEN_AWAY[kind]
            coulomb, viscous = (1.0 + left * (truth[key][joint - 1] - 1.0) for key in ("wear_coulomb", "wear_viscous"))
            # grease does not mend what wears the joint; other parts wear as the healthiest joint does
            pace = None if kind == "greased" else min(truth["wear_per_revolution"])
            self._remote.wear(joint, coulomb_factor=coulomb, viscous_factor=viscous, per_revolution=pace)


def trial_file(folder: Path, document: dict[str, Any], host: str, bus_port: int, page_port: int) -> Path:
    """The configuration of the trial as a file, so that every command can be tried on it.

    document : of the robot's own configuration, or of a first one. The address, the history's place and the ports become the trial's.
    """
    document = {name: dict(table) for name, table in document.items()}
    document["robot"] |= {"host": host}
    document["robot"].pop("serial", None)  # that of the real arm
    document.setdefault("replay", {}).update(allow_motion=True, permit="none", windows_utc=[], hand_over="none")
    document.setdefault("store", {})["directory"] = "history"
    document["bus"] = {"listen": [f"tcp/127.0.0.1:{bus_port}"]}
    document["page"] = {"listen": f"127.0.0.1:{page_port}"}
    path = folder / "try.toml"
    path.write_text(toml_text(document, "A trial of joint-monitor: the arm is simulated, and its clock runs fast."), "utf-8")
    return path
