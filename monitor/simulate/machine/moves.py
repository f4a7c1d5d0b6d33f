"""The limits that a controller supervises: following error, drive torque, joint ranges and jumps of servoj's target."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import sub
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm import motions, path
from monitor.simulate.arm.kinematics import Kinematics, se3
from monitor.simulate.arm.path import Path
from monitor.simulate.arm.physics import Arm
from monitor.simulate.arm.reference import Reference
from monitor.simulate.machine.personality import Personality
from monitor.simulate.machine.state import Clock, Modes, Supervisor

DEVIATION_MAX_RAD = 0.15  # following error that leads to a protective stop
SATURATED_MAX_S = 0.1  # a drive at its torque limit for longer than this means that something blocks the arm
LIMIT_MARGIN_RAD = 1e-6  # rounding errors of a target exactly at the limit
ENDLESS_WRIST = frozenset({"ur3", "ur3e"})  # their last joint turns without end; it is published as ±2π all the same
WAY_BACK_RAD = 0.01  # how much farther out an arm may settle after it was unlocked beyond its range


class Breach(NamedTuple):
    """A limit that a joint has broken."""

    joint: int  # from 1
    text: str


class Limits:
    """The limits of one arm. The controller calls `broken` in every control period."""

    def __init__(self, robot: Robot, tick_s: float) -> None:
        self._robot, self._tick_s = robot, tick_s
        self._limit = robot.max_position_rad + LIMIT_MARGIN_RAD
        if robot.name in ENDLESS_WRIST:
            self._limit[-1] = np.inf
        self._way_back: Array | None = None  # (J,) largest |q| of an arm that was unlocked beyond its range
        self._max_speed: list[float] = robot.max_speed_rad_s.tolist()
        self._slowest = min(self._max_speed)
        self._saturated_s = 0.0

    def broken(self, target: Array, q: Array, torque_nm: Array) -> Breach | None:
        """Check target, encoder position and drive torque, each (J,). Returns the reason for a protective stop."""
        size, deviation = np.abs(torque_nm), np.abs(target - q)
        self._saturated_s = self._saturated_s + self._tick_s if True in (size >= self._robot.max_torque_nm).tolist() else 0.0
        if max(deviation.tolist()) > DEVIATION_MAX_RAD:
            joint = int(np.argmax(deviation)) + 1
            return Breach(joint, f"joint {joint} is {deviation.max():.3f} rad from where it should be")
        if self._saturated_s > SATURATED_MAX_S:
            joint = int(np.argmax(size / self._robot.max_torque_nm)) + 1
            return Breach(joint, f"the drive of joint {joint} is at its torque limit")
        beyond = self.outside(q)
        if self._way_back is not None:
            if beyond and (np.abs(q) <= self._way_back).all():
                return None
            self._way_back = None
        return beyond

    def deviation_ratio(self, target: Array, q: Array) -> float:
        """Following error divided by DEVIATION_MAX_RAD. A ratio of 1 or more leads to a protective stop."""
        return float(np.abs(target - q).max()) / DEVIATION_MAX_RAD

    def reset(self, q: Array) -> None:
        """Begin anew after a protective stop. A joint beyond its range at q (J,) may go back, but not farther out."""
        self._saturated_s = 0.0
        self._way_back = np.maximum(self._limit, np.abs(q) + WAY_BACK_RAD) if self.outside(q) else None

    def outside(self, q: Array) -> Breach | None:
        """Check joint positions (J,). Returns the first joint beyond its range with its position."""
        beyond = (np.abs(q) > self._limit).tolist()
        if True not in beyond:
            return None
        joint = beyond.index(True)
        return Breach(joint + 1, f"joint {joint + 1} at {q[joint]:.3f} rad is beyond ±{self._robot.max_position_rad[joint]:.3f}")

    def jump(self, target: Sequence[float], before: Sequence[float], since_s: float) -> Breach | None:
        """The first joint whose servoj target is farther from the one before than it can have moved since; targets are (J,)."""
        if max(map(abs, map(sub, target, before))) <= DEVIATION_MAX_RAD + self._slowest * since_s:
            return None  # within the bound of the slowest joint
        for joint, (to, was, fastest) in enumerate(zip(target, before, self._max_speed, strict=True)):
            if not abs(to - was) <= DEVIATION_MAX_RAD + fastest * since_s:
                text = f"sudden change of the target of joint {joint + 1} by {abs(to - was):.3f} rad within {1000 * since_s:.0f} ms"
                return Breach(joint + 1, text)
        return None


# --- Moves that a program asks for: each is checked against the limits of the arm and then given to the reference ---

PROGRAM_STOP_RAD_S2 = 15.0  # deceleration when a program ends or pauses: an arm at 2 rad/s stops within 0.13 s
SLOWEST = 1e-9  # smallest speed and acceleration of a move, so that their inverse is finite
STOP_MAX_RAD_S2 = 40.0  # largest joint deceleration of a stopl; near an axis, a slow tool asks for more


@dataclass(frozen=True, slots=True)
class Move:
    """A movej [rad, rad/s, rad/s²] or, if straight, a movel of the tool [m, m/s, m/s²]. The target is joint positions or a tool pose."""

    target: tuple[float, ...]
    pose: bool
    straight: bool
    speed: float
    acceleration: float
    blend_m: float = 0.0  # nearer than this to its end, the next move may begin


@dataclass(frozen=True, slots=True)
class StopMotion:
    """A stopj [rad/s²] or, if straight, a stopl [m/s²]."""

    deceleration: float
    straight: bool = False


class Moves:
    """The moves of one controller."""

    def __init__(
        self,
        *,
        robot: Robot,
        reference: Reference,
        kinematics: Kinematics,
        limits: Limits,
        clock: Clock,
        modes: Modes,
        supervisor: Supervisor,
    ) -> None:
        self._robot, self._reference, self._kinematics, self._limits = robot, reference, kinematics, limits
        self._clock, self._modes, self._supervisor = clock, modes, supervisor
        self._path = Path(reference)
        self.waypoint: Array | None = None  # (6,) tool pose at the end of the last move
        self.interrupted: Move | None = None  # the move that a pause or a protective stop interrupted; it continues with the program
        self._last: Move | None = None
        self._servo_target: Sequence[float] | None = None
        self._servo_target_at_s = 0.0
        self._ask_tool_speed: Callable[[Array, float], None] | None = None

    def start(self, move: Move) -> str:
        """Start a movej or a movel. Returns why the arm cannot make it, or an empty text."""
        self._last, self.interrupted = move, None
        target = np.array(move.target)
        if target.shape != self._reference.q.shape or not np.isfinite(target).all():
            return f"the target is not {self._robot.joints} finite numbers"
        if not (SLOWEST < move.speed < math.inf and SLOWEST < move.acceleration < math.inf):
            return f"speed {move.speed:g} and acceleration {move.acceleration:g} must be positive"
        near = self._path.end if self._reference.mode == path.MODE else None
        q = self.inverse(target, near) if move.pose else target
        if q is None:
            return f"no joint positions for the tool at {target.round(4).tolist()}"
        outside = self._limits.outside(q)
        if outside:
            return outside.text
        obstacle = ""
        goal = se3(target) if move.pose else self._kinematics.at(target)
        if move.blend_m > 0.0 or self._reference.mode == path.MODE:
            obstacle = self._flow(goal, q, move)
        elif not move.straight:
            self._reference.move(q, move.speed, move.acceleration)
        elif self._reference.qd.any():  # a line begins at rest
            self._reference.stop(PROGRAM_STOP_RAD_S2, lambda: self._line_after_stop(goal, move))
        else:
            obstacle = self._line(goal, move)
        self.waypoint = self._kinematics.pose(q)
        return obstacle

    def _flow(self, goal: "pin.SE3", q: Array, move: Move) -> str:
        """Begin a move that flows into the next one, or out of the one before."""
        start, top = self._path.end, self._robot.max_speed_rad_s
        if move.straight:
            stretch = path.line(self._kinematics, start, goal, move.speed, move.acceleration, top)
        else:
            stretch = path.joints(start, q, move.speed, move.acceleration, top)
        if isinstance(stretch, str):
            return stretch
        if stretch is not None:
            self._path.add(stretch)
        return ""

    def flows(self, blend_m: float) -> bool:
        """Whether the present move has ended, or is so near to its end that the next one may begin."""
        if blend_m <= 0.0 or self.interrupted is not None or not self._path.brakes:
            return self.over
        kinematics, reference = self._kinematics, self._reference
        way = kinematics.at(self._path.end).translation - kinematics.at(reference.q).translation
        return math.hypot(*way) < blend_m

    def _line_after_stop(self, goal: "pin.SE3", move: Move) -> None:
        obstacle = self._line(goal, move)
        if obstacle:
            self._supervisor.raise_exception(f"movel: {obstacle}")

    def _line(self, goal: "pin.SE3", move: Move) -> str:
        obstacle = motions.line(self._reference, self._kinematics, goal, move.speed, move.acceleration, self._robot.max_speed_rad_s)
        if obstacle:
            self._reference.hold()
        return obstacle

    @property
    def over(self) -> bool:
        """Whether the last motion has ended and no move waits for the program to continue."""
        return self._reference.at_rest and self.interrupted is None

    def interrupt(self) -> None:
        """Remember the present move: the arm is about to stop, and the move continues later."""
        if self._reference.mode in {"move", "line", path.MODE} or self._reference.queued:
            self.interrupted = self._last

    def forget(self) -> None:
        """Forget the interrupted move: its program has ended."""
        self.interrupted = None

    def resume(self) -> None:
        """Continue the interrupted move from where the arm stands."""
        move, self.interrupted = self.interrupted, None
        obstacle = "" if move is None else self.start(move)
        if obstacle:
            self._supervisor.raise_exception(obstacle)

    def stop(self, stop: StopMotion) -> None:
        """Make a stopj or a stopl. In a stopl the joints decelerate together, so that the tool has the given deceleration [m/s²]."""
        if not self._modes.may_move:
            return  # a program cannot make a safety stop softer
        self.interrupted = None
        reference = self._reference
        deceleration = stop.deceleration
        fastest = float(np.max(np.abs(reference.qd)))
        if stop.straight and fastest > 0.0:
            tool = float(np.linalg.norm(self._kinematics.speed(reference.q, reference.qd)[:3]))
            deceleration = min(deceleration * fastest / max(tool, 1e-3), STOP_MAX_RAD_S2)
        reference.stop(deceleration)

    def tool_speed(self, wanted: Array, acceleration: float) -> None:
        """Make a speedl: the tool moves at a speed (6,) along the base's axes [m/s, rad/s]. Each call replaces the speed."""
        if self._reference.mode != "speedl" or self._ask_tool_speed is None:
            self._ask_tool_speed = motions.tool_speed(self._kinematics, self._reference, self._robot.max_speed_rad_s)
        self._ask_tool_speed(wanted, acceleration)

    def sudden(self, target: Sequence[float]) -> Breach | None:
        """The first joint whose servoj target (J,) is farther from the last one than it can have moved."""
        before, since_s = self._servo_target, self._clock.now_s - self._servo_target_at_s
        if self._reference.mode != "servo" or before is None:
            before, since_s = self._reference.q.tolist(), self._clock.tick_s
        self._servo_target, self._servo_target_at_s = target, self._clock.now_s
        return self._limits.jump(target, before, since_s)

    def inverse(self, pose: Array, near: Array | None = None) -> Array | None:
        """(J,) joint positions for a tool pose (6,), near the given positions or else near the present ones; None if there are none."""
        return self._kinematics.inverse(se3(pose), self._reference.q if near is None else near)


