"""The parts of the golden set that are files and commands; the daemon's is in `daemon.py`."""

import hashlib
import json
from pathlib import Path
from typing import Any

from . import daemon, entry, worlds
from .run import ROOT, Run, data_folder
from .worlds import DAY_S, START_UNIX_S, WORLDS

LATER_UNIX_S = START_UNIX_S + 60 * DAY_S
COLUMNS = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
GAINS = "14.87,13.26,11.13,10.62,11.03,11.47"  # of that arm's authors [N·m/A]
TRAINING, SHORT, LONG, LOADED = (
    f"ur10e/ur-20_02_{name}.csv" for name in ("12-50sec_12harm", "10-30sec_12harm", "19_14harm50sec", "19_14harm50secLoad")
)
WRONG = """[robot]
model = "ur5"
site = "lab"
id = "A b"
[schedule]
cron = "at noon"
blackot = []
[replay]
repetitions = 0
"""


def simulation(run: Run) -> bool:
    """The stepped recordings themselves, signal by signal."""
    for name in WORLDS:
        folder = run.world(name)
        run.put(f"simulation/{name}.json", worlds.digests(sorted(folder.glob("day-*.parquet"))))
    return True


def assess(run: Run) -> bool:
    """Every arm's verdicts: from the command line, and every document behind them."""
    for name, world in WORLDS.items():
        folder = run.world(name)
        run.put_lines(f"assess/{name}-documents.jsonl", entry.judged(folder / "days.csv", folder / "arm.toml"))
        base = ("assess", "--config", "arm.toml", "--manifest", "days.csv")
        ways = {"json": ("--json",), "text": (), "why-3": ("--why", "3")}
        for way, options in ways.items():
            run.command(f"assess/{name}-{way}.json", *base, *options, cwd=folder, at_unix_s=LATER_UNIX_S)
        files = [f"day-{replay:02d}.parquet" for replay in (2, 0, 1, 3)]
        gains = ",".join(map(str, entry.true_gains(_arm(world))))
        spaced = ("--robot", world.robot, "--mounting", world.mounting, "--gains", gains, "--interval", "6h", "--json")
        run.command(f"assess/{name}-spaced.json", "assess", *spaced, *files, cwd=folder, at_unix_s=LATER_UNIX_S)
    folder = run.world("cold")
    for way, options in {
        "other-robot": ("--robot", "ur3", "day-00.parquet"),
        "nothing": ("--robot", "ur3"),
        "all-rejected": ("--robot", "ur10", "--mounting", "ceiling", "day-09.parquet"),
        "no-file": ("--robot", "ur10", "absent.parquet"),
    }.items():
        run.command(f"assess/refused-{way}.json", "assess", *options, "--json", cwd=folder, at_unix_s=LATER_UNIX_S)
    return True


def _arm(world: worlds.World) -> Any:
    return entry.simulated(world.robot, seed=world.seed, mounting=world.mounting, scenario=world.scenario, name=world.name)


def rehearse(run: Run) -> bool:
    """Small fleets, two seeds."""
    for seed in (0, 1):
        options = ("--config", "config/monitor.toml", "--arms", "16", "--seed", str(seed))
        run.command(f"rehearse/seed-{seed}.json", "rehearse", *options, "--json", cwd=ROOT, at_unix_s=LATER_UNIX_S)
    noisy = ("--config", "config/monitor.toml", "--arms", "16", "--noise", "0.04")
    run.command("rehearse/text.json", "rehearse", *noisy, cwd=ROOT, at_unix_s=LATER_UNIX_S)
    return True


