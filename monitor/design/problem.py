"""One design task: the curves, the cell, the figure of merit. Its cost gives an order for any optimiser."""

import math
from dataclasses import dataclass, field

import numpy as np

from monitor.design.clearance import Surroundings
from monitor.design.curve import USED, Family
from monitor.design.objective import OBJECTIVES, Information
from monitor.errors import BadInput
from monitor.model.energy import flange_speed
from monitor.model.fourier import Excitation, State
from monitor.recording import Array

GRID = 100  # samples of a period for the figure of merit; twenty in a period of the fastest default harmonic
CLEARANCE_GRID = 250  # samples of a period for clearance: at 10 m/s² a gap falls by 2 mm between them, less than the reserve
APPROACH = np.linspace(0.1, 1.0, 10)[:, None]  # (10, 1) samples of a straight approach, as fractions of its length
REFINEMENT = 8  # samples for one, in stretches in which the bound is not sufficient
CHECK_RATE_HZ = 125.0  # of the check between samples that a new best must pass
FORBIDDEN = 1e6  # above every allowed cost; the violation is added, so that a search is led back to allowed curves
FARTHEST_START_RAD = 2.4  # [rad] from the pose of rest to the start: a replay refuses to approach from farther than 2.5
RESERVE_M = 0.003  # kept beyond the margins at the samples of the grid, since the path between them comes nearer


