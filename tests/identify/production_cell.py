"""A UR5 at work, by physics that no law of the monitor describes: moves between points, loads in the hand, contact, wear.

Friction is concave in speed and grows with the gear's load; torque ripples with the gear, and its noise is correlated over 0.1 s.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from monitor.config.files import find_excitation
from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.identify.production.arm import ProductionArm, ProductionRows
from monitor.model.regressor import regressor
from monitor.model.robot import PER_JOINT, Mounting, load_robot
from monitor.recording import Array, Context, Recording

UR5, GROUND = load_robot("ur5"), Mounting()
COULOMB_NM = np.array([6.0, 7.0, 5.5, 1.4, 1.3, 1.2])
CONCAVE_NM = np.array([8.0, 9.0, 7.0, 1.6, 1.5, 1.4])  # at 1 rad/s and 25 °C
TEMPERATURE_C = 31.0
FINE_HZ = 125.0
HOME = np.array([0.3, -1.4, 1.6, -1.7, -1.57, 0.0])
CENTRE_M = 0.08  # of a load in the hand, along the flange's axis


def parameters(seed: int) -> Array:
    """(78,) of an arm whose links differ by 3 % from what its manufacturer says, with rotors."""
    rng = np.random.default_rng(seed)
    values = UR5.nominal_parameters(with_inertia=True) * (1.0 + 0.03 * rng.normal(size=13 * UR5.joints))
    values[12::PER_JOINT] = [0.8, 0.8, 0.5, 0.1, 0.1, 0.1]
    return values


def friction(qd: Array, load: Array, temperature_c: float, wear: Array | float) -> Array:
    """(N, J) [N·m]"""
    thin = np.exp(-0.015 * (temperature_c - 25.0))
    return wear * np.sign(qd) * (COULOMB_NM + 0.045 * np.abs(load) + CONCAVE_NM * thin * np.abs(qd) ** 0.65)


@dataclass(kw_only=True)
class Cell:
    """What the arm does again and again: from point to point, with a pause at each."""

    seed: int = 0
    points: int = 6
    speed: float = 1.0  # [rad/s] of the fastest joint
    acceleration: float = 2.0
    pause_s: float = 0.5
    joints: tuple[int, ...] = (0, 1, 2, 3, 4, 5)  # that move
    carried_kg: tuple[float, ...] = ()  # on the way from each point; nothing where empty
    declared_kg: tuple[float, ...] | None = None  # None: the rows hold no payload
    push_nm: tuple[float, ...] = ()  # on all joints in the second half of every other move
    drag: float = 0.0  # of friction, on every second cycle's moves: a hand or a tool
    wear: Array | float = 1.0
    temperature_c: float = TEMPERATURE_C
    rate_hz: float = 25.0
    minutes: float = 3.0
    at_unix_s: float = 1_790_000_000.0
    arm: Array = field(default_factory=lambda: parameters(1))

    def path(self) -> tuple[Array, Array, Array, Array]:
        """q, qd, qdd (N, J) at FINE_HZ of one cycle, and the number of the move (N,)."""
        rng = np.random.default_rng(self.seed)
        spread = np.zeros(6)
        spread[list(self.joints)] = np.array([1.0, 0.4, 0.5, 0.5, 0.5, 0.8])[list(self.joints)]
        points = HOME + rng.uniform(-1.0, 1.0, size=(self.points, 6)) * spread
        parts = []
        for number, (here, there) in enumerate(zip(points, np.roll(points, -1, axis=0), strict=True)):
            way, length = there - here, float(np.max(np.abs(there - here)))
            v, a = min(self.speed, np.sqrt(self.acceleration * length)), self.acceleration
            ramp, total = v / a, length / v + v / a
            t = np.arange(0.0, total, 1.0 / FINE_HZ)
            rest = total - t
            s = np.where(t < ramp, 0.5 * a * t * t, np.where(rest > ramp, v * (t - ramp / 2), length - 0.5 * a * rest * rest))
            sd, sdd = np.where(t < ramp, a * t, np.minimum(v, a * rest)), np.where(t < ramp, a, np.where(rest > ramp, 0.0, -a))
            still = np.zeros((int(self.pause_s * FINE_HZ), 6))
            moved = [here + s[:, None] / length * way, sd[:, None] / length * way, sdd[:, None] / length * way]
            parts.append([np.vstack([moved[0], still + there]), np.vstack([moved[1], still]), np.vstack([moved[2], still])])
            parts[-1].append(np.full(len(t) + len(still), number))
        q, qd, qdd, move = (np.concatenate(each) for each in zip(*parts, strict=True))
        return q, qd, qdd, move

    def rows(self) -> ProductionRows:
        """What a client at `rate_hz` receives."""
        one = self.path()
        cycles = max(1, int(self.minutes * 60.0 * FINE_HZ / len(one[0])))
        q, qd, qdd, move = (np.concatenate([each] * cycles) for each in one)
        cycle = np.repeat(np.arange(cycles), len(one[0]))
        carried = np.zeros(len(q)) if not self.carried_kg else np.array(self.carried_kg)[move]
        torque = measured_torque(self.arm, q, qd, qdd, self.temperature_c, self.wear, self.seed, carried)
        if self.push_nm:
            began = np.flatnonzero(np.diff(move, prepend=-1) != 0)
            since = (np.arange(len(q)) - began[np.searchsorted(began, np.arange(len(q)), side="right") - 1]) / FINE_HZ
            on = (move % 2 == 0) & (since > 0.5) & np.any(np.abs(qd) > 0.02, axis=1)
            torque = torque + np.outer(on, self.push_nm)
        if self.drag:
            torque = torque + (cycle % 2 == 0)[:, None] * self.drag * friction(qd, 0.0 * qd, self.temperature_c, 1.0)
        every = slice(None, None, round(FINE_HZ / self.rate_hz))
        recording = recorded(np.arange(len(q))[every] / FINE_HZ, q[every], qd[every], torque[every], self.temperature_c, self.seed)
        recording = replace(recording, target_qdd=qdd[every], context=Context(robot="ur5", recorded_at_unix_s=self.at_unix_s))
        if self.declared_kg is None:
            return ProductionRows(recording=recording)
        declared = np.array(self.declared_kg)[move][every].astype(float)
        centre = np.zeros((len(declared), 3))
        centre[:, 2] = CENTRE_M
        return ProductionRows(recording=recording, payload_kg=declared, payload_com_m=centre)


def measured_torque(
    arm: Array, q: Array, qd: Array, qdd: Array, temperature_c: float, wear: Array | float, seed: int, carried: Array
) -> Array:
    """(N, J) [N·m] at FINE_HZ. carried : (N,) [kg]."""
    rng = np.random.default_rng(seed + 1000)
    Y = regressor(UR5, GROUND, q, qd, qdd)
    last = PER_JOINT * 5
    rigid = Y @ arm + Y[:, :, last] * carried[:, None] + Y[:, :, last + 3] * (CENTRE_M * carried)[:, None]
    keep = np.exp(-1.0 / (0.1 * FINE_HZ))
    noise = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.normal(size=q.shape), axis=0) * 0.04 * COULOMB_NM
    ripple = 0.03 * COULOMB_NM * np.sin(7.0 * q + np.arange(6))
    return rigid + friction(qd, rigid, temperature_c, wear) + noise + ripple + 0.05 * COULOMB_NM * rng.normal(size=q.shape)


def recorded(t_s: Array, q: Array, qd: Array, torque: Array, temperature_c: float, seed: int) -> Recording:
    """The recording of a motion."""
    rng = np.random.default_rng(seed + 2000)
    return Recording(
        t_s=t_s,
        q=q + 1e-5 * rng.normal(size=q.shape),
        qd=qd + 1e-3 * rng.normal(size=q.shape),
        current=torque / UR5.drive_gain_nm_per_a,
        temperature_c=np.full(q.shape, temperature_c),
        source="production",
    )


def replay(arm: Array, *, temperature_c: float = TEMPERATURE_C, wear: Array | float = 1.0, seed: int = 0) -> Identification:
    """What the shipped trajectory finds."""
    t_s, (q, qd, qdd) = find_excitation("ur5-ground", Path()).sampled(FINE_HZ)
    torque = measured_torque(arm, q, qd, qdd, temperature_c, wear, seed + 500, np.zeros(len(q)))
    return identify([recorded(t_s, q, qd, torque, temperature_c, seed)], UR5, GROUND, residual_friction=True)


@lru_cache
def known_arm() -> ProductionArm:
    """The arm of `Cell` after its replay."""
    return ProductionArm(robot=UR5, mounting=GROUND, identification=replay(parameters(1)), payload_kg=0.0)
