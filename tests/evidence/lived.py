"""Fleets that live a friction that a test writes down: noise of several kinds, and what the judge told of it, day by day."""

from typing import NamedTuple

import numpy as np

from monitor.judge.alerts.evidence import weigh_evidence
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.friction.observation import Observation
from monitor.judge.friction.step import FrictionModel, FrictionState
from monitor.judge.settings import AssessSettings
from monitor.recording import Array

J, SIGMA = 6, 0.02


class Lived(NamedTuple):
    """What was told of A arms on each of D days."""

    state: DriftState  # after the last day
    raises: np.ndarray  # (D, A, J) tier to which each joint's alert may be raised; −1: none
    falls: np.ndarray  # (D, A, J)
    together: np.ndarray  # (D, A)
    wear: Array  # (D, A, J) [log]
    std: Array  # (D, A, J)

    def told(self, days: slice = slice(60, None)) -> np.ndarray:
        """(A, J) joints of which anything was told in these days."""
        told: np.ndarray = ((self.raises >= 0) | self.falls)[days].any(axis=0)
        return told


def correlated(
    rng: np.random.Generator, days: int, joints: int, *, std: float = SIGMA, rho: float | Array = 0.5, shocks: Array | None = None
) -> Array:
    """(days, joints) noise with correlation ρ from replay to replay."""
    new = rng.normal(size=(days, joints)) if shocks is None else shocks
    noise = new.copy()
    for day in range(1, days):
        noise[day] = rho * noise[day - 1] + np.sqrt(1.0 - rho**2) * new[day]
    return std * noise


def flicker(rng: np.random.Generator, days: int, joints: int) -> Array:
    """(days, joints) noise with a spectrum of 1/f and a standard deviation of 2 %; it ends where it began."""
    f = np.fft.rfftfreq(days)
    f[0] = np.inf
    wave = (rng.normal(size=(len(f), joints)) + 1j * rng.normal(size=(len(f), joints))) / np.sqrt(f)[:, None]
    noise = np.fft.irfft(wave, days, axis=0)
    scaled: Array = SIGMA * noise / noise.std(axis=0)
    return scaled


def swelling(rng: np.random.Generator, days: int, joints: int) -> Array:
    """(days, joints) factor of σ: a walk of its logarithm about 0, within a factor of two for three weeks; mean square 1."""
    size = np.exp(0.6 * correlated(rng, days, joints, std=1.0, rho=0.95))
    relative: Array = size / np.sqrt(np.mean(size**2, axis=0))
    return relative


def lived(y: Array, *, interval_days: float = 1.0, settings: AssessSettings | None = None) -> Lived:
    """Arms with friction of e^(2 + y), y (D, A·J), by replays at about one temperature; NaN is not resolved."""
    D, N = y.shape
    A, assess = N // J, settings or AssessSettings()
    kept: list[tuple[np.ndarray, ...]] = []
    state: DriftState | None = None
    for day, of_day in enumerate(y):
        torque = np.exp(2.0 + of_day)
        seen = Observation(
            log_torque=2.0 + of_day,
            variance=np.full(N, 0.005**2),
            temperature_c=np.full(N, 30.0) + 0.1 * np.sin(day),
            viscous_share=np.full(N, 0.4),
            warming_k_per_min=np.zeros(N),
            coulomb_nm=0.6 * torque,
            viscous_nm_s_per_rad=torque,
        )
        state = state or initial_state(seen, J, assess)
        state = step(state, Replay(observation=seen, days=np.full(A, interval_days * (day > 0))), assess, in_place=True).state
        found = weigh_evidence(state, assess.health)
        kept.append((found.raises, found.falls, found.together, found.wear, found.wear_std))
    assert state is not None
    raises, falls, together, wear, std = (np.array(each) for each in zip(*kept, strict=True))
    of_joints = (each.reshape(D, A, J) for each in (wear, std))
    return Lived(state, raises.reshape(D, A, J), falls.reshape(D, A, J), together, *of_joints)


def learnt_correlation(state: FrictionState, model: FrictionModel) -> Array:
    """(A·J,) correlation of the noise of one day and the next that the judge believes in."""
    rho: Array = state.of_joints((state.p * model.noise.column("rho")).sum(axis=0))
    return rho


def of_joint(which: int, value: Array) -> Array:
    """(D, J) of one joint, the others 0; value : (D,)."""
    all_joints = np.zeros((len(value), J))
    all_joints[:, which] = value
    return all_joints


def fleet(arms: int, course: Array, *, seed: int, std: float = SIGMA, rho: float = 0.5, interval_days: float = 1.0) -> Lived:
    """Arms of the course (D, J) [log], each with noise of its own."""
    noise = correlated(np.random.default_rng(seed), len(course), arms * J, std=std, rho=rho)
    return lived(noise + np.tile(course, arms), interval_days=interval_days)
