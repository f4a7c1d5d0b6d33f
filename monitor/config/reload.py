"""Reloading: which settings of a new configuration take effect while the service runs, and which wait for a restart."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

from monitor.config.files import OF_PLANT
from monitor.config.schema import Configuration, assess_sections
from monitor.design.cell import Cell
from monitor.judge.friction.prior import FleetPrior

# sockets, files and identity are opened once
NEEDS_RESTART = (
    "robot.model",
    "robot.site",
    "robot.id",
    "robot.host",
    "robot.listen_hz",
    "replay.hand_over",
    "replay.hand_over_listen",
    "production",
    "bus",
    "metrics",
    "page",
    "notify",
    "store.directory",
    "drift.reference_speed_rad_s",
)
# a history is of one model and refers its friction to one speed: neither can change in it, with a restart or without
BOUND_TO_HISTORY = ("robot.model", "drift.reference_speed_rad_s")


class Reloaded(NamedTuple):
    """The result of a reload."""

    configuration: Configuration
    changed: tuple[str, ...]  # keys in force
    waiting: tuple[str, ...]  # keys that a restart will put in force
    held: tuple[str, ...] = ()  # keys that stay as they are as long as the history is the same: a start with them is refused

    @property
    def text(self) -> str:
        """As a sentence."""
        parts = [f"changed {', '.join(self.changed)}"] if self.changed else []
        parts += [f"waiting for a restart: {', '.join(self.waiting)}"] if self.waiting else []
        if self.held:
            what = "another [store] directory begins a new history; with this one the next start is refused"
            parts.append(f"stays as it is, because the history is bound to it: {', '.join(self.held)} ({what})")
        return "; ".join(parts) or "nothing has changed"


def reloaded(old: Configuration, new: Configuration) -> Reloaded:
    """The old configuration with all settings of the new one that may change while the service runs."""
    was, will = _flat(old), _flat(new)
    different = sorted(key for key in was.keys() | will.keys() if was.get(key) != will.get(key))
    waiting = tuple(key for key in different if any(key == name or key.startswith(f"{name}.") for name in NEEDS_RESTART))
    held = () if "store.directory" in waiting else tuple(key for key in waiting if key in BOUND_TO_HISTORY)
    merged = dataclasses.replace(new, path=old.path)
    for key in (*NEEDS_RESTART, "replay.host"):
        merged = _as_before(merged, old, key.split("."))
    if new.robot.model != old.robot.model:  # a trajectory is made for one model
        merged = dataclasses.replace(merged, excitation=old.excitation)
    changed = tuple(key for key in different if key not in waiting)
    return Reloaded(merged, changed, tuple(key for key in waiting if key not in held), held)


def _as_before(new: Any, old: Any, key: Sequence[str]) -> Any:
    """The new settings with the value of one key, or of a section, as it was."""
    if key[0] in assess_sections() and hasattr(new, "assess"):
        key = ("assess", *key)
    name, *rest = key
    value = _as_before(getattr(new, name), getattr(old, name), rest) if rest else getattr(old, name)
    return dataclasses.replace(new, **{name: value})


def _flat(configuration: Configuration) -> dict[str, Any]:
    """Every setting by its key in the file."""
    flat: dict[str, Any] = {"replay.excitation": (configuration.excitation.digest, configuration.excitation.repetitions)}
    for section in dataclasses.fields(configuration):
        if section.name in {"path", "excitation", "assess", "overrides", "prior_of_plant"}:
            continue
        _into(flat, section.name, getattr(configuration, section.name))
    for room in dataclasses.fields(configuration.assess):
        value = getattr(configuration.assess, room.name)
        _into(flat, room.name if dataclasses.is_dataclass(value) else f"assess.{room.name}", value)
    if configuration.prior_of_plant:
        flat["drift.prior"] = OF_PLANT  # whichever it was: it does not change any more
    flat.pop("replay.host")  # the same as robot.host
    return flat


def _into(flat: dict[str, Any], place: str, value: Any) -> None:
    if dataclasses.is_dataclass(value) and not isinstance(value, type | Cell | FleetPrior):
        for field in dataclasses.fields(value):
            _into(flat, f"{place}.{field.name}", getattr(value, field.name))
    else:
        flat[place] = value
