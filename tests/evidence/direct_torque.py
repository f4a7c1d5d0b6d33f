"""What friction given back to control is worth: hand guiding and tracking by joint torques, on arms whose law is not the monitor's.

The manufacturer's `direct_torque(torque, viscous_scale, coulomb_scale)` (PolyScope 5.25.1, PolyScope X 10.12.1) compensates gravity always,
and friction by a model of its own, whose terms it scales by 0 to 1. That model is not published. Here it is assumed to be
fc·s(q̇) + fv·q̇ of a typical arm of the type at 44 °C, the temperature of the factory's speed sweep of a UR5e, and blind to temperature.

Four ways: `none` (scales 0), `maker` (its default scales), `scaled` (its scales, moved by how the monitor's fc and fv differ from those
at 44 °C, at most 1) and `ours` (scales 0; the monitor's terms less two standard deviations are part of the torque).
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monitor.judge.settings import AssessSettings
from monitor.judge.torque.model import CompensatedModel
from monitor.model.fourier import Excitation, excitation_from_document
from monitor.model.robot import Robot, load_robot
from monitor.publish.compensation import friction_terms
from monitor.recording import Array
from monitor.simulate.arm.friction import FrictionLaw, default_law
from monitor.simulate.arm.physics import Arm
from monitor.simulate.arm.thermal import Temperatures
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.studies.rehearsal.fleet import various

from .torque import _learn

STEP_S = 0.002  # direct_torque is called at 500 Hz
VISCOUS_SCALE, COULOMB_SCALE = np.array([0.9, 0.9, 0.8, 0.9, 0.9, 0.9]), np.array([0.8, 0.8, 0.7, 0.8, 0.8, 0.8])  # the maker's defaults
FACTORY_C = 44.0
SIGN_RAD_S = 0.02  # s(q̇) is q̇/SIGN_RAD_S, at most ±1, as the example of the documentation has it: a speed at rest is no direction
SURE_STD = 2.0  # a joint whose friction is compensated by more than it has would run away
TEMPERATURES_C = (10.0, 25.0, 45.0)
POSTURE = np.array([0.0, -1.2, 1.4, -1.6, -1.5, 0.0])
AMPLITUDE_RAD, RATE_HZ, LASTS_S, SETTLES_S = 0.4, 0.2, 10.0, 2.5
HAND_NM_PER_RAD, HAND_NM_S_PER_RAD = 300.0, 30.0  # of an arm's muscles at the end of a lever of some decimetres
STIFFNESS_PER_S2, DAMPING_PER_S = 100.0, 20.0  # of the tracking controller: 10 rad/s, critically damped, soft as impedance control is
REPLAYS = 20
WAYS = ("none", "maker", "scaled", "ours")

Friction = tuple[Array, Array]  # fc [N·m] and fv [N·m·s/rad] that are compensated, (J,) each


@dataclass(slots=True)
class Hand:
    """A hand that leads every joint along a course: a spring and a damper between the joint and where the hand wants it."""

    arm: Arm
    left_s: float = np.inf
    t_s: float = 0.0

    def torque_nm(self, q: Array) -> Array:
        """(J,) torque on the joints at q (J,) [N·m]."""
        wanted, speed, _ = course(self.t_s)
        torque: Array = HAND_NM_PER_RAD * (wanted - q) + HAND_NM_S_PER_RAD * (speed - self.arm.qd)
        return torque


def course(t_s: float) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration of each joint, (J,) each: sines of one rate, from rest, a sixth of a turn apart."""
    w, phase = 2.0 * np.pi * RATE_HZ, np.arange(len(POSTURE)) * np.pi / 3.0
    soft = min(t_s / SETTLES_S, 1.0)
    sine, cosine = np.sin(w * t_s + phase) - np.sin(phase), np.cos(w * t_s + phase)
    return POSTURE + AMPLITUDE_RAD * soft * sine, AMPLITUDE_RAD * soft * w * cosine, -AMPLITUDE_RAD * soft * w**2 * np.sin(w * t_s + phase)


def factory_friction(law: FrictionLaw) -> Friction:
    """fc and fv of a type at 44 °C without load, as a line through its law at 0.05 to 1.5 rad/s."""
    speeds = np.linspace(0.05, 1.5, 30)[:, None] * np.ones(len(law.coulomb_nm))
    one = np.ones(len(law.coulomb_nm))
    torque = law.torque(speeds, 0.0 * speeds, FACTORY_C * np.ones_like(speeds), one, one)
    fv, fc = np.polyfit(speeds[:, 0], torque, 1)
    return fc, fv