# --- What makes an arm give way: force control along one direction, and freedrive -----------------------

FORCE_GAIN_M_S_N = 6e-4  # speed of the tool for each newton that is missing
FRICTION_HELP = 0.7  # share of its own model of friction that the controller adds in freedrive, so that the arm is light


@dataclass(frozen=True, slots=True)
class Comply:
    """A force_mode along one direction of the base: the tool presses with this force [N], and gives way no faster than this [m/s]."""

    direction: tuple[float, float, float]  # of length 1
    force_n: float
    speed_max_m_s: float = 0.05


class Compliance:
    """Force control and freedrive of one arm; a controller without them holds its path."""

    def __init__(self, arm: Arm, reference: Reference, kinematics: Kinematics, personality: Personality) -> None:
        self._arm, self._reference, self._kinematics, self._personality = arm, reference, kinematics, personality
        self._comply: Comply | None = None
        self.freedrive = False
        self.external_force_n: Array = np.zeros(3)  # (3,) force from outside at the tool, along the axes of the base

    def comply(self, comply: Comply | None) -> None:
        """Begin force control, or end it with None: the next move begins where the arm has been led."""
        self._comply = comply
        if comply is None:
            self._reference.keep()

    def end(self) -> None:
        """Hold the path again: the program has ended."""
        self.freedrive = False
        if self._comply is not None:
            self.comply(None)

    @property
    def any(self) -> bool:
        """Whether the arm gives way."""
        return self.freedrive or self._comply is not None

    def step(self, tick_s: float, substeps: int, encoder_q: Array) -> bool:
        """Give way for one control period. Returns whether that moved the arm, so that its servo must not."""
        if self.freedrive:
            arm = self._arm
            for _ in range(substeps):
                gravity = pin.computeGeneralizedGravity(arm.assumed_model, arm.assumed_model.createData(), arm.q)
                arm.push(tick_s / substeps, gravity + FRICTION_HELP * self._personality.target_friction_nm(arm.qd))
            self._reference.reset(encoder_q)
            return True
        if self._comply is not None:
            direction = np.array(self._comply.direction)
            missing = self._comply.force_n + float(direction @ self.external_force_n)  # what is felt pushes back
            speed = float(np.clip(FORCE_GAIN_M_S_N * missing, -self._comply.speed_max_m_s, self._comply.speed_max_m_s))
            twist = np.concatenate([speed * direction, np.zeros(3)])
            self._reference.give(tick_s * self._kinematics.towards(self._reference.q, twist))
        return False
