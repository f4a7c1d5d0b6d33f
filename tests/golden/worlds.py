"""The simulated arms whose lives are judged: a payload that changes, a joint that is replaced, cold weekends."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from . import entry

DAY_S = 86_400.0
START_UNIX_S = 1_767_582_000.0  # Monday 2026-01-05 03:00 UTC
ENDPOINT, METRICS = "tcp/127.0.88.9:7459", "127.0.88.9:9477"


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """One arm's life: a replay a day from the first Monday on."""

    name: str
    robot: str
    mounting: str
    seed: int
    replays: int
    scenario: dict[str, Any]
    declared: Callable[[int], dict[str, Any]]  # of each replay, in the manifest
    quality: dict[int, dict[str, Any]]  # of some replays: the quality that acquisition would have counted

    @property
    def excitation(self) -> str:
        """The shipped one."""
        return f"{self.robot}-{self.mounting}"

    def at_unix_s(self, replay: int) -> float:
        """When a replay is recorded."""
        return START_UNIX_S + replay * DAY_S


def _payload(replay: int) -> dict[str, Any]:
    return {"payload_kg": 0.0 if replay < 16 else 2.0, "note": "a gripper was mounted" if replay == 16 else ""}


def _replaced(replay: int) -> dict[str, Any]:
    serials = [f"2018-{joint}" for joint in range(1, 7)]
    if replay >= 10:
        serials[1] = "2026-2"
    revolutions = [round(1000.0 + 37.5 * joint * replay, 1) for joint in range(1, 7)]
    declared: dict[str, Any] = {"joint_serials": " ".join(serials), "revolutions": " ".join(map(str, revolutions))}
    return declared | ({"maintenance": "joint 5 greased"} if replay >= 17 else {"maintenance": ""})


def _nothing(_: int) -> dict[str, Any]:
    return {}


PRODUCTION = {"duty": 0.5, "days": [1, 2, 3, 4, 5, 6, 7]}
WORLDS = {
    world.name: world
    for world in (
        World(
            name="payload",
            robot="ur5",
            mounting="ground",
            seed=11,
            replays=26,
            scenario={
                "starts": datetime(2026, 1, 5, 3, tzinfo=UTC),
                "room": {"mean_c": 22.0, "daily_swing_k": 2.0},
                "production": PRODUCTION,
                "event": [
                    {"at_day": 3.0, "do": "wear", "joint": 3, "percent_a_month": 60.0},
                    {"at_day": 12.5, "do": "payload", "kg": 2.0, "told": False},
                    {"at_day": 15.5, "do": "payload", "kg": 2.0, "told": True},
                ],
            },
            declared=_payload,
            quality={},
        ),
        World(
            name="replaced",
            robot="ur5e",
            mounting="wall",
            seed=12,
            replays=22,
            scenario={
                "starts": datetime(2026, 1, 5, 3, tzinfo=UTC),
                "room": {"mean_c": 24.0, "daily_swing_k": 3.0},
                "production": PRODUCTION,
                "event": [
                    {"at_day": 2.0, "do": "wear", "joint": 2, "percent_a_month": 90.0},
                    {"at_day": 9.5, "do": "replace_joint", "joint": 2, "friction_factor": 0.85, "serial": "2026-2"},
                    {"at_day": 16.5, "do": "regrease", "joint": 5, "recovery": 0.8},
                    {"at_day": 18.5, "do": "wear_step", "joint": 4, "coulomb_factor": 1.15, "viscous_factor": 1.1},
                ],
            },
            declared=_replaced,
            quality={},
        ),
        World(
            name="cold",
            robot="ur10",
            mounting="ceiling",
            seed=13,
            replays=24,
            scenario={
                "starts": datetime(2026, 1, 5, 3, tzinfo=UTC),
                "room": {"mean_c": 20.0, "daily_swing_k": 2.0, "weekend_drop_k": 13.0},
                "event": [{"at_day": 17.5, "do": "fault", "fault": "temperatures_frozen"}],
            },
            declared=_nothing,
            quality={9: {"late_share": 0.3}, 14: {"missed_ticks": 100}},
        ),
    )
}


def recorded(world: World, folder: Path, replays: int | None = None) -> list[Path]:
    """The arm's recordings below a folder, with the configuration `arm.toml` and the manifest `days.csv` beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    count = world.replays if replays is None else replays
    paths = [folder / f"day-{replay:02d}.parquet" for replay in range(count)]
    arm = entry.simulated(world.robot, seed=world.seed, mounting=world.mounting, scenario=world.scenario, name=world.name)
    for replay, path in enumerate(paths):
        entry.live_until(arm, replay * DAY_S)
        recording = entry.replayed(arm, world.excitation)
        recording = entry.said_of(recording, quality=world.quality.get(replay), recorded_at_unix_s=world.at_unix_s(replay))
        entry.keep(path, recording)
    (folder / "arm.toml").write_text(configuration(world, entry.true_gains(arm)), "utf-8")
    columns = list(world.declared(0))
    lines = [",".join(["file", "recorded_at", *columns])]
    for replay, path in enumerate(paths):
        at = datetime.fromtimestamp(world.at_unix_s(replay), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        lines.append(",".join([path.name, at, *(str(world.declared(replay)[column]) for column in columns)]))
    (folder / "days.csv").write_text("\n".join(lines) + "\n", "utf-8")
    return paths


def configuration(world: World, gains: list[float], payload_kg: float = 0.0) -> str:
    """The arm's TOML; its history lies beside it."""
    return f"""[robot]
model = "{world.robot}"
site = "lab"
id = "{world.name}"
host = "127.0.0.1"
mounting = "{world.mounting}"
payload_kg = {payload_kg}
gains_nm_per_a = {gains}

[replay]
allow_motion = true
excitation = "{world.excitation}"
repetitions = 1

[schedule]
cron = "0 3 * * *"

[store]
directory = "history"
least_free_mb = 1.0

[bus]
listen = ["{ENDPOINT}"]

[residual]
span_s = 60.0
min_samples = 40
baseline_observations = 1
min_observations = 2

[metrics]
listen = "{METRICS}"

[page]
listen = "127.0.0.1:0"
"""


def digests(paths: list[Path]) -> list[dict[str, Any]]:
    """Of every recording: the digest of each signal, its context and quality, and the digest of its file."""
    documents = []
    for path in paths:
        document = entry.told_of(entry.recording_of(path))
        signals = {
            name: {"shape": list(values.shape), "sha256": hashlib.sha256(values.tobytes()).hexdigest()}
            for name, values in document.pop("signals").items()
        }
        documents.append({"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), **document, "signals": signals})
    return documents
