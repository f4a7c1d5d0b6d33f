"""A reassessment: arm-months are identified, arms judged, and what each says is gathered. I/O."""

import queue
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from monitor import __version__
from monitor.errors import BadInput, MonitorError
from monitor.plant.database import Database
from monitor.studies.from_plant import history_of
from monitor.studies.reassess.cluster import SchedulerLost, cluster, threads_of
from monitor.studies.reassess.identify_month import Cost, Results, ResultsRefused, identify_month, whole, worker_facts
from monitor.studies.reassess.judge_arm import counts, judge_arm
from monitor.studies.reassess.opened import keep_history
from monitor.studies.reassess.plan import Arm, Found, arm_of, histories, histories_of_plant

if TYPE_CHECKING:
    from distributed import Client, Future

AHEAD = 3  # tasks a thread that the scheduler holds: a plant has tens of thousands, and each arm shall be finished early
TRIES = 3  # of a task whose worker died, each on several workers
ALONE_S = 60.0  # a worker that died is replaced within seconds
LOOK_S = 1.0  # how often the scheduler is looked at while nothing comes

Show = Callable[[str, int, int], None]  # phase, recordings done, recordings in all


class Outcome(NamedTuple):
    """What a reassessment has found so far."""

    arms: tuple[dict[str, Any], ...]
    failed: tuple[dict[str, Any], ...]  # arms that could not be judged, and why
    identify: Cost
    judge: Cost
    months: int
    months_found: int  # that were there already


