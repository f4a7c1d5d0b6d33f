"""A scenario, lived: as the arm's life passes, its events happen and the room warms and cools; the same in real time and stepped."""

from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from monitor.model.robot import Mounting
from monitor.simulate import faults
from monitor.simulate.arm.friction import REFERENCE_C
from monitor.simulate.arm.wear import VISCOUS_SHARE_OF_WEAR, rated_revolutions_an_hour
from monitor.simulate.scenario import DAY_S, Event, Scenario

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller

WEAR_QUOTED_AT_RAD_S = 1.0  # "5 % a month" is meant of the friction at this speed, at 25 °C without load
LEAP_S = 600.0  # at once, when life is made to pass; the room hardly changes meanwhile


class Life:
    """Where one arm is in its scenario. `pass_to` makes happen what is due."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.lived_s = 0.0
        self.happened: list[str] = []
        self._due = deque(scenario.events)

    def pass_to(self, lived_s: float, controller: "Controller", *, ambient_c: float | None = None) -> None:
        """The arm has lived so long; a given room temperature outweighs the scenario's for now."""
        self.lived_s = lived_s
        for event in self._now(controller):
            self.happened.append(f"day {event.at_s / DAY_S:g}: {event.do} {_said(event)}")
            _happen(event, self.scenario, controller)
        room = self.scenario.room
        if ambient_c is not None:
            controller.arm.ambient_c = ambient_c
        elif room is not None:
            controller.arm.ambient_c = room.at(self.scenario.started_s + lived_s)

    def _now(self, controller: "Controller") -> Iterator[Event]:
        """What is due; the faults of a life's first moment wait for the first tick, when there is something that can fail."""
        born: list[Event] = []
        while self._due and self._due[0].at_s <= self.lived_s:
            event = self._due.popleft()
            if event.do == "fault" and controller.ticks == 0 and self.lived_s == 0.0:
                born.append(event)
            else:
                yield event
        self._due.extendleft(reversed(born))

    def leap(self, controller: "Controller", seconds: float, ambient_c: float | None, duty: float | None) -> Iterator[float]:
        """Let so much pass without motion, slice by slice, for the controller to count; what is not given is the scenario's."""
        while seconds > 1e-6:
            now_s = controller.lived_s
            self.pass_to(now_s, controller, ambient_c=ambient_c)
            slice_s = min(LEAP_S, seconds, max(self.next_event_s - now_s, 1e-3))
            arm = controller.arm
            arm.live(slice_s / 3600.0, arm.ambient_c, self.duty(now_s) if duty is None else duty)
            yield slice_s
            seconds -= slice_s
        self.pass_to(controller.lived_s, controller, ambient_c=ambient_c)

    def duty(self, lived_s: float) -> float:
        """Of the job that the scenario describes, at this moment."""
        return self.scenario.work.duty_at(self.scenario.started_s + lived_s, lived_s / DAY_S)

    @property
    def next_event_s(self) -> float:
        """When something happens next, after the start; infinity when nothing does."""
        return self._due[0].at_s if self._due else float("inf")


def _said(event: Event) -> str:
    return " ".join(f"{key}={value}" for key, value in event.arguments.items())


def _happen(event: Event, scenario: Scenario, controller: "Controller") -> None:
    arm, a = controller.arm, event.arguments
    joint = int(a.get("joint", 1)) - 1
    match event.do:
        case "wear":
            arm.set_wear(joint, per_revolution=per_revolution(controller, scenario, joint, a["percent_a_month"] / 100.0))
        case "wear_step":
            arm.set_wear(
                joint, coulomb=arm.wear.coulomb[joint] * a["coulomb_factor"], viscous=arm.wear.viscous[joint] * a["viscous_factor"]
            )
        case "regrease":
            arm.regrease(joint, a["recovery"])
        case "replace_joint":
            arm.replace_joint(joint, a["friction_factor"])
            controller.joint_serials[joint] = a["serial"]
        case "payload":
            arm.carry(payload_kg=a["kg"], told=False)
            if a["told"]:
                controller.installed_payload = (a["kg"], *arm.payload_com_m)
            controller.declare(payload=controller.installed_payload if a["told"] else None)
        case "mounting":
            mounting = Mounting.parse(a["mounting"])
            arm.carry(mounting, told=False)
            if a["told"]:
                controller.installed_gravity = mounting.gravity_in_base
            controller.declare(gravity=controller.installed_gravity if a["told"] else None)
        case "fault":
            place = faults.Place(controller=controller) if controller.place is None else controller.place()
            faults.inject(a["fault"], dict(a["with"]), place)


def per_revolution(controller: "Controller", scenario: Scenario, joint: int, growth_a_month: float) -> float:
    """Wear of dry friction per revolution at rated load, so that a joint's friction grows by this share in a month of its work."""
    law, none = controller.arm.law, np.zeros(controller.robot.joints)
    cool, one = none + REFERENCE_C, none + 1.0
    dry = law.dry(none, cool, one)[joint]
    viscous = (law.viscous_coefficient(none + WEAR_QUOTED_AT_RAD_S, cool, one) * WEAR_QUOTED_AT_RAD_S)[joint]
    month = rated_revolutions_an_hour(1.0) * scenario.work.duty_hours_a_month
    return float(growth_a_month * (dry + viscous) / (dry + VISCOUS_SHARE_OF_WEAR * viscous) / max(month, 1e-9))
