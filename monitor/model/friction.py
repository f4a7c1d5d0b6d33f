"""Friction laws one may choose, as columns that are linear in their parameters.

A law turns joint speeds into columns; the regressor, the prediction and the compensated model all read the same columns,
so what is fitted is what is predicted. Every law begins with the paper's fc and fv.
"""

from dataclasses import dataclass

import numpy as np

from monitor.errors import BadInput
from monitor.recording import Array

SIGN_SPEED_RAD_S = 0.001  # tanh(q̇/0.001) instead of sgn(q̇): Raviola et al. (2021), eq. (2)
STRIBECK_SPEED_RAD_S = 0.1  # the film has formed: a linear law needs this fixed, and the fit is blunt between 0.05 and 0.2
CONCAVE_EXPONENT = 0.5  # factory sweeps of a UR5e fit best with 0.52–0.63; 0.5 keeps the column furthest from fc's and fv's


def smooth_sign(qd: Array, width_rad_s: float = SIGN_SPEED_RAD_S) -> Array:
    """Direction of motion, s(v) = tanh(v/v0): −1 … 1, zero at rest, of the shape of q̇ [rad/s]."""
    sign: Array = np.tanh(qd / width_rad_s)
    return sign


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionLaw:
    """Friction torque of joint j = columns(q̇, τ)[:, j] · parameters of joint j.

    τ is the torque that the gear passes on, without friction. The parameters there are: fc [N·m] of s(q̇); fv [N·m·s/rad] of q̇;
    fl (a share) of |τ|·s(q̇): teeth under load rub more; fp [N·m at 1 rad/s] of |q̇|^p·s(q̇): friction of harmonic drives is concave;
    fs [N·m] of exp(−(q̇/v_s)²)·s(q̇): what grips beyond fc before the lubricant carries, Stribeck; Armstrong-Hélouvry et al. (1994).
    """

    name: str
    parameters: tuple[str, ...]  # K names; fc, fv lead
    exponent: float = CONCAVE_EXPONENT  # p

    @property
    def loaded(self) -> bool:
        """Whether the law needs the torque that the gear passes on."""
        return "fl" in self.parameters

    def columns(self, qd: Array, load_nm: Array | None = None) -> Array:
        """q̇ (…, J) [rad/s], torque through the gear (…, J) [N·m] → (…, J, K).

        Raises BadInput where the law knows load and none is given.
        """
        s = smooth_sign(qd)
        columns = [s, qd]
        if self.loaded:
            if load_nm is None:
                raise BadInput(f"friction law {self.name!r} needs the torque that the gear passes on")
            columns.append(np.abs(load_nm) * s)
        if "fp" in self.parameters:
            columns.append(np.abs(qd) ** self.exponent * s)
        if "fs" in self.parameters:
            columns.append(np.exp(-((qd / STRIBECK_SPEED_RAD_S) ** 2)) * s)
        return np.stack(columns, axis=-1)  # (…, J, K)


# the paper's is Coulomb and viscous, Raviola et al. (2021), eq. (2); from the simplest to the richest
LAWS = {
    law.name: law
    for law in (
        FrictionLaw(name="paper", parameters=("fc", "fv")),
        FrictionLaw(name="load", parameters=("fc", "fv", "fl")),
        FrictionLaw(name="concave", parameters=("fc", "fv", "fl", "fp")),
        FrictionLaw(name="stribeck", parameters=("fc", "fv", "fl", "fs")),
    )
}
EVERY_TERM = FrictionLaw(name="every term", parameters=("fc", "fv", "fl", "fp", "fs"))  # what the laws are chosen from


def friction_law(name: str) -> FrictionLaw:
    """The law of that name.

    Raises BadInput listing the laws there are.
    """
    if name not in LAWS:
        raise BadInput(f"friction law {name!r} is not known; known are {', '.join(LAWS)}, and auto where it is to be chosen")
    return LAWS[name]


def friction_torque(coulomb_nm: Array, viscous_nm_s_per_rad: Array, qd: Array) -> Array:
    """The paper's law evaluated: (J,), (J,), q̇ (N, J) [rad/s] → (N, J) [N·m]."""
    parameters = np.stack([coulomb_nm, viscous_nm_s_per_rad], axis=-1)  # (J, 2)
    torque: Array = np.einsum("njk,jk->nj", LAWS["paper"].columns(qd), parameters)
    return torque
