"""The way of a motion to the start of its trajectory, and from its end to where the arm rests. Values only.

As a rule both are the straight line in joint space between the start and where the arm stands. An arm that a motion of ours left on its
trajectory stands where that line may be long, and where nobody has driven it: it goes back over the way it came, along the trajectory
itself, slowly. It does so only where it still stands exactly as it was left.
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from monitor.acquire.settings import ReplaySettings
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Array

SHORTEST_S = 0.2  # a path of no length takes this time too, so that a phase always has a beginning and an end


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPath:
    """A path from start to end; the joint that moves farthest keeps the speed and the acceleration that were asked for."""

    start: Array  # (J,) [rad]
    end: Array  # (J,) [rad]
    ramp_s: float  # how long the speed rises, and how long it falls
    duration_s: float

    def at(self, t_s: float) -> Array:
        """The position (J,) at time t; before the beginning it is the start, after the end it is the end."""
        t = min(max(t_s, 0.0), self.duration_s)
        cruise = 1.0 / (self.duration_s - self.ramp_s)  # share of the path that is covered in a second of constant speed
        if t < self.ramp_s:
            share = cruise * _cruise_time_s(t, self.ramp_s)
        elif t > self.duration_s - self.ramp_s:
            share = 1.0 - cruise * _cruise_time_s(self.duration_s - t, self.ramp_s)
        else:
            share = cruise * (t - 0.5 * self.ramp_s)
        position: Array = self.start + share * (self.end - self.start)
        return position


def _cruise_time_s(t_s: float, ramp_s: float) -> float:
    """Time that constant speed needs for the way covered in the first t of a ramp: ∫₀ᵗ 3u² − 2u³ dt, u = t/ramp (a smoothstep)."""
    u = t_s / ramp_s
    return ramp_s * (u**3 - 0.5 * u**4)


def joint_path(start: Array, end: Array, *, speed_rad_s: float, acceleration_rad_s2: float) -> JointPath:
    """The quickest such path from start to end, both (J,) [rad], within a speed and an acceleration.

    A smoothstep of duration r up to the speed v has its greatest acceleration 1.5·v/r in its middle.
    """
    way = float(np.max(np.abs(end - start)))
    ramp_s = 1.5 * speed_rad_s / acceleration_rad_s2
    if way >= speed_rad_s * ramp_s:
        duration_s = way / speed_rad_s + ramp_s
    else:  # the way is too short to reach the speed: v = way/r, hence 1.5·way/r² = a
        ramp_s = math.sqrt(1.5 * way / acceleration_rad_s2)
        duration_s = 2.0 * ramp_s
    if duration_s < SHORTEST_S:
        ramp_s, duration_s = 0.5 * SHORTEST_S, SHORTEST_S
    return JointPath(start=start, end=end, ramp_s=ramp_s, duration_s=duration_s)


TURN_RAD = 2.0 * math.pi
TURN_SAMPLES = 1001  # of one period: between two a curve below 10 Hz exceeds them by less than a thousandth of its swing
ROUNDING_RAD = 1e-6


def turned(excitation: Excitation, robot: Robot, q: Array) -> Excitation:
    """The same trajectory with each joint as many whole turns on as bring its start nearest to q (J,), within the joint's range.

    A joint without end leaves ±max_position_rad only where it stands beyond it already: that shows that its installation allows it.
    """
    if not np.all(np.isfinite(q)):
        return excitation
    wished = np.round((q - excitation.at(np.zeros(1)).q[0]) / TURN_RAD)  # (J,)
    if not np.any(wished):
        return excitation
    curve = excitation.at(np.linspace(0.0, excitation.pass_s, TURN_SAMPLES)).q  # (N, J)
    free = (robot.endless > 0.0) & (np.abs(q) > robot.max_position_rad)  # (J,)
    limit = np.where(free, np.inf, robot.max_position_rad + ROUNDING_RAD)
    lowest = np.ceil((-limit - np.min(curve, axis=0)) / TURN_RAD)
    highest = np.floor((limit - np.max(curve, axis=0)) / TURN_RAD)
    turns = np.clip(wished, np.minimum(lowest, 0.0), np.maximum(highest, 0.0))  # (J,)
    return excitation if not np.any(turns) else dataclasses.replace(excitation, offset_rad=excitation.offset_rad + TURN_RAD * turns)


LEFT_RAD = 0.02  # an arm sags by less when its brakes close; one that stands farther from where it was left was moved by somebody
JOIN_RAD = 0.2  # each joint brakes by itself: at 10 rad/s² an arm stopped at full speed is 0.05 rad from its path, at 4 rad/s² 0.17
CURVE_SAMPLES = 2001  # of one period: at 2.5 rad/s and 20 s two of them are 0.025 rad apart
AS_NEAR_RAD = 0.005  # of two places of the path as near as this, the earlier one is taken: the way back from there is shorter


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """An arm that a motion of ours left before it was back, as the history has it."""

    path_digest: str  # of the trajectory
    on_path: bool  # it was left on the trajectory; False: on the straight way to its start or from it
    q: tuple[float, ...] = ()  # (J,) [rad] where it was seen to stand; empty: nobody has seen it
    home_q: tuple[float, ...] = ()  # (J,) [rad] where the motion began, and where the arm goes after the next one; empty: not known
    free: bool = False  # nothing speaks against the way back: the cause was harmless, or a person has looked
    cause: str = ""  # why it was left
    failed: int = 0  # so many motions in succession ended while they brought it back

    def as_document(self) -> dict[str, Any]:
        """As JSON can carry it."""
        return asdict(self)


def left_from_document(document: Mapping[str, Any]) -> Left:
    """The inverse of `Left.as_document`; keys of later versions are passed over."""
    known = {name: document[name] for name in Left.__slots__ if name in document}
    return Left(**{**known, **{name: tuple(known.get(name, ())) for name in ("q", "home_q")}})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Way:
    """The ways before and after a trajectory, from where the arm stands."""

    excitation: Excitation  # as it will be played: around the nearest turn of each joint
    begin_q: Array  # (J,) where the arm stands
    home_q: Array  # (J,) where it goes at the end
    back_from_s: float | None = (
        None  # place on the trajectory from which it is brought back along it [s]; None: it goes straight to the start
    )
    off_path_rad: float = 0.0  # how far the arm stands from that place

    @property
    def start_q(self) -> Array:
        """(J,) the start of the trajectory, which is also its end."""
        return self._at(0.0)

    @property
    def lines(self) -> tuple[tuple[Array, Array], ...]:
        """The straight ways in joint space, each from (J,) to (J,)."""
        first = self.start_q if self.back_from_s is None else self._at(self.back_from_s)
        lines = ((self.begin_q, first),)
        return lines if np.array_equal(self.home_q, self.begin_q) else (*lines, (self.start_q, self.home_q))

    def to_start(self, settings: ReplaySettings) -> "Motion":
        """The motion to the start of the trajectory, at rest at both ends."""
        join = _straight(*self.lines[0], settings)
        if self.back_from_s is None:
            return Motion(join, None, self.excitation)
        curve = self.excitation.at(np.linspace(0.0, self.back_from_s, max(2, round(200.0 * self.back_from_s) + 1)))
        fastest = max(float(np.max(np.abs(curve.qd))), 1e-3)  # rad/s, of any joint where the trajectory is played
        along = joint_path(  # of one coordinate: time on the trajectory, which runs backwards
            np.array([self.back_from_s]),
            np.zeros(1),
            speed_rad_s=min(settings.approach_speed_rad_s / fastest, 1.0),
            acceleration_rad_s2=settings.approach_acceleration_rad_s2 / fastest,
        )
        return Motion(join, along, self.excitation)

    def to_home(self, settings: ReplaySettings) -> "Motion":
        """The motion from the end of the trajectory to where the arm rests."""
        return Motion(_straight(self.start_q, self.home_q, settings), None, self.excitation)

    def _at(self, t_s: float) -> Array:
        q: Array = self.excitation.at(np.array([t_s])).q[0]
        return q


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A straight way in joint space, and after it a way along the trajectory, backwards."""

    join: JointPath
    along: JointPath | None
    excitation: Excitation

    @property
    def duration_s(self) -> float:
        """Of both together."""
        return self.join.duration_s + (0.0 if self.along is None else self.along.duration_s)

    def at(self, t_s: float) -> Array:
        """The position (J,) at time t."""
        if self.along is None or t_s < self.join.duration_s:
            return self.join.at(t_s)
        q: Array = self.excitation.at(self.along.at(t_s - self.join.duration_s)).q[0]
        return q


