"""When somebody else's program starts: after a time, after the end of a client's program, or while a client uploads its own."""

from dataclasses import dataclass

from monitor.simulate.controller.logbook import CLIENT
from monitor.simulate.controller.program.machine import Machine
from monitor.simulate.controller.program.runner import Programs

NOW, AFTER_OURS, DURING_UPLOAD = "now", "after_ours", "during_upload"
MOMENTS = (NOW, AFTER_OURS, DURING_UPLOAD)


@dataclass(slots=True, kw_only=True)
class ForeignPlan:
    """One program of somebody else, planned."""

    when: str  # one of MOMENTS
    delay_s: float
    seconds: float
    moves: bool
    due_s: float | None  # on the controller's clock; None until the moment is known


class ForeignPrograms:
    """Starts the planned program of somebody else on one controller."""

    def __init__(self, machine: Machine, programs: Programs) -> None:
        self._machine, self._programs = machine, programs
        self._plan: ForeignPlan | None = None
        self._planned_s = 0.0
        self._held: list[tuple[float, str]] = []  # scripts of clients that the controller has not started yet, with their time

    def plan(self, when: str, *, delay_s: float, seconds: float, moves: bool) -> None:
        """Plan a program that plays for so long. `delay_s` counts from now or from the end of a client's program.

        During an upload the program starts when the client's script arrives, and the script itself is started `delay_s` later.
        """
        self._planned_s = self._machine.clock.now_s
        due_s = self._planned_s + delay_s if when == NOW else None
        self._plan = ForeignPlan(when=when, delay_s=delay_s, seconds=seconds, moves=moves, due_s=due_s)

    def cancel(self) -> None:
        """Forget what is planned."""
        self._plan = None

    def holds(self, script: str) -> bool:
        """Whether a client's script that has just arrived must wait, because somebody else's program starts before it."""
        plan = self._plan
        if plan is None or plan.when != DURING_UPLOAD or not script.startswith("def "):
            return False
        self._start(plan)
        self._held.append((self._machine.clock.now_s + plan.delay_s, script))
        return True

    def step(self) -> list[str]:
        """Start what is due. Returns the scripts of clients that need wait no longer."""
        now_s, plan = self._machine.clock.now_s, self._plan
        if plan is not None:
            if plan.when == AFTER_OURS and plan.due_s is None:
                plan.due_s = self._after_ours(plan.delay_s)
            if plan.due_s is not None and now_s >= plan.due_s:
                self._start(plan)
        if not self._held:
            return []
        due = [script for at_s, script in self._held if now_s >= at_s]
        self._held = [(at_s, script) for at_s, script in self._held if now_s < at_s]
        return due

    def _after_ours(self, delay_s: float) -> float | None:
        logbook = self._machine.journal.logbook
        for run in reversed(logbook.programs):
            if run.boot != logbook.boot:  # its times are of another clock, as are those of every run before it
                return None
            if run.owner == CLIENT and run.ended_s is not None and run.ended_s >= self._planned_s:
                return run.ended_s + delay_s
        return None

    def _start(self, plan: ForeignPlan) -> None:
        self._plan = None
        self._programs.start_foreign(plan.seconds, moves=plan.moves)
