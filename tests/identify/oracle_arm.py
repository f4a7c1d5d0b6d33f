"""Motions of a known arm. The torque is pinocchio's, not that of the regressor under test; friction and rotor inertia are chosen here."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from monitor.identify.signals.motion import Motion
from monitor.identify.signals.rows import SoundRows
from monitor.identify.signals.units import Repaired
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, Robot, load_robot
from monitor.recording import Array, Recording

GROUND = Mounting()
COULOMB_NM = np.array([8.0, 9.0, 7.0, 1.6, 1.5, 1.4])
VISCOUS = np.array([11.0, 12.0, 9.0, 1.7, 1.6, 1.5])
ROTOR_KG_M2 = np.array([1.9, 1.9, 1.9, 0.35, 0.35, 0.35])


@dataclass(frozen=True)
class Truth:
    """States and torque without noise, each (N, J)."""

    t_s: Array
    q: Array
    qd: Array
    qdd: Array
    torque: Array


def excitation(robot: Robot, seed: int = 0, repetitions: int = 3, speed_rad_s: float = 1.5) -> Excitation:
    """Five harmonics in 10 s, at rest at both ends, with the given greatest speed of each joint."""
    rng = np.random.default_rng(seed)
    k = np.arange(1.0, 6.0)
    a, b = rng.normal(size=(2, 5, robot.joints))
    a -= a.mean(axis=0)  # Σa = 0: no speed at the ends
    b -= k[:, None] * (k @ b) / (k @ k)  # Σk·b = 0: no acceleration there
    scale = speed_rad_s / np.hypot(a, b).sum(axis=0)
    return Excitation(
        robot=robot.name,
        mounting=GROUND,
        period_s=10.0,
        repetitions=repetitions,
        offset_rad=np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0]),
        a_rad_s=a * scale,
        b_rad_s=b * scale,
    )


def rigid_torque(robot: Robot, mounting: Mounting, q: Array, qd: Array, qdd: Array) -> Array:
    """(N, J) recursive Newton–Euler of pinocchio."""
    model = robot.pinocchio_model(mounting)
    data = model.createData()
    return np.array([pin.rnea(model, data, *state).copy() for state in zip(q, qd, qdd, strict=True)])


def friction(qd: Array) -> Array:
    return COULOMB_NM * np.tanh(qd / 0.001) + VISCOUS * qd


def truth(robot: Robot, mounting: Mounting = GROUND, rate_hz: float = 125.0, **shape: float) -> Truth:
    t_s, (q, qd, qdd) = excitation(robot, **shape).sampled(rate_hz)
    return Truth(t_s, q, qd, qdd, rigid_torque(robot, mounting, q, qd, qdd) + ROTOR_KG_M2 * qdd + friction(qd))


def exact_motion(known: Truth) -> Motion:
    """The truth as a motion, without any filter."""
    N = len(known.t_s)
    read = Recording(t_s=known.t_s, q=known.q, qd=known.qd, qdd=known.qdd, torque=known.torque, source="oracle")
    return Motion(
        repaired=Repaired(recording=read),
        rows=SoundRows(np.arange(N), {}, np.zeros(0, dtype=np.intp), np.zeros(known.q.shape)),
        t_s=known.t_s,
        q=known.q,
        qd=known.qd,
        qdd=known.qdd,
        direction=np.tanh(known.qd / 0.001),
        current=None,
        torque=known.torque,
        temperature_c=None,
        rate_hz=1.0 / (known.t_s[1] - known.t_s[0]),
    )


def recording(known: Truth, robot: Robot | None = None, noise: float = 1.0, seed: int = 0) -> Recording:
    """The recording of a controller, with `noise` times the encoder and current noise of a real arm."""
    robot = robot or load_robot("ur5")
    rng = np.random.default_rng(seed)

    def with_noise(value: Array, std: float) -> Array:
        return value + noise * std * rng.normal(size=value.shape)

    return Recording(
        t_s=1000.0 + known.t_s,
        q=with_noise(known.q, 2e-5),
        qd=with_noise(known.qd, 1e-3),
        current=with_noise(known.torque / robot.drive_gain_nm_per_a, 0.04),
        temperature_c=np.full(known.q.shape, 31.25),
        source="synthetic",
    )
