"""One replay's step of everything that is remembered of the joints of any number of arms. The order of its stages exists only here.

`learn` steps one arm, `rehearse` and the performance card step simulated fleets, and `step` documents how to judge a fleet of your own.
What is believed of friction is the model of `monitor.judge.friction`; here sensors, contexts, use and temperature laws are around it.

Shapes: A arms, J joints per arm, N = A·J joints in the order arm by arm.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from monitor.judge.drift.from_fleet import with_fleet
from monitor.judge.drift.usage import Usage, no_usage, update_usage
from monitor.judge.friction import step as friction_step
from monitor.judge.friction.beside import model_beside, observations_beside
from monitor.judge.friction.figures import change_found
from monitor.judge.friction.observation import VISCOUS_SHARE, Observation
from monitor.judge.friction.states import SLOPE
from monitor.judge.friction.step import FrictionState, begin, rescale_use
from monitor.judge.settings import AssessSettings
from monitor.judge.temperature.laws import Law, initial_law, inside_range, reopen_law, update_law
from monitor.judge.temperature.stuck import SensorHistory, forget_sensors, held_still, stuck_sensors, suspect_sensors, update_sensors
from monitor.recording import Array

ORDINARY, STEP, OUTLIER, UNRESOLVED = range(4)  # what the last observation was to a joint
OUTLIER_SIGMAS = 4.0  # of an observation from what was expected


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftState:
    """Everything that the step carries from one replay to the next."""

    joints_per_arm: int  # J
    friction: FrictionState
    beside: Mapping[str, FrictionState]  # series beside friction at the reference speed, by name, that were ever measured
    usage: Usage
    sensors: SensorHistory | None  # of temperature; None before the first replay
    since_replay_days: Array  # (N,) since the last replay, at the last observation: replay or production
    viscous: Law
    coulomb: Law
    first_log_torque: Array  # (N,) mean log torque of the first replays, uncorrected; NaN before
    first_temperature_c: Array  # (N,) mean temperature of the same replays [°C]; NaN before
    event: Array  # (N,) ORDINARY, STEP, OUTLIER or UNRESOLVED: the last observation

    @property
    def joints(self) -> int:
        """N, the number of joints of all arms."""
        return len(self.since_replay_days)

    @property
    def slot(self) -> np.ndarray:
        """(N,) in which the level of the context in force is kept."""
        slot: np.ndarray = self.friction.of_joints(self.friction.slot)
        return slot

    @property
    def reference_temperature_c(self) -> Array:
        """(N,) T0 [°C]."""
        return self.friction.of_joints(self.friction.reference_c)

    @property
    def learnt_from(self) -> np.ndarray:
        """(N,) whether the last observation showed the joint."""
        learnt: np.ndarray = self.event != UNRESOLVED
        return learnt


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """One replay of every arm, or of those arms that `replayed` names. None of an optional field means what its comment says."""

    observation: Observation  # (N,) each; what it says of an arm that did not replay is ignored
    days: Array  # (A,) since the arm's last observation, ≥ 0; 0 for its first one
    replayed: np.ndarray | None = None  # (A,) which arms replayed; None: all
    slot: Array | None = None  # (A,) slot of the replay's context; None: that of the last replay
    opened: np.ndarray | None = None  # (A,) whether the slot's level is unknown, as in a context never seen before; None: no arm's
    replaced: np.ndarray | None = None  # (N,) joints that were replaced since the last replay; None: none
    awaiting_proof: np.ndarray | None = None  # (N,) joints that were worked on, and the maintenance is not judged yet; None: none
    undeclared: np.ndarray | None = None  # (A,) whether the recording contradicts its declared context; None: no arm's
    revolutions: Array | None = None  # (N,) total count at the replay, NaN where it is unknown; None: nobody counts
    from_production: bool = False  # it is no replay, but an observation from production; `opened`: production in another context


class StepResult(NamedTuple):
    """The state after a replay, and what the step found out about the replay itself."""

    state: DriftState
    observation: Observation  # (N,) each, as it was used: NaN where a value was withheld
    inside_range: np.ndarray  # (N,) whether the temperature lies in the range that was learned before this replay
    stuck: np.ndarray  # (N,) whether the temperature sensor is stuck; its value is withheld already where it may be


def initial_state(observation: Observation, joints_per_arm: int, settings: AssessSettings) -> DriftState:
    """The state before the first replay: no wear, unknown levels, the temperature slopes of the robot family, or of the fleet's prior.

    Only T0 and the size of the family's slopes are taken from the observation (N,); `step` then learns from it as from any other.
    """
    laws, N = settings.temperature, len(observation.log_torque)
    friction = friction_step.initial_state(observation, joints_per_arm, settings.friction)
    if settings.drift.prior is not None:
        with_fleet(friction, settings.drift.prior, np.arange(len(friction.replays)))
    T0, unknown = friction.of_joints(friction.origin_c), np.full(N, np.nan)
    fall, fall_std, dry_std, scatter = laws.viscous_fall_per_k, laws.viscous_fall_std_per_k, laws.coulomb_fall_std_per_k, laws.scatter
    return DriftState(
        joints_per_arm=joints_per_arm,
        friction=friction,
        beside={},
        usage=no_usage(N),
        sensors=None,
        since_replay_days=np.zeros(N),
        viscous=initial_law(T0, observation.viscous_nm_s_per_rad, fall_per_k=fall, fall_std_per_k=fall_std, scatter=scatter),
        coulomb=initial_law(T0, observation.coulomb_nm, fall_per_k=0.0, fall_std_per_k=dry_std, scatter=scatter),
        first_log_torque=unknown,
        first_temperature_c=unknown,
        event=np.full(N, float(UNRESOLVED)),
    )


def step(state: DriftState, replay: Replay, settings: AssessSettings, *, in_place: bool = False) -> StepResult:
    """One replay of every arm: the state after it. in_place : the state given is used up, which saves a fleet the copy.

    Raises ValueError where the days since an arm's last replay are negative or unknown: replays are learned from in the order of time.

    Judging your own fleet, here three arms of which joint 2 of arm 2 steps by 20 % on day 40. `weigh_evidence` turns the state
    into tiers, as the daemon does it; 1 is the wear tier.

    >>> import numpy as np
    >>> from monitor.judge.alerts.evidence import weigh_evidence
    >>> from monitor.judge.friction.observation import Observation
    >>> from monitor.judge.drift.step import Replay, initial_state, step
    >>> from monitor.judge.friction.figures import found_wear
    >>> from monitor.judge.settings import AssessSettings
    >>> settings, A, J = AssessSettings(), 3, 6
    >>> N, rng, state = A * J, np.random.default_rng(1), None
    >>> for day in range(50):
    ...     torque = 10.0 * np.exp(0.02 * rng.normal(size=N))  # friction torque at drift.reference_speed_rad_s [N·m]
    ...     torque[J + 1] *= 1.2 if day >= 40 else 1.0
    ...     observation = Observation(
    ...         log_torque=np.log(torque),
    ...         variance=np.full(N, 0.005**2),  # of log_torque, from the fit of the replay
    ...         temperature_c=30.0 + rng.normal(size=N),
    ...         viscous_share=np.full(N, 0.4),
    ...         warming_k_per_min=np.zeros(N),
    ...         coulomb_nm=0.6 * torque,
    ...         viscous_nm_s_per_rad=0.4 * torque / settings.drift.reference_speed_rad_s,
    ...     )
    ...     if state is None:
    ...         state = initial_state(observation, J, settings)
    ...     state = step(state, Replay(observation=observation, days=np.full(A, float(day > 0))), settings).state
    >>> weigh_evidence(state, settings.health).raises.reshape(A, J)[1].tolist()
    [-1, 1, -1, -1, -1, -1]
    >>> wear, std = found_wear(state.friction)
    >>> bool(abs(wear[J + 1] - np.log(1.2)) < 3.0 * std[J + 1])
    True
    """
    J = state.joints_per_arm
    here = np.ones(len(replay.days), dtype=bool) if replay.replayed is None else replay.replayed
    seen = replay.observation
    seen = seen._replace(log_torque=np.where(np.repeat(here, J), seen.log_torque, np.nan))
    if replay.from_production:
        return _learn_from_production(state, replay, seen, here, settings, in_place)
    days = np.where(np.repeat(here, J), np.repeat(replay.days, J), 0.0)
    since_replay = state.since_replay_days + days
    sensors, stuck, suspect = _check_sensors(state, seen, here, since_replay)
    withheld = np.zeros(len(here), dtype=bool) if replay.undeclared is None else replay.undeclared
    seen = _withhold(seen, suspect, np.repeat(withheld, J))
    if replay.replaced is not None and replay.replaced.any():
        new = replay.replaced & np.repeat(here, J)
        state, sensors = new_joints(state, new, settings), forget_sensors(sensors, new)
    inside = inside_range(state.viscous.range_c, seen.temperature_c, settings.temperature.margin_k)  # the range before this replay
    state = _remember_baseline(state, seen, settings.drift.baseline_replays)
    before = state.slot.copy()
    use = update_usage(state.usage, _counted(replay.revolutions, here, J), since_replay)
    usual = use.usual_days * days / np.maximum(since_replay, 1e-9)
    friction = state.friction if in_place else deepcopy(state.friction)
    if np.any(use.factor != 1.0):
        rescale_use(friction, _of_channels(use.factor, J))
    around: dict[str, Any] = {
        "replayed": replay.replayed,
        "slot": replay.slot,
        "opened": replay.opened,
        "withheld": withheld,
        "use": usual,
        "awaiting_proof": replay.awaiting_proof,
    }
    friction = friction_step.step(friction, seen, replay.days, settings.friction, in_place=True, **around)
    state = replace(
        state,
        friction=friction,
        beside=_look_beside(state, seen, replay, around, in_place),
        usage=use.usage,
        sensors=sensors,
        since_replay_days=np.where(np.repeat(here, J), 0.0, state.since_replay_days),
        event=np.where(np.repeat(here, J), _event(friction, np.isfinite(seen.log_torque)), state.event),
    )
    # levels that are learnt anew, or what most joints changed together, are another level of the temperature laws too
    anew = (state.slot != before) | np.repeat(friction.told.common.any(axis=0), J)
    state = _reopen_laws(state, anew, settings) if anew.any() else state
    return StepResult(_learn_laws(state, seen), seen, inside, stuck)


def new_joints(state: DriftState, new: np.ndarray, settings: AssessSettings) -> DriftState:
    """The state where the joints in `new` (N,) are other ones: nothing that was learnt of the old ones holds.

    Two things stay as a first guess, with the doubt of a joint never seen: the temperature slope, which another joint of the same size has
    about, and the range of temperatures, which is that of the place.
    """
    friction, beside = deepcopy(state.friction), {name: deepcopy(each) for name, each in state.beside.items()}
    n = friction.channels_of(new)
    mask = np.zeros(len(friction.replays), dtype=bool)
    mask[n] = True
    share = np.full(len(mask), VISCOUS_SHARE)
    slope = (friction.p * friction.x[:, SLOPE]).sum(axis=0)
    begin(friction, mask, share, settings.friction)
    friction.x[:, SLOPE, n] = slope[n]
    if settings.drift.prior is not None:
        with_fleet(friction, settings.drift.prior, n)
    friction_step.unsettle_means(friction, n, settings.friction)
    for name, each in beside.items():
        begin(each, mask, share, model_beside(name))
        friction_step.unsettle_means(each, n, model_beside(name))
    return _reopen_laws(
        replace(
            state,
            friction=friction,
            beside=beside,
            sensors=None if state.sensors is None else forget_sensors(state.sensors, new),
            first_log_torque=np.where(new, np.nan, state.first_log_torque),
            first_temperature_c=np.where(new, np.nan, state.first_temperature_c),
        ),
        new,
        settings,
    )


def _learn_from_production(
    state: DriftState, replay: Replay, seen: Observation, here: np.ndarray, settings: AssessSettings, in_place: bool
) -> StepResult:
    """The state after an observation from production.

    It says nothing of the series beside F(v*), of the temperature laws of fc and fv, of T0, and of sensors: those are the replays'.
    """
    J = state.joints_per_arm
    suspect = np.zeros(state.joints, dtype=bool) if state.sensors is None else suspect_sensors(state.sensors) | held_still(state.sensors)
    seen = _withhold(seen, suspect, np.zeros(state.joints, dtype=bool))
    friction = friction_step.step(
        state.friction,
        seen,
        replay.days,
        settings.friction,
        replayed=replay.replayed,
        opened=replay.opened,
        awaiting_proof=replay.awaiting_proof,
        production=True,
        in_place=in_place,
    )
    days = np.where(np.repeat(here, J), np.repeat(replay.days, J), 0.0)
    state = replace(
        state,
        friction=friction,
        since_replay_days=state.since_replay_days + days,
        event=np.where(np.repeat(here, J), _event(friction, np.isfinite(seen.log_torque)), state.event),
    )
    everywhere = np.ones(state.joints, dtype=bool)
    return StepResult(state, seen, everywhere, ~everywhere)


def _event(friction: FrictionState, shown: np.ndarray) -> Array:
    """(N,) what the last observation was to each joint."""
    told = friction.told
    step = friction.of_joints(told.rises | told.falls) | np.repeat(told.common.any(axis=0), friction.joints_per_arm)
    outlier = np.abs(np.nan_to_num(friction.of_joints(friction.normalised))) > OUTLIER_SIGMAS
    event: Array = np.select([~shown, step, outlier], [float(UNRESOLVED), float(STEP), float(OUTLIER)], float(ORDINARY))
    return event


def _look_beside(
    state: DriftState, seen: Observation, replay: Replay, around: Mapping[str, Any], in_place: bool
) -> dict[str, FrictionState]:
    """The series beside F(v*) after this replay: wear that F(v*) does not show."""
    beside = dict(state.beside)
    observations = observations_beside(seen)
    for name in (*beside, *(name for name in observations if name not in beside)):
        observation = observations.get(name)
        if observation is None:  # nobody measured it this time
            observation = seen._replace(log_torque=np.full(state.joints, np.nan))
        model = model_beside(name)
        known = beside.get(name)
        before = friction_step.initial_state(observation, state.joints_per_arm, model) if known is None else known
        beside[name] = friction_step.step(before, observation, replay.days, model, in_place=in_place or known is None, **around)
    return beside


def _check_sensors(state: DriftState, seen: Observation, here: np.ndarray, days: Array) -> tuple[SensorHistory, np.ndarray, np.ndarray]:
    """The sensors' history after this replay, which joints' temperature sensors are stuck, and which may be, (N,) each."""
    sensors = update_sensors(
        state.sensors,
        np.where(np.repeat(here, state.joints_per_arm), seen.temperature_c, np.nan),
        state.joints_per_arm,
        warming_k_per_min=seen.warming_k_per_min,
        constant=seen.temperature_constant if len(seen.temperature_constant) else None,
        days=days,
    )
    still = held_still(sensors)
    return sensors, stuck_sensors(sensors) | still, suspect_sensors(sensors) | still


def _withhold(seen: Observation, suspect: np.ndarray, withheld: np.ndarray) -> Observation:
    """The observation as it may be used: no temperature of a sensor that may be stuck, no friction under an undeclared change."""
    return seen._replace(
        temperature_c=np.where(suspect, np.nan, seen.temperature_c),
        log_torque=np.where(withheld, np.nan, seen.log_torque),
    )


def _counted(revolutions: Array | None, here: np.ndarray, joints_per_arm: int) -> Array:
    """(N,) total count at the replay; NaN where nobody counts, or the arm did not replay."""
    N = len(here) * joints_per_arm
    return np.full(N, np.nan) if revolutions is None else np.where(np.repeat(here, joints_per_arm), revolutions, np.nan)


def _of_channels(joints: Array, joints_per_arm: int) -> Array:
    """(C,) of joints (N,): the mean of an arm has the mean of its joints."""
    of_arm = joints.reshape(-1, joints_per_arm)
    channels: Array = np.concatenate([of_arm, of_arm.mean(axis=1, keepdims=True)], axis=1).ravel()
    return channels


def _remember_baseline(state: DriftState, seen: Observation, replays: int) -> DriftState:
    """The state with the means of the first replays, before this one is learnt from."""
    n = state.friction.of_joints(state.friction.replays)
    more = (n < replays) & np.isfinite(seen.log_torque)

    def mean(old: Array, new: Array) -> Array:
        usable = more & np.isfinite(new)
        before = np.where(np.isfinite(old), old, new)
        return np.where(usable, before + (new - before) / (n + 1.0), old)

    return replace(
        state,
        first_log_torque=mean(state.first_log_torque, seen.log_torque),
        first_temperature_c=mean(state.first_temperature_c, seen.temperature_c),
    )


def _reopen_laws(state: DriftState, which: np.ndarray, settings: AssessSettings) -> DriftState:
    laws = settings.temperature
    return replace(state, viscous=reopen_law(state.viscous, which, laws), coulomb=reopen_law(state.coulomb, which, laws))


def _learn_laws(state: DriftState, seen: Observation) -> DriftState:
    """The state with the temperature laws after this replay, wear divided out. Joints that it did not show are left out."""
    unworn = np.where(state.learnt_from & (state.event != OUTLIER), np.exp(-change_found(state.friction)), np.nan)
    T = seen.temperature_c
    return replace(
        state,
        viscous=update_law(state.viscous, T, seen.viscous_nm_s_per_rad * unworn),
        coulomb=update_law(state.coulomb, T, seen.coulomb_nm * unworn),
    )
