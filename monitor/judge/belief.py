"""Belief: everything that `assess` remembers of one arm, as a value with an exact JSON document."""

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.document import array, entry, plain, typed
from monitor.judge.drift.contexts import OpenedContext
from monitor.judge.drift.filter_state import RATE, WEAR, WINDOW, FilterState
from monitor.judge.drift.maintenance import Maintenance
from monitor.judge.drift.ripple_track import RippleTrack
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import DriftState
from monitor.judge.drift.undeclared import (
    MassEstimate,
    UndeclaredLevel,
    Weights,
)
from monitor.judge.drift.undetected_change import UnseenStep, undetected_change, unseen_step
from monitor.judge.drift.usage import Usage
from monitor.judge.prediction_error import PredictionErrorStatistics
from monitor.judge.production_observation import ProductionHistory
from monitor.judge.temperature.laws import Law, Line, TemperatureSettings, fit_law
from monitor.judge.temperature.stuck import SensorHistory
from monitor.recording import Array, Context

BELIEF_SCHEMA = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Belief:
    """Everything that `assess` remembers of one arm. The next belief is a function of this one and the next recording."""

    robot: str
    reference_speed_rad_s: float
    at_unix_s: float  # of the last replay, or the end of the last period of production that was judged
    began_at_unix_s: float
    replays: int
    days: int  # UTC days with a replay
    contexts: tuple[OpenedContext, ...]  # in the order in which they were last entered: the last one is in force
    reference_temperature_c: Annotated[Array, "J"]  # T0 [°C]
    filter_state: FilterState
    temperature_c: Annotated[Array, "J"]  # of the last replay
    inside_range: Annotated[Array, "J"]  # 1 where that lay in the range that was learned before it, else 0
    first_log_torque: Annotated[Array, "J"]  # mean of y over the first replays, uncorrected: the reference of an alert's attribution
    last_log_torque: Annotated[Array, "J"]  # of the last replay; NaN where nothing was learned
    first_temperature_c: Annotated[Array, "J"]  # mean over the same first replays
    usage: Usage
    mass_estimate: MassEstimate | None  # in the context in force
    viscous: Law
    coulomb: Law
    sensors: SensorHistory | None = None  # None before the first replay
    # of predicted torque; None before the first prediction
    prediction_error: PredictionErrorStatistics | None = None
    maintenance: tuple[
        Maintenance, ...
    ] = ()  # on joints: those that are not judged yet, and of each joint the last one from which friction counts
    residual_peak_rad: Annotated[Array, "J"] | None = None  # where along the joint the last replay's residual was largest; None: not known
    ripple: RippleTrack | None = None  # of the gears, in the context in force; None where none was seen
    undeclared_level: UndeclaredLevel | None = None  # of weights that contradict the context in force, and have a level of their own
    undeclared_candidate: UndeclaredLevel | None = None  # likewise, after too few replays for one
    schema_version: int = BELIEF_SCHEMA
    production: ProductionHistory | None = None  # observations from production; None: there was none

    @property
    def joints(self) -> int:
        """J, the number of joints."""
        return self.filter_state.joints

    @property
    def context(self) -> Context:
        """The context in force."""
        return self.contexts[-1].context

    @property
    def arm_weights(self) -> Weights:
        """What the arm weighs in the context in force."""
        return Weights(self.mass_estimate, self.undeclared_level, self.undeclared_candidate)

    def with_arm_weights(self, weights: Weights) -> "Belief":
        """The belief with other weights in the context in force."""
        return replace(self, mass_estimate=weights.declared, undeclared_level=weights.level, undeclared_candidate=weights.candidate)

    @property
    def slot(self) -> Array:
        """(J,) slot of the filter in which the level of the context in force is kept."""
        return np.full(self.joints, self.contexts[-1].slot or 0)

    @property
    def drift_state(self) -> DriftState:
        """The part that the filter step carries from one replay to the next."""
        return DriftState(
            joints_per_arm=self.joints,
            filter_state=self.filter_state,
            usage=self.usage,
            slot=self.slot,
            sensors=self.sensors,
            reference_temperature_c=self.reference_temperature_c,
            settled=np.full(self.joints, float(self.replays)),
            viscous=self.viscous,
            coulomb=self.coulomb,
            first_log_torque=self.first_log_torque,
            first_temperature_c=self.first_temperature_c,
        )

    def with_drift_state(self, state: DriftState) -> "Belief":
        """The belief with what a filter step, or new joints, made of `drift_state`; replays are counted by whoever made one."""
        return replace(
            self,
            filter_state=state.filter_state,
            usage=state.usage,
            sensors=state.sensors,
            reference_temperature_c=state.reference_temperature_c,
            viscous=state.viscous,
            coulomb=state.coulomb,
            first_log_torque=state.first_log_torque,
            first_temperature_c=state.first_temperature_c,
        )

    @property
    def awaiting_proof(self) -> np.ndarray:
        """(J,) joints with maintenance that is not judged yet."""
        awaiting_proof = np.zeros(self.joints, dtype=bool)
        awaiting_proof[[act.joint - 1 for act in self.maintenance if act.waiting]] = True
        return awaiting_proof

    def counted_since(self, joint: int) -> Maintenance | None:
        """The maintenance of a joint (from 1) since which its friction counts; None: since the beginning."""
        return next((act for act in reversed(self.maintenance) if act.joint == joint and not act.waiting), None)

    @property
    def wear(self) -> Array:
        """(J,) mean of wear w [log], above the lowest friction held."""
        return self.filter_state.wear

    @property
    def wear_std(self) -> Array:
        """(J,) standard deviation of w [log]."""
        return self.filter_state.wear_std

    @property
    def event(self) -> Array:
        """(J,) ORDINARY, SETTLING, STEP, OUTLIER or UNRESOLVED: the last replay."""
        return self.filter_state.event

    @property
    def learnt_from(self) -> np.ndarray:
        """(J,) whether the filter learned from the last replay of the joint."""
        return self.filter_state.learnt_from

    @property
    def slope(self) -> Array:
        """(J,) −∂y/∂T at T0: how the logarithm of friction falls with temperature [1/K]."""
        return self.filter_state.slope_at(self.reference_temperature_c)

    def level(self) -> Array:
        """(J,) log friction torque at T0 in the context in force, without wear: the lowest that was surely held."""
        return self.filter_state.steady_mean(self.reference_temperature_c, self.slot) - self.wear

    def wear_and_rate(self) -> tuple[Array, Array]:
        """Mean (J, 2) and covariance (J, 2, 2) of wear w = log(F/F0) and of the wear rate, a fraction of F0 per usual day.

        F0 is the lowest friction that was surely held: the level that alerts count rises from.
        """
        pair = [WEAR, RATE]
        return self.filter_state.mean[:, pair], self.filter_state.cov[:, pair][:, :, pair]

    def wear_with_undetected(self, settings: DriftSettings) -> tuple[Array, Array]:
        """Mean and standard deviation of friction over that at the beginning [log], (J,) each, with undetected changes.

        It is for a person to read, and not for alerts.
        """
        H = np.zeros((self.joints, self.filter_state.mean.shape[1]))
        H[:, WEAR] = 1.0
        more, more_var = undetected_change(self.filter_state, H, settings)
        moved = self.filter_state.counted_from
        return self.filter_state.change + more, np.sqrt(self.wear_std**2 + moved.moved_var + more_var)

    def unseen_step(self, settings: DriftSettings) -> UnseenStep:
        """The largest step of the last days that may be unseen [log], (J,) each."""
        return unseen_step(self.filter_state, self.joints, settings)

    def noise_std(self, settings: DriftSettings) -> Array:
        """(J,) standard deviation of y between replays [log]."""
        return np.sqrt(self.filter_state.noise_var(self.joints, settings))

    def reference_torque_nm(self, settings: DriftSettings) -> tuple[Array, Array]:
        """(J,) friction torque [N·m] at the reference speed v* and temperature T0, and its standard deviation.

        Wear and undetected changes are included. NaN where no replay has resolved the joint's friction.
        """
        filter_state = self.filter_state
        mean, std = filter_state.reference(self.reference_temperature_c, self.slot)
        more, more_var = undetected_change(filter_state, filter_state.reference_row(self.reference_temperature_c, self.slot), settings)
        mean, std = mean + more, np.sqrt(std**2 + more_var)
        torque = np.where(self.filter_state.replays > 0, np.exp(mean), np.nan)
        return torque, torque * std

    def lines(self, settings: TemperatureSettings) -> tuple[Line, Line]:
        """fc(T) and fv(T) without wear, referred to T0."""
        T0 = self.reference_temperature_c
        return fit_law(self.coulomb, T0, settings), fit_law(self.viscous, T0, settings)

    def as_document(self) -> dict[str, Any]:
        """The belief as plain JSON; `belief_from_document` is the exact inverse."""
        document: dict[str, Any] = plain(self)
        return document


def belief_from_document(document: Any) -> Belief:
    """A Belief from `Belief.as_document()`.

    Raises BadInput naming the key that is missing or wrong, or a schema version that this release does not read.
    """
    version = entry(document, "schema_version", where="belief")
    if version != BELIEF_SCHEMA:
        raise BadInput(
            f"belief: schema_version is {version!r}; this release reads {BELIEF_SCHEMA}. What was learnt in it cannot be carried "
            "over: move the state directory away, and let `joint-monitor assess` judge its recordings again"
        )
    J = len(array(entry(document, "reference_temperature_c", where="belief"), "J", "belief: reference_temperature_c", {}))
    return typed(Belief, document, where="belief", sizes={"J": J, "N": J, "W": WINDOW})
