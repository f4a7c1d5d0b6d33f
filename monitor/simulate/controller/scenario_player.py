"""Plays a scenario: as the arm grows older, its events happen and its room warms and cools, in real time and in stepped replays."""

from collections import deque
from collections.abc import Iterator

import numpy as np

from monitor.model.robot import Mounting
from monitor.simulate.arm.friction import REFERENCE_C, VISCOUS_SHARE_OF_WEAR, FrictionLaw, rated_revolutions_an_hour
from monitor.simulate.controller.faults import Parts, inject
from monitor.simulate.machine.state import Clock
from monitor.simulate.scenario import DAY_S, Scenario, ScenarioEvent, Work

WEAR_QUOTED_AT_RAD_S = 1.0  # `percent_a_month` refers to the friction at this speed, at 25 °C and without load
LEAP_S = 600.0  # largest step of a leap in time; the temperature of the room hardly changes within it


class ScenarioPlayer:
    """The position of one arm in its scenario."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.lived_s = 0.0  # age of the arm
        self.happened: list[str] = []  # a line for each event
        self._due = deque(scenario.events)

    def advance(self, lived_s: float, parts: Parts, *, ambient_c: float | None = None) -> None:
        """Let the events up to this age happen, and set the temperature of the room. A given temperature replaces the scenario's."""
        self.lived_s = lived_s
        for event in self._due_now(parts.clock):
            self.happened.append(f"day {event.at_s / DAY_S:g}: {event.do} {_arguments(event)}")
            _happen(event, self.scenario.production, parts)
        room = self.scenario.room
        if ambient_c is not None:
            parts.arm.ambient_c = ambient_c
        elif room is not None:
            parts.arm.ambient_c = room.at(self.scenario.started_s + lived_s)

    def _due_now(self, clock: Clock) -> Iterator[ScenarioEvent]:
        """The events that are due. Faults at the age of zero wait for the first control period, when all parts exist."""
        waiting: list[ScenarioEvent] = []
        while self._due and self._due[0].at_s <= self.lived_s:
            event = self._due.popleft()
            if event.do == "fault" and clock.ticks == 0 and self.lived_s == 0.0:
                waiting.append(event)
            else:
                yield event
        self._due.extendleft(reversed(waiting))

    def leap(self, parts: Parts, seconds: float, ambient_c: float | None, duty: float | None) -> None:
        """Let time pass without computing motion. None for the temperature or the duty means as in the scenario."""
        arm, clock = parts.arm, parts.clock
        while seconds > 1e-6:
            now_s = clock.lived_s
            self.advance(now_s, parts, ambient_c=ambient_c)
            slice_s = min(LEAP_S, seconds, max(self.next_event_s - now_s, 1e-3))
            arm.pass_time(slice_s / 3600.0, arm.ambient_c, self.duty(now_s) if duty is None else duty)
            clock.leap(slice_s)
            seconds -= slice_s
        self.advance(clock.lived_s, parts, ambient_c=ambient_c)

    def duty(self, lived_s: float) -> float:
        """The share of time in which the arm moves, at this age."""
        return self.scenario.production.duty_at(self.scenario.started_s + lived_s, lived_s / DAY_S)

    @property
    def next_event_s(self) -> float:
        """The age at the next event; infinity if there is none."""
        return self._due[0].at_s if self._due else float("inf")


def _arguments(event: ScenarioEvent) -> str:
    return " ".join(f"{key}={value}" for key, value in event.arguments.items())


def _happen(event: ScenarioEvent, work: Work, parts: Parts) -> None:
    arm, given, installation = parts.arm, event.arguments, parts.installation
    joint = int(given.get("joint", 1)) - 1
    match event.do:
        case "wear":
            arm.set_wear(joint, per_revolution=wear_per_revolution(arm.law, work, joint, given["percent_a_month"] / 100.0))
        case "wear_step":
            coulomb, viscous = arm.wear.coulomb[joint] * given["coulomb_factor"], arm.wear.viscous[joint] * given["viscous_factor"]
            arm.set_wear(joint, coulomb=coulomb, viscous=viscous)
        case "regrease":
            arm.regrease(joint, given["recovery"])
        case "replace_joint":
            arm.replace_joint(joint, given["friction_factor"])
            parts.identity.joint_serials[joint] = given["serial"]
        case "payload":
            arm.carry(payload_kg=given["kg"], declared=False)
            if given["declared"]:
                installation.install(payload=(given["kg"], *arm.payload_com_m))
            else:
                installation.declare()
        case "mounting":
            mounting = Mounting.parse(given["mounting"])
            arm.carry(mounting, declared=False)
            if given["declared"]:
                installation.install(gravity=mounting.gravity_in_base)
            else:
                installation.declare()
        case "fault":
            inject(given["fault"], dict(given["with"]), parts)


def wear_per_revolution(law: FrictionLaw, work: Work, joint: int, growth_a_month: float) -> float:
    """Growth of dry friction per revolution at rated load, such that the joint's friction grows by this share in a month of the work."""
    none = np.zeros(len(law.coulomb_nm))
    cool, one = none + REFERENCE_C, none + 1.0
    dry = law.dry(none, cool, one)[joint]
    viscous = (law.viscous_coefficient(none + WEAR_QUOTED_AT_RAD_S, cool, one) * WEAR_QUOTED_AT_RAD_S)[joint]
    revolutions_a_month = rated_revolutions_an_hour(1.0) * work.duty_hours_a_month
    return float(growth_a_month * (dry + viscous) / (dry + VISCOUS_SHARE_OF_WEAR * viscous) / max(revolutions_a_month, 1e-9))
