"""Conditions on what is known before the controller is asked: the configuration, the trajectory, the time, the history."""

import ipaddress
import math

import numpy as np

from monitor.acquire.safety.inputs import ConditionInputs, Unreported
from monitor.acquire.safety.limits import clear_of, within_limits
from monitor.errors import MotionRefused

PRIVATE_NETWORKS = tuple(ipaddress.IPv4Network(network) for network in ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16"))  # RFC 1918

CB3, CB3_HZ = "cb3", 125.0  # what a controller of this generation sends at most; later ones send 500


def motion_allowed(inputs: ConditionInputs) -> str:
    """The configuration allows motion. Only the value true itself does; a text such as "false" does not."""
    if inputs.settings.allow_motion is not True:
        raise MotionRefused("motion is not allowed: allow_motion is false (set it to true to let this arm move)")
    return "allow_motion is true"


def local_address(host: str) -> ipaddress.IPv4Address:
    """The address, where it is a literal one of this machine or of a private network. Raises MotionRefused."""
    try:
        ipv4 = ipaddress.IPv4Address(host)
    except ValueError:
        raise MotionRefused(
            f"host {host!r}: expected a literal IPv4 address, as 192.168.0.10; a name may mean another arm some day"
        ) from None
    if not (ipv4.is_loopback or ipv4.is_link_local or any(ipv4 in network for network in PRIVATE_NETWORKS)):
        raise MotionRefused(f"host {host}: expected an address of this machine or of a private network")
    return ipv4


def address(inputs: ConditionInputs) -> str:
    """The address is a literal one of this machine, or of a private network; a real arm there has its cell and slow first passes."""
    settings = inputs.settings
    host = settings.host
    if local_address(host).is_loopback:
        return f"{host} is a simulated arm"
    if not settings.first_pass:
        raise MotionRefused(f"host {host} is a real arm, and first_pass is false: only a simulated one may go without")
    if settings.cell is None:
        raise MotionRefused(f"host {host} is a real arm, and its cell is unchecked: describe what stands around it")
    return f"{host} is a real arm: first passes are slow, clearances are proved"


def time_window(inputs: ConditionInputs) -> str:
    """The motion, with the way to the start and back, ends before the open time window closes."""
    left = inputs.settings.minutes_left(inputs.now_unix_s)
    if left is None:
        raise MotionRefused(f"now is outside every allowed window: {', '.join(inputs.settings.windows_utc)} UTC")
    needed = (inputs.excitation.duration_s + _there_and_back_s(inputs)) / 60.0
    if left < needed:
        raise MotionRefused(f"the window closes in {left:.1f} minutes, the motion alone takes {needed:.1f}")
    return "at any time" if math.isinf(left) else f"open for another {left:.0f} minutes"


def _there_and_back_s(inputs: ConditionInputs) -> float:
    """Duration of the way to the start and back; 0 where it is not known where the arm stands."""
    if inputs.state is None or not np.all(np.isfinite(inputs.state.target_q)):
        return 0.0
    way = inputs.way_from(inputs.state)
    return way.to_start(inputs.settings).duration_s + way.to_home(inputs.settings).duration_s


def trajectory(inputs: ConditionInputs) -> str:
    """The trajectory was designed for this robot and this mounting, and keeps every limit of the robot."""
    excitation, robot = inputs.excitation, inputs.robot
    if excitation.robot != robot.name:
        raise MotionRefused(f"the excitation was designed for {excitation.robot!r}, the arm is {robot.name!r}")
    mounting = inputs.context.mounting_rad
    if mounting is not None and not np.allclose(mounting, excitation.mounting.angles_rad, atol=1e-6):
        designed = np.round(np.degrees(excitation.mounting.angles_rad), 3)
        raise MotionRefused(f"the excitation was designed for mounting {designed}°, the arm hangs at {np.degrees(mounting)}°")
    if robot.generation == CB3 and inputs.settings.rate_hz > CB3_HZ:
        raise MotionRefused(
            f"rate_hz = {inputs.settings.rate_hz:g}: a {robot.name} sends {CB3_HZ:g} rows a second at most, and a motion that follows them "
            f"would be slower than designed; expected at most {CB3_HZ:g}"
        )
    within_limits(excitation, max_position_rad=robot.max_position_rad, max_speed_rad_s=robot.max_speed_rad_s)
    return f"{excitation.digest}, {excitation.duration_s:.1f} s within every limit of the {robot.name}"


def trajectory_clear(inputs: ConditionInputs) -> str:
    """The trajectory was proved clear of the configured cell, and is so when it is proved again."""
    cell = inputs.settings.cell
    if cell is None:
        raise Unreported("the configuration says unchecked: nothing is known to be within reach, and no clearance is proved")
    clear_of(cell, inputs.excitation, inputs.robot)
    return f"proved against the cell {cell.name!r}, and proved again now"


def previous_stop(inputs: ConditionInputs) -> str:
    """A person has acknowledged every earlier stop that a person must check."""
    if inputs.stopped_before is not None:
        raise MotionRefused(f"{inputs.stopped_before}; a person must look at the arm and say so: joint-monitor allow")
    return "no stop is waiting for a person"
