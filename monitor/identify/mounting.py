"""Which direction is down, by the recording itself, and whether that contradicts the configured mounting.

Torque is linear in the direction of gravity and linear in the parameters. With gravity free, Y = Y₀ + Σₖ gₖ·Dₖ. All of it is reduced to one
triangular factor. The search is over a direction on the sphere; for each direction the parameters follow by least squares (variable
projection, Golub and Pereyra (1973)). Three things cannot be decided fully, and the warning names them. A rotation about gravity has no
effect. A component of gravity along an axis that is not excited has a small effect. The opposite direction of gravity with all weights
negative changes the torque only by the inertia of these weights.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from monitor.identify.fit.jackknife import CORRELATED_S
from monitor.identify.fit.least_squares import FELT, reduced, scattered, triangle
from monitor.identify.signals.motion import Motion
from monitor.model.base import base_parameters
from monitor.model.friction import STANDSTILL_SPEED_RAD_S
from monitor.model.identifiable import mounting_with_up
from monitor.model.regressor import Felt, felt_columns, felt_under, felt_weight
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Mask

CONTRADICTION_DEG = 2.0  # floors and brackets are off by less; on real recordings the estimate is right to 0.3°
VAGUE_DEG = 180.0  # standard deviation at which the data do not say where gravity is: one joint that moves about the vertical
SURE_STD = 5.0  # standard deviations by which the configured direction must explain the data worse
ALIKE = 0.5  # cosine between the fitted weights and the manufacturer's; with a payload or a tool it stays above 0.9
FEW_SAMPLES = 300  # for the quick check
SAMPLES = 1500  # of all motions together: the effect of gravity changes slowly, so more samples add little
ROUNDS = 30  # steps of one descent, at most
SETTLED_RAD = 1e-6  # step at which a descent ends
QUICKLY_SETTLED_RAD = 1e-3  # for the quick check: far below the contradiction, and the step after it would be a thousandth of it
NAMED_DEG = 10.0  # within this angle of a named mounting, the warning uses its name
RIDGE = 1e-12  # of a column's square: parameters that the motion does not excite stay near 0

_ASKEW = Mounting(roll_rad=0.7, pitch_rad=0.4)  # a general attitude: its base parameters serve for every attitude
_AXES = np.vstack([np.eye(3), -np.eye(3)])  # (6, 3) starts of the search
_KNOWN = {"ground": Mounting(), "ceiling": Mounting(roll_rad=math.pi), "wall": Mounting(roll_rad=math.pi / 2)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Upward:
    """The direction that is up by the data, beside the configured one."""

    up: Array  # (3,) unit vector in the base
    angle_rad: float  # to the configured up
    std_rad: float  # of that angle; infinite where the data do not determine it
    sign_by: str  # what tells up from down. "inertia": the data; "masses": the manufacturer's masses; "open": nothing
    surprise: float  # standard deviations by which the configured direction explains the data worse
    contradicts: bool  # the configured direction is wrong by the data, or its sign is wrong by the manufacturer's masses

    @property
    def mounting(self) -> Mounting:
        """The mounting with this direction up and yaw 0."""
        return mounting_with_up(self.up)


OPPOSITE_DEG = 170.0  # from which on gravity points the other way
MOUNTING_CONTRADICTION = Sentence(
    "mounting_contradiction",
    "gravity in the data is {angle_deg:.0f} ± {std_deg:.2g}° from where the mounting {mounting} puts it: "
    "likely is {likely}{sign}{offset}; rotation about the vertical (yaw) never shows in torques",
)
UP_BY_MASSES = Sentence("up_by_masses", "; up is told from down by the manufacturer's masses, not by these data")
UP_OPEN = Sentence("up_open", "; up and down stay open: the opposite direction explains the data as well")
SIGNS_AS_WELL = Sentence(
    "signs_as_well",
    "; up is told from down by the manufacturer's masses, not by these data: the opposite sign of all currents or torques would explain it "
    "as well",
)
OFFSET_AS_WELL = Sentence("offset_as_well", "; an offset of a joint's current or torque would explain it as well")


def contradicting(motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, mounting: Mounting) -> Upward | None:
    """Gravity in the data where it has another direction than the mounting gives it, else None. torques : (N, J) [N·m] of each motion."""
    if not motions or _agrees(motions, torques, robot, mounting):
        return None
    found = upward(motions, torques, robot, mounting)
    return found if found.contradicts and math.degrees(found.std_rad) < VAGUE_DEG else None


def mounting_check(motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, mounting: Mounting) -> Reason | None:
    """The warning `mounting_contradiction`, or None. Arguments as for `contradicting`."""
    found = contradicting(motions, torques, robot, mounting)
    return None if found is None else mounting_warning(found, motions, torques, robot, mounting)


def mounting_warning(found: Upward, motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, mounting: Mounting) -> Reason:
    """The warning of what `contradicting` has found."""
    offset: Reason | str = ""
    if not upward(motions, torques, robot, mounting, offsets=True).contradicts:
        offset = OFFSET_AS_WELL()
    angle_deg, std_deg = math.degrees(found.angle_rad), math.degrees(found.std_rad)
    sign = {"inertia": "", "masses": UP_BY_MASSES(), "open": UP_OPEN()}[found.sign_by]
    if found.sign_by == "masses" and angle_deg > OPPOSITE_DEG:
        sign = SIGNS_AS_WELL()
    return MOUNTING_CONTRADICTION(
        angle_deg=angle_deg,
        std_deg=max(std_deg, 0.1),
        mounting=_called(mounting),
        likely=likely_text(found.mounting),
        sign=sign,
        offset=offset,
    )


def _agrees(motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, mounting: Mounting) -> bool:
    """Whether a few hundred samples already confirm the mounting, with weights like the manufacturer's. This is the usual case.

    No other direction can then be that of the arm, and the search over the sphere is not needed.
    """
    problem = _Problem(motions, torques, robot, samples=FEW_SAMPLES)
    configured = -mounting.gravity_in_base / np.linalg.norm(mounting.gravity_in_base)
    up = problem.descend(_nudged(configured), QUICKLY_SETTLED_RAD)
    return bool(math.degrees(math.acos(min(1.0, float(up @ configured)))) < 0.5 * CONTRADICTION_DEG and problem.agreement(up) > ALIKE)


def upward(motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, mounting: Mounting, *, offsets: bool = False) -> Upward:
    """The direction up in the base, by motions and torques (N, J) [N·m]. The search starts from the axes and from the mounting.

    offsets : every joint's torque may have an offset, which would otherwise count as weight.
    """
    problem = _Problem(motions, torques, robot, offsets=offsets)
    configured = -mounting.gravity_in_base / np.linalg.norm(mounting.gravity_in_base)
    ends = [problem.descend(_nudged(start)) for start in (configured, *_AXES)]
    best = min(ends, key=problem.cost)
    least = max(problem.cost(best), 1e-18 * problem.size)  # rounding is no evidence
    opposite = problem.descend(_nudged(-best))
    noise = max(least / problem.evidence, 1e-300)  # of one independent sample

    def worse(cost: float) -> float:
        return math.sqrt(max(cost - least, 0.0) / noise)

    surprise = worse(problem.cost(configured))
    sign_by, upside_down = "inertia", False
    if opposite @ best < 0.0 and worse(problem.cost(opposite)) < SURE_STD:
        here, there = problem.agreement(best), problem.agreement(opposite)
        sign_by = "masses" if max(here, there) > ALIKE else "open"
        preferred = there > here if sign_by == "masses" else opposite @ configured > best @ configured
        best = opposite if preferred else best
        # the data agree with the configured direction, but with weights that push upwards; they agree with the opposite one too
        upside_down = surprise <= SURE_STD and problem.agreement(configured) < -ALIKE and problem.agreement(-configured) > ALIKE
        if upside_down and worse(problem.cost(-configured)) <= SURE_STD:
            best = -configured
    weight_shows = worse(problem.cost(np.zeros(3))) > SURE_STD
    angle = math.atan2(float(np.linalg.norm(np.cross(best, configured))), float(best @ configured))
    return Upward(
        up=best,
        angle_rad=angle,
        std_rad=problem.std_along(best, configured, noise),
        sign_by=sign_by,
        surprise=surprise,
        contradicts=bool(weight_shows and (surprise > SURE_STD or upside_down) and math.degrees(angle) > CONTRADICTION_DEG),
    )


class _Solved(NamedTuple):
    """Least squares for one direction up."""

    values: Array  # (B,)
    residual: Array  # (r,)
    A: Array  # (r, B) columns of unit length
    factor: Array  # (B, B) the lower triangle is Cholesky's of AᵀA


class _Problem:
    """Least squares with gravity free: the cost of a direction, its Gauss–Newton step, and the standard deviation of an angle."""

    def __init__(
        self, motions: Sequence[Motion], torques: Sequence[Array], robot: Robot, samples: int = SAMPLES, offsets: bool = False
    ) -> None:
        base = base_parameters(robot, _ASKEW)
        free = robot.joints if offsets else 0
        B = base.count + free
        kinds = np.array(base.columns) % PER_JOINT
        self.weighty = np.flatnonzero(kinds < 4)  # places of masses and first moments: gravity acts only on these
        self.nominal = np.append(base.combination @ robot.nominal_parameters(), np.zeros(free))  # (B,)
        step = max(1, sum(moved.samples for moved in motions) // samples)
        felt, W = felt_columns(base.columns, robot.joints, robot.innermost), len(self.weighty)
        weights = felt_columns([base.columns[k] for k in self.weighty], robot.joints, robot.innermost)
        rows = [_rows(moved, torque, robot, (felt, weights), step, offsets) for moved, torque in zip(motions, torques, strict=True)]
        factors, evidence = [], 0.0
        self.size = 0.0
        for j in range(robot.joints):
            A = np.concatenate([blocks[j][:, used[:, j]] for blocks, used in rows], axis=1)  # (K, n)
            if A.shape[1] <= B + 3 * W + 1 or not np.any(A[-1]):
                continue  # the joint hardly moves, or nobody measured its torque
            own = [base.count + j] if offsets else []
            places = np.concatenate([felt.places[j], own, *(B + k * W + weights.places[j] for k in range(3)), [B + 3 * W]]).astype(np.intp)
            size = np.linalg.norm(A, axis=1)
            acts = size > FELT * np.max(size)
            R = scattered(reduced(A[acts].T), places[acts], B + 3 * W + 1)
            # gravity is free in each sample's direction here, so the residual is noise and friction that no law describes
            n = A.shape[1]
            left = abs(R[-1, -1]) / math.sqrt(n)
            weight = 1.0 / max(left, 1e-9 * float(np.linalg.norm(R[:, -1])) / math.sqrt(n) + 1e-12)
            factors.append(weight * R)
            self.size += weight**2 * float(R[:, -1] @ R[:, -1])
            moving_s = sum(float(np.sum(used[:, j])) * step / moved.rate_hz for (_, used), moved in zip(rows, motions, strict=True))
            evidence += moving_s / CORRELATED_S  # independent samples
        self.evidence = max(evidence, 1.0)
        C = triangle(np.concatenate(factors)) if factors else np.zeros((1, B + 3 * W + 1))
        self._last: tuple[Array, _Solved] | None = None
        self.still, self.torque = C[:, :B], C[:, -1]
        self.pull = np.stack(np.split(C[:, B:-1], 3, axis=1))  # (3, r, W) what each weight does where up is x, y, z

    def _solved(self, up: Array) -> "_Solved":
        """`_solve`; a search asks for the cost of a direction, and then for its slopes."""
        if self._last is None or not np.array_equal(self._last[0], up):
            self._last = up.copy(), self._solve(up)
        return self._last[1]

    def _solve(self, up: Array) -> "_Solved":
        """The parameters that fit best with this direction up. Normal equations: fast, and precise enough for a search."""
        A = self.still.copy()
        A[:, self.weighty] += np.tensordot(up, self.pull, axes=1)
        norms = np.linalg.norm(A, axis=0)
        scale = np.where(norms > 0.0, norms, 1.0)
        A /= scale
        gram = A.T @ A  # (B, B) of unit diagonal
        gram.reshape(-1)[:: len(gram) + 1] += RIDGE
        factor, failed = scipy.linalg.lapack.dpotrf(gram, lower=1, clean=0)
        if failed:
            raise np.linalg.LinAlgError("the equations hold no numbers")  # RIDGE is far above rounding
        scaled = _back(factor, A.T @ self.torque)
        return _Solved(scaled / scale, self.torque - A @ scaled, A, factor)

    def cost(self, up: Array) -> float:
        """Weighted sum of squared residuals with this direction up; up = 0: without gravity."""
        residual = self._solved(up).residual
        return float(residual @ residual)

    def agreement(self, up: Array) -> float:
        """Cosine, −1 … 1, between the torques of the fitted weights and of the manufacturer's; 0 where those are not published."""
        pull = np.tensordot(up, self.pull, axes=1)  # (r, W)
        fitted, nominal = pull @ self._solved(up).values[self.weighty], pull @ self.nominal[self.weighty]
        cosine = float(fitted @ nominal) / max(float(np.linalg.norm(fitted) * np.linalg.norm(nominal)), 1e-300)
        return cosine if math.isfinite(cosine) else 0.0

    def _slopes(self, up: Array) -> tuple[Array, Array, Array]:
        """Residual (r,), its derivatives (r, 2) along two tangents of the sphere (3, 2). The parameters follow the direction."""
        values, residual, A, factor = self._solved(up)
        tangents = _tangents(up)
        moved = np.tensordot(tangents.T, self.pull @ values[self.weighty], axes=1).T  # (r, 2)
        return residual, A @ _back(factor, A.T @ moved) - moved, tangents

    def descend(self, up: Array, settled_rad: float = SETTLED_RAD) -> Array:
        """The nearest minimum: Gauss–Newton with Kaufman's derivative, damped so that the cost decreases."""
        cost, damping = self.cost(up), 1e-3
        for _ in range(ROUNDS):
            residual, slopes, tangents = self._slopes(up)
            H = slopes.T @ slopes
            if not np.trace(H) > 0.0:
                return up
            step = -np.linalg.solve(H + damping * np.trace(H) * np.eye(2), slopes.T @ residual)
            step *= min(1.0, 0.5 / max(float(np.linalg.norm(step)), 1e-300))
            tried = up + tangents @ step
            tried /= np.linalg.norm(tried)
            new = self.cost(tried)
            if new < cost:
                small = np.linalg.norm(step) < settled_rad or cost - new < 1e-10 * cost
                up, cost, damping = tried, new, damping / 10.0
                if small:
                    break
            else:
                damping *= 10.0
                if damping > 1e6:
                    break
        return up

    def std_along(self, up: Array, towards: Array, noise: float) -> float:
        """Standard deviation of the angle from `up` towards another direction [rad]."""
        _, slopes, tangents = self._slopes(up)
        H = slopes.T @ slopes
        across = tangents.T @ towards  # (2,)
        length = float(np.linalg.norm(across))
        s, V = np.linalg.eigh(H)
        if length < 1e-6:  # the same or the opposite direction: the standard deviation of the least certain tangent
            return math.sqrt(noise / s[0]) if s[0] > 1e-12 * self.size else math.inf
        part = (V.T @ (across / length)) ** 2  # (2,)
        return math.sqrt(noise * float(np.sum(part / np.maximum(s, 1e-12 * self.size + 1e-300))))


