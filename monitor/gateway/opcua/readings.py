"""What the variables of an arm say: value, status and source time of each. No I/O, no clock.

A silent arm keeps its last values as `Uncertain…`, and after a while they are `Bad…`. A figure that is not there is `BadNoData`, one that
nobody has measured yet `BadWaitingForInitialData`.
"""

from typing import NamedTuple

from monitor.gateway.figures import ArmFigures, JointFigures, unacknowledged
from monitor.gateway.opcua.nodes import LATER, axis_id, controller_id, device_id, motion_profile

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


def readings(arm: ArmFigures, now_unix_s: float, bad_after_s: float) -> dict[str, Reading]:
    """By the id of the variable; those that never change are not in it."""
    device, controller = device_id(arm.site, arm.robot), controller_id(arm.site, arm.robot)
    silence = arm.silence(now_unix_s)
    quality = GOOD if silence is None else LOST if silence[0] is None or now_unix_s - silence[0] > bad_after_s else SILENT
    own = OLD if quality == GOOD and arm.stale else quality
    at = arm.said_unix_s
    values = f"{device}/ParameterSet"
    found = {
        f"{device}/DeviceHealth": _reading(None if arm.state is None else NE107[arm.state], own, at),
        f"{values}/StateText": _reading(arm.why if silence is None else silence[1], GOOD if silence else own, at),
        f"{values}/ActiveAlerts": _reading(None if at is None else len(arm.alerts), quality, at),
        f"{values}/UnacknowledgedAlerts": _reading(None if at is None else len(unacknowledged(arm.alerts)), quality, at),
        f"{values}/LastReplay": _reading(arm.last_replay_unix_s, quality, at),
        f"{values}/NextReplay": _reading(arm.next_replay_unix_s, quality, at),
    }
    # what the arm is does not age
    found |= {f"{device}{folder}/Model": _reading(arm.model, GOOD, None) for folder in ("", "/Identification")}
    found |= {f"{device}{folder}/SerialNumber": _reading(arm.serial, GOOD, None) for folder in ("", "/Identification")}
    found[f"{device}/Identification/SoftwareRevision"] = _reading(arm.firmware, GOOD, None)
    found[f"{controller}/Software/PolyScope/SoftwareRevision"] = _reading(arm.firmware, GOOD, None)
    for joint in arm.joints:
        found[f"{axis_id(arm.site, arm.robot, joint.joint)}/MotionProfile"] = _reading(motion_profile(arm.model, joint.joint), GOOD, None)
        found |= _of_joint(joint, axis_id(arm.site, arm.robot, joint.joint), quality, at)
        motor = f"{device}/P{joint.joint}/Motor/ParameterSet/MotorTemperature"
        found[motor] = found[f"{axis_id(arm.site, arm.robot, joint.joint)}/ParameterSet/JointTemperature"]
    return found


def _of_joint(joint: JointFigures, axis: str, quality: str, said_unix_s: float | None) -> dict[str, Reading]:
    own = OLD if quality == GOOD and joint.stale else quality
    at = joint.measured_unix_s
    p10, p50, p90 = joint.life_days
    figures = {
        "Wear": None if joint.wear is None else 100.0 * joint.wear,
        "WearStandardDeviation": None if joint.wear_std is None else 100.0 * joint.wear_std,
        "RemainingLifeP10": p10,
        "RemainingLifeP50": p50,
        "RemainingLifeP90": p90,
        "JointTemperature": joint.temperature_c,
        "FrictionTorque": joint.friction_nm,
    }
    missing = NONE if joint.judged else LATER
    found = {f"{axis}/ParameterSet/{name}": _reading(value, own, at, missing) for name, value in figures.items()}
    alerts = None if said_unix_s is None else len(joint.alerts)
    return found | {
        f"{axis}/DeviceHealth": _reading(None if joint.state is None else NE107[joint.state], own, said_unix_s),
        f"{axis}/ParameterSet/StateText": _reading(joint.why, own, said_unix_s),
        f"{axis}/ParameterSet/LastLearnt": _reading(joint.learnt_unix_s, quality, said_unix_s),
        f"{axis}/ParameterSet/ActiveAlerts": _reading(alerts, quality, said_unix_s),
        f"{axis}/ParameterSet/UnacknowledgedAlerts": _reading(
            None if alerts is None else len(unacknowledged(joint.alerts)), quality, said_unix_s
        ),
    }


def _reading(value: object, quality: str, at_unix_s: float | None, missing: str = LATER) -> Reading:
    if value is None:
        return Reading(None, missing if quality != LOST else LOST, at_unix_s)
    return Reading(None if quality == LOST else value, quality, at_unix_s)
