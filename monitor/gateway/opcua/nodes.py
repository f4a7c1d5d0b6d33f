"""The nodes of an arm by OPC 40010-1, DI and Machinery, with the condition of each joint, and what they say. No I/O, no clock.

An id is `s=KIND/SITE/ROBOT/…` in our own namespace, so it stays the same over restarts. Type numbers are those of the nodesets. Mandatory
members that nobody here knows exist, and say `BadNotSupported`.
"""

from collections.abc import Iterator
from datetime import datetime
from typing import NamedTuple
from urllib.parse import quote

from monitor.plant.arm import MANUFACTURER, HeardArm, HeardJoint
from monitor.publish.shown import Age, unacknowledged

UA, DI, MACHINERY, ROBOTICS = "", "DI/", "Machinery/", "Robotics/"  # after http://opcfoundation.org/UA/
OWN = "urn:joint-monitor:friction-health"


class Ref(NamedTuple):
    """A node of a nodeset."""

    namespace: str
    number: int


class Data(NamedTuple):
    """The type of a variable's value: its data type, and OPC UA's built-in type that carries it."""

    type: Ref
    built_in: str


class Unit(NamedTuple):
    """A unit of UNECE recommendation 20."""

    code: str
    symbol: str
    name: str

    @property
    def number(self) -> int:
        """OPC 10000-8, 5.6.3.4: the characters of the code as a number."""
        return int.from_bytes(self.code.encode(), "big")


class Node(NamedTuple):
    """One node of an arm or of a site."""

    id: str
    parent: str | Ref
    reference: Ref
    namespace: str  # of its name
    name: str
    type: Ref
    data: Data | None = None  # None: an object
    value: object = None
    status: str = "Good"
    links: tuple[tuple[Ref, str | Ref], ...] = ()  # further references: kind, and where to
    organized_by: Ref | None = None  # a folder of a nodeset that also lists it
    unit: Unit | None = None


HAS_COMPONENT, HAS_PROPERTY, ORGANIZES, HAS_ADD_IN, HAS_INTERFACE = (Ref(UA, number) for number in (47, 46, 35, 17604, 17603))
CONTROLS, MOVES, HAS_SAFETY_STATES = Ref(ROBOTICS, 4002), Ref(ROBOTICS, 18178), Ref(ROBOTICS, 18182)

OBJECT, FOLDER, PROPERTY, VARIABLE, ANALOG = (Ref(UA, number) for number in (58, 61, 68, 63, 17497))
SYSTEM, DEVICE, AXIS, POWER_TRAIN, MOTOR = (Ref(ROBOTICS, number) for number in (1002, 1004, 16601, 16794, 1019))
CONTROLLER, SAFETY_STATE, TASK_CONTROL, USER = (Ref(ROBOTICS, number) for number in (1003, 1013, 1011, 18175))
SOFTWARE, GROUP, HEALTH_INTERFACE = Ref(DI, 15106), Ref(DI, 1005), Ref(DI, 15051)
IDENTIFICATION = Ref(MACHINERY, 1012)
DEVICE_SET, MACHINES = Ref(DI, 5001), Ref(MACHINERY, 1001)

TEXT, STRING, DOUBLE = Data(Ref(UA, 21), "LocalizedText"), Data(Ref(UA, 12), "String"), Data(Ref(UA, 11), "Double")
BOOLEAN, COUNT, TIME = Data(Ref(UA, 1), "Boolean"), Data(Ref(UA, 5), "UInt16"), Data(Ref(UA, 13), "DateTime")
UNIT = Data(Ref(UA, 887), "EUInformation")
HEALTH, CATEGORY = Data(Ref(DI, 6244), "Int32"), Data(Ref(ROBOTICS, 18193), "Int32")
PROFILE, MODE = Data(Ref(ROBOTICS, 3008), "Int32"), Data(Ref(ROBOTICS, 3006), "Int32")

PERCENT, DAY, CELSIUS = Unit("P1", "%", "percent"), Unit("DAY", "d", "day"), Unit("CEL", "°C", "degree Celsius")
NEWTON_METRE, RADIAN = Unit("NU", "N·m", "newton metre"), Unit("C81", "rad", "radian")

