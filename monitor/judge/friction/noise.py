"""What differs from replay to replay and means nothing: kinds of noise, each with a scale of its own, and how probable each is.

    o⁺ = ρ^Δ·o + N(0, σ²(1 − ρ^2Δ)),     u⁺ = e^(−Δ/τ)·R(2πΔ/period)·u + N(0, κ²σ²(1 − e^(−2Δ/τ)))

o is noise of correlation ρ a day. u is slow: it wanders (R = 1), or swings with the year as humidity does. Every kind h = (ρ, κ, …) filters
the replays for itself, as if nothing ever changed; its evidence is E_h = Π N(e; 0, S), with innovations e beyond `clip` counted as `clip`
(Huber, 1964), so that an outlier says the same of every kind. σ_h follows the squared innovations: the joint's own, and those of all joints
of the arm, which season and weather change together. The arm is the prior of its joints: what the others' evidence says of a kind counts.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from monitor.judge.friction.states import NOISE, SLOW, SLOW_TURN
from monitor.recording import Array


class Kind(NamedTuple):
    """A kind of noise."""

    rho: float  # ρ, a day
    kappa: float = 0.0  # κ, size of the slow part as a multiple of σ
    memory_days: float = 50.0  # τ of the slow part
    period_days: float = np.inf  # in which it swings; infinite: it wanders
    steady_replays: float = 300.0  # over which σ of a joint stays alike …
    arm_steady_replays: float = 300.0  # … and what all joints of the arm have in common of it
    weight: float = 0.01  # π, prior weight in an arm …
    alone: float = 1.0  # … and what is left of it in a joint that is not like its arm: noise that wanders could be its wear
    of_friction: float = 0.5  # probability that u is friction, and not its identification: nobody can say of what lasts for months

    @property
    def lasts(self) -> bool:
        """Whether a part of it lasts for months: it wanders, or swings with the year."""
        return self.kappa > 0.0 and self.of_friction > 0.0

    @property
    def from_day_to_day(self) -> float:
        """The correlation of one day and the next of what does not last for months."""
        return self.rho if self.lasts else (self.rho + self.kappa**2 * math.exp(-1.0 / self.memory_days)) / (1.0 + self.kappa**2)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoisePriors:
    """What is believed of noise before a joint has said anything."""

    kinds: tuple[Kind, ...] = (
        Kind(0.0, weight=0.15),
        Kind(0.06, weight=0.05),  # of hours: replays once a day do not tell it from the one above
        Kind(0.25, weight=0.2),
        Kind(0.45, weight=0.2),
        Kind(0.6, weight=0.15),
        Kind(0.72, weight=0.1),
        Kind(0.82, weight=0.08),
        Kind(0.89, weight=0.05),
        Kind(0.94, weight=0.02),
        *(Kind(rho, steady_replays=100.0, arm_steady_replays=15.0, weight=0.05) for rho in (0.2, 0.6)),  # seasons and weather
        Kind(0.0, 1.0, 2.0, weight=0.05, of_friction=0.0),  # half of the replay, half of days: several replays a day tell them apart
        *(Kind(rho, 1.0, weight=0.01, alone=0.01) for rho in (0.0, 0.1)),  # wandering …
        *(Kind(rho, kappa, weight=0.02, alone=0.01) for rho, kappa in ((0.4, 0.4), (0.6, 1.0))),
        *(Kind(rho, 0.7, 1000.0, 365.0, weight=0.01, alone=0.1) for rho in (0.0, 0.25, 0.5, 0.75)),  # swinging with the year
    )
    std: float = 0.02  # [log] of innovations of ρ 0.5 …
    std_replays: float = 5.0  # … as if so many replays had shown it
    alike: float = 3.0  # σ of a joint is as sure as if so many times its replays had shown it: its arm's joints are alike
    clip: float = 2.3  # standard deviations beyond which an innovation counts as this
    mixed: float = 0.02  # probability that the joints of an arm differ in their noise …
    stranger: float = 1e-3  # … and that one of them does, though the others are alike
    said: float = 6.0  # [nats] most that a joint says against a kind to the others of its arm, and twice the most that it says for one
    floor: float = 1e-3  # [log] least σ

    def column(self, name: str) -> Array:
        """(H, 1) one field of the kinds."""
        return np.array([[getattr(kind, name)] for kind in self.kinds])


def noise_of_fleet(p: Array, scale: Array, joints_per_arm: int, priors: NoisePriors, *, prior_arms: float = 10.0) -> NoisePriors:
    """What the arms of a fleet say of the noise of its next one, beside the prior, which counts as `prior_arms` arms.

    p : (H, N) probability of each kind; scale : (H, N) σ². Only arms that have learnt for months should be asked. The mean of an arm is
    none of its joints, and left out.
    """
    H, J = len(p), joints_per_arm
    p, scale = (each.reshape(H, -1, J + 1)[..., :J] for each in (p, scale))
    arms = p.shape[1]
    weight = priors.column("weight")[:, 0]
    told = prior_arms * weight / weight.sum() + p.mean(axis=2).sum(axis=1)
    alike = 0.5 * np.log(scale * (1.0 - priors.column("rho")[:, None] ** 2) / 0.75)  # of innovations, as `std` is
    of_arms = (p * alike).sum(axis=(0, 2)) / J
    std = float(np.exp((prior_arms * np.log(priors.std) + of_arms.sum()) / (prior_arms + arms)))
    kinds = tuple(kind._replace(weight=float(of)) for kind, of in zip(priors.kinds, told / told.sum(), strict=True))
    return replace(priors, kinds=kinds, std=std)


def first_scale(joints_alike: Array, priors: NoisePriors) -> Array:
    """(H, N) σ² before the first replay, such that innovations are alike: else the prior of σ would choose ρ.

    joints_alike : (N,) joints of which each channel is the mean; their mean scatters less, though not by √J: joints share some noise.
    """
    alike = priors.std**2 * 0.75 / (1.0 - priors.column("rho") ** 2)
    scale: Array = alike / np.where(joints_alike > 1, 2.0, 1.0)
    return scale


def pass_time(x: Array, P: Array, B: Array, scale: Array, days: Array, priors: NoisePriors) -> None:
    """Let noise fade and come anew, in place. x (H, D, N), P (H, D, D, N), B (H, D, C, 2, N), scale (H, N) σ², days (N,)."""
    rho, kappa, tau, period = (priors.column(name) for name in ("rho", "kappa", "memory_days", "period_days"))
    held = np.where(days > 0.0, np.where(rho > 0.0, rho**days, 0.0), 1.0)  # (H, N)
    x[:, NOISE] *= held
    P[:, NOISE] *= held[:, None]
    P[:, :, NOISE] *= held[:, None]
    B[:, NOISE] *= held[:, None, None].astype(np.float32)
    P[:, NOISE, NOISE] += scale * (1.0 - held**2)
    for h in np.flatnonzero(kappa[:, 0] > 0.0):
        kept, angle = np.exp(-days / tau[h, 0]), 2.0 * np.pi * days / period[h, 0]
        c, s = kept * np.cos(angle), kept * np.sin(angle)
        for each in (x[h], P[h], P[h].swapaxes(0, 1), B[h]):
            _turn(each, c, s)
        new = kappa[h, 0] ** 2 * scale[h] * (1.0 - kept**2)
        P[h, SLOW, SLOW] += new
        P[h, SLOW_TURN, SLOW_TURN] += new


def _turn(states: Array, c: Array, s: Array) -> None:
    """Turn slow noise by kept·cos and kept·sin of the angle, in place; states first, channels last."""
    u, q = states[SLOW].copy(), states[SLOW_TURN].copy()
    states[SLOW], states[SLOW_TURN] = c * u - s * q, s * u + c * q


def follow_scale(scale: Array, informed: Array, excess: Array, told: Array, joints_per_arm: int, priors: NoisePriors) -> Array:
    """(H, N) σ² after a replay.

    excess : (H, N) ψ² − 1 of clipped innovations; told : (H, N) share of their variance that is noise between replays, 0 where the replay
    shows nothing. informed : (H, N) sum of these shares so far.
    """
    H, J = len(scale), joints_per_arm
    share, of_arm = (each.reshape(H, -1, J + 1)[..., :J] for each in (told, told * excess))
    together = np.repeat(of_arm.sum(axis=2) / np.maximum(share.sum(axis=2), 1e-9), J + 1, axis=1)
    n = np.minimum(informed + priors.std_replays, priors.column("steady_replays"))
    of_all = np.minimum(informed + priors.std_replays / J, priors.column("arm_steady_replays"))
    moved = told * ((excess - together) / n + together / of_all)
    followed: Array = np.maximum(scale * np.exp(np.clip(moved, -1.0, 1.0)), priors.floor**2)
    return followed


def probabilities(log_evidence: Array, prior: Array) -> Array:
    """(H, N) probability of each kind."""
    p: Array = prior * np.exp(log_evidence - log_evidence.max(axis=0))
    p /= p.sum(axis=0)
    return p


def prior_by_arm(log_evidence: Array, joints_per_arm: int, priors: NoisePriors) -> Array:
    """(H, N) prior of each kind in each channel: that of the other joints of its arm, where they are alike, else π.

    log_evidence : (H, N). What a joint says is bounded: one that wears says much of noise that wanders. A = Σ_h π_h Π E_h/Σ_h' π_h' E_h'
    over the other joints is how much better one kind explains them all than a kind of its own for each.
    """
    H, J = len(log_evidence), joints_per_arm
    weight = priors.column("weight") / priors.column("weight").sum()
    says = log_evidence - np.log((weight * np.exp(log_evidence)).sum(axis=0))
    says = np.clip(says, -priors.said, priors.said / 2.0).reshape(H, -1, J + 1)
    others = says[..., :J].sum(axis=2, keepdims=True) - says * (np.arange(J + 1) < J)
    alike = weight[:, :, None] * np.exp(others)
    A = alike.sum(axis=0)
    mixed = priors.mixed / (priors.mixed + (1.0 - priors.mixed) * A)
    own = (weight * priors.column("alone"))[:, :, None]
    prior: Array = (1.0 - mixed) * alike / A + (mixed + priors.stranger) * own
    return prior.reshape(H, -1)