def identify(run: Run) -> bool:
    """Every real recording, also those that must be refused; skipped where they are absent."""
    data = data_folder()
    if data is None:
        print("  identify: skipped, the real recordings are absent: set JOINT_MONITOR_DATA to their folder")
        return False
    known = ("--columns", COLUMNS, "--gains", GAINS, "--robot", "ur10e")
    ways = {"default": (), "auto-robust": ("--friction", "auto", "--method", "robust")}
    for path in sorted(data.glob("*/*")):
        name = path.relative_to(data).as_posix()
        arm = known if name.startswith("ur10e/") else _as_what(name)
        for way, options in ways.items():
            _identify(run, f"{name}-{way}", name, *arm, *options, "--json")
    for way, options in {
        "validated": (TRAINING, *known, "--validate", SHORT, "--validate", LONG, "--json"),
        "validated-text": (TRAINING, *known, "--validate", SHORT, "--validate", LONG),
        "readme-auto-loaded": (TRAINING, *known, "--friction", "auto", "--validate", SHORT, "--loaded", LOADED),
        "auto-loaded": (TRAINING, *known, "--friction", "auto", "--validate", SHORT, "--loaded", LOADED, "--json"),
        "pair": (LONG, "--columns", COLUMNS, "--robot", "ur10e", "--payload-pair", LOADED, "--payload", "2.6", "--json"),
        "pair-com": (
            *(LONG, "--columns", COLUMNS, "--robot", "ur10e", "--payload-pair", LOADED, "--payload", "2.6"),
            *("--payload-com", "0.03,0.16,0.03", "--payload-std", "0.05", "--json"),
        ),
        "ls": (TRAINING, *known, "--method", "ls", "--json"),
        "load": (TRAINING, *known, "--friction", "load", "--json"),
        "stribeck": (TRAINING, *known, "--friction", "stribeck", "--json"),
        "two-files": (TRAINING, SHORT, *known, "--json"),
        "wall": (TRAINING, *known, "--mounting", "wall", "--json"),
        "no-columns": (TRAINING, "--robot", "ur10e", "--json"),
        "no-gains": (TRAINING, "--columns", COLUMNS, "--robot", "ur10e", "--json"),
    }.items():
        _identify(run, f"ur10e-{way}", *options)
    earlier = run.production / "earlier.json"
    for way, suffix in {"consistent-urdf": "urdf", "consistent-toml": "toml"}.items():
        exported = run.production / f"arm.{suffix}"
        options = (TRAINING, *known, "--method", "consistent", "--export", str(exported), "--json")
        _identify(run, f"ur10e-{way}", *options, files=[exported])
    document = _stdout(run, "identify/ur10e-ls.json")
    earlier.write_text(document, "utf-8")
    _identify(run, "ur10e-rigid-from", SHORT, *known, "--rigid-from", str(earlier), "--json")
    _identify(run, "ur10e-from-exported", SHORT, *known[:4], "--robot", str(run.production / "arm.toml"), "--json")
    energy = (TRAINING, *known, "--along", SHORT, "--limit", "hand=0.49@0.6")
    run.command("identify/energy.json", "energy", *energy, "--json", cwd=data, at_unix_s=LATER_UNIX_S)
    run.command("identify/energy-text.json", "energy", *energy, cwd=data, at_unix_s=LATER_UNIX_S)
    rows = [f"{data / name},2020-02-{day:02d}" for name, day in ((TRAINING, 12), (SHORT, 10), (LONG, 19), (LOADED, 20))]
    runs = run.production / "runs.csv"
    runs.write_text("file,recorded_at\n" + "\n".join(rows) + "\n", "utf-8")
    for way, more in {"json": ("--json",), "text": ()}.items():
        run.command(f"identify/assess-{way}.json", "assess", *known, "--manifest", runs, *more, cwd=run.production, at_unix_s=LATER_UNIX_S)
    return True


def _as_what(name: str) -> tuple[str, ...]:
    if name.startswith("ur3e/"):
        return ("--robot", "ur3e", "--gains", "5.8,6.3,5.1,4.3,4.2,4.4")
    return ("--robot", "ur3" if name.startswith("ur3_") else "ur5e" if name.startswith("ur5e") else "ur5")


def _identify(run: Run, name: str, *arguments: str, files: list[Path] | None = None) -> None:
    data = data_folder()
    assert data is not None
    path = f"identify/{name.replace('/', '-')}.json"
    run.command(path, "identify", *arguments, cwd=data, at_unix_s=LATER_UNIX_S, files=files or [])


def _stdout(run: Run, name: str) -> str:
    return "\n".join(json.loads((run.into / name).read_text("utf-8"))["stdout"])