class Infeasible(BadInput):
    """No curve keeps the limits. The message names the limit that binds, and by how much it is broken."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """The cost of curves by their free coordinates, and whether a curve is allowed."""

    family: Family
    surroundings: Surroundings
    information: Information
    objective: str
    rest_rad: tuple[Array, ...] = ()  # poses (J,), besides the offset, from which the straight approach to the start must be free
    _times: Array = field(init=False)
    _between: Array = field(init=False)

    def __post_init__(self) -> None:
        """Raises BadInput for an unknown objective, Infeasible where the arm at rest at its offset already breaks a limit."""
        if self.objective not in OBJECTIVES:
            raise BadInput(f"objective {self.objective!r} is not known; known are {', '.join(OBJECTIVES)}")
        object.__setattr__(self, "_times", np.arange(GRID) * (self.family.period_s / GRID))
        object.__setattr__(self, "_between", np.arange(CLEARANCE_GRID) * (self.family.period_s / CLEARANCE_GRID))
        rest = self.family.offset_rad
        still = np.zeros((1, len(rest)))
        broken = self.broken(State(rest[None], still, still))
        if broken is not None:
            where = "start" if self.family.starts_there else "offset"
            raise Infeasible(f"standing at the {where} {np.round(rest, 4).tolist()} rad already, {broken}; choose another --{where}")

    def cost(self, u: Array) -> float:
        """The objective of the curve of u; FORBIDDEN and more where it breaks margins or torque limits at the samples of the grid."""
        excitation = self.family.excitation(u)
        state = excitation.at(self._times)
        ways = [start + APPROACH * (pose - start) for start in state.q[:1] for pose in self.approaches_rad]
        gaps, cell = self.surroundings.gaps(np.vstack([excitation.at(self._between).q, *ways])), self.surroundings.cell
        lacking = np.maximum(cell.self_margin_m + RESERVE_M - gaps.to_itself_m, 0.0).sum()
        lacking += np.maximum(cell.margin_m + RESERVE_M - gaps.to_cell_m, 0.0).sum()
        for pose in self.approaches_rad:
            lacking += np.maximum(np.abs(state.q[0] - pose) - FARTHEST_START_RAD, 0.0).sum()
        if lacking > 0.0:
            return FORBIDDEN * (2.0 + float(lacking))  # clearance first: it is faster to compute than torque
        Y, torque = self.information.rows(*state)
        over = np.maximum(np.abs(torque) / self.family.limits.torque_nm - 1.0, 0.0).sum()
        if over > 0.0:
            return FORBIDDEN * (1.0 + float(over) / (1.0 + float(over)))
        if math.isfinite(self.family.limits.flange_speed_m_s):
            fastest = float(np.max(flange_speed(self.family.robot, state.q, state.qd)))
            over = fastest / (USED * self.family.limits.flange_speed_m_s) - 1.0
            if over > 0.0:
                return FORBIDDEN * (1.0 + over / (1.0 + over))
        value = self.information.merit(self.objective, Y, state.qd, self.family.period_s)
        return value if np.isfinite(value) else FORBIDDEN

    @property
    def approaches_rad(self) -> tuple[Array, ...]:
        """Poses (J,) from which the arm approaches the start."""
        return (self.family.offset_rad, *self.rest_rad)

    def allowed(self, excitation: Excitation) -> bool:
        """Whether the whole path and the approaches keep their margins, between samples too.

        Where the bound at 125 Hz is not sufficient, those stretches are sampled more finely.
        """
        t = np.arange(round(excitation.period_s * CHECK_RATE_HZ) + 1) / CHECK_RATE_HZ
        state = excitation.at(t)
        around, cell = self.surroundings, self.surroundings.cell
        stretches = np.flatnonzero(around.unproved(state.q, bow(state.qdd, 1.0 / CHECK_RATE_HZ)))
        if len(stretches):
            finer = np.linspace(0.0, 1.0 / CHECK_RATE_HZ, REFINEMENT + 1)
            step = bow(state.qdd, 1.0 / CHECK_RATE_HZ / REFINEMENT)
            # gaps at the samples first: most curves that are not allowed are refused here
            near = around.gaps(state.q[stretches])
            if np.min(near.to_itself_m) < cell.self_margin_m or np.min(near.to_cell_m) < cell.margin_m:
                return False
            fine = excitation.at((t[stretches, None] + finer).ravel()).q  # (S·9, J), the stretches one after the other
            unproved = around.unproved(fine, step)
            unproved[REFINEMENT :: REFINEMENT + 1] = False  # there is no path from one stretch to the next
            if np.any(unproved):
                return False
        return all(around.line(pose, state.q[0]).keeps(cell) for pose in self.approaches_rad)

    def broken(self, state: State) -> str | None:
        """The first limit that a path through these samples breaks, as a clause; None where it breaks none."""
        near = self.surroundings.along(state.q).short_of(self.surroundings.cell)
        if near is not None:
            return near
        limits = self.family.limits
        torque = self.information.rows(*state)[1]
        share = np.max(np.abs(torque), axis=0) / limits.torque_nm
        j = int(np.argmax(share))
        if share[j] > 1.0:
            limit = limits.torque_nm[j]
            return f"joint {j + 1} needs {share[j] * limit:.1f} N·m, {(share[j] - 1.0) * limit:.1f} N·m beyond its limit of {limit:.1f} N·m"
        fastest = float(np.max(flange_speed(self.family.robot, state.q, state.qd)))
        if fastest > limits.flange_speed_m_s:
            beyond = fastest - limits.flange_speed_m_s
            return f"the flange moves at {fastest:.2f} m/s, {beyond:.2f} m/s beyond its limit of {limits.flange_speed_m_s:.2f} m/s"
        for pose in self.approaches_rad:
            far = np.abs(state.q[0] - pose)
            j = int(np.argmax(far))
            if far[j] > FARTHEST_START_RAD:
                beyond = far[j] - FARTHEST_START_RAD
                return (
                    f"joint {j + 1} starts {far[j]:.2f} rad from {pose[j]:.2f} rad, {beyond:.2f} rad farther than a replay would approach"
                )
            near = self.surroundings.line(pose, state.q[0]).short_of(self.surroundings.cell)
            if near is not None:
                return f"on the straight way from {np.round(pose, 3).tolist()} rad to the start, {near}"
        return None


def bow(qdd: Array, step_s: float) -> Array:
    """(J,) travel of a joint beyond |Δq| within a step of length h [rad].

    A joint may turn back once within the step. With |q̈| ≤ a, its way beyond the two end points is a·h²/4 at most.
    """
    farther: Array = 0.25 * 1.1 * np.max(np.abs(qdd), axis=0) * step_s**2  # 1.1: q̈ may peak between the samples
    return farther
