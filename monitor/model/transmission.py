"""The transmissions of a URDF: gear ratios, and which motors turn which joints.

A <transmission> of ROS has a type, joints and actuators, each with a <mechanicalReduction> n. With θ, the turns of a motor divided by the
n of its actuator, ROS's transmission_interface moves the motors by

    SimpleTransmission           θ  = n·q
    DifferentialTransmission     θ1 = n1·q1 + n2·q2,   θ2 = n1·q1 − n2·q2
    FourBarLinkageTransmission   θ1 = n1·q1,           θ2 = q1 + n2·q2

Torques follow from these by the power, as in `Robot.share_of_motors`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from monitor.errors import BadInput
from monitor.recording import Array

DIFFERENTIAL, FOUR_BAR = "DifferentialTransmission", "FourBarLinkageTransmission"
REDUCTION = (1e-3, 1e5)  # sizes that a gear has


class Drives(NamedTuple):
    """What the transmissions say of an arm of J joints."""

    gear_ratio: Array  # (J,) NaN where it is not given, or is 1, which generators write for unknown
    coupling: Array | None  # (J, J) as in `Robot`; None where each motor turns its own joint


def drives_of(tree: ET.Element, joints: Sequence[str], source: str) -> Drives:
    """The drives of these joints. Raises BadInput where several of them are turned in a way that is not known, or by no gear."""
    J = len(joints)
    ratio, coupling = np.full(J, math.nan), np.eye(J)
    for transmission in tree.iter("transmission"):
        turned = [joint for joint in transmission.findall("joint") if joint.get("name") in joints]
        motors = transmission.findall("actuator")
        at = [joints.index(joint.get("name", "")) for joint in turned]
        reductions = [_reduction(each) for each in (*turned, *motors)]
        if len(turned) == 1 and len(motors) <= 1:
            total = abs(math.prod(reductions))
            ratio[at[0]] = total if total != 1.0 else math.nan
        if len(turned) < 2:
            continue
        kind = (transmission.findtext("type") or transmission.findtext("plugin") or "").strip().rpartition("/")[2]
        name = f"{source}: transmission {transmission.get('name')!r}"
        if kind not in (DIFFERENTIAL, FOUR_BAR) or len(turned) != 2 or len(motors) != 2:
            raise BadInput(
                f"{name}: {kind or 'without a type'} of {len(motors)} actuators couples {len(turned)} joints; expected {DIFFERENTIAL} or "
                f"{FOUR_BAR} of two and two, or the arm as TOML with its coupling"
            )
        if any(math.isnan(value) for value in reductions):
            raise BadInput(f"{name}: expected a mechanicalReduction between {REDUCTION[0]:g} and {REDUCTION[1]:g} in size everywhere")
        ratio[at] = [abs(value) if abs(value) != 1.0 else math.nan for value in reductions[2:]]
        n1, n2 = reductions[:2]
        coupling[np.ix_(at, at)] = [[n1, n2], [n1, -n2]] if kind == DIFFERENTIAL else [[n1, 0.0], [1.0, n2]]
    return Drives(ratio, None if np.array_equal(coupling, np.eye(J)) else coupling)


def _reduction(element: ET.Element) -> float:
    """The reduction of a joint or an actuator; 1 where none is given, NaN where no gear has it."""
    text = element.findtext("mechanicalReduction") or element.findtext("mechanical_reduction") or "1"
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if REDUCTION[0] <= abs(value) <= REDUCTION[1] else math.nan
