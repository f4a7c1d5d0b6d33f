"""Conditions on who the controller says it is."""

import numpy as np

from monitor.acquire.safety.inputs import CONTROLLER_UNKNOWN, ConditionInputs, Unreported
from monitor.acquire.safety.of_configuration import CHECK_RATE_HZ
from monitor.errors import MotionRefused
from monitor.reason import Reason, Sentence

ROUNDING_RAD = 1e-6  # [rad, rad/s] a trajectory may be designed up to the limit itself


SERVICES_CLOSED = Sentence("services_closed", "nobody answers at {closed}: switch it on in {switch}")
SERVICES_OPEN = Sentence("services_open", "{open} take connections")
SERVICES_NOT_ASKED = Sentence("services_not_asked", "a motion connects to each of them itself")


def services(inputs: ConditionInputs) -> Reason:
    """Every service of the controller that a motion needs takes a connection."""
    found = inputs.services
    if found is None:
        raise Unreported(SERVICES_NOT_ASKED())
    if not found.open:
        raise MotionRefused(inputs.unreachable or CONTROLLER_UNKNOWN())
    if found.closed:
        raise MotionRefused(SERVICES_CLOSED(closed=", ".join(found.closed), switch=found.switch))
    return SERVICES_OPEN(open=", ".join(found.open))


CONTEXT_OF_ANOTHER_ARM = Sentence("context_of_another_arm", "the context is of a {context_arm}, the arm is a {arm}")
MODEL_NOT_REPORTED = Sentence("model_not_reported", "not reported: this software does not tell its model; the configuration is believed")
ANOTHER_MODEL = Sentence("another_model", "the controller says it is a {model}, the configuration says {arm}")
ANOTHER_GENERATION = Sentence(
    "another_generation",
    "the controller says it is a {model} with software {firmware}, which is of the generation {generation}; the "
    "configuration says {arm}, of the generation {arm_generation}",
)
MODEL_AND_SOFTWARE = Sentence("model_and_software", "{model}, software {firmware}{sources}")


def robot_model(inputs: ConditionInputs) -> Reason:
    """The controller is of the configured model."""
    if inputs.identity is None and inputs.unreachable is not None:
        raise MotionRefused(inputs.unreachable)
    identity = inputs.controller
    if inputs.context.robot is not None and inputs.context.robot != inputs.robot.name:
        raise MotionRefused(CONTEXT_OF_ANOTHER_ARM(context_arm=inputs.context.robot, arm=inputs.robot.name))
    if identity.model is None:
        raise Unreported(MODEL_NOT_REPORTED())
    if identity.model.lower().removesuffix("e") != inputs.robot.name.lower().removesuffix("e"):
        raise MotionRefused(ANOTHER_MODEL(model=identity.model, arm=inputs.robot.name))
    generation = identity.generation
    if generation not in {None, inputs.robot.generation}:
        raise MotionRefused(
            ANOTHER_GENERATION(
                model=identity.model,
                firmware=identity.firmware,
                generation=generation,
                arm=inputs.robot.name,
                arm_generation=inputs.robot.generation,
            )
        )
    sources = f" ({identity.sources})" if identity.sources else ""
    return MODEL_AND_SOFTWARE(model=identity.model, firmware=identity.firmware or "not reported", sources=sources)


SOFTWARE_NOT_DRIVABLE = Sentence("software_not_drivable", "software {firmware}: {why}; expected {expected}")
SOFTWARE_TESTED = Sentence("software_tested", "{firmware}, among the tested {tested}; {library}")
SOFTWARE_UNTESTED_ALLOWED = Sentence(
    "software_untested_allowed", "{software}: untested, and replay.allow_untested_software is true; {library}"
)
SOFTWARE_UNTESTED = Sentence(
    "software_untested", "{software}; tested are {tested}; replay.allow_untested_software = true lets another one move the arm; {library}"
)
LIBRARY_TESTED = Sentence("library_tested", "driven by {library}, as tested")
LIBRARY_UNTESTED = Sentence("library_untested", "driven by {library}; tested is {tested}")


def software(inputs: ConditionInputs) -> Reason:
    """The controller's software is one that can be driven, and with which replays are tested."""
    identity = inputs.controller
    firmware, known = identity.firmware, identity.software
    if not known.drivable:
        raise MotionRefused(SOFTWARE_NOT_DRIVABLE(firmware=firmware, why=known.reason, expected=known.expected))
    used, tested = known.client_library, known.expected_client_library
    library = LIBRARY_TESTED(library=used) if used == tested else LIBRARY_UNTESTED(library=used, tested=tested)
    if known.tested:
        return SOFTWARE_TESTED(firmware=firmware, tested=known.expected, library=library)
    what = f"software {firmware}" if firmware else "the software's version is not reported"
    what += f" ({known.reason})" if known.reason else ""
    if inputs.settings.allow_untested_software:
        return SOFTWARE_UNTESTED_ALLOWED(software=what, library=library)
    raise MotionRefused(SOFTWARE_UNTESTED(software=what, tested=known.expected, library=library))


JOINT_LIMITS_NOT_REPORTED = Sentence(
    "joint_limits_not_reported", "not reported: a joint limit of the installation below the published one would show as a protective stop"
)
BEYOND_JOINT_LIMITS = Sentence(
    "beyond_joint_limits",
    "{joint:joint} moves from {least_rad:.2f} to {most_rad:.2f} rad; the installation allows {low_rad:.2f} to {high_rad:.2f}",
)
BEYOND_JOINT_SPEED = Sentence(
    "beyond_joint_speed", "{joint:joint} moves at {fastest_rad_s:.2f} rad/s; the controller's installation allows {limit_rad_s:.2f}"
)
WITHIN_JOINT_LIMITS = Sentence("within_joint_limits", "the trajectory is within those of the controller's installation")


