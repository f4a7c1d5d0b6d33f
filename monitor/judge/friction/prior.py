"""What a fleet says of a joint before its first replay: its dependence on temperature and its noise, pooled over arms of its model.

The family's prior of `TemperatureSettings` is wide, because it must hold for every arm. That of a fleet is as wide as its arms differ.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.document import typed
from monitor.judge.friction.noise import NoisePriors
from monitor.recording import Array

FORMAT, VERSION = "joint-monitor/prior", 2
BOUNDS = {
    "slope_per_k": (-0.1, 0.1),
    "slope_std_per_k": (1e-6, 0.1),
    "curve_per_k2": (-0.01, 0.01),
    "curve_std_per_k2": (1e-8, 0.01),
    "lag": (-1.0, 1.0),
    "lag_std": (1e-6, 1.0),
}
SHARES = ("slowing", "straight", "accelerating")
OF_WEAR = {**dict.fromkeys(SHARES, (1e-4, 1.0)), "life_days": (1.0, 1e5), "life_spread": (0.02, 3.0)}
NOISE_STD = (1e-4, 0.5)
LIFE_RISE = 0.3  # of friction, a fraction: `life_days` count to it
SUM_OF_SHARES = 0.001  # by which the shares of the three families may differ from 1


@dataclass(frozen=True, slots=True, kw_only=True)
class WearPrior:
    """How joints of the fleet wear once they do: along which paths, and how fast."""

    joints: int  # that it was learnt from
    slowing: float  # share of joints that wear so; the three together make 1
    straight: float
    accelerating: float
    life_days: float  # [usual days] median from the onset of wear until friction has risen by LIFE_RISE
    life_spread: float  # standard deviation of its logarithm from joint to joint, the doubt of the median included


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetPrior:
    """The prior of one arm's joints, (J,) each; a new arm of the fleet is expected within the standard deviations.

    Two of the same model and digest are equal: their figures are those of one document.
    """

    model: str
    arms: int  # that it was learnt from
    digest: str  # SHA-256 of the document, 16 hexadecimal digits
    slope_per_k: Array = field(compare=False)  # β = −∂log F/∂T at the origin
    slope_std_per_k: Array = field(compare=False)
    curve_per_k2: Array = field(compare=False)  # γ
    curve_std_per_k2: Array = field(compare=False)
    lag: Array = field(compare=False)  # λ [1/(K/min)]
    lag_std: Array = field(compare=False)
    noise_std: float = field(compare=False)  # of the innovations of log F, as `NoisePriors.std`
    noise_weights: Array = field(compare=False)  # (H,) of the kinds of noise, in their order
    wear: WearPrior | None = None  # None: too few joints of the fleet wear, or the document is of a release that did not say it

    def noise(self, priors: NoisePriors) -> NoisePriors:
        """The priors with the fleet's noise."""
        kinds = tuple(kind._replace(weight=float(of)) for kind, of in zip(priors.kinds, self.noise_weights, strict=True))
        return replace(priors, kinds=kinds, std=self.noise_std)


def prior_from_document(document: Any, model: str, joints: int, reference_speed_rad_s: float, *, digest: str) -> FleetPrior:
    """The prior of a model's joints, from the document that `joint-monitor prior` writes.

    Raises BadInput where it is none, of a later version or another reference speed, has no such model, or holds figures that no joint has.
    """
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadInput(f'is no fleet prior: expected a JSON object with "format": "{FORMAT}", as `joint-monitor prior` writes it')
    if document.get("version") != VERSION:
        raise BadInput(f"version {document.get('version')!r} of a fleet prior; this program reads version {VERSION}")
    speed = document.get("reference_speed_rad_s")
    if speed != reference_speed_rad_s:
        raise BadInput(
            f"is of friction at {speed!r} rad/s; this arm's is followed at {reference_speed_rad_s:g} rad/s ([drift] reference_speed_rad_s)"
        )
    models = document.get("models")
    if not isinstance(models, dict) or not isinstance(models.get(model), dict):
        known = ", ".join(sorted(models)) if isinstance(models, dict) and models else "none"
        raise BadInput(f"holds no prior of a {model}; it holds {known}")
    own = models[model]
    rows, arms = own.get("joints"), own.get("arms")
    if not isinstance(rows, list) or len(rows) != joints or not all(isinstance(row, dict) for row in rows):
        raise BadInput(f"models.{model}.joints: expected {joints} JSON objects, one a joint from the base")
    if not isinstance(arms, int) or isinstance(arms, bool) or arms < 1:
        raise BadInput(f"models.{model}.arms = {arms!r}; expected their number")
    columns = {name: _column(rows, name, model) for name in BOUNDS}
    std, weights = _noise(own.get("noise"), f"models.{model}.noise")
    wear = _wear(own.get("wear"), f"models.{model}.wear")
    return FleetPrior(model=model, arms=arms, digest=digest, noise_std=std, noise_weights=weights, wear=wear, **columns)


def prior_from_plain(document: Mapping[str, Any]) -> FleetPrior:
    """The prior from its plain document, as the provenance of a verdict holds it."""
    return typed(FleetPrior, document, where="fleet prior")


def _noise(document: Any, where: str) -> tuple[float, Array]:
    """Size and weights of the kinds of noise. Raises BadInput naming the figure that is missing or out of bounds."""
    rows = document.get("weights") if isinstance(document, dict) else None
    kinds = len(NoisePriors().kinds)
    if not isinstance(rows, list) or len(rows) != kinds:
        raise BadInput(f"{where}: expected a JSON object with std, and with {kinds} weights, one a kind of noise")
    weights = np.array([_number(value, (0.0, 1.0), f"{where}.weights") for value in rows])
    if abs(weights.sum() - 1.0) > SUM_OF_SHARES:
        raise BadInput(f"{where}.weights: expected numbers that make 1 together")
    return _number(document.get("std"), NOISE_STD, f"{where}: std"), weights


def _wear(document: Any, where: str) -> WearPrior | None:
    """How joints wear. Raises BadInput naming the figure that is missing or out of bounds."""
    if document is None:
        return None
    joints = document.get("joints") if isinstance(document, dict) else None
    if not isinstance(joints, int) or isinstance(joints, bool) or joints < 1:
        raise BadInput(f"{where}: expected a JSON object with the number of joints and {', '.join(OF_WEAR)}")
    figures = {name: _number(document.get(name), bounds, f"{where}: {name}") for name, bounds in OF_WEAR.items()}
    if abs(sum(figures[name] for name in SHARES) - 1.0) > SUM_OF_SHARES:
        raise BadInput(f"{where}: {', '.join(SHARES)} are shares of all joints that wear; expected numbers that make 1 together")
    return WearPrior(joints=joints, **figures)


def _number(value: Any, bounds: tuple[float, float], where: str) -> float:
    low, high = bounds
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise BadInput(f"{where} = {value!r}; expected a number from {low:g} to {high:g}")
    return float(value)


def _column(rows: list[Mapping[str, Any]], name: str, model: str) -> Array:
    """(J,) one figure of all joints. Raises BadInput naming the joint whose figure is missing or out of bounds."""
    return np.array(
        [_number(row.get(name), BOUNDS[name], f"models.{model}.joints, joint {j}: {name}") for j, row in enumerate(rows, start=1)]
    )
