"""Temperature sensors that are stuck: their value does not change while the arm's other joints warm and cool, or where it used to change.

A stuck value is not a temperature. If it were used, every season would look like wear of that joint, or hide it. Where all sensors of an
arm are stuck no other joint shows it: then a value has stood still for longer than chance explains, by how seldom it did so before.
"""

from dataclasses import dataclass, fields
from functools import cache
from typing import Annotated

import numpy as np

from monitor.recording import Array

SAME_K = 1.0 / 32.0  # [K] half a step of a UR's sensor: the mean over a replay varies by more
REPLAYS = 5  # in a row with the same value …
MOVED_K = 3.0  # [K] … while the median of the other joints varied by so much
SUSPECT_REPLAYS, SUSPECT_MOVED_K = 3, 1.0  # the same of a value that is not used until it changes, and that nobody is told of
APART_DAYS = 0.2  # [d] between two replays of which the later one counts: within an hour a temperature may stand still …
TOGETHER_K = 4.0 * SAME_K  # … unless the median of the other joints has changed by so much since: two steps of a UR's sensor
CHANCE = 0.01 / (365.0 * 6.0)  # 0.01 false findings a robot-year, if each replay of each joint could begin a run of the same value
MOVES_K_PER_MIN = 2.0 * 2.0 * SAME_K  # one step of a UR's sensor in half a minute: the sensor of such a replay is not stuck
# Changes from replay to replay as if they had been seen of a sensor that something else speaks against: its readings are one and the same
# number throughout every replay, as in 3 % of half minutes of real arms, or friction changes in most joints and no sensor has moved
CHANGES_ASSUMED = 8.0
LEAST_CHANGES = 1e-9  # of a sensor that has said one value all the time: chance explains it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorHistory:
    """For how long each joint's sensor has had its present value, (N,) each; NaN before the first replay."""

    value_c: Annotated[Array, "N"]
    replays: Annotated[Array, "N"]  # in a row with this value, apart in time or while the others moved
    others_low_c: Annotated[Array, "N"]  # lowest median of the arm's other joints in these replays
    others_high_c: Annotated[Array, "N"]  # and the highest
    held: Annotated[Array, "N"]  # of these replays after the first, those that count: apart in time, and no reading in them was another
    held_before: Annotated[Array, "N"]  # likewise, of the values before, except where the sensor was stuck
    changes: Annotated[Array, "N"]  # from one value to another; to leave a value and to come back to it are two
    constant: Annotated[Array, "N"]  # of `replays`, those throughout which every reading was this value


def no_sensors(joints: int) -> SensorHistory:
    """The history of N joints before the first replay."""
    unknown, none = np.full(joints, np.nan), np.zeros(joints)
    return SensorHistory(
        value_c=unknown,
        replays=none,
        others_low_c=unknown,
        others_high_c=unknown,
        held=none,
        held_before=none,
        changes=none,
        constant=none,
    )


def update_sensors(
    before: SensorHistory | None,
    temperature_c: Array,
    joints_per_arm: int,
    *,
    warming_k_per_min: Array | None = None,
    constant: np.ndarray | None = None,
    days: Array | None = None,
) -> SensorHistory:
    """The history after one more replay at temperatures (N,) [°C]. A sensor without a value keeps its history.

    warming_k_per_min : (N,) slope of the readings; constant : (N,) 1 where they were one number throughout the replay, else 0;
    days : (N,) since the last replay. None or NaN: nobody knows, and the replay counts.
    """
    T, N = temperature_c, len(temperature_c)
    was = no_sensors(N) if before is None else before
    known = np.isfinite(T)
    same = known & (np.abs(T - was.value_c) < SAME_K)
    others = median_of_others(np.where(same, np.nan, T), joints_per_arm)  # of those that move: the others may be stuck
    changed = known & ~same
    apart = np.full(N, True) if days is None else days >= APART_DAYS
    moving = median_of_others(np.abs(T - was.value_c), joints_per_arm) >= TOGETHER_K  # False where nobody knows
    steady = np.full(N, np.nan) if constant is None else constant
    slope = np.full(N, np.nan) if warming_k_per_min is None else np.abs(warming_k_per_min)
    counts, still = apart & ~(slope > MOVES_K_PER_MIN) & (steady != 0.0), np.nan_to_num(steady)
    return SensorHistory(
        value_c=np.where(changed, T, was.value_c),
        replays=np.where(same, was.replays + (apart | moving), np.where(known, 1.0, was.replays)),
        others_low_c=np.where(same, np.fmin(was.others_low_c, others), np.where(known, others, was.others_low_c)),
        others_high_c=np.where(same, np.fmax(was.others_high_c, others), np.where(known, others, was.others_high_c)),
        held=np.where(changed, 0.0, was.held + (same & counts)),
        held_before=was.held_before + np.where(changed & ~held_still(was), was.held, 0.0),
        changes=was.changes + (changed & np.isfinite(was.value_c)),
        constant=np.where(same, was.constant + still, np.where(known, still, was.constant)),
    )


