"""Free coordinates → an excitation that is at rest at both ends and within the limits of position, speed and acceleration.

q̇(0) = Σ aₖ and q̈(0) = ω Σ k bₖ. The free coordinates u span the null spaces of both sums, so every curve starts and ends at rest, to
rounding. Each joint's curve is then scaled down, where needed, to the limit that binds it most on the sampled curve. This allows more than
a bound by the sum of the amplitudes would.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from monitor.errors import BadInput
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array

PAPER_ACCELERATION_RAD_S2 = 5.5 * math.pi  # Raviola et al. (2021), section 2.3
USED = 0.97  # fraction of the limits of position, speed and acceleration that is used: peaks between the samples stay below the limit
SAMPLES_PER_HARMONIC = 40  # in a period of the fastest harmonic: between two samples a peak is higher by 0.3 % at most
MOST_HARMONICS, LONGEST_S = 25, 120.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Limits:
    """The limits of a curve, each (J,) where nothing else is said."""

    position_rad: Array
    speed_rad_s: Array
    acceleration_rad_s2: Array
    torque_nm: Array
    flange_speed_m_s: float  # of the arm; infinite: no limit

    @classmethod
    def of(
        cls,
        robot: Robot,
        *,
        speed_rad_s: float | None = None,
        acceleration_rad_s2: float | None = None,
        torque_share: float = 0.9,
        flange_speed_m_s: float | None = None,
    ) -> "Limits":
        """The robot's own limits, and the given ones where they are stricter.

        Raises BadInput for a limit that is not positive or not finite.
        """
        asked = {
            "speed limit": speed_rad_s,
            "acceleration limit": acceleration_rad_s2,
            "torque share": torque_share,
            "flange speed limit": flange_speed_m_s,
        }
        for name, value in asked.items():
            if value is not None and not (value > 0.0 and math.isfinite(value)):
                raise BadInput(f"{name} = {value!r}; expected a positive number")
        J = robot.joints
        return cls(
            position_rad=robot.max_position_rad,
            speed_rad_s=np.minimum(robot.max_speed_rad_s, math.inf if speed_rad_s is None else speed_rad_s),
            acceleration_rad_s2=np.full(J, min(PAPER_ACCELERATION_RAD_S2, acceleration_rad_s2 or math.inf)),
            torque_nm=robot.max_torque_nm * min(torque_share, 1.0),
            flange_speed_m_s=math.inf if flange_speed_m_s is None else flange_speed_m_s,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Family:
    """All curves with these harmonics, period, offset (or start) and limits; `excitation` selects one by its free coordinates."""

    robot: Robot
    mounting: Mounting
    limits: Limits
    harmonics: int
    period_s: float
    offset_rad: Array  # (J,) the middle of the curves; with `starts_there`, their start and end
    starts_there: bool = False

    def __post_init__(self) -> None:
        """Raises BadInput naming what is wrong, and by how much."""
        if not (0.0 < self.period_s <= LONGEST_S):
            raise BadInput(f"period = {self.period_s!r} s; expected more than 0, at most {LONGEST_S:g} s")
        if not 2 <= self.harmonics <= MOST_HARMONICS:
            raise BadInput(f"harmonics = {self.harmonics!r}; expected 2 to {MOST_HARMONICS}: one alone cannot begin and end at rest")
        J = self.robot.joints
        if self.offset_rad.shape != (J,) or not np.all(np.isfinite(self.offset_rad)):
            raise BadInput(f"{self._pose} = {self.offset_rad.tolist()}; expected {J} finite angles in rad")
        beyond = np.abs(self.offset_rad) - self.limits.position_rad
        j = int(np.argmax(beyond))
        if beyond[j] >= 0.0:
            raise BadInput(
                f"{self._pose}: joint {j + 1} is at {self.offset_rad[j]:.4g} rad, beyond its limit of "
                f"{self.limits.position_rad[j]:.4g} rad by {beyond[j]:.3g} rad"
            )

    @property
    def _pose(self) -> str:
        """The word for `offset_rad` in messages."""
        return "start" if self.starts_there else "offset"

    @property
    def dimension(self) -> int:
        """Number of free coordinates."""
        return 2 * (self.harmonics - 1) * self.robot.joints

    @cached_property
    def null_spaces(self) -> tuple[Array, Array]:
        """(H, H − 1) orthonormal bases of Σ a = 0 and of Σ k·b = 0."""
        k = np.arange(1.0, self.harmonics + 1.0)
        return _null_space(np.ones_like(k)), _null_space(k)

    @cached_property
    def _samples(self) -> tuple[Array, Array, Array]:
        """Matrices (G, 2·(H − 1)) from the free coordinates of a joint to displacement, speed and acceleration at the G samples."""
        H = self.harmonics
        w = 2.0 * np.pi / self.period_s * np.arange(1, H + 1)  # (H,)
        t = np.linspace(0.0, self.period_s, SAMPLES_PER_HARMONIC * H, endpoint=False)  # (G,)
        sin, cos = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))  # (G, H)
        Z_a, Z_b = self.null_spaces
        way = np.hstack([(sin / w) @ Z_a, -((cos - 1.0 if self.starts_there else cos) / w) @ Z_b])
        return way, np.hstack([cos @ Z_a, sin @ Z_b]), np.hstack([-(sin * w) @ Z_a, (cos * w) @ Z_b])

    def coefficients(self, u: Array) -> tuple[Array, Array]:
        """Coefficients a and b, each (H, J) [rad/s], of the free coordinates u (dimension,), scaled into the limits."""
        J, half = self.robot.joints, self.harmonics - 1
        U = u.reshape(2 * half, J) * self.limits.speed_rad_s  # a coordinate of 1 is of the size of the limits
        way, speed, acceleration = (matrix @ U for matrix in self._samples)  # (G, J) each
        limits = self.limits
        share = np.maximum.reduce(
            [
                way.max(axis=0) / (limits.position_rad - self.offset_rad),
                -way.min(axis=0) / (limits.position_rad + self.offset_rad),
                np.abs(speed).max(axis=0) / limits.speed_rad_s,
                np.abs(acceleration).max(axis=0) / limits.acceleration_rad_s2,
            ]
        )  # (J,)
        U = U * np.minimum(1.0, USED / np.maximum(share, 1e-12))
        Z_a, Z_b = self.null_spaces
        return Z_a @ U[:half], Z_b @ U[half:]

    def excitation(self, u: Array, *, repetitions: int = 1) -> Excitation:
        """The curve of the free coordinates u (dimension,)."""
        a, b = self.coefficients(u)
        offset = self.offset_rad
        if self.starts_there:  # q(0) = q0 − Σ b/(kω)
            w = 2.0 * np.pi / self.period_s * np.arange(1, self.harmonics + 1)
            offset = offset + np.sum(b / w[:, None], axis=0)
        return Excitation(
            robot=self.robot.name,
            mounting=self.mounting,
            period_s=self.period_s,
            repetitions=repetitions,
            offset_rad=offset,
            a_rad_s=a,
            b_rad_s=b,
        )


def _null_space(row: Array) -> Array:
    """(H, H − 1) orthonormal basis of the vectors perpendicular to a row (H,), by a Householder reflection.

    Its digits are equal on all machines.
    """
    v = row / np.linalg.norm(row)
    v[0] += math.copysign(1.0, v[0])
    reflection = np.eye(len(row)) - 2.0 * np.outer(v, v) / (v @ v)
    basis: Array = reflection[:, 1:]
    return basis