def _rows(moved: Motion, torque: Array, robot: Robot, felt: tuple[Felt, Felt], step: int, offsets: bool) -> tuple[list[Array], Mask]:
    """Of each joint its columns (K, n), and the rows that count (n, J), of every `step`-th sample.

    felt : of all columns, and of those of the weights. The columns are those without gravity, in the order of `felt`, one for an offset of
    the torque where there are `offsets`, those that gravity along −x, −y and −z adds for the weights, and the torque.
    """
    q, qd, qdd, direction = (signal[::step] for signal in (moved.q, moved.qd, moved.qdd, moved.direction))
    downward = np.stack([robot.gravity(mounting_with_up(up)) for up in np.eye(3)], axis=1)
    still, pulls = felt_under(robot, np.zeros((3, 1)), felt[0], q, qd, qdd, direction), felt_weight(robot, downward, felt[1], q)
    offset = np.ones((int(offsets), len(q)))
    blocks = [
        np.concatenate([own.T, offset, *pull, torque[None, ::step, j]]) for j, (own, pull) in enumerate(zip(still, pulls, strict=True))
    ]
    return blocks, np.abs(qd) > STANDSTILL_SPEED_RAD_S


def _back(factor: Array, b: Array) -> Array:
    """The x of L Lᵀ x = b, where L is the lower triangle of `factor`."""
    x, _ = scipy.linalg.lapack.dpotrs(factor, b, lower=1)
    return np.asarray(x)


