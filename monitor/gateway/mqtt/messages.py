"""Topics, retained messages and Home Assistant's discovery of arms. Any name of a site or a robot has a topic of its own. Pure.

A level of a topic may be any text without `/`, `+`, `#` and NUL; a name in Home Assistant holds only a–z, A–Z, 0–9, `_` and `-`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple
from urllib.parse import quote, unquote

import orjson

from monitor import __version__
from monitor.judge.alerts.health import STATES
from monitor.plant.arm import MANUFACTURER, HeardArm, HeardJoint, Silence
from monitor.publish.documents import as_json
from monitor.publish.shown import unacknowledged
from monitor.publish.timestamps import rfc3339, written_if

GATEWAY = "availability"  # below the root: whether the gateway is connected
ONLINE, OFFLINE = "online", "offline"  # Home Assistant's defaults
_SEPARATOR = "_-"  # an escaped name never holds it: its `_` is doubled, or begins a byte in hexadecimal


class ArmTopics(NamedTuple):
    """The topics of one arm."""

    root: str
    site: str
    robot: str

    @property
    def base(self) -> str:
        """Below which the arm's topics lie."""
        return f"{self.root}/{quote(self.site, safe='')}/{quote(self.robot, safe='')}"

    @property
    def availability(self) -> str:
        """Whether the arm's monitor is heard."""
        return f"{self.base}/availability"

    @property
    def state(self) -> str:
        """The arm at a glance."""
        return f"{self.base}/state"

    @property
    def alerts(self) -> str:
        """Its active alerts."""
        return f"{self.base}/alerts"

    def joint(self, joint: int) -> str:
        """One joint."""
        return f"{self.base}/joint/{joint}"

    @property
    def acknowledge(self) -> str:
        """Where a client acknowledges."""
        return f"{self.base}/cmd/ack"

    @property
    def identity(self) -> str:
        """The arm's name in Home Assistant; no two arms, and no two roots, share one."""
        return _SEPARATOR.join(_escaped(name) for name in (self.root, self.site, self.robot))

    def discovery(self, prefix: str) -> str:
        """Where Home Assistant expects the arm's device discovery."""
        return f"{prefix}/device/{self.identity}/config"


def gateway(root: str) -> str:
    """Whether the gateway is connected."""
    return f"{root}/{GATEWAY}"


def named(root: str, topic: str) -> ArmTopics | None:
    """The arm of a topic below the root; None where it is of none."""
    if not topic.startswith(f"{root}/"):
        return None
    levels = topic.removeprefix(f"{root}/").split("/")
    if len(levels) < 3 or not levels[0] or not levels[1]:
        return None
    found = ArmTopics(root, unquote(levels[0]), unquote(levels[1]))
    return found if topic.startswith(f"{found.base}/") else None  # another way to write the same name is nobody's topic


def _escaped(name: str) -> str:
    """Letters, digits and `-` stay; `_` is doubled, any other byte is `_` and two hexadecimal digits. No two names become the same."""
    return "".join(
        "__" if character == "_" else character if character == "-" or (character.isascii() and character.isalnum()) else _bytes(character)
        for character in name
    )


def _bytes(character: str) -> str:
    return "".join(f"_{byte:02x}" for byte in character.encode("utf-8", "surrogatepass"))


# --- What is published of an arm: its retained messages by topic


def messages(arm: HeardArm, topics: ArmTopics, now_unix_s: float) -> dict[str, bytes]:
    """The retained messages of an arm, by topic; its availability is the last one, so that nobody believes old values."""
    silence = arm.silence(now_unix_s)
    alerts = [as_json(each) for each in arm.alerts]
    told = {topics.state: _json(_arm(arm, silence)), topics.alerts: _json({"alerts": alerts})}
    told |= {topics.joint(joint.joint): _json(_joint(joint)) for joint in arm.joints}
    return told | {topics.availability: (OFFLINE if silence else ONLINE).encode()}


def _arm(arm: HeardArm, silence: Silence | None) -> dict[str, Any]:
    health, shown, last = arm.health, arm.shown, arm.last_replay
    return {
        "site": arm.name.site,
        "robot": arm.name.robot,
        "model": arm.model,
        "serial": arm.serial,
        "state": shown.state,
        "why": shown.said.text,
        "since": written_if(None if health is None else health.since),
        "stale": arm.stale,
        "alerts": len(arm.alerts),
        "unacknowledged": len(unacknowledged(arm.alerts)),
        "last_replay": written_if(None if last is None else last.ended_at),
        "next_replay": written_if(None if health is None else health.next_replay_due),
        "troubles": list(arm.troubles),
        "silent_since": None if silence is None or silence.since_unix_s is None else rfc3339(silence.since_unix_s),
        "silent_why": None if silence is None else silence.why.text,
        "version": arm.version,
    }


def _joint(joint: HeardJoint) -> dict[str, Any]:
    said, of = joint.said, joint.friction
    life = None if of is None else of.remaining_life
    return {
        "joint": joint.joint,
        "state": joint.shown.state,
        "why": joint.shown.said.text,
        "since": written_if(None if said is None else said.since),
        "stale": said is not None and said.stale,
        "learnt_at": written_if(None if said is None else said.learnt_at),
        "measured_at": written_if(None if of is None else of.recorded_at),
        "wear_percent": _rounded(None if of is None else 100.0 * of.wear, 3),
        "wear_std_percent": _rounded(None if of is None else 100.0 * of.wear_std, 3),
        "temperature_c": _rounded(None if of is None else of.temperature_c, 2),
        "friction_nm": _rounded(None if of is None else of.reference_torque_nm, 3),
        "remaining_life_p10_days": _rounded(None if life is None else life.p10_days, 1),
        "remaining_life_p50_days": _rounded(None if life is None else life.p50_days, 1),
        "remaining_life_p90_days": _rounded(None if life is None else life.p90_days, 1),
        "trend_probability": _rounded(None if life is None else life.trend_probability, 4),
        "alerts": len(joint.alerts),
        "unacknowledged": len(unacknowledged(joint.alerts)),
    }


