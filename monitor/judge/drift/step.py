"""One replay's step of the drift filter, over the joints of any number of arms. The order of its stages exists only here.

`learn` steps one arm, `rehearse` and the performance card step simulated fleets, and `step` documents how to judge a fleet of your own.
Each stage is a public function of this module, or of the module that it is imported from.

Shapes: A arms, J joints per arm, N = A·J joints in the order arm by arm.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from monitor.judge.drift.channels import ChannelReplay, restart, update_channels
from monitor.judge.drift.filter_state import (
    FilterState,
    initial_filter,
    leave_context,
    open_slot,
    predict_filter,
    remember_warming,
    replace_joints,
    rescale_rate,
    unknown_joint,
    update_interval,
)
from monitor.judge.drift.from_fleet import begin_from_fleet, temperature_from_fleet, widen_where_prior_fails
from monitor.judge.drift.from_production import (
    arbitrate,
    begin_production,
    confirmed,
    inside_production,
    observed,
    remember_unconfirmed,
    reopen_production,
    swapped,
    widen_range,
)
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.slots import SLOTS
from monitor.judge.drift.update.filter_update import update_filter
from monitor.judge.drift.update.lowest_level import count_from_lowest
from monitor.judge.drift.usage import Usage, no_usage, update_usage
from monitor.judge.temperature.laws import Law, TemperatureSettings, initial_law, inside_range, reopen_law, update_law
from monitor.judge.temperature.stuck import SensorHistory, forget_sensors, held_still, stuck_sensors, suspect_sensors, update_sensors
from monitor.recording import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftState:
    """Everything that the step carries from one replay to the next."""

    joints_per_arm: int  # J
    filter_state: FilterState
    usage: Usage
    slot: Array  # (N,) in which slot of the filter the level of the context in force is kept
    sensors: SensorHistory | None  # of temperature; None before the first replay
    reference_temperature_c: Array  # (N,) T0 [°C]
    settled: Array  # (N,) number of replays that T0 is the mean of
    viscous: Law
    coulomb: Law
    first_log_torque: Array  # (N,) mean log torque of the first replays, uncorrected; NaN before
    first_temperature_c: Array  # (N,) mean temperature of the same replays [°C]; NaN before

    @property
    def joints(self) -> int:
        """N, the number of joints of all arms."""
        return self.filter_state.joints


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """One replay of every arm, or of those arms that `replayed` names. None of an optional field means what its comment says."""

    observation: Observation  # (N,) each; what it says of an arm that did not replay is ignored
    days: Array  # (A,) since the arm's last replay, ≥ 0; 0 for its first one
    replayed: np.ndarray | None = None  # (A,) which arms replayed; None: all
    slot: Array | None = None  # (A,) slot of the replay's context, 0 … SLOTS − 1; None: that of the last replay
    opened: np.ndarray | None = None  # (A,) whether the slot's level is unknown, as in a context never seen before; None: no arm's
    replaced: np.ndarray | None = None  # (N,) joints that were replaced since the last replay; None: none
    awaiting_proof: np.ndarray | None = None  # (N,) joints that were worked on, and the maintenance is not judged yet; None: none
    undeclared: np.ndarray | None = None  # (A,) whether the recording contradicts its declared context; None: no arm's
    same_mass: np.ndarray | None = None  # (A,) whether the arm was weighed, and carries what it did before; None: nobody weighed
    revolutions: Array | None = None  # (N,) total count at the replay, NaN where it is unknown; None: nobody counts
    from_production: bool = False  # it is no replay, but an observation from production; `opened`: production in another context


class StepResult(NamedTuple):
    """The state after a replay, and what the step found out about the replay itself."""

    state: DriftState
    observation: Observation  # (N,) each, as the filter used it: NaN where a value was withheld
    inside_range: np.ndarray  # (N,) whether the temperature lies in the range that was learned before this replay
    stuck: np.ndarray  # (N,) whether the temperature sensor is stuck; its value is withheld already where it may be


class JointReplay(NamedTuple):
    """A `Replay` with every field filled in and expanded to joints, (N,) each."""

    observation: Observation
    days: Array
    replayed: np.ndarray
    slot: Array
    opened: np.ndarray
    replaced: np.ndarray
    awaiting_proof: np.ndarray
    undeclared: np.ndarray
    same_mass: np.ndarray
    revolutions: Array


def initial_state(observation: Observation, joints_per_arm: int, drift: DriftSettings, temperature: TemperatureSettings) -> DriftState:
    """The state before the first replay: no wear, unknown levels, the temperature slopes of the robot family, or of the fleet's prior.

    Only T0 and the size of the family's slopes are taken from the observation (N,); `step` then learns from it as from any other.
    """
    fall, fall_std = temperature.viscous_fall_per_k, temperature.viscous_fall_std_per_k
    coulomb_std = temperature.coulomb_fall_std_per_k
    state = initial_filter(observation, drift, fall_per_k=fall, fall_std_per_k=fall_std, coulomb_std_per_k=coulomb_std)
    if drift.prior is not None:
        state = begin_from_fleet(state, drift.prior)
    state = replace(state, noise_weight=state.noise_weight / joints_per_arm)  # the prior is one of the arm: each joint has its part
    T0, N, scatter = state.origin_c, state.joints, temperature.scatter
    unknown = np.full(N, np.nan)
    return DriftState(
        joints_per_arm=joints_per_arm,
        filter_state=state,
        usage=no_usage(N),
        slot=np.zeros(N, dtype=int),
        sensors=None,
        reference_temperature_c=T0,
        settled=np.zeros(N),
        viscous=initial_law(T0, observation.viscous_nm_s_per_rad, fall_per_k=fall, fall_std_per_k=fall_std, scatter=scatter),
        coulomb=initial_law(T0, observation.coulomb_nm, fall_per_k=0.0, fall_std_per_k=coulomb_std, scatter=scatter),
        first_log_torque=unknown,
        first_temperature_c=unknown,
    )


def step(state: DriftState, replay: Replay, drift: DriftSettings, temperature: TemperatureSettings) -> StepResult:
    """One replay of every arm: the state after it.

    Raises ValueError where the days since an arm's last replay are negative or unknown: replays are learned from in the order of time.

    Judging your own fleet, here three arms of which joint 2 of arm 2 steps by 20 % on day 40. `weigh_evidence` turns the state
    into tiers, as the daemon does it; 1 is the wear tier.

    >>> import numpy as np
    >>> from monitor.judge.alerts.evidence import nothing_counted, wear_of_state, weigh_evidence
    >>> from monitor.judge.drift.observation import Observation
    >>> from monitor.judge.drift.settings import DriftSettings
    >>> from monitor.judge.drift.step import Replay, initial_state, step
    >>> from monitor.judge.settings import HealthSettings
    >>> from monitor.judge.temperature.laws import TemperatureSettings
    >>> drift, temperature, health = DriftSettings(), TemperatureSettings(), HealthSettings()
    >>> A, J = 3, 6
    >>> N, rng = A * J, np.random.default_rng(1)
    >>> state, counts = None, nothing_counted(N, A)
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
    ...         viscous_nm_s_per_rad=0.4 * torque / drift.reference_speed_rad_s,
    ...     )
    ...     if state is None:
    ...         state = initial_state(observation, J, drift, temperature)
    ...     result = step(state, Replay(observation=observation, days=np.full(A, float(day > 0))), drift, temperature)
    ...     state, joints = result.state, result.state.filter_state
    ...     after = wear_of_state(joints, joints.learnt_from & result.inside_range, day)
    ...     evidence = weigh_evidence(after, counts, J, health)
    ...     counts = evidence.counts
    >>> evidence.raises.reshape(A, J)[1].tolist()
    [-1, 1, -1, -1, -1, -1]
    >>> bool(abs(joints.wear[J + 1] - np.log(1.2)) < 3.0 * joints.wear_std[J + 1])
    True
    """
    joint = per_joint(state, replay)
    if replay.from_production:
        return learn_from_production(state, joint, drift, temperature)
    state, stuck, suspect = check_sensors(state, joint)
    observation = withhold(joint, suspect)
    state = enter_context(state, joint, drift, temperature)
    state = age(state, joint.days, joint.revolutions, drift)
    inside = inside_range(state.viscous.range_c, observation.temperature_c, temperature.margin_k)  # the range before this replay
    state = remember_baseline(state, observation, drift)
    updated = update_by_replay(state, joint, observation, drift)
    if drift.prior is not None:
        updated = widen_where_prior_fails(updated, drift.prior, _family_std_per_k(temperature))
    state = replace(state, filter_state=count_from_lowest(updated, joint.days, drift, joint.awaiting_proof))
    state = replace(state, filter_state=remember_warming(state.filter_state, observation.warming_k_per_min))
    state = replace(state, filter_state=look_beside(state, joint, observation))
    state = settle_reference(state, observation.temperature_c, drift)
    return StepResult(learn_laws(state, observation), observation, inside, stuck)


def learn_from_production(state: DriftState, joint: JointReplay, drift: DriftSettings, temperature: TemperatureSettings) -> StepResult:
    """The state after an observation from production.

    It says nothing of the channels beside F(v*), of the temperature laws of fc and fv, of T0, and of sensors: those are the replays'.
    """
    suspect = np.zeros(state.joints, dtype=bool) if state.sensors is None else suspect_sensors(state.sensors) | held_still(state.sensors)
    seen = withhold(joint, suspect)
    began = begin_production(state.filter_state, state.joints_per_arm, drift)
    state = replace(state, filter_state=reopen_production(began, joint.opened))
    state = age(state, joint.days, np.full(state.joints, np.nan), drift)
    inside = inside_production(state.filter_state, seen.temperature_c, temperature.margin_k)
    before = swapped(state.filter_state)
    updated = update_filter(before, seen, np.full(state.joints, SLOTS), state.joints_per_arm, drift, replay_slot=state.slot)
    resolved = np.isfinite(seen.log_torque)
    learnt = resolved & updated.learnt_from
    updated = widen_range(observed(updated, resolved, learnt, state.joints_per_arm), seen.temperature_c, learnt)
    updated = remember_unconfirmed(before, updated, resolved)
    counted = count_from_lowest(swapped(updated), joint.days, drift, joint.awaiting_proof)
    return StepResult(replace(state, filter_state=counted), seen, inside, np.zeros(state.joints, dtype=bool))


def update_by_replay(state: DriftState, joint: JointReplay, observation: Observation, drift: DriftSettings) -> FilterState:
    """The filter state updated by a replay, which confirms or contradicts what production alone has found since the last one."""
    joints, J = state.filter_state, state.joints_per_arm
    if joints.sources is None:
        return update_filter(joints, observation, state.slot, J, drift, same_mass=joint.same_mass)
    before = arbitrate(joints, observation, state.slot, J, drift)
    updated = update_filter(before, observation, state.slot, J, drift, same_mass=joint.same_mass)
    return confirmed(observed(updated, joint.replayed, updated.learnt_from, J), joint.replayed & updated.learnt_from)


def per_joint(state: DriftState, replay: Replay) -> JointReplay:
    """The replay over joints. An arm that did not replay keeps its slot, and its days and count are as if no time had passed.

    Raises ValueError where the days since an arm's last replay are negative or unknown.
    """
    N, J = state.joints, state.joints_per_arm
    _check_days(replay)

    def of_arms(mask: np.ndarray | None, absent: bool) -> np.ndarray:
        return np.full(N, absent) if mask is None else np.repeat(mask, J)

    here = of_arms(replay.replayed, True)
    seen = replay.observation
    return JointReplay(
        observation=seen._replace(log_torque=np.where(here, seen.log_torque, np.nan)),
        days=np.where(here, np.repeat(replay.days, J), 0.0),
        replayed=here,
        slot=state.slot if replay.slot is None else np.where(here, np.repeat(replay.slot, J), state.slot),
        opened=here & of_arms(replay.opened, False),
        replaced=here & (np.zeros(N, dtype=bool) if replay.replaced is None else replay.replaced),
        awaiting_proof=np.zeros(N, dtype=bool) if replay.awaiting_proof is None else replay.awaiting_proof,
        undeclared=of_arms(replay.undeclared, False),
        same_mass=of_arms(replay.same_mass, False),
        revolutions=np.full(N, np.nan) if replay.revolutions is None else np.where(here, replay.revolutions, np.nan),
    )


def _check_days(replay: Replay) -> None:
    here = np.ones(len(replay.days), dtype=bool) if replay.replayed is None else replay.replayed
    wrong = np.flatnonzero(here & ~(replay.days >= 0.0))
    if len(wrong):
        first = wrong[0]
        raise ValueError(
            f"days since the last replay of arm {first} of {len(here)}: {replay.days[first]}; "
            "expected 0 or more: replays are learned from in the order of time"
        )


def look_beside(state: DriftState, joint: JointReplay, observation: Observation) -> FilterState:
    """The filter state with the channels beside F(v*) after this replay: wear that F(v*) does not show."""
    joints = state.filter_state
    replay = ChannelReplay(observation, joints.origin_c, state.slot, joint.opened, joint.replaced)
    return replace(joints, channels=update_channels(joints.channels, replay, state.joints_per_arm))


def check_sensors(state: DriftState, joint: JointReplay) -> tuple[DriftState, np.ndarray, np.ndarray]:
    """The state with the sensors' history after this replay, which joints' temperature sensors are stuck, and which may be, (N,) each."""
    measured = np.where(joint.replayed, joint.observation.temperature_c, np.nan)
    seen, sources = joint.observation, state.filter_state.sources
    sensors = update_sensors(
        state.sensors,
        measured,
        state.joints_per_arm,
        warming_k_per_min=seen.warming_k_per_min,
        constant=seen.temperature_constant if len(seen.temperature_constant) else None,
        days=joint.days if sources is None else sources.since_days + joint.days,
    )
    still = held_still(sensors)
    return replace(state, sensors=sensors), stuck_sensors(sensors) | still, suspect_sensors(sensors) | still


def withhold(joint: JointReplay, suspect: np.ndarray) -> Observation:
    """The observation as the filter may use it: no temperature of a sensor that may be stuck, no friction under an undeclared change."""
    seen = joint.observation
    return seen._replace(
        temperature_c=np.where(suspect, np.nan, seen.temperature_c),
        log_torque=np.where(joint.undeclared, np.nan, seen.log_torque),
    )


def enter_context(state: DriftState, joint: JointReplay, drift: DriftSettings, temperature: TemperatureSettings) -> DriftState:
    """The state in the contexts of this replay.

    A context that was seen before has the level that it had. In a new one the level is unknown, and wear and its rate are kept with their
    uncertainty: wear that coincides with the change cannot be seen. In either case the temperature laws' levels are learned anew. A joint
    that was replaced starts without wear, and its levels are unknown in every slot.
    """
    moved = joint.slot != state.slot
    if joint.opened.any():
        state = replace(state, filter_state=open_slot(state.filter_state, joint.slot, joint.opened))
    if moved.any():
        state = replace(
            state,
            slot=joint.slot,
            filter_state=leave_context(state.filter_state, moved),
            viscous=reopen_law(state.viscous, moved, temperature),
            coulomb=reopen_law(state.coulomb, moved, temperature),
        )
    return new_joints(state, joint.replaced, drift, temperature) if joint.replaced.any() else state


def new_joints(state: DriftState, new: np.ndarray, drift: DriftSettings, temperature: TemperatureSettings) -> DriftState:
    """The state where the joints in `new` (N,) are other ones: nothing that was learnt of the old ones holds.

    Two things stay as a first guess, with the doubt of a joint never seen: the temperature slope, which another joint of the same size has
    about, and the range of temperatures, which is that of the place.
    """
    filter_state = replace_joints(state.filter_state, new, drift)
    filter_state = unknown_joint(filter_state, new, drift, slope_std=_family_std_per_k(temperature))
    if drift.prior is not None:
        filter_state = temperature_from_fleet(filter_state, drift.prior, new)
    if filter_state.channels is not None:
        nothing = np.zeros(len(new), dtype=bool)
        filter_state = replace(filter_state, channels=restart(filter_state.channels, state.slot, nothing, new))
    return replace(
        state,
        filter_state=filter_state,
        viscous=reopen_law(state.viscous, new, temperature),
        coulomb=reopen_law(state.coulomb, new, temperature),
        sensors=None if state.sensors is None else forget_sensors(state.sensors, new),
        first_log_torque=np.where(new, np.nan, state.first_log_torque),
        first_temperature_c=np.where(new, np.nan, state.first_temperature_c),
    )


def _family_std_per_k(temperature: TemperatureSettings) -> float:
    """Standard deviation of −∂log F/∂T [1/K] among all arms, whatever the share of viscous friction."""
    return float(np.hypot(temperature.viscous_fall_std_per_k, temperature.coulomb_fall_std_per_k))


def age(state: DriftState, days: Array, revolutions: Array, drift: DriftSettings) -> DriftState:
    """The state `days` (N,) later, at a count of `revolutions` (N,), NaN where nobody counts: wear grows at its rate, uncertainty grows.

    A new usual usage per day rescales the wear rate, which is a rate per usual day; then the filter predicts over the usage.
    """
    sources = state.filter_state.sources
    counted_days = days if sources is None else sources.since_days + days  # revolutions are counted from replay to replay
    production = update_usage(state.usage, revolutions, counted_days)
    use = production.usual_days if sources is None else production.usual_days * days / np.maximum(counted_days, 1e-9)
    rescaled = rescale_rate(state.filter_state, production.factor)
    predicted = predict_filter(rescaled, days, state.joints_per_arm, drift, use)
    return replace(state, usage=production.usage, filter_state=update_interval(predicted, days))


def remember_baseline(state: DriftState, observation: Observation, drift: DriftSettings) -> DriftState:
    """The state with the means of the first `baseline_replays` replays, before the filter has learned from this one."""
    n = state.filter_state.replays
    more = (n < drift.baseline_replays) & np.isfinite(observation.log_torque)

    def mean(old: Array, new: Array) -> Array:
        usable = more & np.isfinite(new)
        before = np.where(np.isfinite(old), old, new)
        return np.where(usable, before + (new - before) / (n + 1.0), old)

    return replace(
        state,
        first_log_torque=mean(state.first_log_torque, observation.log_torque),
        first_temperature_c=mean(state.first_temperature_c, observation.temperature_c),
    )


def settle_reference(state: DriftState, temperature_c: Array, drift: DriftSettings) -> DriftState:
    """The state with T0 as the mean of a joint's first `settle_replays` temperatures (N,) of replays that the filter learned from."""
    settling = state.filter_state.learnt_from & np.isfinite(temperature_c) & (state.settled < drift.settle_replays)
    T0 = state.reference_temperature_c
    moved = T0 + (temperature_c - T0) / (state.settled + 1.0)
    return replace(state, reference_temperature_c=np.where(settling, moved, T0), settled=state.settled + settling)


def learn_laws(state: DriftState, observation: Observation) -> DriftState:
    """The state with the temperature laws after this replay, wear divided out. Joints that the filter did not learn from are left out."""
    unworn = np.where(state.filter_state.learnt_from, np.exp(-state.filter_state.change), np.nan)
    T = observation.temperature_c
    return replace(
        state,
        viscous=update_law(state.viscous, T, observation.viscous_nm_s_per_rad * unworn),
        coulomb=update_law(state.coulomb, T, observation.coulomb_nm * unworn),
    )
