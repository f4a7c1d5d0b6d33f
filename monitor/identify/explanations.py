"""What else a recording may be: causes under which its torque is that of the arm, each with what it leaves unexplained.

A recording of the wrong columns, signs or units fits badly, and so does a sound one on another mounting. Each cause makes another recording
of the one that was given. All are fitted alike on a part of the rows, and the cause that leaves least is the likeliest. What counts is the
residual of each joint beside its torque, as a logarithm: this is the likelihood for noise of each joint's own size, and neither a unit nor
the order of the joints changes it. A cause after which friction surely drives joints is less likely than one after which it does not.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from monitor.identify.fit.jackknife import CORRELATED_S
from monitor.identify.mounting import likely_text
from monitor.identify.signals.motion import Motion
from monitor.model.base import base_parameters
from monitor.model.friction import STANDSTILL_SPEED_RAD_S
from monitor.model.regressor import felt_columns, felt_under, friction_columns
from monitor.model.robot import Mounting, Robot
from monitor.reason import Reason, Sentence, joints_by_number
from monitor.recording import Array, Mask

ROWS = 300  # of all recordings together
FEWEST_ROWS = 20  # in which a joint moves
RIDGE = 1e-10  # of a column's square: parameters that the motion does not excite stay near 0
REWEIGHTINGS = 3  # the scales of the joints settle to 1 % in two
REFERENCE_RAD_S = 0.4
DRIVES = 0.02  # of the torque's RMS: friction that pushes by more is none
SURE = 5.0  # standard deviations
SOUND = 0.15  # of the torque may be left on every joint where a cause explains the recording …
MUCH = 0.3  # … else a quarter of the residual must go: exp(−0.3)
AS_WELL = 0.1  # by which the logarithm of another cause's residual may be larger
LARGEST_GAIN = 200.0  # factor on one joint's torque: a gear's
TOGETHER = 3  # causes that may come together, at most
DOUBTFUL = 0.1  # of the torque: a sound recording leaves less
APART = 6.0  # times the share of its torque that another joint rubs; of real arms 4 at most
OUTERMOST = 3  # joints that carry little
FEWEST_IN_ORDER = 2  # two joints have no other order than exchanged
FELT = 1e-9  # of the largest column: a smaller one is rounding
ROUNDING = 1e-18  # of the torque's square
POSITIONS = ("q", "qd", "qdd", "direction")
GAINS = 15  # from the least to the largest: each 2.1 times the one before
TURNS_DEG = (90.0, -90.0, 180.0)  # between the zeros of two conventions
_ASKEW = Mounting(roll_rad=0.7, pitch_rad=0.4)  # its base parameters serve for every attitude

AS_GIVEN = Sentence("as_given", "the recording is what it was given as")
EXCHANGED_CURRENTS = Sentence("exchanged_currents", "the currents or torques of joints {joint} and {other} are exchanged")
EXCHANGED_POSITIONS = Sentence("exchanged_positions", "the positions of joints {joint} and {other} are exchanged")
EXCHANGED_JOINTS = Sentence("exchanged_joints", "joints {joint} and {other} are exchanged in all columns")
ORDER_CURRENTS = Sentence("order_currents", "the currents or torques of joints 1, 2, … are those of joints {order}")
ORDER_POSITIONS = Sentence("order_positions", "the positions of joints 1, 2, … are those of joints {order}")
ORDER_JOINTS = Sentence("order_joints", "all columns of joints 1, 2, … are those of joints {order}")
OTHER_SIGN = Sentence("other_sign", "the current or torque of joint {joint} has the opposite sign")
OTHER_SIGNS = Sentence("other_signs", "the currents or torques of {joints} have the opposite sign")
OTHER_AXIS = Sentence("other_axis", "joint {joint} turns the other way than the robot's model says")
OTHER_POSITION_SIGN = Sentence("other_position_sign", "the positions of joint {joint} have the opposite sign")
OTHER_ZERO = Sentence("other_zero", "the zero of joint {joint} is {turn_deg:.0f}° from that of the robot's model")
OTHER_GAIN = Sentence("other_gain", "the current, torque or gain of joint {joint} is {factor:.2g} times what it should be")
NM_FOR_A = Sentence("nm_for_a", "the currents are torques [N·m] already: name them actual_torque")
A_FOR_NM = Sentence("a_for_nm", "the torques are currents [A]: name them actual_current")
OTHER_OFFSET = Sentence("other_offset", "the current or torque of joint {joint} has an offset")
OTHER_MOUNTING = Sentence("other_mounting", "the mounting is {likely}")
BOTH_CAUSES = Sentence("both_causes", "{one}, and {other}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows:
    """Samples of the recordings, (n, J) each."""

    q: Array
    qd: Array
    qdd: Array
    direction: Array
    torque: Array
    gravity: Array  # (3,) in DH frame 0 [m/s²]
    independent: float  # of the samples of a joint, in the mean

    def changed(self, positions: Array, torques: Array) -> "_Rows":
        """With positions and torques that are sums of these: (J, J) each."""
        moved = {name: getattr(self, name) @ positions.T for name in POSITIONS}
        return replace(self, **moved, torque=self.torque @ torques.T)


class Explained(NamedTuple):
    """A cause, and what is left of the torque where it is the right one."""

    cause: Reason
    rows: _Rows  # as the cause makes them
    left: Array  # (J,) residual beside torque, RMS; NaN for a joint that hardly moves
    rubbing: Array  # (J,) friction at the reference speed, or where the joint is slower at its own [N·m]; NaN likewise
    drives: int  # joints that friction would drive
    score: float  # mean logarithm of what is left

    @property
    def worst(self) -> float:
        """What is left of the torque of the joint that fits worst."""
        return float(np.nanmax(self.left, initial=0.0, where=np.isfinite(self.left)))


class _Order(NamedTuple):
    """Joints in another order (J, J), and what it is called of torques, of positions, and of both."""

    change: Array
    torques: Reason
    positions: Reason
    both: Reason


class _Problem:
    """Least squares of one set of positions, for any torques that are made of the recorded ones."""

    def __init__(self, robot: Robot, rows: _Rows, seen: Mask) -> None:
        base = base_parameters(robot, _ASKEW)
        J, B = robot.joints, base.count
        felt = felt_columns(base.columns, J, robot.innermost)
        blocks = felt_under(robot, rows.gravity[:, None], felt, rows.q, rows.qd, rows.qdd, rows.direction)
        self.unknowns, self.seen, self.rows = B, seen, rows
        self.coulomb, self.viscous = (np.searchsorted(base.columns, own) for own in friction_columns(J))
        self.speed = np.minimum(REFERENCE_RAD_S, np.quantile(np.abs(rows.qd), 0.9, axis=0))  # none is faster than the joint
        self.grams = np.zeros((J, B + J + 1, B + J + 1))  # of the unknowns, the torques of all joints, and an offset
        on, ones = (np.abs(rows.qd) > STANDSTILL_SPEED_RAD_S).T, np.ones((1, len(rows.q)))
        for j in np.flatnonzero(seen):
            own = np.concatenate([felt.places[j], np.arange(B, B + J + 1)])
            A = np.concatenate([blocks[j].T, rows.torque.T, ones])  # (K, n), memory along the samples as in the blocks
            self.grams[np.ix_([j], own, own)] = (A * on[j]) @ A.T / max(int(np.sum(on[j])), 1)

    def explained(self, cause: Reason, torques: Array | None = None, offset: int | None = None) -> Explained:
        """The fit of torques (J, J), of each joint as a sum of the recorded ones. offset : the joint whose torque may have one."""
        J, B = len(self.seen), self.unknowns
        torques = np.eye(J) if torques is None else torques
        keep = np.zeros((J, B + 2, B + J + 1))  # unknowns, offset, torque
        keep[:, :B, :B], keep[:, B + 1, B : B + J] = np.eye(B), torques
        if offset is not None:
            keep[offset, B, -1] = 1.0
        grams = keep @ self.grams @ keep.swapaxes(1, 2)
        sizes = grams[:, -1, -1]
        seen = self.seen & (sizes > 0.0)
        weights = np.where(seen, 1.0 / np.where(seen, sizes, 1.0), 0.0)
        values, squares, unsure = np.zeros(B + 1), sizes, np.zeros(J)
        speeds = np.zeros((B + 1, J))  # friction at a speed, as sums of the unknowns
        speeds[self.coulomb, np.arange(J)], speeds[self.viscous, np.arange(J)] = 1.0, self.speed
        for _ in range(REWEIGHTINGS):
            G = np.tensordot(weights, grams, 1)
            scale = np.sqrt(np.diag(G)[:-1])
            scale = np.where(scale > FELT * np.max(scale, initial=0.0), scale, np.inf)
            normal = G[:-1, :-1] / scale[:, None] / scale
            normal.reshape(-1)[:: B + 2] = 1.0 + RIDGE
            asked = np.column_stack([G[:-1, -1], speeds]) / scale[:, None]
            answer = scipy.linalg.solve(normal, asked, assume_a="pos") / scale[:, None]
            values, unsure = answer[:, 0], np.sqrt(np.einsum("xj,xj->j", speeds, answer[:, 1:]) / self.rows.independent)
            x = np.append(values, -1.0)
            squares = np.maximum((grams @ x) @ x, ROUNDING * sizes)
            weights = np.where(seen, 1.0 / np.where(seen, squares, 1.0), 0.0)
        left = np.where(seen, np.sqrt(squares / np.where(seen, sizes, 1.0)), np.nan)
        mean = float(np.mean(np.log(left[seen]))) if seen.any() else 0.0
        rubbing = values @ speeds
        drives = int(np.sum(seen & (rubbing < -DRIVES * np.sqrt(sizes)) & (rubbing < -SURE * unsure)))
        rows = replace(self.rows, torque=self.rows.torque @ torques.T)
        return Explained(cause, rows, left, np.where(seen, rubbing, np.nan), drives, mean)


class Explanations:
    """What else recordings may be. torques : (N, J) [N·m] of each motion. other : the mounting that the data say, where it is another."""

    def __init__(
        self, motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, mounting: Mounting, other: Mounting | None = None
    ) -> None:
        step = max(1, sum(moved.samples for moved in motions) // ROWS)
        parts = [[getattr(moved, name)[::step] for name in POSITIONS] for moved in motions]
        q, qd, qdd, direction = (np.concatenate(signal) for signal in zip(*parts, strict=True))
        torque = np.concatenate([torque[::step] for torque in torques])
        on = np.abs(qd) > STANDSTILL_SPEED_RAD_S
        self.robot, self.other = robot, other
        self.seen = (np.sum(on, axis=0) >= FEWEST_ROWS) & np.any(torque != 0.0, axis=0)
        moving_s = np.sum(on, axis=0) * step / motions[0].rate_hz
        self.evidence = float(np.sum(moving_s[self.seen])) / CORRELATED_S  # independent samples
        self.measured = any(moved.current is None for moved in motions)  # torque itself
        independent = max(1.0, self.evidence / max(1, int(np.sum(self.seen))))
        rows = _Rows(q=q, qd=qd, qdd=qdd, direction=direction, torque=torque, gravity=robot.gravity(mounting), independent=independent)
        self.as_it_is = _Problem(robot, rows, self.seen).explained(AS_GIVEN())

    @property
    def doubtful(self) -> bool:
        """Whether a look at all causes is worth its time.

        A joint fits badly, is driven by friction, or rubs much more of what it can give than another; or two of the outermost joints may be
        exchanged: these carry little, so that a recording with two of them exchanged in all columns still fits.
        """
        if self.as_it_is.worst > DOUBTFUL or self.as_it_is.drives:
            return True
        with np.errstate(invalid="ignore"):
            share = (self.as_it_is.rubbing / self.robot.max_torque_nm)[self.seen]
        if np.all(share > 0.0) and len(share) and np.max(share) > APART * np.min(share):
            return True
        inner = np.eye(self.robot.joints)[:-OUTERMOST]
        outer = [order for order in self._orders() if np.array_equal(order.change[:-OUTERMOST], inner)]
        return any(self._explains(self._changed(self.as_it_is.rows, order)[1], self.as_it_is) for order in outer)

    def likeliest(self) -> list[Explained]:
        """Causes that explain the recordings surely better than they are, the likeliest first; none for a sound recording.

        Where one cause leaves much, others are looked for beside it, and count together where they leave a sound fit.
        """
        found = self._after(self.as_it_is)
        told = [one for one in found if self._explains(one, self.as_it_is)]
        best = found[0] if found else self.as_it_is
        for _ in range(TOGETHER - 1):
            if best.worst < SOUND and best.drives == 0:
                break
            beside = self._after(best)[0]
            if beside.score >= best.score and beside.drives >= best.drives:
                break
            best = beside._replace(cause=BOTH_CAUSES(one=best.cause, other=beside.cause))
            if best.worst < SOUND and self._explains(best, self.as_it_is):
                told = [best, *told]
        return told

    def _after(self, before: Explained) -> list[Explained]:
        """All causes beside those that made these rows, the likeliest first."""
        found = [*self._of_torques(before), *self._of_positions(before.rows)]
        return sorted(found, key=lambda one: (one.drives, one.score))

    def _explains(self, one: Explained, before: Explained) -> bool:
        """Whether the cause is surely better, and what it leaves is a sound fit or at least much less."""
        less = before.score - one.score
        if one.drives == 0 < before.drives:
            return less > -AS_WELL
        sure = less > 0.0 and math.sqrt(2.0 * self.evidence * less) > SURE
        return sure and one.drives <= before.drives and (less > MUCH or one.worst < SOUND)

    def _of_torques(self, before: Explained) -> Iterator[Explained]:
        """Causes that leave the positions as they are."""
        problem, J = _Problem(self.robot, before.rows, self.seen), self.robot.joints
        driven = np.flatnonzero(before.rubbing < 0.0)
        if len(driven) > 1:
            signs = np.ones(J)
            signs[driven] = -1.0
            yield problem.explained(OTHER_SIGNS(joints=joints_by_number((driven + 1).tolist())), np.diag(signs))
        for order in self._orders():
            yield problem.explained(order.torques, order.change)
        for j in np.flatnonzero(self.seen).tolist():
            yield problem.explained(OTHER_SIGN(joint=j + 1), _scaled(J, j, -1.0))
            yield problem.explained(OTHER_OFFSET(joint=j + 1), offset=j)
            yield self._of_gain(problem, j)
        cause, factor = unit_cause(self.robot, measured=self.measured)
        if np.all(np.isfinite(factor)):
            yield problem.explained(cause, np.diag(factor))

    def _of_gain(self, problem: _Problem, j: int) -> Explained:
        """The factor on one joint's torque that explains most."""
        J, most = self.robot.joints, math.log(LARGEST_GAIN)

        def score(power: float) -> float:
            return problem.explained(AS_GIVEN(), _scaled(J, j, math.exp(-power))).score

        powers = np.linspace(-most, most, GAINS)
        nearest = float(powers[int(np.argmin([score(power) for power in powers]))])
        around = nearest - 2.0 * most / (GAINS - 1), nearest + 2.0 * most / (GAINS - 1)
        best = scipy.optimize.minimize_scalar(score, bounds=around, method="bounded", options={"maxiter": 8})
        return problem.explained(OTHER_GAIN(joint=j + 1, factor=math.exp(best.x)), _scaled(J, j, math.exp(-best.x)))

    def _of_positions(self, rows: _Rows) -> Iterator[Explained]:
        """Causes after which the arm stands elsewhere: exchanged and turned joints, another zero, another mounting."""
        robot, seen, same = self.robot, self.seen, np.eye(self.robot.joints)
        for order in self._orders():
            yield from self._changed(rows, order)
        for j in np.flatnonzero(seen).tolist():
            change = _scaled(robot.joints, j, -1.0)
            problem = _Problem(robot, rows.changed(change, same), seen)
            yield problem.explained(OTHER_POSITION_SIGN(joint=j + 1))
            yield problem.explained(OTHER_AXIS(joint=j + 1), change)
            for turn_deg in TURNS_DEG:
                turned = replace(rows, q=rows.q + math.radians(turn_deg) * same[j])
                yield _Problem(robot, turned, seen).explained(OTHER_ZERO(joint=j + 1, turn_deg=turn_deg))
        if self.other is not None:
            gravity = robot.gravity(self.other)
            yield _Problem(robot, replace(rows, gravity=gravity), seen).explained(OTHER_MOUNTING(likely=likely_text(self.other)))

    def _changed(self, rows: _Rows, order: _Order) -> tuple[Explained, Explained]:
        """The positions in another order, and all columns."""
        problem = _Problem(self.robot, rows.changed(order.change, np.eye(len(order.change))), self.seen)
        return problem.explained(order.positions), problem.explained(order.both, order.change)

    def _orders(self) -> Iterator[_Order]:
        """Joints that change places: two of them, all by some places, or from the last to the first."""
        J, exchanged = self.robot.joints, (EXCHANGED_CURRENTS, EXCHANGED_POSITIONS, EXCHANGED_JOINTS)
        for j, k in self._pairs():
            yield _Order(_exchange(J, j, k), *(cause(joint=j + 1, other=k + 1) for cause in exchanged))
        places = np.arange(J)
        if J > FEWEST_IN_ORDER and self.seen.all():
            for order in (*(np.roll(places, by) for by in places[1:]), places[::-1]):
                causes = (cause(order=order + 1) for cause in (ORDER_CURRENTS, ORDER_POSITIONS, ORDER_JOINTS))
                yield _Order(np.eye(J)[np.argsort(order)], *causes)

    def _pairs(self) -> Iterator[tuple[int, int]]:
        """Two joints that move."""
        joints = np.flatnonzero(self.seen).tolist()
        return ((j, k) for at, j in enumerate(joints) for k in joints[at + 1 :])


def unit_cause(robot: Robot, *, measured: bool) -> tuple[Reason, Array]:
    """That currents are torques or torques currents, and the factor on the torque (J,) then; NaN where gains are not known.

    measured : whether the recording has torque itself.
    """
    gains = robot.drive_gain_nm_per_a
    return (A_FOR_NM(), gains) if measured else (NM_FOR_A(), 1.0 / gains)


def _exchange(joints: int, j: int, k: int) -> Array:
    """(J, J) with which two joints change places."""
    order = np.arange(joints)
    order[[j, k]] = k, j
    return np.eye(joints)[order]


def _scaled(joints: int, j: int, factor: float) -> Array:
    """(J, J) with which one joint has so many times its size."""
    change = np.eye(joints)
    change[j, j] = factor
    return change
