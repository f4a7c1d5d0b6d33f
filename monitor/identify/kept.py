"""What a verdict needs of an identification, as plain JSON and numbers, and back to the last bit."""

from typing import Any

import numpy as np

from monitor.identify.identification import Identification, ResidualFrictionFit
from monitor.identify.signals.ripple import Ripple
from monitor.model.base import base_parameters
from monitor.model.friction import friction_law
from monitor.model.robot import Mounting, load_robot
from monitor.reason import reason_from
from monitor.recording import Array

_ARRAYS = (
    "values", "covariance", "coulomb_nm", "viscous_nm_s_per_rad", "friction_cov", "temperature_c", "max_speed_rad_s", "rms_nm",
    "relative_rms", "rms_all_nm", "warming_k_per_min", "mean_speed_rad_s", "residual_peak_rad", "temperature_constant", "current_noise_a",
    "condition_number", "normalised_error_nm",
)  # fmt: skip
_FIGURES = ("condition_number", "normalised_error_nm")  # of them: one number each
_RESIDUAL = ("rigid", "friction", "load_nm", "rms_nm")
_RIPPLE = ("cycles_per_turn", "amplitude_a", "std_a", "highest_rad_s", "gain_nm_per_a")


def parts_of(found: Identification, flat: list[Array]) -> dict[str, Any]:
    """The plain part; arrays are appended to `flat`, and their shapes stand in the document in the same order."""
    parts: list[tuple[str, Array | None]] = [(name, getattr(found, name)) for name in _ARRAYS]
    residual, ripple = found.residual_friction, found.ripple
    if residual is not None:
        parts += [(f"residual.{name}", getattr(residual, name)) for name in _RESIDUAL]
    if ripple is not None:
        parts += [(f"ripple.{name}", getattr(ripple, name)) for name in _RIPPLE]
    known = [(name, np.asarray(value, dtype=float)) for name, value in parts if value is not None]
    flat += [value for _, value in known]
    return {
        "robot": found.robot,
        "mounting_rad": found.mounting.angles_rad,
        "method": found.method,
        "samples": found.samples,
        "warnings": [warning.document() for warning in found.warnings],
        "residual_law": None if residual is None else residual.law.name,
        "ripple_why": None if ripple is None else ripple.why,
        "shapes": [(name, value.shape) for name, value in known],
    }


def from_parts(document: dict[str, Any], numbers: Array) -> Identification:
    """The identification of `parts_of`: its document, and its arrays one after the other."""
    arrays: dict[str, Any] = {}
    start = 0
    for name, shape in document["shapes"]:
        size = int(np.prod(shape))
        arrays[name] = numbers[start : start + size].reshape(shape)
        start += size
    mounting = Mounting.of(document["mounting_rad"])
    base = base_parameters(load_robot(document["robot"]), mounting)
    residual = ripple = None
    if document["residual_law"] is not None:
        residual = ResidualFrictionFit(friction_law(document["residual_law"]), *(arrays[f"residual.{name}"] for name in _RESIDUAL))
    if document["ripple_why"] is not None:
        why = tuple(tuple(row) for row in document["ripple_why"])
        parts = {name: arrays[f"ripple.{name}"] for name in _RIPPLE if f"ripple.{name}" in arrays}
        ripple = Ripple(why=why, **parts)
    found: dict[str, Any] = {name: arrays.get(name) for name in _ARRAYS}
    found |= {name: float(found[name]) for name in _FIGURES}
    return Identification(
        robot=document["robot"],
        mounting=mounting,
        method=document["method"],
        names=base.names,
        combination=base.combination,
        columns=base.columns,
        samples=document["samples"],
        warnings=tuple(reason_from(warning) for warning in document["warnings"]),
        residual_friction=residual,
        ripple=ripple,
        **found,
    )
