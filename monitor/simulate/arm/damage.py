"""Faults of joints beside wear: what breaks in a gear, a bearing, its grease, a brake, an encoder or a motor.

Guida, Bertolino, De Martin and Sorli (2024), "Comprehensive Analysis of Major Fault-to-Failure Mechanisms in Harmonic Drives", Machines 12,
776, list what fails in the joints of a UR5. Each fault here has a name and a severity from 0, sound, to 1, where the joint is of no use any
more. Laws follow the sources that are named beside them; the sizes at severity 1 are assumptions of the simulator.

A damaged gear makes every joint elastic: motor and link are two masses with the stiffness of the gear between them, as in Tuttle and
Seering (1996), IEEE Trans. Robotics and Automation 12, 368–374, who describe a strain wave gear by friction, compliance and kinematic
error. An arm without a damaged gear is rigid. Angles and speeds of motors are those of the joint, as everywhere in the simulator.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.friction import FrictionLaw

# Backlash: no torque passes while the play is crossed, and beyond it torque is that of the elastic shaft, the classical dead zone in
# Nordin, Galić and Gutman (1997), Int. J. Adaptive Control and Signal Processing 11, 49–63. Strain wave gears have none when new.
PLAY_RAD = 3e-3  # whole, at severity 1: ten minutes of arc
# Stiffness falls where the flexspline cracks.
STIFFNESS_PER_NM = 280.0  # of a sound gear [1/rad], per maximum torque: at that torque it winds up by twelve minutes of arc
STIFFNESS_LOST = 0.8  # share of the stiffness, at severity 1
SPRING_DAMPING = 0.05  # share of the critical damping of the motor on the spring
# Kinematic error: the link is ahead of the motor by a wave of two periods a turn of the wave generator and of its harmonics. Tuttle (1992),
# MIT AI Laboratory report 1365, measured it at such frequencies; Ghorbel, Gandhi and Alpeter (2001), J. Mechanical Design 123, 90–97,
# tell the error of the gear from the flexibility that adds to it.
KINEMATIC_RAD = 6e-4  # amplitude at severity 1 of two periods a turn: two minutes of arc
KINEMATIC_SHARES = {2.0: 1.0, 1.0: 0.5, 4.0: 0.25}  # periods a turn of the wave generator → amplitude over that of two
# A local defect of the outer ring of the motor's bearing: each ball that passes adds torque, a load torque that varies with the passing
# frequency, Blödt, Granjon, Raison and Rostaing (2004), IEEE ISIE. That is n/2·(1 − d/D·cos β) a turn, as in every text on bearings.
BALLS, BALL_PER_PITCH, CONTACT_RAD = 9, 0.22, 0.0  # n, d/D, β of a small deep groove bearing
PASSES_PER_TURN = 0.5 * BALLS * (1.0 - BALL_PER_PITCH * np.cos(CONTACT_RAD))
PULSE_SHARE = 0.15  # of the way from ball to ball
PULSE_NM_PER_NM = 0.02  # peak at severity 1, per maximum torque: two fifths of dry friction
# Lubricant: a thinner film keeps surfaces apart only at higher speeds, the Stribeck curve as in Andersson, Söderberg and Björklund (2007),
# Tribology International 40, 580–587. At severity 1:
AGED_STRIBECK = 10.0  # times the Stribeck speed, less 1 by severity
AGED_STICTION = 1.0  # stiction above dry friction rises by this share
AGED_VISCOUS = 0.4  # viscous friction falls by this share
AGED_DRY = 0.4  # dry friction rises by this share
# A brake that does not lift wholly rubs on the motor's shaft, whatever load and grease are.
DRAG_NM_PER_NM = 0.02  # at severity 1, per maximum torque
# Encoder: a graduation of mean diameter D whose centre is off by e misreads by ± 2·e/D once a turn: Heidenhain, "Position Encoders for
# Servo Drives", p. 29, ± 412 seconds of arc times e [µm] over D [mm].
OFF_CENTRE_PER_DIAMETER = 0.1e-3 / 50e-3  # e/D at severity 1: a tenth of a millimetre on five centimetres
ENCODER_RAD = 2.0 * OFF_CENTRE_PER_DIAMETER  # at the encoder's own shaft
# Magnets lose flux for good where heat takes their working point beyond the knee of the demagnetisation curve: Ruoho (2011), "Modeling
# Demagnetization of Sintered NdFeB Magnet Material", Aalto University. The torque constant is proportional to the flux.
KNEE_C = 80.0  # of motors
FLUX_LOST_PER_K = 2e-3  # above the knee
OVERHEATED_K = 60.0  # above the knee, to which a motor is heated at severity 1

DAMAGES: Mapping[str, str] = {
    "backlash": "play in the gear, at 1 of 10 minutes of arc",
    "soft_gear": "the gear loses stiffness, at 1 four fifths of it",
    "kinematic_error": "the gear's ratio varies twice a turn of the motor, at 1 by ± 2 minutes of arc, and at its harmonics",
    "bearing": f"a defect in the motor's bearing: pulses of friction {PASSES_PER_TURN:.2f} times a turn of the motor",
    "aged_lubricant": "the grease is spent: at 1 40 % less viscous and more dry friction, and ten times the Stribeck speed",
    "dragging_brake": "the brake does not lift wholly, at 1 it drags with 2 % of the largest torque",
    "joint_encoder": "the joint's encoder is off its centre: at 1 it misreads by ± 4 mrad once a turn of the joint",
    "motor_encoder": "the motor's encoder is off its centre: at 1 it misreads by ± 4 mrad of the motor once a turn of it",
    "demagnetisation": "the motor was too hot, at 1 140 °C: its magnets are weaker for good",
}
GEAR = ("backlash", "soft_gear", "kinematic_error")


@dataclass(slots=True, eq=False)
class Damage:
    """The severities of all faults, (J,) each, by their names in DAMAGES, and the flux that is left."""

    severity: dict[str, Array]
    flux: Array  # (J,) share of the magnets' flux that is left

    @classmethod
    def none(cls, joints: int) -> "Damage":
        """All joints are sound."""
        return cls({name: np.zeros(joints) for name in DAMAGES}, np.ones(joints))

    def renew(self, joint: int) -> None:
        """A joint (0 … J−1) is replaced by a sound one."""
        for of_joints in self.severity.values():
            of_joints[joint] = 0.0
        self.flux[joint] = 1.0

    @property
    def of_gears(self) -> bool:
        """Whether any gear is damaged."""
        return any(self.severity[name].any() for name in GEAR)

    def heat(self, motor_c: Array) -> bool:
        """Let magnets be as warm as this, (J,). Returns whether any has lost flux."""
        if float(motor_c.max()) <= KNEE_C:
            return False
        left = np.minimum(self.flux, 1.0 - FLUX_LOST_PER_K * np.maximum(motor_c - KNEE_C, 0.0))
        lost = bool((left < self.flux).any())
        self.flux = left
        return lost

    def law(self, sound: FrictionLaw, max_torque_nm: Array) -> FrictionLaw:
        """Friction with this lubricant and these brakes."""
        aged = self.severity["aged_lubricant"]
        thin, dry = 1.0 - AGED_VISCOUS * aged, 1.0 + AGED_DRY * aged
        return replace(
            sound,
            coulomb_nm=dry * sound.coulomb_nm,
            load_factor=dry * sound.load_factor,
            concave_nm=thin * sound.concave_nm,
            linear_nm_s_per_rad=thin * sound.linear_nm_s_per_rad,
            stiction=(1.0 + AGED_STICTION * aged) * sound.stiction,
            stribeck_rad_s=(1.0 + (AGED_STRIBECK - 1.0) * aged) * sound.stribeck_rad_s,
            drag_nm=DRAG_NM_PER_NM * self.severity["dragging_brake"] * max_torque_nm,
        )

    def encoder(self, q: Array, gear_ratio: Array) -> tuple[Array, Array]:
        """(J,) what the encoders show too much at q (J,), and its derivative by q."""
        of_joint, of_motor = (ENCODER_RAD * self.severity[name] for name in ("joint_encoder", "motor_encoder"))
        turned = gear_ratio * q
        return of_joint * np.sin(q) + of_motor / gear_ratio * np.sin(turned), of_joint * np.cos(q) + of_motor * np.cos(turned)


class Bearings:
    """Friction that the defects of bearings add."""

    def __init__(self, severity: Array, robot: Robot, gear_ratio: Array) -> None:
        self._peak_nm = PULSE_NM_PER_NM * severity * robot.max_torque_nm
        self._passes_per_rad = PASSES_PER_TURN * gear_ratio / (2.0 * np.pi)

    def pulse_nm(self, q: Array) -> Array:
        """(J,) friction at q (J,): half a sine while a ball passes the defect, else zero."""
        place = (self._passes_per_rad * q) % 1.0
        pulse: Array = self._peak_nm * np.where(place < PULSE_SHARE, np.sin(np.pi * place / PULSE_SHARE), 0.0)
        return pulse


class Gears:
    """Elastic gears, and the state of the links behind them."""

    def __init__(self, damage: Damage, robot: Robot, gear_ratio: Array, rotor_kg_m2: Array) -> None:
        of = damage.severity
        sound = STIFFNESS_PER_NM * robot.max_torque_nm
        self._rotor = rotor_kg_m2
        self._stiffness = sound * (1.0 - STIFFNESS_LOST * of["soft_gear"])
        self._damping = 2.0 * SPRING_DAMPING * np.sqrt(self._stiffness * rotor_kg_m2)
        self._half_play = 0.5 * PLAY_RAD * of["backlash"]
        periods, shares = (np.array(each)[:, None] for each in (list(KINEMATIC_SHARES), list(KINEMATIC_SHARES.values())))
        self._periods, self._amplitudes = periods * gear_ratio, shares * KINEMATIC_RAD * of["kinematic_error"]
        self.twist: Array = np.zeros(len(sound))  # link minus motor
        self.speed: Array = np.zeros(len(sound))  # of the links
        self.acceleration: Array = np.zeros(len(sound))

    def rest(self, q: Array, qd: Array, torque_nm: Array, before: "Gears | None") -> "Gears":
        """These gears after `before`, or else with the links where they bear this torque (J,)."""
        if before is not None:
            self.twist, self.speed, self.acceleration = before.twist, before.speed, before.acceleration
        else:
            self.twist = self.ahead(q)[0] - torque_nm / self._stiffness - np.sign(torque_nm) * self._half_play
            self.speed = qd.copy()
        return self

    def ahead(self, q: Array) -> tuple[Array, Array]:
        """(J,) by how much an unloaded link is ahead of its motor at q (J,), and the derivative of that by q."""
        turned = self._periods * q
        return (self._amplitudes * np.sin(turned)).sum(axis=0), (self._amplitudes * self._periods * np.cos(turned)).sum(axis=0)

    def links(self, q: Array, half_h: Array) -> tuple[Array, Array]:
        """(J,) positions and speeds of the links in the middle of a step, at whose start the motors are at q (J,)."""
        return q + self.twist + half_h * self.speed, self.speed + half_h * self.acceleration

    def reduced(self, M: Array, rest: tuple[Array, Array], v: Array, q_m: Array, x_m: Array, h: float) -> tuple[Array, Array]:
        """A (J, J) and b (J,) of A·v' = b, the speeds of the motors after a step of length h, with the links eliminated.

        M : (J, J) with the rotors. rest : (J,) torque on the motors and on the links, without gears. v : (J,) speeds of the motors before.
        q_m, x_m : (J,) motors and links in the middle. The springs are computed by the implicit midpoint rule: they store what they take.
        """
        error, slope = self.ahead(q_m)
        g, w, wound = 1.0 + slope, self.speed, q_m + error - x_m
        meshed = np.abs(wound) > self._half_play
        k, c = np.where(meshed, self._stiffness, 0.0), np.where(meshed, self._damping, 0.0)
        stiff, passed = 0.25 * h * k + 0.5 * c, k * (wound - np.sign(wound) * self._half_play) + (0.5 * c - 0.25 * h * k) * (g * v - w)
        links, J, along = M - np.diag(self._rotor), len(v), h * stiff * g
        solved = np.linalg.solve(links + np.diag(h * stiff), np.column_stack([links.dot(w) + h * (rest[1] + passed), np.diag(along)]))
        self._own, self._with_motors = solved[:, 0], solved[:, 1 : J + 1]
        A: Array = np.diag(self._rotor + along * g) - along[:, None] * self._with_motors
        b: Array = self._rotor * v + h * (rest[0] - g * passed) + along * self._own
        return A, b

    def follow(self, v: Array, after: Array, h: float) -> None:
        """Let the links move as the motors do, whose speeds were v before the step and are `after` (J,)."""
        w = self._own + self._with_motors.dot(after)
        self.twist = self.twist + 0.5 * h * (self.speed + w - v - after)
        self.acceleration, self.speed = (w - self.speed) / h, w

    def stop(self) -> None:
        """Brakes closed: the links stand."""
        self.speed, self.acceleration = np.zeros_like(self.speed), np.zeros_like(self.speed)
