"""Base parameters: what of the standard parameters any motion can reveal, Raviola et al. (2021), §2.3; Gautier (1991).

The regressor stacked at random states shows which columns depend on columns to their left. Going left to right without pivoting
gives the basis of the paper's appendix; pivoting would give another, equally valid one that nobody could compare.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from monitor.model.regressor import parameter_names, regressor
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.recording import Array

RANDOM_STATES = 25  # as the paper; 150 equations for 78 columns
SEED = 20210083  # any seed gives the same basis: the states are only in general position
RANK_TOLERANCE = 1e-9  # of the largest column: rounding leaves 1e-15, the faintest true column of any UR stands above 1e-2


class Classification(NamedTuple):
    """The standard parameters by what a motion can reveal of them; every one is in exactly one of the three."""

    fully: tuple[str, ...]  # alone: its value may be quoted
    in_combination: tuple[str, ...]  # only in a sum with others
    not_identifiable: tuple[str, ...]  # no torque depends on it

    @property
    def counts(self) -> tuple[int, int, int]:
        """How many of each."""
        return len(self.fully), len(self.in_combination), len(self.not_identifiable)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Base:
    """A basis of the identifiable: base = combination · standard parameters, and Y[:, :, columns] · base = torque."""

    columns: tuple[int, ...]  # (B,) columns of the regressor that are kept
    combination: Array  # (B, P)
    singular_values: Array  # (P,) of the stacked regressor, largest first
    parameters: tuple[str, ...]  # (P,) names of the standard parameters

    @property
    def count(self) -> int:
        """B."""
        return len(self.columns)

    @property
    def terms(self) -> tuple[dict[str, float], ...]:
        """(B,) every combination as coefficients by the name of the standard parameter; the kept one leads."""
        rows = []
        for column, row in zip(self.columns, self.combination, strict=True):
            others = [int(k) for k in np.flatnonzero(row) if k != column]
            rows.append({self.parameters[k]: float(row[k]) for k in [column, *others]})
        return tuple(rows)

    @property
    def names(self) -> tuple[str, ...]:
        """(B,) short readable names: `m1z1 − 4.104·J2xz + …`."""
        return tuple(_short(terms) for terms in self.terms)

    @property
    def texts(self) -> tuple[str, ...]:
        """(B,) the combinations in full, four significant digits."""
        return tuple(_short(terms, len(self.parameters)) for terms in self.terms)

    @property
    def cumulative_energy(self) -> Array:
        """(P,) share of the regressor's energy Σσ² in its first singular values; 1 from the rank on."""
        energy = np.cumsum(self.singular_values**2)
        share: Array = energy / energy[-1]
        return share

    @property
    def by_column(self) -> Classification:
        """Fully identifiable is a kept column that no dropped column leans on.

        The choice of basis does not matter: those are the unit vectors in the row space of the regressor.
        """
        fully = {name for terms in self.terms if len(terms) == 1 for name in terms}
        return sorted_into(self.parameters, fully, set(self.without_effect))

    @property
    def as_in_paper(self) -> Classification:
        """As Raviola et al. (2021) count: a first moment m·x is a product, hence a combination of a mass and a coordinate.

        So no first moment is fully identifiable, and a mass without a column of its own is in combination where one of its moments shows.
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
    """Each parameter in its class, in the order of the parameters."""
    return Classification(
        tuple(name for name in parameters if name in fully),
        tuple(name for name in parameters if name not in fully and name not in hidden),
        tuple(name for name in parameters if name in hidden),
    )


def _short(terms: dict[str, float], longest: int = 4) -> str:
    (lead, _), *others = terms.items()
    text = lead
    for name, factor in others[: longest - 1]:
        size = "" if abs(abs(factor) - 1.0) < 5e-5 else f"{abs(factor):.4g}·"
        text += f" {'+' if factor > 0 else '−'} {size}{name}"
    return text + (" + …" if len(others) >= longest else "")


def base_parameters(robot: Robot, mounting: Mounting, tol: float = RANK_TOLERANCE, seed: int = SEED) -> Base:
    """The base parameters of a robot on a mounting; computed once for each pair.

    `tol` is relative to the largest column. Friction (fc, fv) always stands for itself.
    """
    return _base_parameters(_ByIdentity(robot), mounting, tol, seed)


class _ByIdentity:
    """A robot as a key of the cache: it holds arrays, so equality is being the same object."""

    __slots__ = ("robot",)

    def __init__(self, robot: Robot) -> None:
        self.robot = robot  # held, so its id cannot be given to another robot

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
    dependence = np.linalg.lstsq(Y[:, columns], Y, rcond=None)[0]  # (B, P): Y = Y_kept · combination
    # 1e-15 of rounding is not a dependence, and 1.0 reads better than 0.9999999999999981
    combination: Array = np.round(dependence, 12).astype(np.float64)
    combination[:, columns] = np.eye(len(columns))
    return Base(
        columns=tuple(columns),
        combination=combination,
        singular_values=np.asarray(np.linalg.svd(Y, compute_uv=False), dtype=float),
        parameters=parameter_names(robot.joints),
    )


def _left_to_right(Y: Array, tol: float) -> list[int]:
    """Unpivoted QR that keeps a column if what the kept ones leave of it exceeds `tol` of the largest column.

    A plain QR would also take a direction of rounding from every dependent column. Returns the kept columns.
    """
    largest = np.linalg.norm(Y, axis=0).max()
    Q = np.empty((len(Y), 0))
    kept: list[int] = []
    for k in range(Y.shape[1]):
        new = Y[:, k]
        for _ in range(2):  # twice is enough: Giraud et al. (2005)
            new = new - Q @ (Q.T @ new)
        remainder = np.linalg.norm(new)
        if remainder > tol * largest:
            kept.append(k)
            Q = np.column_stack([Q, new / remainder])
    return kept