def forget_sensors(sensors: SensorHistory, new: np.ndarray) -> SensorHistory:
    """The history where the joints in `new` (N,) have another sensor."""
    fresh = no_sensors(len(new))
    return SensorHistory(**{f.name: np.where(new, getattr(fresh, f.name), getattr(sensors, f.name)) for f in fields(SensorHistory)})


def held_still(sensors: SensorHistory) -> np.ndarray:
    """(N,) which sensors have had one value for longer than chance explains, whatever the arm's other sensors do."""
    constant = (sensors.constant > 0) & (sensors.constant >= sensors.held)
    return _beyond_chance(sensors, np.where(constant, CHANGES_ASSUMED, 0.0))


def all_held_still(sensors: SensorHistory) -> bool:
    """The same of all sensors of one arm whose friction changes in most joints together, as it does with their temperature."""
    known = np.isfinite(sensors.value_c)
    return bool(known.any() and _beyond_chance(sensors, CHANGES_ASSUMED)[known].all())


def _beyond_chance(sensors: SensorHistory, assumed: Array | float) -> np.ndarray:
    """(N,) whether `held` is too many.

    The share of replays after which a sensor says the same again has a beta distribution, by those that were seen. From it follows the
    probability that so many in a row do. assumed : changes that count as seen.
    """
    from scipy.special import betaln  # only a verdict needs it

    same, changes = 1.0 + sensors.held_before, np.maximum(sensors.changes / 2.0 + assumed, LEAST_CHANGES)
    beyond: np.ndarray = betaln(same + sensors.held, changes) - betaln(same, changes) < np.log(CHANCE)
    return beyond


def stuck_sensors(sensors: SensorHistory) -> np.ndarray:
    """(N,) which sensors are stuck."""
    moved = sensors.others_high_c - sensors.others_low_c
    stuck: np.ndarray = (sensors.replays >= REPLAYS) & (moved >= MOVED_K)
    return stuck


def suspect_sensors(sensors: SensorHistory) -> np.ndarray:
    """(N,) which sensors may be stuck: until that is sure, a temperature that they missed would look like friction."""
    moved = sensors.others_high_c - sensors.others_low_c
    suspect: np.ndarray = (sensors.replays >= SUSPECT_REPLAYS) & (moved >= SUSPECT_MOVED_K)
    return suspect


def median_of_others(values: Array, joints_per_arm: int) -> Array:
    """(N,) for each joint, the median of the finite values (N,) of the arm's other joints; NaN where fewer than two are finite."""
    J = joints_per_arm
    if J < 3:
        return np.full(len(values), np.nan)
    known = np.where(np.isfinite(values), values, np.nan).reshape(-1, J)[:, _others(J)]
    ordered = np.sort(known, axis=-1)  # (A, J, J − 1), NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    lower, upper = (np.take_along_axis(ordered, np.maximum(k, 0), axis=-1) for k in ((count - 1) // 2, count // 2))
    return np.where(count >= 2, (lower + upper) / 2.0, np.nan).ravel()


@cache
def _others(joints: int) -> np.ndarray:
    """(J, J − 1) the other joints of each joint."""
    return np.array([[k for k in range(joints) if k != j] for j in range(joints)])
