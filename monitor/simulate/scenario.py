"""Scenarios: what happens to one simulated arm over its life. A scenario is a TOML file; some are shipped and have names.

All keys are optional: `about`; `starts`, a date and time of which the weekday and the hour matter; `[arm]`, the arm; `[room]`, the
temperature around it; `[production]`, when the arm works between the replays; `[[event]]`, what happens on a day. Other keys are errors.
"""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

from monitor.errors import BadInput
from monitor.model.robot import Mounting
from monitor.simulate import faults
from monitor.simulate.faults import Choice, Flag, Kind, Number, Text, check

DAY_S, HOUR_S = 86_400.0, 3600.0
DAYS_MAX = 36_600.0  # latest day of an event
HEATING_OFF_H, HEATING_ON_H = 20.0, 6.0  # the heating is off from Friday 20 h to Monday 6 h
COOLING_H, WARMING_H = 10.0, 2.5  # time constants of a hall without and with heating
FILE_MAX_BYTES = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Room:
    """The temperature of the air around the arm."""

    mean_c: float = 22.0
    daily_swing_k: float = 0.0  # half of the difference between the warmest and the coldest hour
    warmest_h: float = 15.0  # hour of the day
    weekend_drop_k: float = 0.0  # drop of the temperature after a long time without heating

    def at(self, since_monday_s: float) -> float:
        """The temperature at a time after the midnight that begins a Monday [°C]."""
        hour = since_monday_s / HOUR_S
        swing = self.daily_swing_k * math.cos(2.0 * math.pi * (hour - self.warmest_h) / 24.0)
        return self.mean_c + swing - self.weekend_drop_k * _cold(hour % 168.0)


