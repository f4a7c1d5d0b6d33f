"""What a reassessment costs, by parts, on one worker process and on two: `python -m tests.bench.reassess [HISTORY …]`.

Without a history, `--arms` arms live for `--replays` days on a simulated controller, 30 s at 125 Hz each; their recordings differ. With
`--folder` histories and results are kept there, and the same call goes on from there: it counts what it has computed itself.

`--recordings 100000` does it in parts of 66 arms of 60 replays, each of which is made, judged and removed, so that 12 GB of disk are
enough: an eleventh of a part on one worker, the rest on two, which of them first by turns. So slow changes of the machine's speed fall on
both, and `efficiency` has a standard error. A finished part is a line in `parts.jsonl` of `--folder`: the same call goes on after the
last one. With `--s3` the recordings are on a real S3 server (SeaweedFS) alone.

`efficiency` is by the clock, and means something on a machine without other work alone. Beside it stands what the machine itself gains by
its second core: processes that identify the same recordings and know nothing of each other. `beside` is what reading, decoding, keeping and
scheduling take of the processor beside identification and verdicts, and means something on any machine.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

sys.path += [str(Path(__file__).parents[1] / "store")]  # the tests import each other by their names

import numpy as np
from pyarrow import fs

from monitor.config.files import find_excitation
from monitor.config.load import from_document
from monitor.judge.assess import identified
from monitor.judge.settings import AssessSettings
from monitor.model.robot import Mounting, load_robot
from monitor.service.history.assess_and_store import assess_stored, load_state, state_after
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.archive.archive import Copy, key_of
from monitor.store.archive.places import ArchiveSettings
from monitor.store.formats.recordings import recording_of, write_recording
from monitor.store.store import Store
from monitor.studies.reassess.cluster import OF_WORKERS, warm_up
from monitor.studies.reassess.identify_month import keep_memory
from monitor.studies.reassess.reassess import reassess

PLANT = 1_830_000  # recordings of 1250 arms in a year, four a day
ALONE = 30  # recordings that each process identifies, to see what the machine gains by its second core
MADE = "made"  # file in the folder of an arm that has lived to its end
PART_ARMS, PART_REPLAYS, OF_ONE = 66, 60, 11  # of a part; one arm in eleven is judged by one worker
VOLUME_MB = 2048  # of the S3 server, whose eight volumes hold the 6 GB of a part
NUMBERED = 1_000_000  # number in the recordings of the first arm; those of others have as many digits
BEGAN_S, DAY_S = 1.7e9, 86_400.0


class Bucket(NamedTuple):
    """A place on an S3 server, to which recordings go by the server's own client: unlike the service, nothing is read back."""

    settings: ArchiveSettings
    client: fs.S3FileSystem
    folder: str

    def take(self, content: bytes, key: str) -> Copy:
        """One recording."""
        with self.client.open_output_stream(f"{self.folder}/{key}") as stream:
            stream.write(content)
        return Copy(f"{self.settings.address}/{key}", hashlib.sha256(content).hexdigest(), len(content), was_there=False)


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
            at = BEGAN_S + DAY_S * day
            number = store.ledger.claim(at, "scheduled", at)
            assert number is not None
            context = replace(configuration.context, firmware=made.context.firmware, recorded_at_unix_s=at)
            current = made.current * (1.0 + 0.005 * rng.normal(size=6)) + 0.01 * rng.normal(size=made.current.shape)
            quality = {**made.quality, "arm": NUMBERED}
            write_recording(store.recordings.path(number), replace(made, current=current, context=context, quality=quality))
            store.ledger.mark_recorded(number)
            known = state_after(known, assess_stored(store, configuration, known, number, lambda at=at: at))
    return folder


def plant(folder: Path, arms: int, replays: int, first: int = 0, archive: Bucket | None = None) -> list[Path]:
    """So many arms from a number on: arm 0 has lived, others have its history and other bytes of its recordings, here or in an archive."""
    alive = folder / "arm-00000"
    if not (alive / MADE).is_file():
        shutil.rmtree(alive, ignore_errors=True)
        lived(alive, replays)
        (alive / MADE).touch()
    homes = {k: folder / f"arm-{k:05d}" for k in range(first, first + arms)}

    def make(k: int) -> None:
        home = homes[k]
        if (home / MADE).is_file():
            return
        shutil.rmtree(home, ignore_errors=True)
        shutil.copytree(alive, home, ignore=shutil.ignore_patterns("*.parquet", MADE))
        if archive is not None:
            in_archive(home, of_arm(alive, k), archive)
        else:
            for _, path, content in of_arm(alive, k):
                (home / "recordings" / path.name).write_bytes(content)
        (home / MADE).touch()

    with ThreadPoolExecutor() as threads:
        list(threads.map(make, homes))
    return list(homes.values())


