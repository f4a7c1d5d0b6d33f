"""What Home Assistant's documentation asks of a device discovery message, as a judge that knows nothing of this project.

Sources: home-assistant.io/integrations/mqtt (discovery, device discovery, origin, availability), …/sensor.mqtt, …/button.mqtt, and
developers.home-assistant.io/docs/core/entity/sensor (device classes, their units and state classes).
"""

import json
import re

STATE_CLASSES = {"measurement", "measurement_angle", "total", "total_increasing"}
ANY = STATE_CLASSES - {"measurement_angle"}
MEASUREMENT, TOTALS = {"measurement"}, {"total", "total_increasing"}
# device class: its units, and the state classes that go with it
SENSORS = {
    "apparent_power": ({"VA"}, MEASUREMENT),
    "aqi": ({None}, MEASUREMENT),
    "area": ({"m²", "cm²", "km²", "mm²", "in²", "ft²", "yd²", "mi²", "ac", "ha"}, ANY),
    "atmospheric_pressure": ({"cbar", "bar", "hPa", "mmHg", "inHg", "kPa", "mbar", "Pa", "psi"}, MEASUREMENT),
    "battery": ({"%"}, MEASUREMENT),
    "carbon_dioxide": ({"ppm"}, MEASUREMENT),
    "current": ({"A", "mA"}, MEASUREMENT),
    "data_rate": ({"bit/s", "kbit/s", "Mbit/s", "Gbit/s", "B/s", "kB/s", "MB/s", "GB/s", "KiB/s", "MiB/s", "GiB/s"}, MEASUREMENT),
    "date": ({None}, set()),
    "distance": ({"km", "m", "cm", "mm", "mi", "nmi", "yd", "in"}, ANY),
    "duration": ({"d", "h", "min", "s", "ms"}, ANY),
    "energy": ({"J", "kJ", "MJ", "GJ", "mWh", "Wh", "kWh", "MWh", "GWh", "TWh", "cal", "kcal", "Mcal", "Gcal"}, TOTALS),
    "enum": ({None}, set()),
    "frequency": ({"Hz", "kHz", "MHz", "GHz"}, MEASUREMENT),
    "humidity": ({"%"}, MEASUREMENT),
    "irradiance": ({"W/m²", "BTU/(h⋅ft²)"}, MEASUREMENT),
    "moisture": ({"%"}, MEASUREMENT),
    "power": ({"W", "kW", "MW", "GW", "TW"}, MEASUREMENT),
    "power_factor": ({"%", None}, MEASUREMENT),
    "pressure": ({"cbar", "bar", "hPa", "mmHg", "inHg", "kPa", "mbar", "Pa", "psi"}, MEASUREMENT),
    "speed": ({"ft/s", "in/d", "in/h", "in/s", "km/h", "kn", "m/s", "mph", "mm/d", "mm/s"}, MEASUREMENT),
    "temperature": ({"°C", "°F", "K"}, MEASUREMENT),
    "timestamp": ({None}, set()),
    "voltage": ({"V", "mV"}, MEASUREMENT),
    "weight": ({"kg", "g", "mg", "µg", "oz", "lb", "st"}, ANY),
}
BUTTONS = {None, "identify", "restart", "update"}
PLATFORMS = {"sensor", "binary_sensor", "button", "number", "select", "switch", "event", "text", "update"}
COMMON = {
    *("platform", "unique_id", "name", "icon", "availability", "availability_mode", "availability_topic", "enabled_by_default"),
    *("entity_category", "entity_picture", "json_attributes_topic", "json_attributes_template", "qos", "encoding", "default_entity_id"),
    *("payload_available", "payload_not_available", "device_class"),
}
KNOWN = {
    "sensor": COMMON
    | {"expire_after", "force_update", "last_reset_value_template", "options", "state_class", "state_topic", "suggested_display_precision"}
    | {"unit_of_measurement", "value_template"},
    "button": COMMON | {"command_template", "command_topic", "payload_press", "retain"},
}
DEVICE = {"configuration_url", "connections", "hw_version", "identifiers", "manufacturer", "model", "model_id", "name", "serial_number"}
DEVICE |= {"suggested_area", "sw_version", "via_device"}
ABOVE = {"device", "origin", "components", "availability", "availability_mode", "state_topic", "command_topic", "qos", "encoding"}