def way(excitation: Excitation, robot: Robot, q: Array, left: Left | None, *, max_approach_rad: float) -> Way:
    """The ways of a motion that begins at q (J,); `left`: how the last motion left the arm, None where it brought it back.

    Where the place of rest before that motion is not known, or farther than max_approach_rad from the start, the arm rests at the start.
    """
    nearest = turned(excitation, robot, q)
    straight = Way(excitation=nearest, begin_q=q, home_q=q)
    if left is None or not stands_as_left(left, excitation, q):
        return straight
    home_q = np.array(left.home_q) if len(left.home_q) == len(q) else None
    around = [nearest] if home_q is None else [turned(excitation, robot, home_q), nearest]
    off_path_rad, at_s, played = min(((*nearest_place(each, q), each) for each in around), key=lambda found: found[0])
    brought_back = left.on_path and left.free and off_path_rad <= JOIN_RAD
    start_q = (played if brought_back else nearest).at(np.zeros(1)).q[0]
    if home_q is None or np.max(np.abs(home_q - start_q)) > max_approach_rad:
        home_q = start_q
    if not brought_back:
        return replace(straight, home_q=home_q)
    return Way(excitation=played, begin_q=q, home_q=home_q, back_from_s=at_s, off_path_rad=off_path_rad)


def nearest_place(excitation: Excitation, q: Array) -> tuple[float, float]:
    """Distance of the farthest joint of q (J,) from the nearest place of the trajectory [rad], and the earliest such time [s]."""
    t_s = np.linspace(0.0, excitation.pass_s, CURVE_SAMPLES)
    apart = np.max(np.abs(excitation.at(t_s).q - q), axis=1)  # (N,)
    near = apart <= np.min(apart) + AS_NEAR_RAD
    first = int(np.argmax(near))
    after = np.flatnonzero(~near[first:])
    nearest = first + int(np.argmin(apart[first : first + int(after[0]) if after.size else None]))
    return float(apart[nearest]), float(t_s[nearest])


def stands_as_left(left: Left, excitation: Excitation, q: Array) -> bool:
    """Whether the arm stands where it was left, and the trajectory is the same."""
    if len(left.q) != len(q) or left.path_digest != excitation.path_digest:
        return False
    return bool(np.all(np.abs(q - np.array(left.q)) <= LEFT_RAD))


def _straight(start: Array, end: Array, settings: ReplaySettings) -> JointPath:
    return joint_path(start, end, speed_rad_s=settings.approach_speed_rad_s, acceleration_rad_s2=settings.approach_acceleration_rad_s2)