def in_archive(home: Path, recordings: Iterable[tuple[int, Path, bytes]], archive: Bucket) -> None:
    """Bring an arm's recordings to an archive, and its history to know of them."""
    with Store.open(home) as store:
        store.archived.note_place(archive.settings)
        for number, _, content in recordings:
            key = key_of("lab", home.name, BEGAN_S + DAY_S * (number - 1), number, content)
            store.archived.add(number, archive.take(content, key), BEGAN_S)


def of_arm(alive: Path, k: int) -> Iterator[tuple[int, Path, bytes]]:
    """Number and path of each recording of the arm that has lived, and its bytes as those of arm k."""
    with Store.reader(alive) as store:
        recordings = list(store.recordings.numbered())
    for number, path in recordings:
        content = path.read_bytes()
        own = content.replace(f'"arm": {NUMBERED}'.encode(), f'"arm": {NUMBERED + k}'.encode())
        assert own != content
        yield number, path, own


def in_parts(folder: Path, recordings: int, arms: int, replays: int, s3: bool) -> None:
    """Judge so many recordings part by part on one worker and on two; what was judged before is in `parts.jsonl`."""
    done = folder / "parts.jsonl"
    parts = [json.loads(line) for line in done.read_text().splitlines()] if done.is_file() else []
    while sum(judged(part) for part in parts) < recordings:
        number, began = len(parts), time.perf_counter()
        with ExitStack() as stack:
            place = folder / "part"
            shutil.rmtree(place, ignore_errors=True)  # of a call that was ended: every part is measured whole
            place.mkdir(parents=True)
            stack.callback(shutil.rmtree, place)
            archive = served(place, stack) if s3 else None
            homes = plant(folder / "plant", arms, replays, 1 + number * arms, archive)
            for home in homes:
                stack.callback(shutil.rmtree, home)
            made_s = time.perf_counter() - began
            shares = [(1, homes[::OF_ONE]), (2, [home for k, home in enumerate(homes) if k % OF_ONE])]
            costs = {workers: measured(of_it, str(place / "results"), workers) for workers, of_it in shares[:: 1 if number % 2 else -1]}
        parts.append({"part": number, "made_s": made_s, "one": costs[1], "two": costs[2]})
        with done.open("a") as lines:
            lines.write(json.dumps(parts[-1]) + "\n")
        print(f"part {number}: made in {made_s:.0f} s; {judged(parts[-1])} recordings, efficiency {efficiency(parts[-1]):.1%}", flush=True)
    show_parts(parts)


def served(place: Path, stack: ExitStack) -> Bucket:
    """A bucket on a real S3 server whose files are below a folder."""
    from s3_server import KEYS, s3_server

    (place / "s3").mkdir()
    server = stack.enter_context(s3_server(place / "s3", VOLUME_MB, processors=2))
    os.environ.update(AWS_ACCESS_KEY_ID=KEYS[0], AWS_SECRET_ACCESS_KEY=KEYS[1], AWS_ENDPOINT_URL=server.endpoint)
    settings = ArchiveSettings(address=f"s3://{server.bucket}/plant", endpoint=server.endpoint)
    return Bucket(settings, server.client(), f"{server.bucket}/plant")


def judged(part: dict[str, Any]) -> int:
    """How many recordings a part has identified."""
    return sum(int(part[each]["identify"]["recordings"]) for each in ("one", "two"))


def efficiency(part: dict[str, Any]) -> float:
    """Of two workers against one, by the clock."""
    one, two = (part[each]["identify"]["recordings"] / part[each]["run_s"] for each in ("one", "two"))
    return float(two / one / 2.0)


def show_parts(parts: Sequence[dict[str, Any]]) -> None:
    """All parts together."""
    each = [efficiency(part) for part in parts]
    error = f" ± {statistics.stdev(each) / len(each) ** 0.5:.1%}" if len(each) > 1 else ""
    print(f"{sum(map(judged, parts))} recordings in {len(parts)} parts")
    print(f"efficiency of two workers by the clock {statistics.mean(each):.1%}{error}")
    ones, twos = together([part["one"] for part in parts]), together([part["two"] for part in parts])
    show(1, ones, ones)
    show(2, twos, ones)


def together(costs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The costs of several runs as those of one."""
    found: dict[str, Any] = {}
    for name, value in costs[0].items():
        if isinstance(value, dict):
            found[name] = together([cost[name] for cost in costs])
        else:
            found[name] = (max if name in ("threads", "peak_mb") else sum)(cost[name] for cost in costs)
    return found


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
    parser.add_argument("--recordings", type=int, help="in parts, which take turns on one worker and on two")
    parser.add_argument("--s3", action="store_true", help="with --recordings: on a real S3 server")
    parser.add_argument("--folder", type=Path, help="where arms and results stay: the same call goes on from there")
    parser.add_argument("--results", default="", help="folder or s3://bucket/prefix")
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        if arguments.recordings:
            in_parts(folder, arguments.recordings, PART_ARMS, PART_REPLAYS, arguments.s3)
            return
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