def _tangents(up: Array) -> Array:
    """(3, 2) two unit vectors at right angles to the unit vector `up` and to each other: Duff et al. (2017)."""
    x, y, z = up.tolist()
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    return np.array([[1.0 + sign * x * x * a, x * y * a], [sign * x * y * a, sign + y * y * a], [-sign * x, -y]])


def _nudged(up: Array) -> Array:
    """The direction turned by a degree. Exactly along the axis of joint 1 the weight of link 1 has no column, and the slope is zero."""
    off = up + 0.02 * np.array([0.3, 0.5, 0.7])
    direction: Array = off / np.linalg.norm(off)
    return direction


def _called(mounting: Mounting) -> str:
    """The configured mounting by its name, else by its angles [°]."""
    for name, known in _KNOWN.items():
        if np.allclose(known.rotation, mounting.rotation, atol=1e-9):
            return name
    return ",".join(f"{math.degrees(angle):g}" for angle in mounting.angles_rad)


def likely_text(likely: Mounting) -> str:
    """A mounting with yaw 0: its angles [°], with a name where one is near."""
    up = -likely.gravity_in_base / np.linalg.norm(likely.gravity_in_base)
    roll, pitch, _ = (math.degrees(angle) + 0.0 if abs(angle) > math.radians(0.5) else 0.0 for angle in likely.angles_rad)  # no −0
    angles = f"roll {roll:.0f}°, pitch {pitch:.0f}°"
    for name, known in _KNOWN.items():
        away = -known.gravity_in_base / np.linalg.norm(known.gravity_in_base)
        if float(up @ away) > math.cos(math.radians(NAMED_DEG)):
            return f"{name} ({angles})"
    return angles
