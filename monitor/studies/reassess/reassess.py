"""The past judged once more, as one document: what would have been said otherwise, what it rests on, and what it cost. I/O."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from monitor import __version__
from monitor.errors import BadInput
from monitor.studies.reassess.cluster import cluster, threads_of
from monitor.studies.reassess.compare import counts
from monitor.studies.reassess.plan import histories
from monitor.studies.reassess.program import worker_facts
from monitor.studies.reassess.results import Results, whole
from monitor.studies.reassess.run import Outcome, Reassessment, Show

LEFT_OUT = ("gone", "changed", "rejected", "unknown_state")
OF_ALL = ("identical", "different", "not_recomputable")


def reassess(
    places: Sequence[Path],
    *,
    results: str,
    changes: Mapping[str, Any],
    scheduler: str | None = None,
    workers: int | None = None,
    show: Show = lambda *_: None,
) -> dict[str, Any]:
    """Judge the past of all arms at or below these folders once more.

    results : folder or address of finished results. changes : of the settings, from `read_changes`; empty: today's program with the
    settings of each verdict. scheduler : of a Dask cluster; None: `workers` processes on this machine.

    Raises BadInput where a place holds no history or the cluster does not fit, and SchedulerLost or ResultsRefused in the midst of it:
    what was finished by then is kept, and found by the next call.
    """
    results = whole(results)
    found = histories(places, changes)
    if not any(arm.recordings for arm in found):
        raise BadInput(f"{places[0]}: no replay was judged yet; there is nothing to judge once more")
    began = time.perf_counter()
    Results(results, make=True)
    with cluster(scheduler, workers, results) as client:
        around = _Around(client)
        outcome = Reassessment(client, results, changes, show).run(found)
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
