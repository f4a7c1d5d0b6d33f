"""Conditions on who the controller says it is."""

from monitor.acquire.safety.inputs import ConditionInputs, Unreported
from monitor.acquire.state import Identity
from monitor.errors import MotionRefused


def _identity(inputs: ConditionInputs) -> Identity:
    """Who the controller is, which must be known."""
    if inputs.identity is None:
        raise MotionRefused("unknown: the dashboard does not answer")
    return inputs.identity


def robot_model(inputs: ConditionInputs) -> str:
    """The controller is of the configured model."""
    identity = _identity(inputs)
    if inputs.context.robot is not None and inputs.context.robot != inputs.robot.name:
        raise MotionRefused(f"the context is of a {inputs.context.robot}, the arm is a {inputs.robot.name}")
    if identity.model is None:
        raise Unreported("not reported: this software does not tell its model; the configuration is believed")
    if identity.model.lower().removesuffix("e") != inputs.robot.name.lower().removesuffix("e"):
        raise MotionRefused(f"the controller says it is a {identity.model}, the configuration says {inputs.robot.name}")
    return f"{identity.model}, software {identity.firmware or 'not reported'}"


def serial(inputs: ConditionInputs) -> str:
    """The controller has the configured serial number."""
    identity, expected = _identity(inputs), inputs.context.serial
    if identity.serial is None:
        raise Unreported("not reported: this arm cannot be told from another of its model")
    if expected is not None and identity.serial != expected:
        raise MotionRefused(f"the controller's serial number is {identity.serial}, expected {expected}")
    return identity.serial if expected is not None else f"{identity.serial}; the configuration names none"


def remote_control(inputs: ConditionInputs) -> str:
    """The controller takes commands over the network, so nobody else starts a program at its pendant."""
    identity = _identity(inputs)
    if identity.remote_control is None:
        raise Unreported("not reported: this generation has no local control; whoever holds the pendant may start a program meanwhile")
    if not identity.remote_control:
        raise MotionRefused("the controller is in local control; set it to remote control on its pendant")
    return "on"
