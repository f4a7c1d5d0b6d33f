"""What a reassessment costs, by parts, on one worker process and on two: `python -m tests.bench.reassess [HISTORY …]`.

Without a history, `--arms` arms live for `--replays` days on a simulated controller, 30 s at 125 Hz each; their recordings differ. With
`--folder` histories and results are kept there, and the same call goes on from there: it counts what it has computed itself.

`efficiency` is by the clock, and means something on a machine without other work alone. Beside it stands what the machine itself gains by
its second core: processes that identify the same recordings and know nothing of each other. `beside` is what reading, decoding, keeping and
scheduling take of the processor beside identification and verdicts, and means something on any machine.
"""

import argparse
import multiprocessing
import os
import shutil
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.assess import AssessSettings, identified
from monitor.config.files import find_excitation
from monitor.config.load import from_document
from monitor.model.robot import Mounting, load_robot
from monitor.service.history.assess_and_store import assess_stored, load_state, state_after
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.recordings import read_recording, recording_of, write_recording
from monitor.store.store import Store
from monitor.studies.reassess.cluster import OF_WORKERS
from monitor.studies.reassess.memory import keep_memory
from monitor.studies.reassess.reassess import reassess
from monitor.studies.reassess.warm_up import warm_up

PLANT = 1_830_000  # recordings of 1250 arms in a year, four a day
ALONE = 30  # recordings that each process identifies, to see what the machine gains by its second core
MADE = "made"  # file in the folder of an arm that has lived to its end


def lived(folder: Path, replays: int) -> Path:
    """The history of an arm with a replay a day."""
    configuration = from_document(
        {"robot": {"model": "ur5", "site": "lab", "id": "a"}, "store": {"directory": str(folder)}}, folder / "a.toml"
    )
    made = stepped_replay(Controller(SimulateSettings(robot="ur5")), find_excitation("ur5-ground", Path()))
    rng = np.random.default_rng(0)
    with Store.open(folder) as store:
        known = load_state(store)
        for day in range(replays):
            at = 1.7e9 + 86_400.0 * day
            number = store.ledger.claim(at, "scheduled", at)
            assert number is not None
            context = replace(configuration.context, firmware=made.context.firmware, recorded_at_unix_s=at)
            current = made.current * (1.0 + 0.005 * rng.normal(size=6)) + 0.01 * rng.normal(size=made.current.shape)
            write_recording(store.recordings.path(number), replace(made, current=current, context=context))
            store.ledger.mark_recorded(number)
            known = state_after(known, assess_stored(store, configuration, known, number, lambda at=at: at))
    return folder


def plant(folder: Path, arms: int, replays: int) -> list[Path]:
    """So many arms: the first one has lived, the others have its history and recordings of their own: other bytes, and the same motion."""
    first = folder / "arm-00000"
    homes = [folder / f"arm-{k:05d}" for k in range(arms)]
    for k, home in enumerate(homes):
        if (home / MADE).is_file():
            continue
        shutil.rmtree(home, ignore_errors=True)
        if k == 0:
            lived(home, replays)
        else:
            shutil.copytree(first, home, ignore=shutil.ignore_patterns("*.parquet", MADE))
            with Store.reader(first) as store:
                for _, path in store.recordings.numbered():
                    of_first = read_recording(path)
                    write_recording(home / "recordings" / path.name, replace(of_first, quality={**of_first.quality, "arm": k}))
        (home / MADE).touch()
    return homes


def measured(histories: list[Path], results: str, workers: int) -> dict[str, Any]:
    """The cost of one run, of what no earlier one has left at `results`."""
    return reassess(histories, results=f"{results}/{workers}-workers", changes={}, workers=workers)["cost"]


def alone(home: Path, processes: int) -> float:
    """Recordings a second of processes that know nothing of each other, each with the first `ALONE` recordings of a history."""
    for name, value in OF_WORKERS.items():
        os.environ[name] = value
    with Store.reader(home) as store:
        paths = [path for _, path in store.recordings.numbered()][:ALONE]
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        list(pool.map(_identify, [paths[:2]] * processes))  # loads everything
        began = time.perf_counter()
        list(pool.map(_identify, [paths] * processes))
        return processes * len(paths) / (time.perf_counter() - began)