def compensated(way: str, typical: Friction, model: CompensatedModel, temperature_c: float) -> Friction:
    """What one of WAYS compensates at a temperature of all joints."""
    fc, fv = typical
    at, factory = (friction_terms(model, np.full(model.joints, T)) for T in (temperature_c, FACTORY_C))
    if way == "none":
        return 0.0 * fc, 0.0 * fv
    if way == "maker":
        return COULOMB_SCALE * fc, VISCOUS_SCALE * fv
    if way == "scaled":
        scales = (
            np.clip(default * at[name] / factory[name], 0.0, 1.0)
            for default, name in ((COULOMB_SCALE, "coulomb_nm"), (VISCOUS_SCALE, "viscous_nm_s_per_rad"))
        )
        return next(scales) * fc, next(scales) * fv
    return (
        np.maximum(at["coulomb_nm"] - SURE_STD * at["coulomb_std_nm"], 0.0),
        np.maximum(at["viscous_nm_s_per_rad"] - SURE_STD * at["viscous_std_nm_s_per_rad"], 0.0),
    )


def guided(arm: Arm, friction: Friction) -> Array:
    """(J,) RMS of the torque with which a hand leads the joints [N·m]."""
    hand = Hand(arm)
    arm.contact = hand
    felt = []
    for k in range(round(LASTS_S / STEP_S)):
        hand.t_s = k * STEP_S
        torque = _gravity(arm) + _compensating(arm, friction)
        if hand.t_s >= SETTLES_S:
            felt.append(hand.torque_nm(arm.q))
        arm.push(STEP_S, torque)
    arm.contact = None
    return np.sqrt(np.mean(np.square(felt), axis=0))


def tracked(arm: Arm, friction: Friction) -> Array:
    """(J,) RMS of the error with which computed torque tracks the same course [rad]."""
    errors = []
    for k in range(round(LASTS_S / STEP_S)):
        q, qd, qdd = course(k * STEP_S)
        asked = qdd + STIFFNESS_PER_S2 * (q - arm.q) + DAMPING_PER_S * (qd - arm.qd)
        drive, _ = arm.rigid_torque(arm.q[None], arm.qd[None], asked[None])
        if k * STEP_S >= SETTLES_S:
            errors.append(q - arm.q)
        arm.push(STEP_S, drive[0] + _compensating(arm, friction))
    return np.sqrt(np.mean(np.square(errors), axis=0))


def _gravity(arm: Arm) -> Array:
    none = np.zeros_like(arm.q)
    torque: Array = arm.rigid_torque(arm.q[None], none[None], none[None])[0][0]
    return torque


def _compensating(arm: Arm, friction: Friction) -> Array:
    torque: Array = friction[0] * np.clip(arm.qd / SIGN_RAD_S, -1.0, 1.0) + friction[1] * arm.qd
    return torque


def study_arm(seed: int, *, excitation: Excitation, robot: str = "ur5") -> dict[str, list[list[list[float]]]]:
    """`hand_nm` and `error_rad` of one simulated arm, (temperatures, ways, J)."""
    description, rng = load_robot(robot), np.random.default_rng(seed)
    law = various(default_law(description), (), rng)
    controller = Controller(SimulateSettings(robot=robot, seed=seed), law=law)
    settings = AssessSettings()
    learnt = _learn(controller, description, rng, excitation=excitation, settings=settings, replays=REPLAYS, clock=lambda: 0.0)
    typical = factory_friction(default_law(description))

    def measured(of: Callable[[Arm, Friction], Array]) -> list[list[list[float]]]:
        return [[_one(of, description, law, typical, learnt.model, T, way) for way in WAYS] for T in TEMPERATURES_C]

    return {"hand_nm": measured(guided), "error_rad": measured(tracked)}


def _one(
    of: Callable[[Arm, Friction], Array], robot: Robot, law: FrictionLaw, typical: Friction, model: CompensatedModel, T: float, way: str
) -> list[float]:
    arm = Arm(robot, q=course(0.0)[0], law=law, ambient_c=T)
    arm.set_temperatures(Temperatures(*np.full((2, robot.joints), T)))
    found: list[float] = of(arm, compensated(way, typical, model, T)).tolist()
    return found


def table(arms: Sequence[dict[str, list[list[list[float]]]]]) -> str:
    """The means over arms as a table in Markdown: joints 1–3 and 4–6."""
    hand, error = (np.mean([arm[name] for arm in arms], axis=0) for name in ("hand_nm", "error_rad"))
    lines = [
        "| joints | compensation | hand, N·m: 10 °C | 25 °C | 45 °C | error, mrad: 10 °C | 25 °C | 45 °C |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for joints, part in (("1–3", slice(0, 3)), ("4–6", slice(3, 6))):
        for k, way in enumerate(WAYS):
            figures = [f"{x:.2f}" for x in hand[:, k, part].mean(axis=-1)] + [f"{1000 * x:.1f}" for x in error[:, k, part].mean(axis=-1)]
            lines.append(f"| {joints} | {way} | {' | '.join(figures)} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=6)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    excitation = excitation_from_document(json.loads(Path("config/excitation/ur5-ground.json").read_text("utf-8")))
    arms = [study_arm(seed, excitation=excitation) for seed in range(given.arms)]
    if given.json:
        given.json.write_text(json.dumps(arms), "utf-8")
    print(table(arms))


if __name__ == "__main__":
    main()