def _json(document: Mapping[str, Any]) -> bytes:
    return orjson.dumps(document)


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


# --- Home Assistant's device discovery of an arm: a device a robot, entities of the arm and of each joint

QOS = 1
DIAGNOSTIC = "diagnostic"

_ENUM: Mapping[str, Any] = {"device_class": "enum", "options": list(STATES)}
_PERCENT: Mapping[str, Any] = {"unit_of_measurement": "%", "state_class": "measurement", "suggested_display_precision": 1}
_CELSIUS: Mapping[str, Any] = {
    "device_class": "temperature",
    "unit_of_measurement": "°C",
    "state_class": "measurement",
    "suggested_display_precision": 1,
}
_DAYS: Mapping[str, Any] = {
    "device_class": "duration",
    "unit_of_measurement": "d",
    "state_class": "measurement",
    "suggested_display_precision": 0,
}
_COUNT: Mapping[str, Any] = {"state_class": "measurement"}
_TIME: Mapping[str, Any] = {"device_class": "timestamp", "entity_category": DIAGNOSTIC}
_RARE: Mapping[str, Any] = {"enabled_by_default": False}

# key of the message, name, icon, and what Home Assistant is told of it
_OF_ARM: tuple[tuple[str, str, str, Mapping[str, Any]], ...] = (
    ("state", "Health", "mdi:robot-industrial", _ENUM),
    ("alerts", "Active alerts", "mdi:alert", _COUNT),
    ("unacknowledged", "Alerts to acknowledge", "mdi:alert-circle", _COUNT),
    ("last_replay", "Last replay", "mdi:history", _TIME),
    ("next_replay", "Next replay", "mdi:calendar-clock", _TIME),
)
_OF_JOINT: tuple[tuple[str, str, str, Mapping[str, Any]], ...] = (
    ("state", "health", "mdi:rotate-360", _ENUM),
    ("wear_percent", "wear", "mdi:chart-line", _PERCENT),
    ("wear_std_percent", "wear, standard deviation", "mdi:chart-bell-curve", {**_PERCENT, "entity_category": DIAGNOSTIC, **_RARE}),
    ("temperature_c", "temperature", "mdi:thermometer", _CELSIUS),
    ("remaining_life_p50_days", "remaining life", "mdi:timer-sand", _DAYS),
    ("remaining_life_p10_days", "remaining life, P10", "mdi:timer-sand", {**_DAYS, **_RARE}),
    ("remaining_life_p90_days", "remaining life, P90", "mdi:timer-sand", {**_DAYS, **_RARE}),
)


def discovery(arm: HeardArm, topics: ArmTopics, *, acknowledge: bool) -> bytes:
    """The discovery message of an arm.

    acknowledge : whether buttons are offered that acknowledge the alerts of the arm, and of each joint; where they are not, those that an
    earlier message offered are taken back.
    """
    components: dict[str, Any] = {}
    for key, name, icon, about in _OF_ARM:
        components[key] = _sensor(topics, key, key, name, icon, topics.state, about)
    for joint in arm.joints:
        for key, name, icon, about in _OF_JOINT:
            own = f"j{joint.joint}_{key}"
            components[own] = _sensor(topics, own, key, f"J{joint.joint} {name}", icon, topics.joint(joint.joint), about)
    buttons: list[tuple[str, str, int | None]] = [("acknowledge", "Acknowledge alerts of the arm", None)]
    buttons += [(f"j{each.joint}_acknowledge", f"J{each.joint} acknowledge alerts", each.joint) for each in arm.joints]
    for own, name, number in buttons:
        components[own] = _button(topics, own, name, number) if acknowledge else {"platform": "button"}
    return orjson.dumps(
        {
            "device": _device(arm, topics),
            "origin": {"name": "joint-monitor", "sw_version": __version__},
            "components": components,
            "availability": [{"topic": gateway(topics.root)}, {"topic": topics.availability}],
            "availability_mode": "all",
            "qos": QOS,
        }
    )


def _device(arm: HeardArm, topics: ArmTopics) -> dict[str, Any]:
    known = {
        "model": arm.model,
        "serial_number": arm.serial,
        "sw_version": arm.firmware,
        "suggested_area": arm.name.site,
    }
    return {
        "identifiers": [topics.identity],
        "name": " ".join(arm.name),
        "manufacturer": MANUFACTURER,
        **{key: value for key, value in known.items() if value},
    }


def _sensor(topics: ArmTopics, own: str, key: str, name: str, icon: str, topic: str, about: Mapping[str, Any]) -> dict[str, Any]:
    sensor = {
        "platform": "sensor",
        "unique_id": f"{topics.identity}_-{own}",
        "name": name,
        "icon": icon,
        "state_topic": topic,
        "value_template": f"{{{{ value_json.{key} }}}}",
        **about,
    }
    if key == "state":
        sensor["json_attributes_topic"] = topic  # the rest of the message stands beside the state
    return sensor


def _button(topics: ArmTopics, own: str, name: str, joint: int | None) -> dict[str, Any]:
    return {
        "platform": "button",
        "unique_id": f"{topics.identity}_-{own}",
        "name": name,
        "icon": "mdi:check",
        "command_topic": topics.acknowledge,
        "payload_press": orjson.dumps({"joint": joint, "by": "Home Assistant"}).decode(),
        "retain": False,
    }
