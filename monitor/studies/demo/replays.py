"""How the demo makes a day's recording: a live replay over RTDE on some days, a replay that the simulator steps on the others."""

import dataclasses
from collections.abc import Callable
from typing import Any

from monitor.acquire.replay import replay
from monitor.acquire.watch import Caller, ReplayProgress
from monitor.config.schema import Configuration
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable
from monitor.identify.signals.cleaning.quality import quality_problem
from monitor.model.fourier import Excitation
from monitor.recording import Context, Recording
from monitor.simulate.remote import Remote
from monitor.studies.demo.plan import LIVE_DAYS, DemoState

LIVE_ATTEMPTS = 3  # of one live replay: other work on this machine may disturb one; more than that is a machine without real time
OF_LATE_TARGETS = {"following_error", "torque_band"}  # a person must look at a real arm; nothing can be in the way of a simulated one


class DemoReplay:
    """Makes the recording of the present day; the daemon calls it in the place of a replay of a real arm."""

    def __init__(self, configuration: Configuration, remote: Remote, state: DemoState) -> None:
        self._configuration, self._remote, self._state = configuration, remote, state

    def __call__(self, excitation: Excitation, context: Context, should_stop: Callable[[], bool]) -> Recording:
        """One replay. Raises MotionRefused, RobotUnreachable and ReplayAborted like `replay`."""
        if self._state.day in LIVE_DAYS:
            return self._undisturbed(excitation, context, lambda: self._live(excitation, context, should_stop))
        self._state.activity = "stepped replay: the simulator plays it faster than real time"
        recording = self._remote.play(excitation)
        return _of_daemon(recording, context)

    def _live(self, excitation: Excitation, context: Context, should_stop: Callable[[], bool]) -> Recording:
        robot, settings = self._configuration.robot_description, self._configuration.replay
        return replay(excitation, robot, settings, context=context, caller=Caller(on_progress=self._show, should_stop=should_stop))

    def _show(self, at: ReplayProgress) -> None:
        total = f" of {at.duration_s:.0f}" if at.duration_s else ""
        self._state.activity = f"live replay over RTDE, servoJ at 125 Hz: {at.phase} {at.elapsed_s:.1f}{total} s"

    def _undisturbed(self, excitation: Excitation, context: Context, live: Callable[[], Recording]) -> Recording:
        """Repeat a live replay that other work on this machine disturbed: here the arm is a process among others.

        A replay that ended on its way leaves the arm far from the start, where the next one would be refused. The simulator therefore
        steps one replay first: it ends at the start. The daemon itself waits before it tries again. After the last try the stepped replay
        is the day's, and the summary says so: a slow machine is no fault of the arm or of the monitor.
        """
        for attempt in range(1, LIVE_ATTEMPTS + 1):
            try:
                recording = live()
            except (MotionRefused, RobotUnreachable) as error:  # what does not answer in time is a simulator without processor time
                reason: str | None = str(error)
            except ReplayAborted as error:
                if error.needs_a_person and error.cause not in OF_LATE_TARGETS:
                    raise
                reason = error.cause
            else:
                reason = quality_problem(recording.quality, recording.samples, self._configuration.assess.trust)
                if reason is None:
                    return recording
            self._state.disturbed.append(f"day {self._state.day + 1}, try {attempt}: {reason}")
            self._state.activity = (
                f"live replay disturbed by other work on this machine ({reason}): the simulator steps the arm to the start"
            )
            recording = self._remote.play(excitation)
        self._state.not_live.append(self._state.day)
        return _of_daemon(recording, context)


def _of_daemon(recording: Recording, context: Context) -> Recording:
    """A stepped recording with what the daemon knows of its context."""
    return dataclasses.replace(recording, context=dataclasses.replace(recording.context, **known_facts(context)))


def known_facts(context: Context) -> dict[str, Any]:
    """The fields of a context that are known, by name."""
    facts = {field.name: getattr(context, field.name) for field in dataclasses.fields(context)}
    return {name: value for name, value in facts.items() if value is not None}