def joint_limits(inputs: ConditionInputs) -> Reason:
    """The trajectory keeps the joint limits of the controller's installation, where it reports them."""
    limits, state = inputs.controller.joint_limits, inputs.state
    if limits is None:
        raise Unreported(JOINT_LIMITS_NOT_REPORTED())
    played = inputs.played
    curve = played.at(np.linspace(0.0, played.pass_s, max(2, round(played.pass_s * CHECK_RATE_HZ) + 1)))
    low, high, speed = (np.array(each) for each in limits)
    if state is not None:  # an endless joint that stands beyond its limits shows that they are not in force
        beyond = (inputs.robot.endless > 0.0) & ~((state.q >= low) & (state.q <= high))
        low, high = np.where(beyond, -np.inf, low), np.where(beyond, np.inf, high)
    for j in range(inputs.robot.joints):
        least, most, fastest = float(np.min(curve.q[:, j])), float(np.max(curve.q[:, j])), float(np.max(np.abs(curve.qd[:, j])))
        if not (least >= low[j] - ROUNDING_RAD and most <= high[j] + ROUNDING_RAD):
            raise MotionRefused(BEYOND_JOINT_LIMITS(joint=j + 1, least_rad=least, most_rad=most, low_rad=low[j], high_rad=high[j]))
        if not fastest <= speed[j] + ROUNDING_RAD:
            raise MotionRefused(BEYOND_JOINT_SPEED(joint=j + 1, fastest_rad_s=fastest, limit_rad_s=speed[j]))
    return WITHIN_JOINT_LIMITS()


SERIAL_NOT_REPORTED_AGAIN = Sentence("serial_not_reported_again", "not reported; expected {expected}, the arm that was moved before")
SERIAL_BELIEVED = Sentence("serial_believed", "not reported: the configuration says {expected} and is believed")
SERIAL_NOT_REPORTED = Sentence("serial_not_reported", "not reported: this arm cannot be told from another of its model")
ANOTHER_SERIAL = Sentence("another_serial", "the controller's serial number is {serial}, expected {expected}")
ANOTHER_ARM = Sentence(
    "another_arm",
    "the controller's serial number is {serial}, expected {expected}, the arm that was moved before; a person must say that "
    "this is another arm on purpose: joint-monitor allow",
)
SERIAL_FROM_NOW_ON = Sentence("serial_from_now_on", "{serial}; the configuration names none, and from the first motion on it is expected")
SERIAL_AS_CONFIGURED = Sentence("serial_as_configured", "{serial}")
SERIAL_AS_BEFORE = Sentence("serial_as_before", "{serial}, the arm that was moved before")


def serial(inputs: ConditionInputs) -> Reason:
    """The controller has the configured serial number, or else that of the arm that was moved before."""
    identity, configured, before = inputs.controller, inputs.context.serial, inputs.last.expected_serial
    if identity.serial is None and configured is None and before is not None:
        raise MotionRefused(SERIAL_NOT_REPORTED_AGAIN(expected=before))
    if identity.serial is None and configured is not None:
        raise Unreported(SERIAL_BELIEVED(expected=configured))
    if identity.serial is None:
        raise Unreported(SERIAL_NOT_REPORTED())
    if configured is not None and identity.serial != configured:
        raise MotionRefused(ANOTHER_SERIAL(serial=identity.serial, expected=configured))
    if configured is None and before is not None and identity.serial != before:
        raise MotionRefused(ANOTHER_ARM(serial=identity.serial, expected=before))
    if configured is None and before is None:
        return SERIAL_FROM_NOW_ON(serial=identity.serial)
    return (SERIAL_AS_CONFIGURED if configured is not None else SERIAL_AS_BEFORE)(serial=identity.serial)


MANUAL_MODE = Sentence("manual_mode", "the controller is in manual mode; set it to automatic mode and to remote control on its pendant")
LOCAL_CONTROL_LENT = Sentence(
    "local_control_lent", "off: a program lends its arm in local control too; nobody can stop it over the network then, but its node does"
)
REMOTE_CONTROL_NOT_REPORTED = Sentence(
    "remote_control_not_reported", "not reported: {why}whoever holds the pendant may start a program meanwhile"
)
LOCAL_CONTROL = Sentence("local_control", "the controller is in local control; set it to remote control on its pendant")
REMOTE_CONTROL_AUTOMATIC = Sentence("remote_control_automatic", "on, in automatic mode")
REMOTE_CONTROL_ON = Sentence("remote_control_on", "on")


def remote_control(inputs: ConditionInputs) -> Reason:
    """The controller takes commands over the network, so nobody else starts a program at its pendant; for a lent arm it need not."""
    identity = inputs.controller
    if identity.automatic is False:
        raise MotionRefused(MANUAL_MODE())
    if inputs.settings.lent is not None and identity.remote_control is False:
        return LOCAL_CONTROL_LENT()
    if identity.remote_control is None:
        raise Unreported(REMOTE_CONTROL_NOT_REPORTED(why=identity.no_remote_control))
    if not identity.remote_control:
        raise MotionRefused(LOCAL_CONTROL())
    return REMOTE_CONTROL_AUTOMATIC() if identity.automatic else REMOTE_CONTROL_ON()
