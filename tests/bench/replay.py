"""What the process that streams targets costs, and how punctual it is: `python -m tests.bench.replay`.

Replays of 10 s on a simulated controller, at 125 Hz and at 500 Hz. For each: the share of a core that the streaming process takes during
the play, the share of its own thread alone (the rest are the threads of ur-rtde), the ticks that it missed, and the rows that came late
by half a tick or more. On a machine with other work the kernel wakes every process late, whatever it does; `chrt -f 10 python -m
tests.bench.replay` gives simulator and streaming process real-time priority, as the streaming process of a real arm has it.

`--save a.json` keeps the figures, `--compare a.json b.json` sets two versions side by side. Only public functions are used, so the file
runs on an older version too; versions are best compared by runs that take turns (`--rounds 1`, several times, saved to the same file).
"""

import argparse
import json
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.watch import Caller
from monitor.config.load import find_excitation
from monitor.errors import ReplayAborted
from monitor.model.robot import load_robot

sys.path.append(str(Path(__file__).parents[1]))  # the tests import each other by their names
from tests.acquire.processes import children
from tests.acquire.simulated_arm import known_gains, simulated_arm

ADDRESS = "127.0.89.93"
CASES = {"125 Hz": ("ur5", 125.0), "500 Hz": ("ur5e", 500.0)}
ROUNDS = 5


class Meter:
    """Processor time of the streaming process during the play, from /proc; `__call__` is the replay's `on_progress`."""

    def __init__(self) -> None:
        self._pid: int | None = None
        self._first: tuple[float, dict[str, float]] | None = None
        self._last: tuple[float, dict[str, float]] | None = None

    def __call__(self, progress) -> None:
        if progress.phase != "play":
            return
        self._pid = self._pid or streaming_process()
        used = time.monotonic(), thread_seconds(self._pid)
        self._first, self._last = self._first or used, used

    def shares(self) -> tuple[float, float]:
        """[% of a core] of the whole process, and of its first thread."""
        (began, before), (ended, after) = self._first, self._last
        scale = 100.0 / (ended - began)
        return scale * sum(after[thread] - before[thread] for thread in before), scale * (after[str(self._pid)] - before[str(self._pid)])


def streaming_process() -> int:
    """The child of this process whose command line names the streaming module."""
    return children(naming="acquire.ur.stream")[0]


def thread_seconds(pid: int) -> dict[str, float]:
    return {task.name: int((task / "schedstat").read_text().split()[0]) / 1e9 for task in Path(f"/proc/{pid}/task").iterdir()}


def run(rounds: int) -> dict[str, list[dict[str, float]]]:
    """The figures of each replay, by case; replays that the machine's other work ended are left out and counted."""
    found: dict[str, list[dict[str, float]]] = {}
    for title, (robot, rate_hz) in CASES.items():
        settings = ReplaySettings(
            host=ADDRESS, allow_motion=True, first_pass=False, approach_speed_rad_s=1.0, max_approach_rad=6.0, rate_hz=rate_hz
        )
        excitation = replace(find_excitation(f"{robot}-ground", Path()), repetitions=1)
        for _ in range(rounds):
            meter = Meter()
            with simulated_arm(ADDRESS, "--robot", robot):
                try:
                    gains = known_gains(robot)
                    recording = replay(excitation, load_robot(robot), settings, installation=gains, caller=Caller(on_progress=meter))
                except ReplayAborted as error:
                    found.setdefault(title, []).append({"ended": 1.0})
                    print(f"{title}: {error.cause}")
                    continue
            quality, (process, thread) = recording.quality, meter.shares()
            figures = {
                "process, % of a core": process,
                "its own thread, % of a core": thread,
                "missed ticks, %": 100.0 * quality["missed_ticks"] / (recording.samples + quality["missed_ticks"]),
                "late rows, %": 100.0 * quality["late_share"],
                "latency p99, ms": quality["latency_p99_ms"],
                "pacing p99, ms": quality["pacing_p99_ms"],
                "doubled rows": quality["duplicated_ticks"],
                "following error, mrad": 1000.0 * quality["max_following_error_rad"],
            }
            found.setdefault(title, []).append(figures)
            print(f"{title}: " + ", ".join(f"{name} {value:.2f}" for name, value in figures.items()), flush=True)
    return found


def show(runs: list[dict[str, list[dict[str, float]]]]) -> None:
    """Mean and largest of each figure, a column pair a run."""
    for title in runs[0]:
        replays = [[each for each in found[title] if "ended" not in each] for found in runs]
        counts = " and ".join(f"{len(each)} (ended {len(found[title]) - len(each)})" for each, found in zip(replays, runs, strict=True))
        print(f"{title}, {counts} replays: mean, largest")
        for name in replays[0][0] if all(replays) else ():
            columns = (f"{statistics.mean(r[name] for r in each):9.3f} {max(r[name] for r in each):9.3f}" for each in replays)
            print(f"  {name:<30}" + "   ".join(columns))


def main() -> None:
    """Measure, or compare two saved runs."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.replay", description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--save", type=Path, metavar="FILE", help="keep the figures as JSON, beside those that the file holds already")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("A", "B"), help="two saved runs")
    arguments = parser.parse_args()
    if arguments.compare:
        show([json.loads(path.read_text()) for path in arguments.compare])
        return
    found = run(arguments.rounds)
    if arguments.save:
        held = json.loads(arguments.save.read_text()) if arguments.save.exists() else {}
        arguments.save.write_text(json.dumps({title: held.get(title, []) + each for title, each in found.items()}))
    show([found])


if __name__ == "__main__":
    main()