def design(run: Run) -> bool:
    """Small searches: the file and the printed report."""
    for name, options in {
        "ground": ("--robot", "ur5", "--seed", "3", "--evaluations", "200", "--speed-limit", "2.2", "--flange-speed-limit", "1.5"),
        "ceiling-condition": (
            *("--robot", "ur10", "--mounting", "ceiling", "--objective", "condition"),
            *("--seed", "1", "--evaluations", "120"),
        ),
        "wall-dopt-start": (
            *("--robot", "ur3e", "--mounting", "wall", "--objective", "dopt", "--evaluations", "120", "--harmonics", "4", "--period", "8"),
            *("--start", "0.1,-1.4,0.2,-1.5,0.1,0.0"),
        ),
        "genetic": ("--robot", "ur5", "--optimiser", "ga", "--seed", "2", "--evaluations", "600"),
        "random": ("--robot", "ur5", "--random", "4"),
        "cell": ("--robot", "ur5", "--cell", str(ROOT / "config/cell/example.toml"), "--evaluations", "150", "--objective", "scaled"),
    }.items():
        output = run.production / f"{name}.json"
        run.command(f"design/{name}.json", "design", *options, "-o", output, cwd=run.production, at_unix_s=LATER_UNIX_S, files=[output])
        run.command(f"design/{name}-json.json", "design", *options, "-o", output, "--json", cwd=run.production, at_unix_s=LATER_UNIX_S)
    return True


def reproduce(run: Run) -> bool:
    """The paper's campaign on one arm, with small searches: some statements do not hold then, and the same ones never do."""
    options = ("--robot", "ur3", "--replays", "2", "--evaluations", "100", "--seed", "1")
    run.command("reproduce/json.json", "reproduce", *options, "--json", cwd=run.production, at_unix_s=LATER_UNIX_S)
    run.command("reproduce/text.json", "reproduce", *options, cwd=run.production, at_unix_s=LATER_UNIX_S)
    return True


def rest(run: Run) -> bool:
    """What says something without a recording: base parameters, schemas, help of every command, the reference configuration."""
    for robot in ("ur3", "ur5", "ur10", "ur3e", "ur5e", "ur10e", "ur16e", "ur20", "ur30"):
        run.command(f"rest/base-{robot}.json", "base", "--robot", robot, "--json", cwd=ROOT, at_unix_s=LATER_UNIX_S)
    for frames in ("modified-dh", "joint"):
        options = ("--robot", "ur5", "--mounting", "wall", "--frames", frames)
        run.command(f"rest/base-ur5-wall-{frames}.json", "base", *options, cwd=ROOT, at_unix_s=LATER_UNIX_S)
    run.command("rest/schema.json", "schema", cwd=ROOT, at_unix_s=LATER_UNIX_S)
    kinds = "info health friction alert event events model torque-request torque torque-live history monitor ack-request shelve-request"
    for kind in f"{kinds} replay-request replay permit permit-answer answer error none".split():
        run.command(f"rest/schema-{kind}.json", "schema", kind, cwd=ROOT, at_unix_s=LATER_UNIX_S)
    run.command("rest/help.json", "--help", cwd=ROOT, at_unix_s=LATER_UNIX_S)
    commands = "run simulate identify base energy predict watch status design alerts ack shelve schema assess rehearse check replay record"
    for command in f"{commands} allow schedule history export report reproduce import demo".split():
        run.command(f"rest/help-{command}.json", command, "--help", cwd=ROOT, at_unix_s=LATER_UNIX_S)
    wrong = run.production / "wrong.toml"
    wrong.write_text(WRONG, "utf-8")
    run.command("rest/wrong-configuration.json", "run", "--config", wrong, cwd=run.production, at_unix_s=LATER_UNIX_S)
    for name in ("monitor", "simulated"):
        options = ("--config", f"config/{name}.toml", "--count", "3", "--json")
        run.command(f"rest/schedule-{name}.json", "schedule", *options, cwd=ROOT, at_unix_s=LATER_UNIX_S)
    shipped = sorted(path for folder in ("excitation", "cell", "scenarios") for path in (ROOT / "config" / folder).iterdir())
    run.put("rest/shipped.json", {path.relative_to(ROOT).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in shipped})
    return True


PARTS = {
    "simulation": simulation,
    "assess": assess,
    "rehearse": rehearse,
    "identify": identify,
    "design": design,
    "reproduce": reproduce,
    "rest": rest,
    "bus": daemon.bus,
    "history": daemon.history,
}
