"""Friction laws one may choose, as columns that are linear in their parameters.

A law turns joint speeds into columns; the regressor, the prediction and the compensated model all read the same columns,
so what is fitted is what is predicted.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor.errors import BadInput
from monitor.recording import Array

SIGN_SPEED_RAD_S = 0.001  # tanh(q̇/0.001) instead of sgn(q̇): Raviola et al. (2021), eq. (2)


def smooth_sign(qd: Array, width_rad_s: float = SIGN_SPEED_RAD_S) -> Array:
    """Direction of motion, s(v) = tanh(v/v0): −1 … 1, zero at rest, of the shape of q̇ [rad/s]."""
    sign: Array = np.tanh(qd / width_rad_s)
    return sign


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrictionLaw:
    """Friction torque of joint j = columns(q̇, τ)[:, j] · parameters of joint j."""

    name: str
    parameters: tuple[str, ...]  # K names, each becomes a base parameter of every joint
    columns: Callable[[Array, Array | None], Array]  # q̇ (N, J) [rad/s], load torque (N, J) [N·m] or None → (N, J, K)


def _paper(qd: Array, load_nm: Array | None) -> Array:  # noqa: ARG001 the paper's law knows no load
    """Coulomb and viscous, Raviola et al. (2021), eq. (2)."""
    return np.stack([smooth_sign(qd), qd], axis=-1)  # (N, J, 2)


LAWS = {law.name: law for law in (FrictionLaw(name="paper", parameters=("fc", "fv"), columns=_paper),)}


def friction_law(name: str) -> FrictionLaw:
    """The law of that name.

    Raises BadInput listing the laws there are.
    """
    if name not in LAWS:
        raise BadInput(f"friction law {name!r} is not known; known are {', '.join(sorted(LAWS))}")
    return LAWS[name]


def friction_torque(coulomb_nm: Array, viscous_nm_s_per_rad: Array, qd: Array) -> Array:
    """The paper's law evaluated: (J,), (J,), q̇ (N, J) [rad/s] → (N, J) [N·m]."""
    parameters = np.stack([coulomb_nm, viscous_nm_s_per_rad], axis=-1)  # (J, 2)
    torque: Array = np.einsum("njk,jk->nj", LAWS["paper"].columns(qd, None), parameters)
    return torque
