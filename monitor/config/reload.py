"""Reloading: which settings of a new configuration take effect while the service runs, and which wait for a restart."""

import dataclasses
from typing import Any, NamedTuple

from monitor.config.schema import Configuration
from monitor.config.sections import OF_OTHER_FILES

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
    kept = {name: getattr(old, name) for name in ("production", "bus", "metrics", "page") if hasattr(old, name)}
    staying = [name.removeprefix("robot.") for name in NEEDS_RESTART if name.startswith("robot.")]
    robot = dataclasses.replace(new.robot, **{name: getattr(old.robot, name) for name in staying})
    excitation = new.excitation if new.robot.model == old.robot.model else old.excitation  # a trajectory is made for one model
    speed = old.assess.drift.reference_speed_rad_s
    merged = dataclasses.replace(
        new,
        robot=robot,
        store=dataclasses.replace(new.store, directory=old.store.directory),
        replay=dataclasses.replace(new.replay, **{name: getattr(old.replay, name) for name in ("host", "hand_over", "hand_over_listen")}),
        assess=dataclasses.replace(new.assess, drift=dataclasses.replace(new.assess.drift, reference_speed_rad_s=speed)),
        excitation=excitation,
        path=old.path,
        **kept,
    )
    changed = tuple(key for key in different if key not in waiting)
    return Reloaded(merged, changed, tuple(key for key in waiting if key not in held), held)


def _flat(configuration: Configuration) -> dict[str, Any]:
    """Every setting by its key in the file."""
    flat: dict[str, Any] = {"replay.excitation": (configuration.excitation.digest, configuration.excitation.repetitions)}
    for section in dataclasses.fields(configuration):
        if section.name in {"path", "excitation", "assess", "overrides", "notices"}:
            continue
        _into(flat, section.name, getattr(configuration, section.name))
    for room in dataclasses.fields(configuration.assess):
        value = getattr(configuration.assess, room.name)
        _into(flat, room.name if dataclasses.is_dataclass(value) else f"assess.{room.name}", value)
    flat.pop("replay.host")  # it is set in [robot]
    return flat


def _into(flat: dict[str, Any], place: str, value: Any) -> None:
    if dataclasses.is_dataclass(value) and not isinstance(value, (type, *OF_OTHER_FILES)):
        for field in dataclasses.fields(value):
            _into(flat, f"{place}.{field.name}", getattr(value, field.name))
    else:
        flat[place] = value
