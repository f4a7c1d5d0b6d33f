"""The equations of motion of recordings, and where each unknown of a fit lies.

The unknowns x are the B base parameters, then, for laws richer than the paper's, each joint's friction parameters after fc and fv:
x = [base; joint 1's; joint 2's; …], X in all. The load of a gear is the torque of the rigid arm that the fit itself predicts. The measured
torque would be a wrong load: it contains the friction, and its noise would then stand on both sides of the equation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.felt import Felt
from monitor.identify.fit.jackknife import block_steps
from monitor.identify.fit.least_squares import Rows
from monitor.identify.signals.motion import Motion
from monitor.model.base import Base
from monitor.model.friction import PAPER, FrictionLaw
from monitor.model.regressor import ROTOR, felt_columns, felt_regressor, friction_columns
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.recording import Array, Indices, Mask


class Layout(NamedTuple):
    """Where the unknowns lie."""

    rigid: Mask  # (B,) False for fc and fv
    load: Mask  # (B,) the rigid parameters whose torque passes through the gear
    friction: Indices  # (J, 2) places of fc and fv
    frozen: bool  # True: rigid parameters stay at the prior

    def of_law(self, law: FrictionLaw) -> Indices:
        """(J, K) places of each joint's friction parameters, in the order of the law's terms."""
        J, extras = len(self.friction), len(law.extra_terms)
        return np.concatenate([self.friction, len(self.rigid) + np.arange(J * extras).reshape(J, extras)], axis=1)


def layout_of(columns: Sequence[int], joints: int, *, frozen: bool = False) -> Layout:
    """The layout for the columns (B,) of the regressor that the base parameters keep.

    A rotor's inertia loads the motor and not the gear. On the first joints the rotor has no column of its own, since no motion tells its
    inertia from that of the link. There it counts as load.
    """
    friction = np.searchsorted(columns, np.stack(friction_columns(joints), axis=1))  # (J, 2)
    rigid = np.ones(len(columns), dtype=bool)
    rigid[friction] = False
    return Layout(rigid, rigid & (np.asarray(columns) % PER_JOINT != ROTOR), friction, frozen)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equations:
    """One recording's rows in the paper's base parameters, from which the rows of any law are made."""

    motion: Motion
    Y: Felt  # (N, J, B) base regressor; the column of fc passed the filter of the torque
    torque_nm: Array  # (N, J)
    used: Mask  # (N, J) the rows that are fitted
    steps: Indices  # (N,) as in `Rows`

    def load(self, values: Array, layout: Layout) -> Array:
        """(N, J) torque through the gears [N·m] by base parameters `values` (B,)."""
        torque: Array = self.Y @ np.where(layout.load, values, 0.0)
        return torque

    def rows(self, law: FrictionLaw, values: Array, layout: Layout, robust_weight: Array | None = None) -> Rows:
        """The rows in the unknowns of the law, with the load that base parameters `values` (B,) predict. robust_weight : as in `Rows`."""
        Y, torque = self.Y, self.torque_nm
        if layout.frozen:
            torque = torque - Y @ np.where(layout.rigid, values, 0.0)
            Y = Y.only(~layout.rigid)
        if law.extra_terms:
            Y = Y.with_own(self.extra_columns(law, values, layout))
        return Rows(Y, torque, self.used, self.steps, self.motion.segments, robust_weight)

    def extra_columns(self, law: FrictionLaw, values: Array, layout: Layout) -> Array:
        """(N, J, K − 2) each joint's columns of the law after fc's and fv's, filtered as the torque was."""
        return self.motion.rounded(law.columns(self.motion.qd, self.load(values, layout), first=len(PAPER.terms)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitProblem:
    """What a fit needs to know."""

    equations: Sequence[Equations]  # of each recording
    layout: Layout
    prior: Array  # (B,) of base parameters that the data do not determine, and of frozen rigid parameters

    @property
    def redundancy(self) -> int:
        """One of so many samples says as much as all: enough to choose a law and for a covariance, at a fraction of the time."""
        return min(eq.motion.redundancy for eq in self.equations)


def equations_of(
    moved: Motion, torque_nm: Array, robot: Robot, mounting: Mounting, base: Base, *, all_rows: bool, moving_rad_s: float, block_s: float
) -> Equations:
    """The equations of one motion with torque_nm (N, J).

    all_rows : fit the rows in which a joint is slower than `moving_rad_s` too. block_s : length of the jackknife's blocks.
    The measured torque passed a filter that rounds the step of Coulomb friction, so the column of fc passes the same filter. With a sharp
    step in the column, fc would be too small by several of its standard deviations, and fv too large.
    """
    felt = felt_columns(base.columns, robot.joints, robot.innermost)

    def make(at: slice | Indices) -> list[Array]:
        return felt_regressor(robot, mounting, felt, moved.q[at], moved.qd[at], moved.qdd[at], moved.direction[at])

    Y = Felt(moved.samples, base.count, felt.places, make)
    used = np.ones(torque_nm.shape, dtype=bool) if all_rows else moved.moving(moving_rad_s)
    return Equations(motion=moved, Y=Y, torque_nm=torque_nm, used=used, steps=block_steps(moved, block_s))