def _identify(paths: list[Path]) -> None:
    keep_memory()
    warm_up()
    for path in paths:
        identified(recording_of(path.read_bytes(), str(path)), load_robot("ur5"), Mounting.of((0.0, 0.0, 0.0)), None, AssessSettings())


def show(workers: int, cost: dict[str, Any], first: dict[str, Any]) -> None:
    """A paragraph a run; first : the cost of the first run, on its own number of workers."""
    found, judge, n = cost["identify"], cost["judge"], cost["identify"]["recordings"]
    if not n:
        print(f"{workers} workers: nothing was left to do")
        return
    useful = found["compute_s"] + judge["compute_s"]
    tasks = found["task_s"] + judge["task_s"]
    parts = {name: found[f"{name}_s"] + judge[f"{name}_s"] for name in ("read", "decode", "write")}
    busy = tasks / (cost["run_s"] * workers)
    processor = cost["workers_processor_s"] + cost["own_processor_s"]
    of_tasks = found["processor_s"] + judge["processor_s"]
    share = useful / tasks * of_tasks  # of the processor, as of the clock
    of_first = first["identify"]["recordings"] / first["run_s"] / first["threads"]
    print(f"{workers} workers: {n} recordings, {found['bytes_read'] / 1e6:.0f} MB, {cost['run_s']:.1f} s: {n / cost['run_s']:.2f} a second")
    print(f"  efficiency by the clock {n / cost['run_s'] / workers / of_first:.1%}; the workers had a task for {busy:.0%} of the time")
    print(f"  start of the workers {cost['took_s'] - cost['run_s']:.1f} s; arm-months found {cost['arm_months_found']}")
    print(f"  of tasks, by the clock: {', '.join(f'{name} {value / tasks:.1%}' for name, value in parts.items())}")
    print(f"  processor: {1000 * processor / n:.0f} ms a recording, of which identification and verdict {1000 * share / n:.0f}")
    beside = {
        "tasks": of_tasks / share - 1.0,
        "rest of the workers": (cost["workers_processor_s"] - of_tasks) / share,
        "scheduler and client": cost["own_processor_s"] / share,
    }
    print(f"  beside these: {processor / share - 1:.1%}: {', '.join(f'{part} {value:.1%}' for part, value in beside.items())}")
    print(f"  peak memory of a worker {max(found['peak_mb'], judge['peak_mb']):.0f} MB")
    hours, read_tb = PLANT * processor / n / 3600, PLANT * found["bytes_read"] / n / 1e12
    print(f"  {PLANT} recordings: {hours:.0f} core-hours, {read_tb:.2f} TB read", flush=True)


def main() -> None:
    """Run on one worker, then on two."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.reassess", description=__doc__)
    parser.add_argument("histories", type=Path, nargs="*", help="of arms; those that live here where none is given")
    parser.add_argument("--replays", type=int, default=30, help="of each arm")
    parser.add_argument("--arms", type=int, default=8)
    parser.add_argument("--folder", type=Path, help="where arms and results stay: the same call goes on from there")
    parser.add_argument("--results", default="", help="folder or s3://bucket/prefix")
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        histories = arguments.histories or plant(folder / "plant", arguments.arms, arguments.replays)
        if not arguments.histories and max(arguments.workers) > 1:
            one, many = (alone(histories[0], processes) for processes in (1, max(arguments.workers)))
            gain = many / one / max(arguments.workers)
            print(f"the machine itself: {one:.1f} a second in one process, {many:.1f} in {max(arguments.workers)}: {gain:.0%} each")
        first: dict[str, Any] = {}
        for workers in arguments.workers:
            cost = measured(histories, arguments.results or str(folder / "results"), workers)
            first = first or cost
            show(workers, cost, first)


if __name__ == "__main__":
    main()
