"""What happens on which day of the demo, and what the demo knows of its own course while it runs."""

from dataclasses import dataclass, field

import numpy as np

from monitor.recording import Array

DAY_S = 86_400.0
FIRST_DAY_UNIX_S = 1_767_582_000.0  # Monday 2026-01-05 03:00 UTC
DAYS = 28  # one replay each: two weeks healthy, two weeks with wear
LIVE_DAYS = (0, 27)  # replays of these days run over RTDE in real time, 15 s each; the others are stepped
WEARING_JOINT = 3  # numbered from 1
ONSET_DAY = 14  # from this day on the joint wears
WEAR_PER_REVOLUTION = 5e-5  # fraction of friction: thousands of times a healthy joint's, so that two weeks show what takes years
WORKING_H = 10.0  # of a day
DUTY = 0.5  # share of the working hours in which the arm moves
WEEKEND_DUTY = 0.1
WEEKEND = (5, 6)  # days of the week, counted from Monday
DUTY_BEFORE_REPLAY = (0.0, 0.15, 0.4, 0.7)  # of the last hour, day after day: the replays find the joints cold and warm
ROOM_C = 22.0
SEASON_K, SEASON_DAYS = 2.5, 9.0  # amplitude and period of the room's slow change, so that temperatures do not repeat every week
PRODUCTION_WARMS_ROOM_K = 2.0
COLD_DAYS = {7: -9.0, 21: -7.0}  # day → change of the room [K]: Mondays after a weekend without heating
REFERENCE_C = 27.0  # true friction is compared at one temperature: about that of a joint in this room


@dataclass(slots=True)
class DemoState:
    """The course of the demo up to now; the screen and the summary read it."""

    clock_unix_s: float = FIRST_DAY_UNIX_S  # the daemon's clock
    day: int = 0
    activity: str = "starting the simulated arm, the daemon and its bus"
    ambient_c: float = ROOM_C
    replays: list[str] = field(default_factory=list)  # a line each
    live_replays: int = 0
    stepped_replays: int = 0
    disturbed: list[str] = field(default_factory=list)  # live replays that were repeated: the day and the reason
    not_live: list[int] = field(default_factory=list)  # days whose live replay this machine could not keep in real time: stepped instead
    failed: list[str] = field(default_factory=list)  # replays that were not assessed: the day, how it ended and why
    true_wear: Array = field(default_factory=lambda: np.zeros(6))  # (J,) growth of friction by the simulator's own law
