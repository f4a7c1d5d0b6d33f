"""The model of friction that the settings ask for."""

from functools import cache

from monitor.judge.friction.decision import DecisionSettings
from monitor.judge.friction.noise import NoisePriors
from monitor.judge.friction.settings import DriftSettings
from monitor.judge.friction.states import Priors
from monitor.judge.friction.step import FrictionModel
from monitor.judge.temperature.laws import TemperatureSettings


@cache
def friction_model(drift: DriftSettings, temperature: TemperatureSettings, **decision: float) -> FrictionModel:
    """Equal settings have one model. decision : fields of `DecisionSettings`."""
    noise = NoisePriors(std=drift.between_std)
    slope = (-temperature.viscous_fall_per_k, temperature.viscous_fall_std_per_k, temperature.coulomb_fall_std_per_k)
    return FrictionModel(
        states=Priors(slope_per_k=slope),
        noise=noise if drift.prior is None else drift.prior.noise(noise),
        decision=DecisionSettings(**decision),  # type: ignore[arg-type]  # whole numbers are among them
        onsets_per_year=drift.onsets_per_year,
    )