def discovered(prefix, topic):
    """The object id of a device discovery topic; None where it is none."""
    found = re.fullmatch(rf"{re.escape(prefix)}/device/(?:[a-zA-Z0-9_-]+/)?([a-zA-Z0-9_-]+)/config", topic)
    return found and found[1]


def mistakes(payload):
    """What Home Assistant would refuse, or complain of, in a device discovery message."""
    message = json.loads(payload)
    wrong = [f"{key}: unknown" for key in message.keys() - ABOVE]
    device, origin, components = (message.get(key) for key in ("device", "origin", "components"))
    if not device or not (device.get("identifiers") or device.get("connections")):
        wrong.append("device: without identifiers or connections")
    wrong += [f"device.{key}: unknown" for key in (device or {}).keys() - DEVICE]
    wrong += [f"device.{key}: no text" for key, value in (device or {}).items() if key != "identifiers" and not isinstance(value, str)]
    if not origin or not isinstance(origin.get("name"), str) or origin.keys() - {"name", "sw_version", "support_url"}:
        wrong.append("origin: needs a name, and may have sw_version and support_url")
    if not components:
        return [*wrong, "components: none"]
    wrong += _availability(message)
    live = {own: about for own, about in components.items() if about.keys() != {"platform"}}  # a platform alone takes an entity back
    ids = [about.get("unique_id") for about in live.values()]
    if None in ids or len(set(ids)) != len(ids):
        wrong.append("components: each needs a unique_id of its own")
    for own, about in components.items():
        wrong += [f"{own}: {each}" for each in _component(about, live=own in live)]
    return wrong


def _availability(about):
    wrong = []
    if about.get("availability_mode", "latest") not in {"all", "any", "latest"}:
        wrong.append("availability_mode: expected all, any or latest")
    if "availability" in about and "availability_topic" in about:
        wrong.append("availability and availability_topic exclude each other")
    return wrong + [f"availability: {each}" for each in about.get("availability", []) if not _topic(each.get("topic"))]


def _topic(topic):
    return isinstance(topic, str) and 0 < len(topic.encode()) < 65536 and not set(topic) & {"+", "#", "\0"}


def _component(about, *, live):
    platform = about.get("platform")
    if platform not in PLATFORMS:
        return [f"platform {platform!r}: unknown"]
    if not live:
        return []
    wrong = [f"{key}: unknown" for key in about.keys() - KNOWN[platform]]
    if about.get("entity_category") not in {None, "diagnostic", *({"config"} if platform != "sensor" else ())}:
        wrong.append(f"entity_category {about['entity_category']!r}: not for a {platform}")
    wrong += [f"{key} {about[key]!r}: no topic" for key in about if key.endswith("_topic") and not _topic(about[key])]
    if not re.fullmatch(r"mdi:[a-z0-9-]+", about.get("icon", "mdi:ok")):
        wrong.append(f"icon {about['icon']!r}: expected mdi:…")
    return wrong + (_sensor(about) if platform == "sensor" else _button(about))


def _sensor(about):
    wrong = [] if "state_topic" in about else ["without state_topic"]
    kind, unit, state = (about.get(key) for key in ("device_class", "unit_of_measurement", "state_class"))
    if state not in {None, *STATE_CLASSES}:
        wrong.append(f"state_class {state!r}: unknown")
    if kind is not None and kind not in SENSORS:
        return [*wrong, f"device_class {kind!r}: unknown"]
    if ("options" in about) != (kind == "enum"):
        wrong.append("options belong to the device class enum, and it needs them")
    if kind == "enum" and (state or unit):
        wrong.append("an enum has neither state_class nor unit")
    if kind is not None:
        units, states = SENSORS[kind]
        if unit not in units:
            wrong.append(f"unit {unit!r} is none of {kind}")
        if state is not None and state not in states:
            wrong.append(f"state_class {state!r} does not go with {kind}")
    if "suggested_display_precision" in about and kind in {"enum", "date", "timestamp"}:
        wrong.append("suggested_display_precision: only for numbers")
    return wrong


def _button(about):
    wrong = [] if "command_topic" in about else ["without command_topic"]
    return wrong + ([] if about.get("device_class") in BUTTONS else [f"device_class {about['device_class']!r}: none of a button"])


def shown(about, message):
    """The state that Home Assistant shows for a sensor after a message: its template is `{{ value_json.KEY }}`."""
    key = re.fullmatch(r"\{\{ value_json\.(\w+) \}\}", about["value_template"])[1]
    value = json.loads(message)[key]
    return "unknown" if value is None else value
