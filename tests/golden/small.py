"""The small part that is committed: what a few stepped replays, a small fleet, a small search and a continued history give.

`python -m tests.golden expected` writes `expected/` anew and prints what has changed.
"""

import gzip
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from . import daemon, entry, worlds
from .compare import differences
from .run import Run
from .worlds import DAY_S

EXPECTED = Path(__file__).with_name("expected")
DIGITS = 10  # of every figure that is kept: more than is compared
WRITTEN, CONTINUED = 10, 13  # replays in the history as it is found, and after it was continued
STEP_DAY = 6.5  # an earlier step belongs to the baseline
SMALL = worlds.World(
    name="small",
    robot="ur5",
    mounting="ground",
    seed=21,
    replays=CONTINUED,
    scenario={
        "room": {"mean_c": 22.0, "daily_swing_k": 2.0, "weekend_drop_k": 6.0},
        "production": worlds.PRODUCTION,
        "event": [{"at_day": STEP_DAY, "do": "wear_step", "joint": 3, "coulomb_factor": 1.3, "viscous_factor": 1.2}],
    },
    declared=lambda _: {"payload_kg": 0.0},
    quality={},
)
LATER_UNIX_S = SMALL.at_unix_s(30)


def run_in(folder: Path) -> Run:
    """A run whose files lie below a scratch folder, and whose commands run in this process."""
    run = Run(into=folder / "set", production=folder / "production", artefacts=folder, here=True)
    run.production.mkdir(parents=True)
    return run


def recorded(run: Run) -> Path:
    """The folder of the recordings, made once a run."""
    folder = run.artefacts / "recordings" / SMALL.name
    if not folder.is_dir():
        worlds.recorded(SMALL, folder)
    return folder


def assessed(run: Run) -> Any:
    """What `assess` prints."""
    return _printed(run, "assess", "--config", "arm.toml", "--manifest", "days.csv", "--json", cwd=recorded(run))


def rehearsed(_: Run) -> Any:
    """A fleet of sixteen arms over some months, in which a joint wears."""
    return entry.small_fleet(arms=16, days=110, seed=3)


def designed(run: Run) -> Any:
    """A search cut short, with its proof, and a random trajectory."""
    found = {}
    for name, options in {"search": ("--seed", "3", "--evaluations", "40"), "random": ("--random", "4")}.items():
        output = run.production / f"{name}.json"
        document = _printed(run, "design", "--robot", "ur5", *options, "-o", output, "--json", cwd=run.production)
        assert document.pop("digest") == document["proof"].pop("path_digest")  # of every bit: another processor's is another
        found[name] = document
    return found


def continued(run: Run) -> Any:
    """A history: what it holds as it is found, and after a restart and three more replays."""
    home = run.artefacts / "written"
    written(run, home)
    found = {"as found": _told(run, home)}
    days = daemon.Days(recorded(run))
    clock = entry.Clock(SMALL.at_unix_s(WRITTEN - 1) + DAY_S / 2)
    with daemon.alone(), entry.running(home / "arm.toml", clock, days.play) as running:
        for day in range(WRITTEN, CONTINUED):
            clock.unix_s, days.next = SMALL.at_unix_s(day) + 5.0, day
            running.perform(SMALL.at_unix_s(day))
        last = running.last_values()
    found["continued"] = _told(run, home)
    found["last values"] = json.loads(run.clean(json.dumps({key: last[key] for key in sorted(last) if key != "info"})))
    return found


def recomputed(run: Run) -> dict[str, Any]:
    """Every verdict of the continued history once more; to be asked after `continued`."""
    home = run.artefacts / "written"
    found: dict[str, Any] = _printed(run, "assess", "--from-store", "--config", "arm.toml", "--json", cwd=home, may_end_with=(0, 3))
    return found


def _told(run: Run, home: Path) -> dict[str, Any]:
    config = ("--config", "arm.toml")
    status = _printed(run, "status", *config, "--why", "3", "--json", cwd=home)
    del status["monitor"]["store"]["history_id"]  # of each history another one
    del status["monitor"]["bus"]["to_send"]  # as far as the session has sent at this moment
    return {
        "status": status,
        "history": _printed(run, "history", *config, "--joint", "3", "--json", cwd=home),
        "report": _printed(run, "report", *config, "--json", cwd=home),
    }


def _printed(run: Run, *arguments: str | Path, cwd: Path, may_end_with: tuple[int, ...] = (0,)) -> Any:
    run.command("last.json", *arguments, cwd=cwd, at_unix_s=LATER_UNIX_S)
    result = json.loads((run.into / "last.json").read_text("utf-8"))
    assert result["exit"] in may_end_with, result
    return json.loads("\n".join(result["stdout"]))


def written(run: Run, home: Path) -> None:
    """A history as the daemon writes it: replays, a missed window, one that a person must check, an acknowledged alert."""
    days = daemon.Days(recorded(run))
    home.mkdir(parents=True)
    shutil.copy(days.folder / "arm.toml", home)
    clock = entry.Clock(SMALL.at_unix_s(0) - 60.0)
    with daemon.alone(), entry.running(home / "arm.toml", clock, days.play) as running:
        for day in range(WRITTEN):
            clock.unix_s, days.next = SMALL.at_unix_s(day) + 5.0, day
            running.perform(SMALL.at_unix_s(day))
            clock.unix_s += DAY_S / 2
            if day == 1:
                running.skip(clock.unix_s, "missed: the monitor or its host was not running, or had another replay under way")
            if day == 4:
                days.next = daemon.raising(entry.aborted("protective_stop in the phase 'play'", "protective_stop"))
                running.perform(clock.unix_s)
            if day == WRITTEN - 1:
                running.acknowledge(3, "Ada", "grease is ordered")
        running.say_monitor()


def regenerated(run: Run) -> dict[str, Any]:
    """Everything that is expected, by its name."""
    return {"assess": assessed(run), "rehearse": rehearsed(run), "design": designed(run), "history": continued(run)}


def expected(name: str) -> Any:
    """As it was written; None where it was not."""
    path = EXPECTED / f"{name}.json.gz"
    return json.loads(gzip.decompress(path.read_bytes())) if path.is_file() else None


def rewrite() -> int:
    """Write what is expected anew, and print what has changed. 0 where nothing has."""
    EXPECTED.mkdir(exist_ok=True)
    changed = False
    with tempfile.TemporaryDirectory(prefix="golden-") as scratch:
        run = run_in(Path(scratch))
        for name, found in regenerated(run).items():
            now, before = rounded(found), expected(name)
            lines = list(differences(before, now))
            print(f"{name}: {f'{len(lines)} differences' if lines else 'same'}")
            for line in lines:
                print(f"    {line}")
            changed = changed or bool(lines)
            text = json.dumps(now, ensure_ascii=False, separators=(",", ":")) + "\n"
            (EXPECTED / f"{name}.json.gz").write_bytes(gzip.compress(text.encode(), mtime=0))
        run.close()
    return int(changed)


def rounded(document: Any) -> Any:
    """The document with `DIGITS` digits of every figure. Further digits depend on the processor."""
    if isinstance(document, dict):
        return {key: rounded(value) for key, value in document.items()}
    if isinstance(document, list):
        return [rounded(value) for value in document]
    return float(f"{document:.{DIGITS}g}") if isinstance(document, float) else document