def _cold(hour: float) -> float:
    """The share of the weekend's drop at an hour of the week; Monday 0 h is 0."""
    off = 4 * 24.0 + HEATING_OFF_H
    if hour >= off:
        return 1.0 - math.exp(-(hour - off) / COOLING_H)
    since_off = hour + 168.0 - off
    if hour <= HEATING_ON_H:
        return 1.0 - math.exp(-since_off / COOLING_H)
    end = 1.0 - math.exp(-(HEATING_ON_H + 168.0 - off) / COOLING_H)
    return end * math.exp(-(hour - HEATING_ON_H) / WARMING_H)


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """When the arm works between the replays. It matters only where time passes on command."""

    duty: float = 0.5  # share of the working hours in which the arm moves
    from_h: float = 7.0
    to_h: float = 17.0
    days: tuple[int, ...] = (1, 2, 3, 4, 5)  # Monday is 1
    pauses: tuple[tuple[float, float], ...] = ()  # days of the scenario [from, to) without work, such as a holiday

    def duty_at(self, since_monday_s: float, day: float) -> float:
        """The share of time in which the arm moves. `day` counts from the scenario's start."""
        weekday, hour = int(since_monday_s // DAY_S) % 7 + 1, since_monday_s % DAY_S / HOUR_S
        if any(begin <= day < end for begin, end in self.pauses):
            return 0.0
        return self.duty if weekday in self.days and self.from_h <= hour < self.to_h else 0.0

    @property
    def duty_hours_a_month(self) -> float:
        """Hours of motion in thirty days without a pause."""
        return self.duty * (self.to_h - self.from_h) * len(self.days) * 30.0 / 7.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioEvent:
    """One event of a scenario. `do` is a key of EVENTS."""

    at_s: float  # after the start of the scenario
    do: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """What happens to one arm."""

    name: str = "fresh"
    about: str = "a healthy arm"
    started_s: float = 0.0  # time between the midnight that began the week's Monday and the start
    arm: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    room: Room | None = None
    production: Work = field(default_factory=Work)
    events: tuple[ScenarioEvent, ...] = ()


_JOINT = Number(1, 6)
EVENTS: dict[str, dict[str, Kind]] = {
    "wear": {"joint": _JOINT, "percent_a_month": Number(0, 1000)},
    "wear_step": {"joint": _JOINT, "coulomb_factor": Number(0, 100, 1.0), "viscous_factor": Number(0, 100, 1.0)},
    "regrease": {"joint": _JOINT, "recovery": Number(0, 1, 0.8)},
    "replace_joint": {"joint": _JOINT, "friction_factor": Number(0.1, 10, 1.0), "serial": Text("")},
    "payload": {"kg": Number(0, 100), "declared": Flag(default=False)},
    "mounting": {"mounting": Text(), "declared": Flag(default=False)},
    "fault": {"fault": Choice(tuple(faults.FAULTS))},
}
ARM: dict[str, Kind] = {
    "robot": Text("ur5"),
    "mounting": Text("ground"),
    "payload_kg": Number(0, 100, 0.0),
    "serial": Text("20180500001"),
    "current_noise": Number(0, 100, 1.0),
}
ROOM: dict[str, Kind] = {
    "mean_c": Number(-20, 60, 22.0),
    "daily_swing_k": Number(0, 30, 0.0),
    "warmest_h": Number(0, 24, 15.0),
    "weekend_drop_k": Number(0, 40, 0.0),
}


def scenario_names() -> list[str]:
    """The names of the shipped scenarios, sorted."""
    return sorted(file.stem for folder in _folders() if folder.is_dir() for file in folder.glob("*.toml"))


def load_scenario(name: str) -> Scenario:
    """Load a shipped scenario by its name, or any scenario by the path of its file.

    Raises BadInput with the names of the shipped scenarios if it is neither, or with the key that is wrong in the file.
    """
    path = Path(name)
    if path.suffix != ".toml":
        found = (
            [folder / f"{name}.toml" for folder in _folders() if (folder / f"{name}.toml").is_file()] if name in scenario_names() else []
        )
        if not found:
            raise BadInput(f"scenario {name!r} is not known; known are {', '.join(scenario_names())}, or give a file that ends in .toml")
        path = found[0]
    try:
        if path.stat().st_size > FILE_MAX_BYTES:
            raise BadInput(f"{path}: larger than {FILE_MAX_BYTES} bytes; a scenario is a few lines")
        document = tomllib.loads(path.read_text("utf-8"))
    except OSError as wrong:
        raise BadInput(f"{path}: cannot be read ({wrong.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as wrong:
        raise BadInput(f"{path}: not TOML ({wrong})") from None
    return scenario_from_document(document, path.stem, str(path))


def scenario_from_document(document: dict[str, Any], name: str, where: str) -> Scenario:
    """A scenario from the keys of a file. `where` begins every message. Raises BadInput with the key that is wrong."""
    known = {"about", "starts", "arm", "room", "production", "event"}
    unknown = sorted(set(document) - known)
    if unknown:
        raise BadInput(f"{where}: {', '.join(unknown)} is not a key of a scenario; known are {', '.join(sorted(known))}")
    about = document.get("about", "")
    if not isinstance(about, str):
        raise BadInput(f"{where}: about = {about!r}; expected a sentence")
    events = document.get("event", [])
    if not isinstance(events, list):
        raise BadInput(f"{where}: event is a list of tables; write [[event]]")
    room = _table(document, "room", where)
    parsed_events = [_event(entry, f"{where}: [[event]] {i + 1}") for i, entry in enumerate(events)]
    work = _work(_table(document, "production", where) or {}, f"{where}: [production]")
    if work.duty_hours_a_month == 0.0 and any(event.arguments.get("percent_a_month") for event in parsed_events):
        raise BadInput(
            f"{where}: a joint wears by percent_a_month of work, and [production] has none; expected a duty above 0 on some days"
        )
    return Scenario(
        name=name,
        about=about or name,
        started_s=_since_monday(document.get("starts", date(2026, 1, 5)), where),
        arm=MappingProxyType(check(f"{where}: [arm]", ARM, _table(document, "arm", where) or {})),
        room=None if room is None else Room(**check(f"{where}: [room]", ROOM, room)),
        production=work,
        events=tuple(sorted(parsed_events, key=lambda event: event.at_s)),
    )


def _table(document: dict[str, Any], key: str, where: str) -> dict[str, Any] | None:
    table = document.get(key)
    if table is not None and not isinstance(table, dict):
        raise BadInput(f"{where}: {key} = {table!r}; expected a table [{key}]")
    return table


def _since_monday(starts: Any, where: str) -> float:
    if isinstance(starts, datetime):
        return starts.weekday() * DAY_S + starts.hour * HOUR_S + starts.minute * 60.0 + starts.second
    if isinstance(starts, date):
        return starts.weekday() * DAY_S
    raise BadInput(f"{where}: starts = {starts!r}; expected a date, e.g. 2026-01-05, or a date and time")


def _work(table: dict[str, Any], where: str) -> Work:
    days, pauses = table.pop("days", [1, 2, 3, 4, 5]), table.pop("pauses", [])
    if not isinstance(days, list) or not all(type(day) is int and 1 <= day <= 7 for day in days) or len(set(days)) != len(days):
        raise BadInput(f"{where}: days = {days!r}; expected numbers from 1 (Monday) to 7, each once")
    good = isinstance(pauses, list) and all(
        isinstance(p, list) and len(p) == 2 and all(type(x) in {int, float} and math.isfinite(x) for x in p) and 0 <= p[0] < p[1]
        for p in pauses
    )
    if not good:
        raise BadInput(f"{where}: pauses = {pauses!r}; expected pairs of days [from, to] after the start")
    kinds: dict[str, Kind] = {"duty": Number(0, 1, 0.5), "from_h": Number(0, 24, 7.0), "to_h": Number(0, 24, 17.0)}
    rest = check(where, kinds, table)
    if rest["from_h"] >= rest["to_h"]:
        raise BadInput(f"{where}: from_h = {rest['from_h']:g} is not before to_h = {rest['to_h']:g}")
    return Work(days=tuple(days), pauses=tuple((float(a), float(b)) for a, b in pauses), **rest)


def _event(entry: Any, where: str) -> ScenarioEvent:
    if not isinstance(entry, dict):
        raise BadInput(f"{where}: {entry!r}; expected a table")
    entry = dict(entry)
    do = entry.pop("do", None)
    if not isinstance(do, str) or do not in EVENTS:
        raise BadInput(f"{where}: do = {do!r}; expected one of {', '.join(EVENTS)}")
    when = {key: entry.pop(key) for key in ("at_day", "at_s") if key in entry}
    if len(when) != 1:
        raise BadInput(f"{where}: when? give either at_day or at_s, after the start")
    at = check(where, {"at_day": Number(0, DAYS_MAX)} if "at_day" in when else {"at_s": Number(0, DAYS_MAX * DAY_S)}, when)
    at_s = at["at_day"] * DAY_S if "at_day" in at else at["at_s"]
    if do == "fault":
        name = check(where, EVENTS["fault"], {"fault": entry.pop("fault", None)})["fault"]
        return ScenarioEvent(at_s=at_s, do=do, arguments=MappingProxyType({"fault": name, "with": faults.checked(name, entry)}))
    if do == "replace_joint" and "serial" not in entry:
        entry["serial"] = "unknown"
    arguments = check(where, EVENTS[do], entry)
    if do == "mounting":
        Mounting.parse(arguments["mounting"])
    return ScenarioEvent(at_s=at_s, do=do, arguments=MappingProxyType(arguments))


def _folders() -> tuple[Path, Path]:
    """The folders that may hold the shipped scenarios: in an installed wheel, and beside the package."""
    package = Path(str(files("monitor")))
    return package / "_config" / "scenarios", package.parent / "config" / "scenarios"
