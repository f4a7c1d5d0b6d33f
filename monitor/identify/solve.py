"""Identification: the parameters that explain a recording, and how sure we are of them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.model.robot import Mounting
from monitor.recording import Array


class Caveat(NamedTuple):
    """Something the reader of a result must know; `code` is for programs, `text` for people."""

    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """What one recording, or several together, say about one arm."""

    robot: str
    mounting: Mounting
    method: str  # "ls" | "wls"
    names: tuple[str, ...]  # (B,) of the base parameters
    combination: Array  # (B, P): base = combination · standard parameters
    columns: tuple[int, ...]  # (B,) columns of the regressor that were kept
    values: Array  # (B,)
    covariance: Array  # (B, B) honest: accounts for correlated residuals
    condition_number: float
    coulomb_nm: Array  # (J,)
    viscous_nm_s_per_rad: Array  # (J,)
    friction_cov: Array  # (J, 2, 2) of (fc, fv) of each joint
    temperature_c: Array | None  # (J,) mean during the recording
    max_speed_rad_s: Array  # (J,) fastest each joint moved
    rms_nm: Array  # (J,) residual over moving samples
    relative_rms: Array  # (J,) fraction of the torque's RMS over the same samples
    rms_all_nm: Array  # (J,) over all samples
    normalised_error_nm: float  # e_N = √(eᵀe)/N, Raviola et al. (2021)
    samples: int
    caveats: tuple[Caveat, ...] = ()

    def friction_at(self, speed_rad_s: float) -> tuple[Array, Array]:
        """Friction torque fc + fv·v at a positive speed, and its standard deviation, each (J,) [N·m]."""
        x = np.array([1.0, speed_rad_s])
        torque: Array = self.coulomb_nm + self.viscous_nm_s_per_rad * speed_rad_s
        return torque, np.sqrt(np.einsum("i,jik,k->j", x, self.friction_cov, x))