ARTICULATED_ROBOT = 1
ROTARY, ROTARY_ENDLESS = 1, 2
UNKNOWN, LATER = "BadNotSupported", "BadWaitingForInitialData"

CONDITION: tuple[tuple[str, Data, Unit | None], ...] = (  # of each joint
    ("Wear", DOUBLE, PERCENT),
    ("WearStandardDeviation", DOUBLE, PERCENT),
    ("RemainingLifeP10", DOUBLE, DAY),
    ("RemainingLifeP50", DOUBLE, DAY),
    ("RemainingLifeP90", DOUBLE, DAY),
    ("JointTemperature", DOUBLE, CELSIUS),
    ("FrictionTorque", DOUBLE, NEWTON_METRE),
    ("StateText", STRING, None),
    ("LastLearnt", TIME, None),
    ("ActiveAlerts", COUNT, None),
    ("UnacknowledgedAlerts", COUNT, None),
)
OF_ARM: tuple[tuple[str, Data], ...] = (
    ("StateText", STRING),
    ("ActiveAlerts", COUNT),
    ("UnacknowledgedAlerts", COUNT),
    ("LastReplay", TIME),
    ("NextReplay", TIME),
)


def system_id(site: str) -> str:
    """Of a site's motion device system."""
    return f"system/{quote(site, safe='')}"


def device_id(site: str, robot: str) -> str:
    """Of an arm."""
    return f"device/{quote(site, safe='')}/{quote(robot, safe='')}"


def controller_id(site: str, robot: str) -> str:
    """Of an arm's controller."""
    return f"controller/{quote(site, safe='')}/{quote(robot, safe='')}"


def axis_id(site: str, robot: str, joint: int) -> str:
    """Of a joint."""
    return f"{device_id(site, robot)}/J{joint}"


def motion_profile(model: str | None, joint: int) -> int | None:
    """How a joint turns: within limits, except the last one of the smallest arms. None: the model is not known."""
    if model is None:
        return None
    return ROTARY_ENDLESS if model.lower().startswith("ur3") and not model.lower().startswith("ur30") and joint == 6 else ROTARY


def site_nodes(site: str) -> Iterator[Node]:
    """The motion device system of a site, without its arms."""
    system = system_id(site)
    yield Node(system, DEVICE_SET, HAS_COMPONENT, OWN, site, SYSTEM)
    for name in ("MotionDevices", "Controllers", "SafetyStates"):
        yield Node(f"{system}/{name}", system, HAS_COMPONENT, ROBOTICS, name, FOLDER)
    safety = f"{system}/SafetyStates/SafetyState"
    yield Node(safety, f"{system}/SafetyStates", HAS_COMPONENT, OWN, "SafetyState", SAFETY_STATE)
    yield _object(safety, "ParameterSet", DI)
    for name, data in (("OperationalMode", MODE), ("EmergencyStop", BOOLEAN), ("ProtectiveStop", BOOLEAN)):
        yield _variable(f"{safety}/ParameterSet", name, data, ROBOTICS, status=UNKNOWN)


def arm_nodes(arm: HeardArm) -> Iterator[Node]:
    """The arm as a motion device, each joint as an axis with its power train, and the arm's controller. Parents come first."""
    system, device = system_id(arm.name.site), device_id(*arm.name)
    yield Node(
        *(device, f"{system}/MotionDevices", HAS_COMPONENT, OWN, arm.name.robot, DEVICE),
        links=((HAS_INTERFACE, HEALTH_INTERFACE),),
        organized_by=MACHINES,
    )
    yield from _nameplate(device)
    yield _property(device, "MotionDeviceCategory", CATEGORY, ROBOTICS, value=ARTICULATED_ROBOT)
    yield _variable(device, "DeviceHealth", HEALTH, DI)
    yield _object(device, "ParameterSet", DI)
    yield _variable(f"{device}/ParameterSet", "SpeedOverride", DOUBLE, ROBOTICS, status=UNKNOWN)
    diagnostics = f"{device}/Diagnostics"
    shown = [f"{device}/DeviceHealth", *(f"{device}/ParameterSet/{name}" for name, _ in OF_ARM)]
    yield Node(diagnostics, device, HAS_COMPONENT, DI, "Diagnostics", GROUP, links=_organized(shown))
    for name, data in OF_ARM:
        yield _variable(f"{device}/ParameterSet", name, data, OWN)
    yield from _identification(device)
    for name in ("Axes", "PowerTrains"):
        yield Node(f"{device}/{name}", device, HAS_COMPONENT, ROBOTICS, name, FOLDER)
    for joint in arm.joints:
        yield from _axis(device, joint.joint)
        yield from _power_train(device, joint.joint)
    yield from _controller(arm)


