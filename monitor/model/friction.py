"""Friction laws: the registry of the laws that an identification can fit, and the terms that they are made of.

A law is a sum of terms, each linear in one parameter. The regressor, the fit, the prediction and the compensated torque model all read
the terms of the law from here, so the law that is fitted is the law that predicts. Every law begins with the terms fc and fv of the paper,
Raviola et al. (2021), eq. (2). A new law is one more entry of `LAWS`, with the terms that it needs.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from monitor.errors import BadInput
from monitor.recording import Array

SIGN_SPEED_RAD_S = 0.001  # width of tanh(q̇/0.001), which stands for sgn(q̇): Raviola et al. (2021), eq. (2)
STANDSTILL_SPEED_RAD_S = 0.02  # at a lower speed friction is stiction, and the torque depends on what was before
STRIBECK_SPEED_RAD_S = 0.1  # v_s: fixed, so that the law is linear; the residual hardly changes between 0.05 and 0.2 rad/s
CONCAVE_EXPONENT = 0.5  # p: factory sweeps of a UR5e fit best with 0.52–0.63; with 0.5 the column differs most from those of fc and fv
PROBED_LOADS_NM = (1.0, 50.0)  # a magnitude that depends on the load differs between them
PROBED_SPEEDS_RAD_S = (0.0, 0.1, 1.0)
LOAD_SHARE_STD = 0.2  # fl of healthy gears is 0.02–0.1; on a joint without load the data do not limit fl, and this prior does
Quantity = TypeVar("Quantity", float, Array)
AUTO = "auto"  # in the place of a law's name: choose the law by cross-validation


def smooth_sign(qd: Array) -> Array:
    """Direction of motion s(q̇) = tanh(q̇/v₀), −1 … 1 and zero at rest. q̇ [rad/s] may have any shape; the result has the same shape."""
    sign: Array = np.tanh(qd / SIGN_SPEED_RAD_S)
    return sign


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionTerm:
    """One term of a friction law: parameter · magnitude(|q̇|, |τ|) · direction of motion.

    τ is the torque through the gear without friction [N·m]. The magnitude is a function of a module, not a lambda, because
    identifications travel between processes.
    """

    name: str  # of the parameter, as JSON spells it
    magnitude: Callable[[Any, Any], Any]  # of |q̇| [rad/s] and |τ| [N·m], arrays of one shape or plain numbers; not negative
    smooth: bool = True  # True: the direction is s(q̇). False: it is sgn(q̇), for a magnitude that is zero at rest
    loaded: bool = False  # True: the magnitude depends on |τ|
    braking: bool = False  # True: the term counts only where the load drives the joint, and the motor brakes: τ·q̇ < 0
    expected_std: float = math.inf  # prior standard deviation of the parameter about 0; infinite: no prior

    def __post_init__(self) -> None:
        """Raises ValueError where the magnitude depends on the load and `loaded` is False: the load would then be taken to be 0."""
        if not self.loaded and self._depends_on_load():
            raise ValueError(f"friction term {self.name!r}: its magnitude depends on the load; expected loaded=True")

    def _depends_on_load(self) -> bool:
        """Whether another load gives another magnitude at one of the probed speeds."""
        speeds = np.array(PROBED_SPEEDS_RAD_S)
        low, high = (self.magnitude(speeds, np.full_like(speeds, load)) for load in PROBED_LOADS_NM)
        return not np.array_equal(low, high)

    def column(self, direction: Array, qd: Array, load_nm: Array) -> Array:
        """Torque per unit of the parameter.

        direction : s(q̇), or s(q̇) after the filter of the measured torque; qd [rad/s] and load_nm [N·m] have the same shape.
        """
        magnitude: Array = self.magnitude(np.abs(qd), np.abs(load_nm))
        if self.braking:
            magnitude = np.where(qd * load_nm < 0.0, magnitude, 0.0)
        return magnitude * direction if self.smooth else np.copysign(magnitude, qd)


def _one(_speed: Quantity, _load: Quantity) -> float:
    return 1.0


def _speed(speed: Quantity, _load: Quantity) -> Quantity:
    return speed


def _load(_speed: Quantity, load: Quantity) -> Quantity:
    return load


def _root_of_speed(speed: Quantity, _load: Quantity) -> Quantity:
    root: Quantity = speed**CONCAVE_EXPONENT
    return root


def _stribeck(speed: Quantity, _load: Quantity) -> Quantity:
    grip: Quantity = math.e ** -((speed / STRIBECK_SPEED_RAD_S) ** 2)
    return grip


FC = FrictionTerm(name="fc", magnitude=_one)  # [N·m] Coulomb friction
FV = FrictionTerm(name="fv", magnitude=_speed, smooth=False)  # [N·m·s/rad] viscous friction
# fraction of |τ|: teeth under load have more friction
FL = FrictionTerm(name="fl", magnitude=_load, loaded=True, expected_std=LOAD_SHARE_STD)
# fraction of |τ| that gears cost where the motor brakes, beyond what they cost where it drives; less than 0 where they cost less
FB = FrictionTerm(name="fb", magnitude=_load, loaded=True, braking=True, expected_std=LOAD_SHARE_STD)
# [N·m] at 1 rad/s: friction of harmonic drives is concave in speed
FP = FrictionTerm(name="fp", magnitude=_root_of_speed)
# [N·m] friction beyond fc before the lubricant film carries, Stribeck; Armstrong-Hélouvry et al. (1994)
FS = FrictionTerm(name="fs", magnitude=_stribeck)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionLaw:
    """A sum of terms: friction torque of joint j = Σₖ parameterₖⱼ · columnₖ(q̇ⱼ, τⱼ). The first two terms are `FC` and `FV`.

    What the paper would call fc and fv of a richer law is the line nearest to it over the samples of the recording; it follows from
    the columns (`identify.fit.projection`).
    """

    name: str
    terms: tuple[FrictionTerm, ...]  # K terms
    automatic: bool = True  # whether the choice `auto` considers the law

    def __post_init__(self) -> None:
        """Raises ValueError where the law does not begin with fc and fv."""
        if self.terms[:2] != (FC, FV):
            raise ValueError(f"friction law {self.name!r} begins with {', '.join(self.parameters[:2])}; expected fc, fv")

    @property
    def parameters(self) -> tuple[str, ...]:
        """K names of the parameters."""
        return tuple(term.name for term in self.terms)

    @property
    def extra_terms(self) -> tuple[FrictionTerm, ...]:
        """K − 2 terms after fc and fv."""
        return self.terms[2:]

    @property
    def loaded(self) -> bool:
        """Whether the law needs the torque through the gear."""
        return any(term.loaded for term in self.terms)

    def columns(self, qd: Array, load_nm: Array | None = None, first: int = 0) -> Array:
        """Torque per unit of each parameter from the `first` one on, (…, J, K). Memory runs along the samples.

        qd : (…, J) joint speeds [rad/s]. load_nm : (…, J) torque through the gears without friction [N·m].
        Raises BadInput where the law needs the load and `load_nm` is None.
        """
        if load_nm is None:
            if self.loaded:
                raise BadInput(f"friction law {self.name!r} needs the torque that the gear passes on")
            load_nm = np.zeros_like(qd)
        direction = smooth_sign(qd)
        terms = self.terms[first:]
        columns = np.empty((*qd.shape, len(terms)), order="F")
        for k, term in enumerate(terms):
            columns[..., k] = term.column(direction, qd, load_nm)
        return columns

    def torque(self, parameters: Array, qd: Array, load_nm: Array | None = None) -> Array:
        """Friction torque (N, J) [N·m].

        parameters : (J, K). qd : (N, J) [rad/s]. load_nm : (N, J) torque through the gears [N·m]. Raises BadInput as `columns`.
        """
        torque: Array = np.einsum("njk,jk->nj", self.columns(qd, load_nm), parameters)
        return torque

    def opposing_torque(self, parameters: Sequence[Quantity], direction: Quantity, speed: Quantity, load: Quantity) -> Quantity:
        """Friction torque against the motion [N·m] of a joint that drives its load, of arrays or of plain numbers.

        parameters : K, (J,) each. direction : |s(q̇)|, speed : |q̇| [rad/s], load : |τ| [N·m]; (N, J) each.
        """
        smooth = other = 0.0 * speed
        for value, term in zip(parameters, self.terms, strict=True):
            if term.braking:
                continue
            if term.smooth:
                smooth = smooth + value * term.magnitude(speed, load)
            else:
                other = other + value * term.magnitude(speed, load)
        return direction * smooth + other


PAPER = FrictionLaw(name="paper", terms=(FC, FV))  # Raviola et al. (2021), eq. (2)
CONCAVE = FrictionLaw(name="concave", terms=(FC, FV, FL, FP))

# From the simplest to the richest: `auto` prefers an earlier law to a later one.
LAWS: dict[str, FrictionLaw] = {
    law.name: law
    for law in (
        PAPER,
        FrictionLaw(name="load", terms=(FC, FV, FL)),
        CONCAVE,
        FrictionLaw(name="stribeck", terms=(FC, FV, FL, FS)),
        FrictionLaw(name="braking", terms=(FC, FV, FL, FP, FS, FB)),
    )
}

# The law whose terms predict torque beside fc and fv. It erred least on recordings that were not fitted.
RESIDUAL_LAW = "concave"


def friction_law(name: str) -> FrictionLaw:
    """The law of that name.

    Raises BadInput listing the laws that are known.
    """
    if name not in LAWS:
        raise BadInput(f"friction law {name!r} is not known; known are {', '.join(LAWS)}, and {AUTO} where it is to be chosen")
    return LAWS[name]


def residual_law() -> FrictionLaw:
    """The law of the residual friction: what the compensated torque model predicts beyond fc and fv."""
    return friction_law(RESIDUAL_LAW)


def automatic_laws() -> tuple[FrictionLaw, ...]:
    """The laws that `auto` chooses from; the first is the paper's."""
    return (PAPER, *(law for law in LAWS.values() if law.automatic and law != PAPER))


def law_of_every_term() -> FrictionLaw:
    """A law with each term of the laws that `auto` chooses from, once."""
    terms = dict.fromkeys(term for law in automatic_laws() for term in law.terms)
    return FrictionLaw(name="every term", terms=tuple(terms), automatic=False)


def law_choices() -> str:
    """The names of the laws for the help of an option: `paper (fc, fv), load, …`."""
    simplest, *others = LAWS.values()
    return ", ".join([f"{simplest.name} ({', '.join(simplest.parameters)})", *(law.name for law in others)])
