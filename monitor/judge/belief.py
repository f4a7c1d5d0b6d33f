"""Belief: everything that `assess` remembers of one arm, as a value with an exact JSON document."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.judge.document import entry, plain, typed
from monitor.judge.drift.contexts import OpenedContext
from monitor.judge.drift.maintenance import Maintenance
from monitor.judge.drift.ripple_track import RippleTrack
from monitor.judge.drift.step import UNRESOLVED, DriftState
from monitor.judge.drift.undeclared import (
    MassEstimate,
    UndeclaredLevel,
    Weights,
)
from monitor.judge.drift.usage import Usage
from monitor.judge.friction.figures import (
    UnseenStep,
    WearAndRate,
    change_found,
    change_with_unfound,
    found_wear,
    level_in_force,
    noise_var,
    slope_per_k,
    unseen_step,
    wear_and_rate,
)
from monitor.judge.friction.found import Found
from monitor.judge.friction.states import CUBE, CURVE, SLOPE, viscous_distance
from monitor.judge.friction.step import FrictionModel, FrictionState
from monitor.judge.friction.stored import state_of
from monitor.judge.prediction_error import PredictionErrorStatistics
from monitor.judge.production_observation import ProductionHistory
from monitor.judge.temperature.laws import Law, Line, TemperatureSettings, fit_law
from monitor.judge.temperature.stuck import SensorHistory
from monitor.recording import Array, Context

BELIEF_SCHEMA = 7
STEPPED = tuple(f.name for f in fields(DriftState) if f.name != "joints_per_arm")


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
    friction: FrictionState
    beside: Mapping[str, FrictionState]  # series beside friction at the reference speed, by name
    event: Annotated[Array, "J"]  # ORDINARY, STEP, OUTLIER or UNRESOLVED: the last observation
    since_replay_days: Annotated[Array, "J"]  # since the last replay, at the last observation
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
        return self.friction.joints_per_arm

    @property
    def reference_temperature_c(self) -> Array:
        """(J,) T0 [°C]."""
        return self.friction.of_joints(self.friction.reference_c)

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
    def slot(self) -> np.ndarray:
        """(J,) in which the level of the context in force is kept."""
        return np.full(self.joints, self.contexts[-1].slot or 0)

    @property
    def drift_state(self) -> DriftState:
        """The part that the step carries from one replay to the next."""
        return DriftState(joints_per_arm=self.joints, **{name: getattr(self, name) for name in STEPPED})

    def with_drift_state(self, state: DriftState) -> "Belief":
        """The belief with what a step, or new joints, made of `drift_state`; replays are counted by whoever made one."""
        return replace(self, **{name: getattr(state, name) for name in STEPPED})

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
        """(J,) mean of the wear that was found [log], above the level that it counts from."""
        return found_wear(self.friction)[0]

    @property
    def wear_std(self) -> Array:
        """(J,) its standard deviation [log]."""
        return found_wear(self.friction)[1]

    @property
    def change(self) -> Array:
        """(J,) log of friction over that at the beginning, as found."""
        return change_found(self.friction)

    @property
    def learnt_from(self) -> np.ndarray:
        """(J,) whether the last observation showed the joint."""
        learnt: np.ndarray = self.event != UNRESOLVED
        return learnt

    @property
    def learnt_replays(self) -> Array:
        """(J,) number of replays that have shown the joint that is there now."""
        return self.friction.of_joints(self.friction.replays)

    @property
    def unconfirmed(self) -> np.ndarray:
        """(J,) whether production alone has found a rise."""
        return self.friction.of_joints(self.friction.unconfirmed)

    @property
    def consistency(self) -> Array:
        """(J,) mean square of the last replays' innovations over what the model believes."""
        return self.friction.of_joints(self.friction.consistency)

    @property
    def slope(self) -> Array:
        """(J,) −∂y/∂T at T0: how the logarithm of friction falls with temperature [1/K]."""
        return slope_per_k(self.friction, self.reference_temperature_c)

    def level(self) -> Array:
        """(J,) log friction torque at T0 in the context in force, without wear: the level that wear counts from."""
        state, T0 = self.friction, self.reference_temperature_c
        t = viscous_distance(T0, state.of_joints(state.origin_c))
        b, c, d = (state.of_joints((state.p * state.x[:, k]).sum(axis=0)) for k in (SLOPE, CURVE, CUBE))
        level: Array = level_in_force(state) + b * t + c * t**2 + d * t**3
        return level

    def wear_and_rate(self) -> WearAndRate:
        """Wear w = log(F/F0) and the wear rate, a fraction of F0 per usual day, as found.

        F0 is the level that wear counts from.
        """
        return wear_and_rate(self.friction)

    def change_with_unfound(self, model: FrictionModel) -> tuple[Array, Array]:
        """Mean and standard deviation of friction over that at the beginning [log], (J,) each, with changes that were not found.

        It is for a person to read, and not for alerts.
        """
        return change_with_unfound(self.friction, model)

    def found(self, joint: int) -> "JointFound":
        """How the last change of a joint (from 0) was found."""
        return JointFound(**{f.name: float(getattr(self.friction.found, f.name)[joint]) for f in fields(Found)})

    def odds_of_rise(self, model: FrictionModel) -> "OddsOfRise":
        """How far a rise of each joint is from being found."""
        state, J = self.friction, self.joints
        counted = ~state.risen.reshape(-1, J + 1)[:, :J]
        needed = model.decision.needed(state.peaks, counted, J, state.age_days)[0]
        odds, needed = state.of_joints(state.odds[0]), state.of_joints(needed)
        return OddsOfRise(odds, needed, float(model.decision.limits(J)[0]), self.learnt_replays)

    def unseen_step(self, model: FrictionModel) -> UnseenStep:
        """The largest step of the last days that may be unseen [log], (J,) each."""
        return unseen_step(self.friction, model)

    def noise_std(self, model: FrictionModel) -> Array:
        """(J,) standard deviation of y between replays [log]."""
        return np.sqrt(noise_var(self.friction, model))

    def reference_torque_nm(self, model: FrictionModel) -> tuple[Array, Array]:
        """(J,) friction torque [N·m] at the reference speed v* and temperature T0, and its standard deviation.

        Wear and changes that were not found are included. NaN where no replay has resolved the joint's friction.
        """
        mean, var = (self.friction.of_joints(each) for each in self.friction.friction(self.friction.reference_c, model).moments())
        torque = np.where(self.learnt_replays > 0, np.exp(mean), np.nan)
        return torque, torque * np.sqrt(var)

    def lines(self, settings: TemperatureSettings) -> tuple[Line, Line]:
        """fc(T) and fv(T) without wear, referred to T0."""
        T0 = self.reference_temperature_c
        return fit_law(self.coulomb, T0, settings), fit_law(self.viscous, T0, settings)

    def as_document(self) -> dict[str, Any]:
        """The belief as plain JSON; `belief_from_document` is the exact inverse."""
        document: dict[str, Any] = plain(self)
        return document


def learnt_replays_of(document: Any) -> Array | None:
    """(J,) replays that have shown each joint, without reading the rest of a belief; None for one of another release."""
    if not isinstance(document, dict) or document.get("schema_version") != BELIEF_SCHEMA:
        return None
    state = state_of(document.get("friction"), "belief: friction")
    return state.of_joints(state.replays)


class JointFound(NamedTuple):
    """How the last change of one joint was found, as `Found`."""

    odds: float
    needed: float
    ago_days: float
    began_days: float
    began_std: float
    at_once: float


class OddsOfRise(NamedTuple):
    """How far rises are from being found."""

    odds: Array  # (J,) R [days]
    needed: Array  # (J,) from which a rise is found
    limit: float  # A, the least of these
    replays: Array  # (J,) that have shown each joint


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
    friction = entry(document, "friction", where="belief")
    J = state_of(friction, "belief: friction").joints_per_arm
    return typed(Belief, document, where="belief", sizes={"J": J, "N": J})
