"""The arm that works: its model from the last replay, and the columns by which torque is explained."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.model.friction import CONCAVE, FC, FV
from monitor.model.regressor import Felt, felt_columns, felt_regressor, friction_columns
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.recording import Array, Indices

LOADS = 4  # unknowns of a load at the flange: m [kg], mx, my, mz [kg·m]
LEAST_RMS_NM, RMS_SHARE = 1e-3, 0.01  # of a residual that is not known: of the joint's largest torque
LAW = CONCAVE  # the friction of the last replay, from which work measures the difference; its first two terms are fc and fv


class Torques(NamedTuple):
    """What explains the torque of n rows: torque = rigid·p + friction·f + load·(what is at the flange beyond the replay's)."""

    rigid: Array  # (n, J, R)
    friction: Array  # (n, J, K) columns of `LAW`
    load: Array  # (n, J, 4)


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: what does not change with the rows is made once
class ProductionArm:
    """One arm with the identification of its last replay."""

    robot: Robot
    mounting: Mounting
    identification: Identification
    gains: Array | None = None  # (J,) [N·m/A]; None: the published torque constants
    payload_kg: float | None = None  # in the hand during that replay; None: nothing, or not known
    payload_com_m: tuple[float, float, float] | None = None  # None: where that of the work is

    def __post_init__(self) -> None:
        """Raises BadInput where the identification is of another robot."""
        if self.identification.robot != self.robot.name:
            raise BadInput(f"the identification is of a {self.identification.robot}, the robot is a {self.robot.name}")

    @property
    def joints(self) -> int:
        """J."""
        return self.robot.joints

    @cached_property
    def rigid_columns(self) -> tuple[int, ...]:
        """(R,) columns of the regressor that are rigid base parameters."""
        friction = np.concatenate(friction_columns(self.joints))
        return tuple(int(c) for c in self.identification.columns if c not in set(friction.tolist()))

    @cached_property
    def _felt(self) -> tuple[tuple[int, ...], Felt]:
        last = PER_JOINT * (self.joints - 1)
        columns = tuple(sorted({*self.identification.columns, *(last + k for k in range(LOADS))}))
        return columns, felt_columns(columns, self.joints, self.robot.innermost)

    @cached_property
    def rigid(self) -> Array:
        """(R,) rigid parameters of the last replay."""
        return rigid_parameters(self.identification, self.rigid_columns)

    @cached_property
    def residual_nm(self) -> Array:
        """(J,) RMS of what the replay's fit does not explain."""
        found = self.identification
        rms = found.rms_nm if found.residual_friction is None else found.residual_friction.rms_nm
        stand_in = RMS_SHARE * np.where(np.isfinite(self.robot.max_torque_nm), self.robot.max_torque_nm, 50.0)
        known: Array = np.maximum(np.where(np.isfinite(rms), rms, stand_in), LEAST_RMS_NM)
        return known

    @cached_property
    def friction(self) -> Array:
        """(J, K) terms of `LAW` by the last replay; 0 where unknown."""
        return friction_terms(self.identification)

    def torques(self, q: Array, qd: Array, qdd: Array, direction: Array) -> Torques:
        """The columns at states (n, J). direction : s(q̇) through the filter of the torque."""
        columns, felt = self._felt
        n, J = q.shape
        Y = np.zeros((n, J, len(columns)))
        for j, block in enumerate(felt_regressor(self.robot, self.mounting, felt, q, qd, qdd, direction)):
            Y[:, j, felt.places[j]] = block
        places = np.searchsorted(columns, self.rigid_columns)
        last = PER_JOINT * (J - 1)
        load = Y[:, :, np.searchsorted(columns, [last + k for k in range(LOADS)])]
        rigid = Y[:, :, places]
        gear = np.array([self.rigid_columns[k] % PER_JOINT != PER_JOINT - 1 for k in range(len(places))])
        through = rigid @ np.where(gear, self.rigid, 0.0)  # (n, J)
        terms = [term.column(direction, qd, through) for term in LAW.terms]
        return Torques(rigid, np.stack(terms, axis=-1), load)


def rigid_places(found: Identification, columns: tuple[int, ...]) -> Indices:
    """(R,) places of these rigid columns among the base parameters of an identification. Raises BadInput where one is missing."""
    places = np.searchsorted(found.columns, columns)
    if np.any(places >= len(found.columns)) or not np.array_equal(np.array(found.columns)[places], columns):
        raise BadInput(f"the base parameters of this {found.robot} are others than those of the work; expected the same kind of mounting")
    return places


def rigid_parameters(found: Identification, columns: tuple[int, ...]) -> Array:
    """(R,) rigid parameters of a replay, those that were fitted beside `LAW` where it was."""
    values = found.values if found.residual_friction is None else found.residual_friction.rigid
    rigid: Array = values[rigid_places(found, columns)]
    return rigid


def friction_terms(found: Identification) -> Array:
    """(J, K) terms of `LAW` by a replay: those of its residual friction where that has this law, else fc and fv alone; 0 where unknown."""
    J = len(found.coulomb_nm)
    terms = np.zeros((J, len(LAW.terms)))
    terms[:, 0], terms[:, 1] = found.coulomb_nm, found.viscous_nm_s_per_rad
    richer = found.residual_friction
    if richer is not None and richer.law == LAW:
        known = np.all(np.isfinite(richer.friction), axis=1)
        terms[known] = richer.friction[known]
    elif found.friction is not None and found.friction.law == LAW:
        terms = found.friction.values.copy()
    assert LAW.terms[:2] == (FC, FV)
    return np.nan_to_num(terms)
