"""Identification: the parameters of one arm by its recordings, with their uncertainty."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.settings import BETWEEN_RUNS
from monitor.identify.signals.ripple import Ripple
from monitor.model.friction import PAPER, FrictionLaw
from monitor.model.robot import Mounting
from monitor.reason import Reason
from monitor.recording import Array

if TYPE_CHECKING:
    from monitor.identify.fit.physically_consistent import PhysicallyConsistentArm


QUOTED_SPEEDS_RAD_S = (0.2, 0.4, 0.8)  # at which friction is compared between runs


class Source(NamedTuple):
    """One recording that was fitted."""

    file: str
    samples: int
    rate_hz: float
    duration_s: float
    rejected_samples: int
    rejected_why: Mapping[str, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrictionFit:
    """Friction by a law richer than the paper's."""

    law: FrictionLaw
    values: Array  # (J, K) in the order of `law.parameters`
    covariance: Array  # (J, K, K); NaN where the motion did not excite it
    load_nm: Array  # (J,) mean |τ| through the gear while the joint moved

    def at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """Friction torque (J,) [N·m] at a positive speed under the recording's mean load, and its standard deviation (J,).

        It is the mean of driving and braking: to and fro under a weight, a joint does as much of the one as of the other.
        """
        speeds = np.full(len(self.load_nm), speed_rad_s)
        x = 0.5 * (self.law.columns(speeds, self.load_nm) + self.law.columns(speeds, -self.load_nm))  # (J, K)
        return np.einsum("jk,jk->j", x, self.values), np.sqrt(np.einsum("ji,jik,jk->j", x, self.covariance, x))


class ResidualFrictionFit(NamedTuple):
    """The fit of the same recording by the law of the residual friction, with rigid parameters of its own and without covariances."""

    law: FrictionLaw
    rigid: Array  # (B,) base parameters; the entries of fc and fv have no meaning
    friction: Array  # (J, K) in the order of `law.parameters`; NaN where the motion did not excite them
    load_nm: Array  # (J,) largest |τ| through the gear over the samples used
    rms_nm: Array  # (J,) residual over moving samples


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """The parameters of one arm by one recording, or by several together.

    With every friction law, fc and fv mean the same: the line fc·s(q̇) + fv·q̇ nearest to the law over the speeds and loads of the
    recording. So they can be compared between laws. `values` contains them too. The covariances are those of noise: how much another
    recording of the same motion would differ. Another motion would differ by `misfit_cov` more, since no law is exactly that of the arm.
    """

    robot: str
    mounting: Mounting
    method: str  # "ls" | "wls" | "robust" | "consistent"
    names: tuple[str, ...]  # (B,) of the base parameters
    combination: Array  # (B, P): base = combination · standard parameters
    columns: tuple[int, ...]  # (B,) columns of the regressor that were kept
    values: Array  # (B,)
    covariance: Array  # (B, B) by the jackknife, which accounts for correlated residuals; NaN for what the motion did not excite
    condition_number: float
    coulomb_nm: Array  # (J,) NaN where the motion did not excite it
    viscous_nm_s_per_rad: Array  # (J,)
    friction_cov: Array  # (J, 2, 2) of (fc, fv) of each joint
    temperature_c: Array | None  # (J,) mean during the recording
    max_speed_rad_s: Array  # (J,) largest |q̇|
    rms_nm: Array  # (J,) residual over moving samples
    relative_rms: Array  # (J,) fraction of the torque's RMS over the same samples
    rms_all_nm: Array  # (J,) over all samples
    normalised_error_nm: float  # e_N = √(eᵀe)/N, Raviola et al. (2021)
    samples: int
    warnings: tuple[Reason, ...] = ()
    sources: tuple[Source, ...] = ()
    friction: FrictionFit | None = None  # None: the law is the paper's, with fc and fv alone
    total_covariance: Array | None = None  # (B, B) for another motion, and from the truth: with what the law misses
    misfit_cov: Array | None = None  # (J, 2, 2) of (fc, fv), to be added to `friction_cov` to compare different motions
    held_out: Mapping[str, float] | None = None  # law → RMS residual on data left out, in units of the noise; with `auto` only
    paper_d: Array | None = None  # (B,) d = √diag((ȲᵀWȲ)⁻¹), Raviola et al. (2021): without scale and correlation of the noise
    warming_k_per_min: Array | None = None  # (J,) slope of temperature; while it is positive, the grease is colder than the sensor
    temperature_constant: Array | None = None  # (J,) 1 where every reading of the temperature was one and the same number, else 0
    mean_speed_rad_s: Array | None = None  # (J,) mean |q̇|
    residual_friction: ResidualFrictionFit | None = None  # None: not asked for
    residual_peak_rad: Array | None = None  # (J,) where along the joint the residual is largest; NaN where it did not move
    physical: "PhysicallyConsistentArm | None" = None  # None: the method was not `consistent`
    current_noise_a: Array | None = None  # (J,) standard deviation of one reading of the current [A]; None: the recordings hold none
    ripple: Ripple | None = None  # of the gears; None where the recordings hold no current, or no gear ratio is known

    @property
    def law(self) -> FrictionLaw:
        """The friction law."""
        return self.friction.law if self.friction else PAPER

    @property
    def std(self) -> Array:
        """(B,) standard deviation of each base parameter from the truth; NaN where the motion did not excite it."""
        deviation: Array = np.sqrt(np.diag(self.covariance if self.total_covariance is None else self.total_covariance))
        return deviation

    def friction_at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """Friction torque (J,) [N·m] by the law at a positive speed and the mean load, and its standard deviation (J,).

        Friction at −v is the opposite. Raises BadInput where the speed is negative or no number.
        """
        if not 0.0 <= speed_rad_s < np.inf:
            raise BadInput(f"friction at {speed_rad_s:g} rad/s was asked for; expected a positive speed")
        if self.friction:
            return self.friction.at(speed_rad_s)
        x = np.array([1.0, speed_rad_s])
        torque: Array = self.coulomb_nm + self.viscous_nm_s_per_rad * speed_rad_s
        return torque, np.sqrt(np.einsum("i,jik,k->j", x, self.friction_cov, x))

    def line_at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """Friction fc + fv·v (J,) [N·m] at a positive speed, and the standard deviation of what a run of another motion finds.

        That run is as doubtful as this one, so its deviation counts twice. No run shows what changes from one to the next.
        """
        x = np.array([1.0, speed_rad_s])
        cov = self.friction_cov if self.misfit_cov is None else self.friction_cov + self.misfit_cov
        torque_nm = self.coulomb_nm + self.viscous_nm_s_per_rad * speed_rad_s
        return torque_nm, np.sqrt(2.0 * (np.einsum("i,jik,k->j", x, cov, x) + (BETWEEN_RUNS * torque_nm) ** 2))
