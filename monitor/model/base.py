"""Base parameters: the combinations of standard parameters that motion reveals, Raviola et al. (2021), §2.3; Gautier (1991).

The regressor stacked at random states shows which columns depend on columns to their left. Column by column from left to right, without
pivoting, this gives the basis of the paper's appendix. Pivoting would give another basis, as valid, but not comparable with the paper's.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from monitor.model.regressor import COULOMB, VISCOUS, parameter_names, regressor
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.recording import Array

RANDOM_STATES = 25  # as in the paper; 150 equations for 78 columns
SEED = 20210083  # of the random states; every seed gives the same basis, since the states are in general position
# of the largest column: axes that are parallel or at right angles to a milliradian, as written in a URDF or measured of one arm, make
# columns that no recording tells apart; the smallest independent column of any UR is above 1e-2
RANK_TOLERANCE = 1e-3
ROUNDING = 0.01  # of the tolerance


class Classification(NamedTuple):
    """The standard parameters in three classes, by what a motion reveals of them. Every parameter is in one class."""

    fully: tuple[str, ...]  # identifiable individually
    in_combination: tuple[str, ...]  # identifiable only in a sum with others
    not_identifiable: tuple[str, ...]  # without effect on any torque

    @property
    def counts(self) -> tuple[int, int, int]:
        """The number of parameters in each class."""
        return len(self.fully), len(self.in_combination), len(self.not_identifiable)


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: its texts, which every verdict asks for, are made once
class Base:
    """A basis of the identifiable parameters: base = combination · standard, and torque = Y[:, :, columns] · base."""

    columns: tuple[int, ...]  # (B,) columns of the regressor that are kept
    combination: Array  # (B, P)
    singular_values: Array  # (P,) of the stacked regressor, largest first
    parameters: tuple[str, ...]  # (P,) names of the standard parameters

    @property
    def count(self) -> int:
        """B."""
        return len(self.columns)

    @cached_property
    def terms(self) -> tuple[dict[str, float], ...]:
        """(B,) the coefficients of each combination, by the name of the standard parameter; the kept parameter is the first."""
        rows = []
        for column, row in zip(self.columns, self.combination, strict=True):
            others = [int(k) for k in np.flatnonzero(row) if k != column]
            rows.append({self.parameters[k]: float(row[k]) for k in [column, *others]})
        return tuple(rows)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(B,) short names: `m1z1 − 4.104·J2xz + …`."""
        return tuple(_short(terms) for terms in self.terms)

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """(B,) the full combinations, with four significant digits."""
        return tuple(_short(terms, len(self.parameters)) for terms in self.terms)

    @property
    def cumulative_energy(self) -> Array:
        """(P,) fraction of the regressor's energy Σσ² in its first singular values; 1 from the rank on."""
        energy = np.cumsum(self.singular_values**2)
        share: Array = energy / energy[-1]
        return share

    @property
    def by_column(self) -> Classification:
        """The classes by columns: a parameter is fully identifiable where its column is kept and no dropped column depends on it.

        They do not depend on the basis: the fully identifiable parameters are the unit vectors in the row space of the regressor.
        """
        fully = {name for terms in self.terms if len(terms) == 1 for name in terms}
        return sorted_into(self.parameters, fully, set(self.without_effect))

    @property
    def as_in_paper(self) -> Classification:
        """The classes as Raviola et al. (2021) count them: a first moment m·x is a combination, as the product of mass and coordinate.

        So no first moment is fully identifiable. A mass without a column of its own is in combination where one of its moments is.
        """
        columns = self.by_column
        moments = {f"m{k}{axis}{k}": f"m{k}" for k in range(1, len(self.parameters) // PER_JOINT + 1) for axis in "xyz"}
        hidden = set(columns.not_identifiable)
        shown_by_a_moment = {mass for moment, mass in moments.items() if moment not in hidden}
        return sorted_into(self.parameters, set(columns.fully) - set(moments), hidden - shown_by_a_moment)

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Standard parameters that no motion on this mounting reveals, not even in a combination."""
        return tuple(name for name, used in zip(self.parameters, np.any(self.combination != 0.0, axis=0).tolist(), strict=True) if not used)


def sorted_into(parameters: tuple[str, ...], fully: set[str], hidden: set[str]) -> Classification:
    """Each parameter in its class, in the order of `parameters`. hidden : those without effect."""
    return Classification(
        tuple(name for name in parameters if name in fully),
        tuple(name for name in parameters if name not in fully and name not in hidden),
        tuple(name for name in parameters if name in hidden),
    )


def _short(terms: dict[str, float], longest: int = 4) -> str:
    """A combination as text, with `longest` terms at most."""
    (lead, _), *others = terms.items()
    text = lead
    for name, factor in others[: longest - 1]:
        size = "" if abs(abs(factor) - 1.0) < 5e-5 else f"{abs(factor):.4g}·"
        text += f" {'+' if factor > 0 else '−'} {size}{name}"
    return text + (" + …" if len(others) >= longest else "")


def base_parameters(robot: Robot, mounting: Mounting, tol: float = RANK_TOLERANCE, seed: int = SEED) -> Base:
    """The base parameters of a robot on a mounting, computed once for each pair.

    tol : relative to the largest column. seed : of the random states. The friction parameters fc and fv are always base parameters.
    """
    return _base_parameters(_ByIdentity(robot), mounting, tol, seed)


class _ByIdentity:
    """A robot as a key of the cache. It holds arrays, so two robots are equal where they are the same object."""

    __slots__ = ("robot",)

    def __init__(self, robot: Robot) -> None:
        self.robot = robot  # the reference keeps its id from being given to another robot

    def __hash__(self) -> int:
        return id(self.robot)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByIdentity) and other.robot is self.robot


@lru_cache(maxsize=32)
def _base_parameters(key: _ByIdentity, mounting: Mounting, tol: float, seed: int) -> Base:
    robot = key.robot
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(-np.pi, np.pi, (3, RANDOM_STATES, robot.joints))
    Y = regressor(robot, mounting, q, qd, qdd).reshape(-1, PER_JOINT * robot.joints)  # (25·J, P)
    columns = _left_to_right(Y, tol)
    dependence = np.zeros((len(columns), Y.shape[1]))  # (B, P): Y = Y_kept · combination
    rigid = [b for b, column in enumerate(columns) if column % PER_JOINT not in (COULOMB, VISCOUS)]  # friction depends on nothing
    dependence[rigid] = np.linalg.lstsq(Y[:, [columns[b] for b in rigid]], Y, rcond=None)[0]
    # a share far below what counts as a column of its own is rounding, of the arithmetic or of the file's angles
    norms = np.linalg.norm(Y, axis=0)
    shown = np.abs(dependence) * norms[columns, None] > ROUNDING * tol * np.max(norms)
    combination: Array = np.where(shown, np.round(dependence, 12), 0.0)
    combination[:, columns] = np.eye(len(columns))
    return Base(
        columns=tuple(columns),
        combination=combination,
        singular_values=np.asarray(np.linalg.svd(Y, compute_uv=False), dtype=float),
        parameters=parameter_names(robot.joints),
    )


def _left_to_right(Y: Array, tol: float) -> list[int]:
    """The kept columns of Y (n, P): those whose remainder, without the part along the columns kept before, exceeds `tol`·largest column.

    An unpivoted QR without this test would also keep a direction of rounding from every dependent column.
    """
    largest = np.linalg.norm(Y, axis=0).max()
    Q = np.empty((len(Y), 0))
    kept: list[int] = []
    for k in range(Y.shape[1]):
        new = Y[:, k]
        for _ in range(2):  # twice gives orthogonality to rounding: Giraud et al. (2005)
            new = new - Q @ (Q.T @ new)
        remainder = np.linalg.norm(new)
        if remainder > tol * largest:
            kept.append(k)
            Q = np.column_stack([Q, new / remainder])
    return kept
