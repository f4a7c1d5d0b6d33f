"""Recordings of an arm whose friction no law of the monitor describes, and what may go wrong with them.

Rigid torque is pinocchio's. Friction is concave in speed and grows with the gear's load; torque ripples with the gear, and its noise is
correlated over several samples. Faults change the recording, never the identifier's own equations.
"""

from dataclasses import replace

import numpy as np
from oracle_arm import COULOMB_NM, VISCOUS, friction, truth
from scipy.signal import lfilter

from monitor.model.robot import load_robot
from monitor.recording import Array, Recording

UR5 = load_robot("ur5")


def productioned_arm(seed: int = 1, repetitions: int = 2, **shape: float) -> Recording:
    """A UR5 on the ground that warms up by a tenth of a kelvin a minute."""
    rng = np.random.default_rng(seed)
    known = truth(UR5, seed=seed, repetitions=repetitions, **shape)
    rigid = known.torque - friction(known.qd)
    rubbing = np.tanh(known.qd / 0.005) * (0.8 * COULOMB_NM + 0.04 * np.abs(rigid) + 0.9 * VISCOUS * np.abs(known.qd) ** 0.7)
    ripple = 0.03 * COULOMB_NM * np.sin(101.0 * known.q)
    noise = lfilter([0.3], [1.0, -0.9], rng.normal(size=known.q.shape), axis=0) * 0.02 * COULOMB_NM
    torque = rigid + rubbing + ripple + noise
    return Recording(
        t_s=500.0 + known.t_s,
        q=known.q + 2e-5 * rng.normal(size=known.q.shape),
        qd=known.qd + 1e-3 * rng.normal(size=known.q.shape),
        current=torque / UR5.drive_gain_nm_per_a + 0.03 * rng.normal(size=known.q.shape),
        temperature_c=30.0 + known.t_s[:, None] / 600.0 + np.arange(6),
        source="worked",
    )


def late(recording: Recording, delay_s: float, joints: slice | list[int] = slice(None)) -> Recording:
    """Currents of these joints that come so much later."""
    rows = round(delay_s / float(np.median(np.diff(recording.t_s))))
    current = recording.current.copy()
    current[rows:, joints] = recording.current[:-rows, joints]
    return replace(recording, current=current)


def with_current(recording: Recording, joint: int, change) -> Recording:
    """The current of one joint (from 0) through `change`, a function of its column."""
    current = recording.current.copy()
    current[:, joint] = change(recording.current[:, joint])
    return replace(recording, current=current)


def held(x: Array, rows: int) -> Array:
    """A signal that is sampled once in so many rows."""
    return x[np.arange(len(x)) // rows * rows]


def frozen(x: Array, first: int, last: int) -> Array:
    """A signal that keeps its value in these rows."""
    y = x.copy()
    y[first:last] = x[first]
    return y


def coupled_wrist(recording: Recording, share: float = -1.0) -> Recording:
    """The last angle is recorded at its motor, which the fifth axis turns too."""
    q, qd = recording.q.copy(), recording.qd.copy()
    q[:, 5] += share * recording.q[:, 4]
    qd[:, 5] += share * recording.qd[:, 4]
    return replace(recording, q=q, qd=qd)
