"""Home Assistant's device discovery of an arm: a device a robot, entities of the arm and of each joint. No I/O, no clock.

The conventions are those of https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery: one message a device, with `origin`, and every
entity with a `unique_id`. A value of null renders as `None`, by which Home Assistant shows the entity as unknown.
"""

from collections.abc import Mapping
from typing import Any

import orjson

from monitor import __version__
from monitor.gateway.figures import MANUFACTURER, ArmFigures
from monitor.gateway.mqtt.topics import ArmTopics, gateway
from monitor.judge.alerts.health import STATES

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


def discovery(arm: ArmFigures, topics: ArmTopics, *, acknowledge: bool) -> bytes:
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


def _device(arm: ArmFigures, topics: ArmTopics) -> dict[str, Any]:
    known = {
        "model": arm.model,
        "serial_number": arm.serial,
        "sw_version": arm.firmware,
        "suggested_area": arm.site,
    }
    return {
        "identifiers": [topics.identity],
        "name": f"{arm.site} {arm.robot}",
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
