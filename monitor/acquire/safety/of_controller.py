"""Conditions on who the controller says it is."""

import numpy as np

from monitor.acquire.safety.inputs import ConditionInputs, Unreported
from monitor.acquire.safety.of_configuration import CHECK_RATE_HZ
from monitor.acquire.state import Identity
from monitor.errors import MotionRefused
from monitor.reason import joint_text

ROUNDING_RAD = 1e-6  # [rad, rad/s] a trajectory may be designed up to the limit itself


def _identity(inputs: ConditionInputs) -> Identity:
    """Who the controller is, which must be known."""
    if inputs.identity is None:
        raise MotionRefused("unknown: the controller does not answer")
    return inputs.identity


def robot_model(inputs: ConditionInputs) -> str:
    """The controller is of the configured model."""
    if inputs.identity is None and inputs.unreachable:
        raise MotionRefused(inputs.unreachable)
    identity = _identity(inputs)
    if inputs.context.robot is not None and inputs.context.robot != inputs.robot.name:
        raise MotionRefused(f"the context is of a {inputs.context.robot}, the arm is a {inputs.robot.name}")
    if identity.model is None:
        raise Unreported("not reported: this software does not tell its model; the configuration is believed")
    if identity.model.lower().removesuffix("e") != inputs.robot.name.lower().removesuffix("e"):
        raise MotionRefused(f"the controller says it is a {identity.model}, the configuration says {inputs.robot.name}")
    generation = identity.generation
    if generation not in {None, inputs.robot.generation}:
        raise MotionRefused(
            f"the controller says it is a {identity.model} with software {identity.firmware}, which is of the generation {generation}; "
            f"the configuration says {inputs.robot.name}, of the generation {inputs.robot.generation}"
        )
    sources = f" ({identity.sources})" if identity.sources else ""
    return f"{identity.model}, software {identity.firmware or 'not reported'}{sources}"


def software(inputs: ConditionInputs) -> str:
    """The controller's software is one that can be driven, and with which replays are tested."""
    identity = _identity(inputs)
    firmware, known = identity.firmware, identity.software
    if not known.drivable:
        raise MotionRefused(f"software {firmware}: {known.reason}; expected {known.expected}")
    if known.tested:
        return f"{firmware}, among the tested {known.expected}"
    what = f"software {firmware}" if firmware else "the software's version is not reported"
    what += f" ({known.reason})" if known.reason else ""
    if inputs.settings.allow_untested_software:
        return f"{what}: untested, and replay.allow_untested_software is true"
    raise MotionRefused(f"{what}; tested are {known.expected}; replay.allow_untested_software = true lets another one move the arm")


def joint_limits(inputs: ConditionInputs) -> str:
    """The trajectory keeps the joint limits of the controller's installation, where it reports them."""
    limits, state = _identity(inputs).joint_limits, inputs.state
    if limits is None:
        raise Unreported("not reported: a joint limit of the installation below the published one would show as a protective stop")
    played = inputs.played
    curve = played.at(np.linspace(0.0, played.pass_s, max(2, round(played.pass_s * CHECK_RATE_HZ) + 1)))
    low, high, speed = (np.array(each) for each in limits)
    if state is not None:  # an endless joint that stands beyond its limits shows that they are not in force
        beyond = (inputs.robot.endless > 0.0) & ~((state.q >= low) & (state.q <= high))
        low, high = np.where(beyond, -np.inf, low), np.where(beyond, np.inf, high)
    for j in range(inputs.robot.joints):
        least, most, fastest = float(np.min(curve.q[:, j])), float(np.max(curve.q[:, j])), float(np.max(np.abs(curve.qd[:, j])))
        if not (least >= low[j] - ROUNDING_RAD and most <= high[j] + ROUNDING_RAD):
            raise MotionRefused(
                f"{joint_text(j + 1)} moves from {least:.2f} to {most:.2f} rad; the installation allows {low[j]:.2f} to {high[j]:.2f}"
            )
        if not fastest <= speed[j] + ROUNDING_RAD:
            raise MotionRefused(f"{joint_text(j + 1)} moves at {fastest:.2f} rad/s; the controller's installation allows {speed[j]:.2f}")
    return "the trajectory is within those of the controller's installation"


def serial(inputs: ConditionInputs) -> str:
    """The controller has the configured serial number, or else that of the arm that was moved before."""
    identity, configured, before = _identity(inputs), inputs.context.serial, inputs.expected_serial
    if identity.serial is None and configured is None and before is not None:
        raise MotionRefused(f"not reported; expected {before}, the arm that was moved before")
    if identity.serial is None and configured is not None:
        raise Unreported(f"not reported: the configuration says {configured} and is believed")
    if identity.serial is None:
        raise Unreported("not reported: this arm cannot be told from another of its model")
    if configured is not None and identity.serial != configured:
        raise MotionRefused(f"the controller's serial number is {identity.serial}, expected {configured}")
    if configured is None and before is not None and identity.serial != before:
        raise MotionRefused(
            f"the controller's serial number is {identity.serial}, expected {before}, the arm that was moved before; a person must say "
            "that this is another arm on purpose: joint-monitor allow"
        )
    if configured is None and before is None:
        return f"{identity.serial}; the configuration names none, and from the first motion on it is expected"
    return identity.serial if configured is not None else f"{identity.serial}, the arm that was moved before"


def remote_control(inputs: ConditionInputs) -> str:
    """The controller takes commands over the network, so nobody else starts a program at its pendant; for a lent arm it need not."""
    identity = _identity(inputs)
    if identity.automatic is False:
        raise MotionRefused("the controller is in manual mode; set it to automatic mode and to remote control on its pendant")
    if inputs.settings.lent is not None and identity.remote_control is False:
        return "off: a program lends its arm in local control too; nobody can stop it over the network then, but its node does"
    if identity.remote_control is None:
        raise Unreported(f"not reported: {identity.no_remote_control}whoever holds the pendant may start a program meanwhile")
    if not identity.remote_control:
        raise MotionRefused("the controller is in local control; set it to remote control on its pendant")
    return "on, in automatic mode" if identity.automatic else "on"
