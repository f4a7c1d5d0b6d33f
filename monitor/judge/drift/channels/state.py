"""What the channels beside F(v*) remember of each joint, and what they found: values only.

Shapes: C channels in the order of `CHANNELS`, N joints, P features of the regression, W replays of the window.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from monitor.judge.document import array
from monitor.judge.drift.slots import SLOTS
from monitor.recording import Array

CONTRAST, SLOW, FAST, RESIDUAL = range(4)
CHANNELS = ("contrast", "slow", "fast", "residual")
WINDOW = 32  # W [replays] in which a change is looked for; older replays are the baseline
SLOPE, CURVE, LAG = SLOTS, SLOTS + 1, SLOTS + 2  # features after the levels: t, t², warming
FEATURES = SLOTS + 3  # P


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelState:
    """The channels of N joints. In the window, index 0 is the newest replay."""

    mean: Array  # (C, N, P) levels of the contexts' slots, slope [1/K], curve [1/K²], lag [1/(K/min)] of the baseline
    cov: Array  # (C, N, P, P)
    values: Array  # (C, N, W) NaN where there is none
    t: Array  # (N, W) temperature less the origin [K]
    warming: Array  # (N, W) [K/min]
    slot: Array  # (N, W) of the replay's context
    variance: Array  # (C, N) of one replay around the baseline
    product: Array  # (C, N) mean product of two successive replays' residuals
    weight: Array  # (C, N) replays in both
    slow_ratio: Array  # (C, N) mean square of the window's mean over what correlated noise explains
    last: Array  # (C, N) residual of the last replay that left the window; NaN: none to compare with
    log_torque: Array  # (N,) y of the last replay that was resolved
    shift: Array  # (C, N) [log] how far the replays since the likeliest change are from the baseline, beyond the arm's other joints
    shift_std: Array  # (C, N)
    level: Array  # (C, N) [log] of the baseline in the last replay's context at its temperature
    found: Array  # (C, N) 1 where that change is beyond chance


def channels_from_document(document: Any, joints: int) -> ChannelState | None:
    """A ChannelState from its document; None from an older one, which has none. Raises BadInput naming the key."""
    if document is None:
        return None
    C, N, P, W = len(CHANNELS), joints, FEATURES, WINDOW
    shapes: dict[str, tuple[int, ...]] = {
        "mean": (C, N, P), "cov": (C, N, P, P), "values": (C, N, W), "t": (N, W), "warming": (N, W), "slot": (N, W), "log_torque": (N,),
    }  # fmt: skip
    return ChannelState(
        **{f.name: array(document, f.name, shapes.get(f.name, (C, N)), where="belief: channels") for f in fields(ChannelState)}
    )


def no_channels(joints: int) -> ChannelState:
    """The channels of N joints before the first replay."""
    C, N, W = len(CHANNELS), joints, WINDOW
    unknown, zero = np.full((C, N), np.nan), np.zeros((C, N))
    mean, cov = prior(N)
    variance = np.full((C, N), PRIOR_STD**2)
    return ChannelState(
        mean=mean,
        cov=cov,
        values=np.full((C, N, W), np.nan),
        t=np.zeros((N, W)),
        warming=np.zeros((N, W)),
        slot=np.full((N, W), -1.0),
        variance=variance,
        product=PRIOR_CORRELATION * variance,
        weight=np.full((C, N), PRIOR_REPLAYS),
        slow_ratio=np.ones((C, N)),
        last=unknown,
        log_torque=np.full(N, np.nan),
        shift=zero,
        shift_std=zero,
        level=unknown,
        found=zero,
    )


DIFFUSE_VAR = 100.0  # [log²] of an unknown level
PRIOR_STD = 0.05  # [log] of one replay: fc and fv of real joints scatter by 4–10 %, and are anti-correlated
PRIOR_CORRELATION = 0.5  # of successive replays, as is assumed of friction: `DriftSettings.autocorrelation`
PRIOR_REPLAYS = 5.0  # weight of both
FALL_PER_K = 0.015  # viscous friction falls by 0.8–2.2 %/K, Coulomb friction hardly: Raviola et al. (2021)
SLOPES_PER_K = np.array([FALL_PER_K, 0.3 * FALL_PER_K, -0.3 * FALL_PER_K, 0.0])  # (C,) the share of viscous friction is 0.2 to 0.8
SLOPE_STDS_PER_K = np.array([0.007, 0.005, 0.005, 0.01])  # (C,) likewise; what temperature does to the residual is not known
CURVE_STDS = np.array([1e-4, 1e-4, 1e-4, 1e-4])  # [1/K²] Vogel's law beyond an exponential; of sums, k²/2 · share · (1 − share)
LAG_MIN, LAG_STD_MIN = 3.0, 6.0  # [min] of the grease behind the motor's sensor


def prior(joints: int) -> tuple[Array, Array]:
    """Mean (C, N, P) and covariance (C, N, P, P) of a baseline before its first replay."""
    C, N = len(CHANNELS), joints
    mean = np.zeros((C, N, FEATURES))
    mean[..., SLOPE] = SLOPES_PER_K[:, None]
    mean[..., LAG] = -LAG_MIN * SLOPES_PER_K[:, None]
    std = np.full((C, FEATURES), np.sqrt(DIFFUSE_VAR))
    std[:, SLOPE], std[:, CURVE] = SLOPE_STDS_PER_K, CURVE_STDS
    std[:, LAG] = LAG_STD_MIN * np.hypot(SLOPES_PER_K, SLOPE_STDS_PER_K)
    cov = np.zeros((C, N, FEATURES, FEATURES))
    cov[..., range(FEATURES), range(FEATURES)] = (std**2)[:, None, :]
    return mean, cov