def _identification(device: str) -> Iterator[Node]:
    """Machinery's identification of a machine."""
    about = f"{device}/Identification"
    yield Node(about, device, HAS_ADD_IN, DI, "Identification", IDENTIFICATION)
    yield _property(about, "Manufacturer", TEXT, DI, value=MANUFACTURER)
    yield _property(about, "Model", TEXT, DI)
    yield _property(about, "SerialNumber", STRING, DI)
    yield _property(about, "ProductInstanceUri", STRING, DI, status=UNKNOWN)
    yield _property(about, "SoftwareRevision", STRING, DI)


def _axis(device: str, joint: int) -> Iterator[Node]:
    axis = f"{device}/J{joint}"
    yield Node(axis, f"{device}/Axes", HAS_COMPONENT, OWN, f"J{joint}", AXIS, links=((HAS_INTERFACE, HEALTH_INTERFACE),))
    yield _property(axis, "MotionProfile", PROFILE, ROBOTICS)
    yield _variable(axis, "DeviceHealth", HEALTH, DI)
    values = f"{axis}/ParameterSet"
    yield _object(axis, "ParameterSet", DI)
    yield from _analog(values, "ActualPosition", RADIAN, ROBOTICS, status=UNKNOWN)
    for name, data, unit in CONDITION:
        if unit is None:
            yield _variable(values, name, data, OWN)
        else:
            yield from _analog(values, name, unit, OWN)
    shown = [f"{axis}/DeviceHealth", *(f"{values}/{name}" for name, _, _ in CONDITION)]
    yield Node(f"{axis}/Diagnostics", axis, HAS_COMPONENT, DI, "Diagnostics", GROUP, links=_organized(shown))


def _power_train(device: str, joint: int) -> Iterator[Node]:
    train = f"{device}/P{joint}"
    moves = ((MOVES, f"{device}/J{joint}"),)
    yield Node(train, f"{device}/PowerTrains", HAS_COMPONENT, OWN, f"P{joint}", POWER_TRAIN, links=moves)
    motor = f"{train}/Motor"
    yield Node(motor, train, HAS_COMPONENT, OWN, "Motor", MOTOR)
    yield _property(motor, "Manufacturer", TEXT, DI, status=UNKNOWN)
    yield _property(motor, "Model", TEXT, DI, status=UNKNOWN)
    yield _property(motor, "ProductCode", STRING, DI, status=UNKNOWN)
    yield _property(motor, "SerialNumber", STRING, DI, status=UNKNOWN)
    yield _object(motor, "ParameterSet", DI)
    yield from _analog(f"{motor}/ParameterSet", "MotorTemperature", CELSIUS, ROBOTICS)


