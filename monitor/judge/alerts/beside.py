"""Wear that the channels beside F(v*) found, as a rise of friction that the tiers of `wear_rising` compare, and as text.

The tier compares the largest rise over the speeds: a joint that needs 10 % more torque at low speed is worn though it needs none more at
v*. For wear at one place of the joint it compares the torque that came to the unexplained one, as RMS over the replay, with friction. None
of them raises the limit tier: the configured limit is one of F(v*).

Shapes: C channels, N joints.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from monitor.identify.validate import PLACE_RAD
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.drift.channels import CONTRAST, FAST, RESIDUAL, SLOW, ChannelState
from monitor.judge.drift.observation import FAST_RAD_S, SLOW_RAD_S
from monitor.reason import joint_text
from monitor.recording import Array

REFERENCE_RAD_S = 0.4  # the speed at which friction is unchanged while the contrast turns; the rises depend on it weakly
AT_LOW, AT_HIGH, AT_PLACE = f"{SLOW_RAD_S:g} rad/s", f"{FAST_RAD_S:g} rad/s", "one place"
KINDS = (AT_LOW, AT_HIGH, AT_PLACE)
LEAST_STD = 0.01  # [log] a straight line is no law of friction: what it says of another speed is not better known than this
NOTHING = -np.inf  # [log] rise where no channel found a change


class ChannelRise(NamedTuple):
    """The largest rise that a channel found, (N,) each."""

    rise: Array  # [log] of friction at that speed or place over that at v*; −∞ where nothing was found
    std: Array
    kind: Array  # index into `KINDS`
    ratio: Array  # of the residual's RMS to that of the baseline; 1 where it did not change


class JointBeside(NamedTuple):
    """What the channels found of one joint."""

    rise: float  # [log] −∞ where nothing was found, or where F(v*) itself rose by more
    std: float
    kind: str
    ratio: float

    @property
    def found(self) -> bool:
        """Whether a channel found more than friction at the reference speed shows."""
        return bool(np.isfinite(self.rise))

    def above(self, settings: HealthSettings) -> Array:
        """(3,) probability that the rise is above that of each tier."""
        if not self.found:
            return np.zeros(3)
        probability: Array = scipy.special.ndtr((self.rise - np.log1p(settings.rises)) / max(self.std, 1e-9))
        return probability

    @property
    def finding(self) -> str:
        """What the channel found, as a clause."""
        percent = f"{np.expm1(self.rise):+z.0%} ± {np.exp(self.rise) * self.std:.0%}"
        if self.kind == AT_PLACE:
            return (
                f"torque that the fit does not explain is {self.ratio:.1f} times that of before, {percent} of friction: wear at one place"
            )
        return f"friction at {self.kind} rose by {percent} against friction at {REFERENCE_RAD_S:g} rad/s"

    def text(self, j: int, of_reference: Callable[[], str], peak_rad: Array | None = None) -> str:
        """The alert's text: of the channel where one found more than F(v*) shows, and of F(v*).

        peak_rad : (J,) where the residual of the last replay is largest; None where nobody knows.
        """
        if not self.found:
            return of_reference()
        place = ""
        if self.kind == AT_PLACE and peak_rad is not None and np.isfinite(peak_rad[j]):
            place = f", now largest between {peak_rad[j] - PLACE_RAD / 2:.1f} and {peak_rad[j] + PLACE_RAD / 2:.1f} rad"
        return f"{joint_text(j + 1)}: {self.finding}{place}. {of_reference()}"


def rise_beside(state: ChannelState | None) -> ChannelRise | None:
    """The rise of each joint by the channels' state; None without one."""
    if state is None:
        return None
    N = state.found.shape[1]
    if not state.found.any():  # as on nearly every day
        return ChannelRise(rise=np.full(N, NOTHING), std=np.zeros(N), kind=np.zeros(N, dtype=int), ratio=np.ones(N))
    rises = np.stack([_rises(state, state.shift), _rises(state, state.shift - np.copysign(state.shift_std, state.shift))])
    found = np.stack(
        [_found(state, CONTRAST) | _found(state, SLOW), _found(state, CONTRAST) | _found(state, FAST), _found(state, RESIDUAL)]
    )
    rise = np.where(found, rises[0], NOTHING)
    kind = np.argmax(rise, axis=0)
    at = kind[None, :]
    largest, lower = (np.take_along_axis(each, at, axis=0)[0] for each in (rise, rises[1]))
    known = np.isfinite(largest) & (largest > 0)
    return ChannelRise(
        rise=np.where(known, largest, NOTHING),
        std=np.where(known, np.maximum(largest - lower, LEAST_STD), 0.0),
        kind=kind,
        ratio=np.exp(np.where(_found(state, RESIDUAL), state.shift[RESIDUAL], 0.0)),
    )


def tiers_beside(beside: ChannelRise | None, excess: Array, settings: HealthSettings) -> np.ndarray:
    """(N, 3) whether a channel shows the rise of each tier. excess : (N,) of F(v*) [log]; a fall of it counts against the rise."""
    if beside is None:
        return np.zeros((len(excess), len(settings.rises)), dtype=bool)
    known = np.isfinite(beside.rise)
    rise = np.where(known, beside.rise, 0.0) + np.minimum(excess, 0.0)
    wear = scipy.special.ndtr((rise - np.log1p(settings.wear_rise)) / np.where(known, beside.std, 1.0)) >= settings.wear_sure
    return np.stack([known & (rise >= np.log1p(settings.advisory_rise)), known & wear, np.zeros_like(known)], axis=1)


def joint_beside(beside: ChannelRise | None, excess: Array, j: int) -> JointBeside:
    """What the channels found of joint j (from 0), with the fall of F(v*) taken from it."""
    if beside is None or not np.isfinite(beside.rise[j]):
        return JointBeside(NOTHING, 0.0, AT_LOW, 1.0)
    rise = float(beside.rise[j] + min(excess[j], 0.0))
    if rise <= excess[j]:
        return JointBeside(NOTHING, 0.0, AT_LOW, 1.0)
    return JointBeside(rise, float(beside.std[j]), KINDS[int(beside.kind[j])], float(beside.ratio[j]))


def _found(state: ChannelState, channel: int) -> np.ndarray:
    found: np.ndarray = state.found[channel] > 0
    return found


def _rises(state: ChannelState, shift: Array) -> Array:
    """(3, N) rise at low speed, at high speed and at one place [log], by shifts (C, N) of the channels from their baselines."""
    before = state.level[CONTRAST]
    after = before + np.where(_found(state, CONTRAST), shift[CONTRAST], 0.0)
    line = [np.nan_to_num(_to_reference(after, v) - _to_reference(before, v)) for v in (SLOW_RAD_S, FAST_RAD_S)]
    fitted = [np.where(_found(state, k), shift[k], -np.inf) for k in (SLOW, FAST)]
    was = np.exp(2.0 * state.level[RESIDUAL] - 2.0 * state.log_torque)  # (N,) of friction squared
    more = was * np.expm1(2.0 * np.maximum(shift[RESIDUAL], 0.0))
    return np.stack([np.maximum(line[0], fitted[0]), np.maximum(line[1], fitted[1]), np.log1p(np.sqrt(np.nan_to_num(more)))])


def _to_reference(contrast: Array, speed_rad_s: float) -> Array:
    """Logarithm of friction at a speed over that at v*, by the line fc + fv·v and its contrast log fc − log fv."""
    dry = np.exp(np.clip(contrast, -20.0, 20.0))
    ratio: Array = np.log((dry + speed_rad_s) / (dry + REFERENCE_RAD_S))
    return ratio