class _Progress:
    """An arm whose months are under way."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.addresses: dict[int, str] = {}
        self.failed = False


class _Task(NamedTuple):
    of: _Progress
    month: int | None  # None: the arm itself
    tries: int = 1


class Reassessment:
    """Keeps the workers busy, a few tasks ahead of each; an arm is judged as soon as its months are identified."""

    def __init__(self, client: "Client", place: str, changes: Mapping[str, Any], show: Show, plant: Database | None = None) -> None:
        self._client, self._place, self._changes, self._show, self._plant = client, place, dict(changes), show, plant
        self._open: dict[Future, _Task] = {}
        self._ended: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        self._arms: list[dict[str, Any]] = []
        self._failed: list[dict[str, Any]] = []
        self._identify, self._judge = Cost(), Cost()
        self._months = self._found = 0

    def run(self, arms: Sequence[Found]) -> Outcome:
        """Compute everything. Raises SchedulerLost where the scheduler went away, ResultsRefused where nothing can be kept."""
        total, done = sum(arm.recordings for arm in arms), 0
        to_come, waiting = deque(arms), deque[_Task]()
        most = AHEAD * max(1, threads_of(self._client))
        while to_come or waiting or self._open:
            while len(self._open) < most and (waiting or to_come):
                if not waiting:
                    waiting += self._tasks(to_come.popleft())
                else:
                    self._submit(waiting.popleft())
            if not self._open:  # the last arms could not be read
                continue
            future = self._next()
            task = self._open.pop(future)
            following = self._taken(future, task)
            if following is not None:  # before other arms' months: who asked for many arms wants the first ones early
                waiting.appendleft(following)
            if task.month is not None and following is not task:
                done += len(task.of.arm.months[task.month].recordings)
            self._show(f"{len(self._arms)} of {len(arms)} arms judged", done, total)
        return self.outcome

    @property
    def outcome(self) -> Outcome:
        """What is known now."""
        arms = sorted(self._arms, key=lambda each: str(each["arm"]))
        return Outcome(tuple(arms), tuple(self._failed), self._identify, self._judge, self._months, self._found)

    def _tasks(self, found: Found) -> list[_Task]:
        """The months of an arm; of one without any, the arm itself; nothing of one whose history cannot be read any more."""
        try:
            of = _Progress(self._arm(found))
        except ResultsRefused:
            raise
        except MonitorError as wrong:
            self._failed.append({"arm": found.name, "reason": str(wrong)})
            return []
        return [_Task(of, k) for k in range(len(of.arm.months))] or [_Task(of, None)]

    def _arm(self, found: Found) -> Arm:
        if found.of_plant is None or self._plant is None:
            return arm_of(found, self._changes)
        with history_of(self._plant, found.of_plant) as copy:
            arm = arm_of(found, self._changes, copy.folder)
            return arm._replace(kept=keep_history(copy, Results(self._place)))

    def _submit(self, task: _Task) -> None:
        arm = task.of.arm
        if task.month is not None:
            future = self._client.submit(identify_month, arm.months[task.month], self._place, pure=False)
        else:
            addresses = [task.of.addresses[k] for k in range(len(arm.months))]
            future = self._client.submit(judge_arm, arm, addresses, arm.changes, self._place, pure=False)
        self._open[future] = task
        future.add_done_callback(self._ended.put)

    def _next(self) -> "Future[Any]":
        """The next task that ended. Raises SchedulerLost, also where no worker is left and none comes."""
        alone = 0
        while True:
            try:
                return self._ended.get(timeout=LOOK_S)
            except queue.Empty:
                if self._client.status != "running":
                    raise SchedulerLost(self._lost("the scheduler")) from None
                with suppress(Exception):  # a scheduler that ends now is seen at the next look
                    alone = 0 if threads_of(self._client) else alone + 1
                if alone * LOOK_S > ALONE_S:
                    raise SchedulerLost(self._lost("every worker")) from None

    def _taken(self, future: "Future[Any]", task: _Task) -> _Task | None:
        """Take what a task has found; the task that follows from it."""
        from distributed import KilledWorker

        if future.status == "cancelled":
            raise SchedulerLost(self._lost("the scheduler"))
        wrong = future.exception()
        if isinstance(wrong, KilledWorker) and task.tries < TRIES:
            return task._replace(tries=task.tries + 1)
        if isinstance(wrong, ResultsRefused):
            raise wrong
        if wrong is not None:
            self._fail(task, wrong)
            return None
        found = future.result()
        if task.month is None:
            self._arms.append(found.document)
            self._judge = self._judge.plus(found.cost)
            return None
        self._months += 1
        self._found += found.found
        self._identify = self._identify.plus(found.cost)
        task.of.addresses[task.month] = found.address
        complete = len(task.of.addresses) == len(task.of.arm.months)
        return _Task(task.of, None) if complete and not task.of.failed else None

    def _fail(self, task: _Task, wrong: BaseException) -> None:
        from distributed import KilledWorker

        if isinstance(wrong, KilledWorker):
            reason = "its workers died again and again, as for want of memory"
        else:
            reason = str(wrong) if isinstance(wrong, MonitorError) else f"internal: {type(wrong).__name__}: {wrong}"
        if not task.of.failed:
            self._failed.append({"arm": task.of.arm.name, "reason": reason})
        task.of.failed = True

    def _lost(self, who: str) -> str:
        return (
            f"{who} went away; {self._months} arm-months and {len(self._arms)} arms are kept in {self._place}: "
            "the same command goes on from there"
        )


# --- The past judged once more, as one document: what would have been said otherwise, what it rests on, and what it cost. I/O ---

LEFT_OUT = ("gone", "changed", "rejected", "unknown_state")
OF_ALL = ("identical", "different", "not_recomputable")


def reassess(
    places: Sequence[Path],
    *,
    plant: Database | None = None,
    results: str,
    changes: Mapping[str, Any],
    scheduler: str | None = None,
    workers: int | None = None,
    show: Show = lambda *_: None,
) -> dict[str, Any]:
    """Judge the past of all arms at or below these folders once more, or of all arms of a plant.

    results : folder or address of finished results. changes : of the settings, from `read_changes`; empty: today's program with the
    settings of each verdict. scheduler : of a Dask cluster; None: `workers` processes on this machine.

    Raises BadInput where a place holds no history or the cluster does not fit, and SchedulerLost or ResultsRefused in the midst of it:
    what was finished by then is kept, and found by the next call.
    """
    results = whole(results)
    found = histories(places, changes) if plant is None else histories_of_plant(plant, changes)
    if not any(arm.recordings for arm in found):
        silent = sum(arm.of_plant is not None and not arm.of_plant.says_rows for arm in found)
        why = "; there is nothing to judge once more"
        if silent:
            kept = f"{silent} of {len(found)} arms hand over nothing that they judged: of an earlier release, or simulated"
            why = f" of what the plant has; {kept}"
        raise BadInput(f"{places[0] if plant is None else plant.name}: no replay was judged yet{why}")
    began = time.perf_counter()
    Results(results, make=True)
    with cluster(scheduler, workers, results) as client:
        around = _Around(client)
        outcome = Reassessment(client, results, changes, show, plant).run(found)
        spent = around.spent()
    cost = _cost(outcome, {"took_s": time.perf_counter() - began, **spent})
    return _document(outcome, changes, results, cost) | {"processors": around.processors}


class _Around:
    """What is spent around the tasks: by this process, which on one machine is the scheduler too, and by the workers."""

    def __init__(self, client: Any) -> None:
        self._client, self._threads = client, threads_of(client)
        self._workers: dict[str, float] = client.run(time.process_time, on_error="ignore")
        # by which numerical libraries choose their kernels: of several kinds, the last digits depend on who computed what
        self.processors = sorted({facts["processor"] for facts in client.run(worker_facts, on_error="ignore").values()})
        self._began, self._own = time.perf_counter(), time.process_time()

    def spent(self) -> dict[str, Any]:
        """Seconds since it was made, of the clock and of the processors."""
        workers: dict[str, float] = self._client.run(time.process_time, on_error="ignore")
        return {
            "threads": self._threads,
            "run_s": time.perf_counter() - self._began,
            "own_processor_s": time.process_time() - self._own,
            "workers_processor_s": sum(now - self._workers.get(address, 0.0) for address, now in workers.items()),
        }


def _document(outcome: Outcome, changes: Mapping[str, Any], results: str, cost: Mapping[str, Any]) -> dict[str, Any]:
    rows = [{"arm": arm["arm"], **row} for arm in outcome.arms for row in arm["alerts"]]
    document: dict[str, Any] = {
        "joint_monitor": __version__,
        "changes": dict(changes),
        "arms": len(outcome.arms),
        "replays": sum(arm["replays"] for arm in outcome.arms),
        "judged": sum(arm["judged"] for arm in outcome.arms),
        "left_out": {name: sum(arm["left_out"][name] for arm in outcome.arms) for name in LEFT_OUT},
        "newly_accepted": sum(arm["newly_accepted"] for arm in outcome.arms),
        "of_parts": sum(arm["of_parts"] for arm in outcome.arms),
        "alerts": counts(rows),
        "changed_alerts": [row for row in rows if row["change"] != "same"],
        "by_arm": [
            {**{key: arm[key] for key in ("arm", "replays", "judged", "left_out")}, **counts(arm["alerts"])} for arm in outcome.arms
        ],
        "friction": {arm["arm"]: arm["friction"] for arm in outcome.arms if "friction" in arm},
        "errors": [{"arm": arm["arm"], **error} for arm in outcome.arms for error in arm["errors"]],
        "failed": list(outcome.failed),
        "results": results,
        "cost": cost,
    }
    if not changes:
        document["verdicts"] = {key: sum(arm["verdicts"][key] for arm in outcome.arms) for key in OF_ALL}
        document["changed_since"] = list(dict.fromkeys(line for arm in outcome.arms for line in arm["verdicts"]["changed_since"]))
        document["differing"] = [{"arm": arm["arm"], **each} for arm in outcome.arms for each in arm["verdicts"]["differing"]]
    return document


def _cost(outcome: Outcome, spent: Mapping[str, Any]) -> dict[str, Any]:
    def rounded(cost: Mapping[str, Any]) -> dict[str, Any]:
        return {name: round(value, 3) if isinstance(value, float) else value for name, value in cost.items()}

    return {
        **rounded(spent),
        "arm_months": outcome.months,
        "arm_months_found": outcome.months_found,
        "identify": rounded(outcome.identify._asdict()),
        "judge": rounded(outcome.judge._asdict()),
    }