def _controller(arm: HeardArm) -> Iterator[Node]:
    system, controller = system_id(arm.name.site), controller_id(*arm.name)
    links = ((CONTROLS, device_id(*arm.name)), (HAS_SAFETY_STATES, f"{system}/SafetyStates/SafetyState"))
    yield Node(controller, f"{system}/Controllers", HAS_COMPONENT, OWN, arm.name.robot, CONTROLLER, links=links)
    yield _property(controller, "Manufacturer", TEXT, DI, value=MANUFACTURER)
    yield _property(controller, "Model", TEXT, DI, status=UNKNOWN)
    yield _property(controller, "ProductCode", STRING, DI, status=UNKNOWN)
    yield _property(controller, "SerialNumber", STRING, DI, status=UNKNOWN)
    user = f"{controller}/CurrentUser"
    yield Node(user, controller, HAS_COMPONENT, ROBOTICS, "CurrentUser", USER)
    yield _property(user, "Level", STRING, ROBOTICS, status=UNKNOWN)
    for name in ("Software", "TaskControls"):
        yield Node(f"{controller}/{name}", controller, HAS_COMPONENT, ROBOTICS, name, FOLDER)
    software = f"{controller}/Software/PolyScope"
    yield Node(software, f"{controller}/Software", HAS_COMPONENT, OWN, "PolyScope", SOFTWARE)
    yield _property(software, "Manufacturer", TEXT, DI, value=MANUFACTURER)
    yield _property(software, "Model", TEXT, DI, value="PolyScope")
    yield _property(software, "SoftwareRevision", STRING, DI)
    task = f"{controller}/TaskControls/TaskControl"
    yield Node(task, f"{controller}/TaskControls", HAS_COMPONENT, OWN, "TaskControl", TASK_CONTROL)
    yield _property(task, "ComponentName", TEXT, DI, status=UNKNOWN)
    yield _object(task, "ParameterSet", DI)
    yield _variable(f"{task}/ParameterSet", "TaskProgramName", STRING, ROBOTICS, status=UNKNOWN)
    yield _variable(f"{task}/ParameterSet", "TaskProgramLoaded", BOOLEAN, ROBOTICS, status=UNKNOWN)


def _nameplate(device: str) -> Iterator[Node]:
    yield _property(device, "Manufacturer", TEXT, DI, value=MANUFACTURER)
    yield _property(device, "Model", TEXT, DI)
    yield _property(device, "ProductCode", STRING, DI, status=UNKNOWN)
    yield _property(device, "SerialNumber", STRING, DI)


def _object(parent: str, name: str, namespace: str) -> Node:
    return Node(f"{parent}/{name}", parent, HAS_COMPONENT, namespace, name, OBJECT)


def _property(parent: str, name: str, data: Data, namespace: str, *, value: object = None, status: str = "") -> Node:
    known = status or ("Good" if value is not None else LATER)
    return Node(f"{parent}/{name}", parent, HAS_PROPERTY, namespace, name, PROPERTY, data, value, known)


def _variable(parent: str, name: str, data: Data, namespace: str, *, status: str = LATER) -> Node:
    return Node(f"{parent}/{name}", parent, HAS_COMPONENT, namespace, name, VARIABLE, data, None, status)


def _analog(parent: str, name: str, unit: Unit, namespace: str, *, status: str = LATER) -> Iterator[Node]:
    own = f"{parent}/{name}"
    yield Node(own, parent, HAS_COMPONENT, namespace, name, ANALOG, DOUBLE, None, status)
    yield Node(f"{own}/EngineeringUnits", own, HAS_PROPERTY, UA, "EngineeringUnits", PROPERTY, UNIT, unit=unit)


def _organized(ids: list[str]) -> tuple[tuple[Ref, str | Ref], ...]:
    return tuple((ORGANIZES, each) for each in ids)


# --- What the variables of an arm say: value, status and source time of each

NE107 = {
    "NORMAL": 0,
    "FAILURE": 1,
    "CHECK_FUNCTION": 2,
    "OFF_SPEC": 3,
    "MAINTENANCE_REQUIRED": 4,
}  # DeviceHealthEnumeration of OPC 10000-100
GOOD, OLD = "Good", "UncertainLastUsableValue"
SILENT, LOST = "UncertainNoCommunicationLastUsableValue", "BadNoCommunication"
NONE = "BadNoData"


class Reading(NamedTuple):
    """One value."""

    value: object  # None where the status is bad
    status: str
    at_unix_s: float | None  # of the source; None: not known


def readings(arm: HeardArm, now_unix_s: float, bad_after_s: float) -> dict[str, Reading]:
    """By the id of the variable; those that never change are not in it."""
    device, controller = device_id(*arm.name), controller_id(*arm.name)
    silence, health, shown = arm.silence(now_unix_s), arm.health, arm.shown
    quality = GOOD
    if silence is not None:
        quality = LOST if silence.since_unix_s is None or now_unix_s - silence.since_unix_s > bad_after_s else SILENT
    own = OLD if quality == GOOD and shown.age is not Age.NOW else quality
    at = None if health is None else health.said_at.timestamp()
    values = f"{device}/ParameterSet"
    found = {
        f"{device}/DeviceHealth": _reading(None if shown.state is None else NE107[shown.state], own, at),
        f"{values}/StateText": _reading(shown.said.text if silence is None else silence.why.text, GOOD if silence else own, at),
        f"{values}/ActiveAlerts": _reading(None if at is None else len(arm.alerts), quality, at),
        f"{values}/UnacknowledgedAlerts": _reading(None if at is None else len(unacknowledged(arm.alerts)), quality, at),
        f"{values}/LastReplay": _reading(_unix_s(None if arm.last_replay is None else arm.last_replay.ended_at), quality, at),
        f"{values}/NextReplay": _reading(_unix_s(None if health is None else health.next_replay_due), quality, at),
    }
    # what the arm is does not age
    found |= {f"{device}{folder}/Model": _reading(arm.model, GOOD, None) for folder in ("", "/Identification")}
    found |= {f"{device}{folder}/SerialNumber": _reading(arm.serial, GOOD, None) for folder in ("", "/Identification")}
    found[f"{device}/Identification/SoftwareRevision"] = _reading(arm.firmware, GOOD, None)
    found[f"{controller}/Software/PolyScope/SoftwareRevision"] = _reading(arm.firmware, GOOD, None)
    for joint in arm.joints:
        axis = axis_id(*arm.name, joint.joint)
        found[f"{axis}/MotionProfile"] = _reading(motion_profile(arm.model, joint.joint), GOOD, None)
        found |= _of_joint(joint, axis, quality, at)
        found[f"{device}/P{joint.joint}/Motor/ParameterSet/MotorTemperature"] = found[f"{axis}/ParameterSet/JointTemperature"]
    return found


def _of_joint(joint: HeardJoint, axis: str, quality: str, said_unix_s: float | None) -> dict[str, Reading]:
    own = OLD if quality == GOOD and joint.said is not None and joint.said.stale else quality
    of, alerts = joint.friction, None if said_unix_s is None else joint.alerts
    figures: dict[str, float | None] = dict.fromkeys(name for name, _, unit in CONDITION if unit is not None)
    if of is not None:
        life = of.remaining_life
        figures = {
            "Wear": 100.0 * of.wear,
            "WearStandardDeviation": 100.0 * of.wear_std,
            "RemainingLifeP10": life.p10_days,
            "RemainingLifeP50": life.p50_days,
            "RemainingLifeP90": life.p90_days,
            "JointTemperature": of.temperature_c,
            "FrictionTorque": of.reference_torque_nm,
        }
    at, missing = None if of is None else of.recorded_at.timestamp(), LATER if of is None else NONE
    found = {f"{axis}/ParameterSet/{name}": _reading(value, own, at, missing) for name, value in figures.items()}
    learnt = None if joint.said is None else joint.said.learnt_at
    return found | {
        f"{axis}/DeviceHealth": _reading(None if joint.shown.state is None else NE107[joint.shown.state], own, said_unix_s),
        f"{axis}/ParameterSet/StateText": _reading(joint.shown.said.text, own, said_unix_s),
        f"{axis}/ParameterSet/LastLearnt": _reading(_unix_s(learnt), quality, said_unix_s),
        f"{axis}/ParameterSet/ActiveAlerts": _reading(None if alerts is None else len(alerts), quality, said_unix_s),
        f"{axis}/ParameterSet/UnacknowledgedAlerts": _reading(
            None if alerts is None else len(unacknowledged(alerts)), quality, said_unix_s
        ),
    }


def _unix_s(at: datetime | None) -> float | None:
    return None if at is None else at.timestamp()


def _reading(value: object, quality: str, at_unix_s: float | None, missing: str = LATER) -> Reading:
    if value is None:
        return Reading(None, missing if quality != LOST else LOST, at_unix_s)
    return Reading(None if quality == LOST else value, quality, at_unix_s)
