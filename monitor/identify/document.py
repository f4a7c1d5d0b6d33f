"""The JSON object that `identify --json` prints: units in the names, null for unknown."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.identify.fit.physically_consistent import PhysicallyConsistentArm
from monitor.identify.gains import Gains
from monitor.identify.identification import QUOTED_SPEEDS_RAD_S, Identification
from monitor.identify.payload import NAMES as PAYLOAD_NAMES
from monitor.identify.payload import Payload
from monitor.identify.signals.ripple import Ripple
from monitor.identify.validate import Validation
from monitor.model.base import base_parameters
from monitor.model.friction import CONCAVE_EXPONENT
from monitor.model.robot import Mounting, Robot
from monitor.recording import Array, known_or_none

NINETY = 1.645  # standard deviations on each side of an interval of 90 %
LARGEST = 1e6  # [kg, kg·m, kg·m², N·m] no arm has a larger parameter


def document(identification: Identification, validations: Sequence[Validation] = ()) -> dict[str, Any]:
    """The identification and its validations as a JSON object. Unknown is None; there is no NaN and no infinity."""
    found = identification
    return {
        "robot": found.robot,
        "mounting": {
            f"{axis}_deg": round(math.degrees(angle), 9)
            for axis, angle in zip(("roll", "pitch", "yaw"), found.mounting.angles_rad, strict=True)
        },
        "recordings": [
            {
                "file": source.file,
                "samples": source.samples,
                "rate_hz": source.rate_hz,
                "duration_s": source.duration_s,
                "rejected_samples": source.rejected_samples,
                "rejected_why": dict(source.rejected_why),
            }
            for source in found.sources
        ],
        "method": found.method,
        "base_parameters": {
            "count": len(found.names),
            "condition_number": known_or_none(found.condition_number),
            "names": list(found.names),
            "values": _numbers(found.values),
            "std": _numbers(found.std),
            **({} if found.paper_d is None else {"paper_d": _numbers(np.where(np.isnan(found.std), np.nan, found.paper_d))}),
        },
        "friction": {
            "coulomb_nm": _numbers(found.coulomb_nm),
            "coulomb_std_nm": _numbers(np.sqrt(found.friction_cov[:, 0, 0])),
            "viscous_nm_s_per_rad": _numbers(found.viscous_nm_s_per_rad),
            "viscous_std_nm_s_per_rad": _numbers(np.sqrt(found.friction_cov[:, 1, 1])),
            "covariance": _numbers(found.friction_cov[:, 0, 1]),
            "temperature_c": None if found.temperature_c is None else _numbers(found.temperature_c),
            "max_speed_rad_s": _numbers(found.max_speed_rad_s),
            **_misfit(found),
            "at_speeds": [_at_speed(found, speed) for speed in QUOTED_SPEEDS_RAD_S],
            "law": _law(found),
        },
        "fit": {
            "samples": found.samples,
            "rms_nm": _numbers(found.rms_nm),
            "relative_rms": _numbers(found.relative_rms),
            "rms_all_nm": _numbers(found.rms_all_nm),
            "normalised_error_nm": known_or_none(found.normalised_error_nm),
        },
        "validation": [
            {
                "file": validation.file,
                "samples": validation.samples,
                "rms_nm": _numbers(validation.rms_nm),
                "relative_rms": _numbers(validation.relative_rms),
                "r2": _numbers(validation.r2),
                "rms_all_nm": _numbers(validation.rms_all_nm),
                "normalised_error_nm": known_or_none(validation.normalised_error_nm),
                "nominal_rms_nm": _numbers(validation.nominal_rms_nm),
                "nominal_normalised_error_nm": known_or_none(validation.nominal_normalised_error_nm),
            }
            for validation in validations
        ],
        **({} if found.ripple is None else {"ripple": _ripple(found.ripple)}),
        **({} if found.physical is None else {"physical": physical_document(found.physical)}),
        "warnings": [warning.document() for warning in found.warnings],
    }


def physical_document(physical: PhysicallyConsistentArm) -> dict[str, Any]:
    """The physically consistent arm: tensors about the centres of mass, in DH frames."""
    arm = physical.robot
    return {
        "residual_ratio": known_or_none(physical.residual_ratio),
        "links": [
            {"name": name, "mass_kg": known_or_none(mass), "com_m": _numbers(com), "inertia_kg_m2": [_numbers(row) for row in inertia]}
            for name, mass, com, inertia in zip(arm.link_names, arm.mass_kg, arm.com_m, arm.inertia_kg_m2, strict=True)
        ],
        "coulomb_nm": _numbers(physical.coulomb_nm),
        "viscous_nm_s_per_rad": _numbers(physical.viscous_nm_s_per_rad),
        "rotor_kg_m2": _numbers(physical.rotor_kg_m2),
    }


def _misfit(found: Identification) -> dict[str, Any]:
    """Standard deviations of fc and fv by the misfit of the friction law, for another motion."""
    if found.misfit_cov is None:
        return {}
    fc, fv = np.sqrt(found.misfit_cov[:, [0, 1], [0, 1]]).T
    return {"coulomb_misfit_std_nm": _numbers(fc), "viscous_misfit_std_nm_s_per_rad": _numbers(fv)}


def _at_speed(found: Identification, speed_rad_s: float) -> dict[str, Any]:
    """Friction fc + fv·v at one speed, and the half width of the interval that holds 90 % of what other runs find there."""
    torque_nm, std_nm = found.line_at(speed_rad_s)
    return {"speed_rad_s": speed_rad_s, "torque_nm": _numbers(torque_nm), "another_run_90_nm": _numbers(NINETY * std_nm)}


def _ripple(ripple: Ripple) -> list[dict[str, Any]]:
    """Gear ripple of each joint's current, a figure for each number of cycles a turn, and why one is not known."""
    return [
        {
            "joint": j + 1,
            "cycles_per_turn": [known_or_none(cycles) for cycles in ripple.cycles_per_turn[j]],
            "amplitude_a": _numbers(ripple.amplitude_a[j]),
            "std_a": _numbers(ripple.std_a[j]),
            "up_to_rad_s": _numbers(ripple.highest_rad_s[j]),
            "why_not": list(why),
        }
        for j, why in enumerate(ripple.why)
    ]


def _law(found: Identification) -> dict[str, Any]:
    """The friction law; for a law richer than the paper's, each parameter of each joint."""
    law: dict[str, Any] = {"name": found.law.name, "parameters": list(found.law.parameters)}
    if found.friction:
        fitted = found.friction
        std = np.sqrt(np.diagonal(fitted.covariance, axis1=1, axis2=2))  # (J, K)
        law |= {
            "values": {name: _numbers(fitted.values[:, k]) for k, name in enumerate(fitted.law.parameters)},
            "std": {name: _numbers(std[:, k]) for k, name in enumerate(fitted.law.parameters)},
            "exponent": CONCAVE_EXPONENT,
            "load_nm": _numbers(fitted.load_nm),
        }
    if found.held_out:
        law["held_out"] = {name: known_or_none(error) for name, error in found.held_out.items()}
    return law


def identification_from_document(plain: Any, robot: Robot, mounting: Mounting, source: str) -> Identification:
    """The parameters in a JSON object of `document`, for `identify(rigid_from=…)`.

    The object holds no correlations, so the covariance is diagonal. Raises BadInput where it is no such object, or is of another robot or
    kind of mounting.
    """
    base = base_parameters(robot, mounting)
    try:
        made_by, names = plain["robot"], plain["base_parameters"]["names"]
        values, std = (_array(plain["base_parameters"][key], base.count) for key in ("values", "std"))
        friction = [_array(plain["friction"][key], robot.joints) for key in ("coulomb_nm", "viscous_nm_s_per_rad", "max_speed_rad_s")]
        condition = plain["base_parameters"]["condition_number"]
        condition, samples = math.inf if condition is None else float(condition), int(plain["fit"]["samples"])
        method, names = str(plain["method"]), tuple(str(name) for name in names)
    except (KeyError, TypeError, ValueError, OverflowError) as wrong:
        raise BadInput(
            f"{source}: is no identification ({type(wrong).__name__}: {wrong}); expected what `identify --json` printed"
        ) from None
    if made_by != robot.name or names != base.names:
        raise BadInput(
            f"{source}: holds {len(names)} base parameters of {made_by}; expected the {base.count} of {robot.name} on this kind of mounting"
        )
    if not np.all(np.abs(np.nan_to_num(values)) < LARGEST):
        raise BadInput(f"{source}: holds parameters of {np.nanmax(np.abs(values)):.3g}; expected those of an arm")
    if not np.all(np.isfinite(values)):
        raise BadInput(f"{source}: {base.names[int(np.argmin(np.isfinite(values)))]} is not known; expected a number for every parameter")
    unknown = np.full(robot.joints, np.nan)
    return Identification(
        robot=robot.name,
        mounting=mounting,
        method=method,
        names=base.names,
        combination=base.combination,
        columns=base.columns,
        values=values,
        covariance=np.diag(std**2),
        condition_number=condition,
        coulomb_nm=friction[0],
        viscous_nm_s_per_rad=friction[1],
        friction_cov=np.full((robot.joints, 2, 2), np.nan),
        temperature_c=None,
        max_speed_rad_s=friction[2],
        rms_nm=unknown,
        relative_rms=unknown,
        rms_all_nm=unknown,
        normalised_error_nm=math.nan,
        samples=samples,
    )


def gains_document(gains: Gains) -> dict[str, Any]:
    """Joint gains from a payload pair; null where the pair does not determine the gain."""
    return {"values_nm_per_a": _numbers(gains.values), "std_nm_per_a": _numbers(gains.std), "rms_a": _numbers(gains.rms_a)}


def payload_document(payload: Payload) -> dict[str, Any]:
    """The payload at the flange, in the last DH frame."""
    std = np.sqrt(np.diag(payload.covariance))
    return {
        "mass_kg": known_or_none(payload.mass_kg),
        "mass_std_kg": known_or_none(payload.mass_std_kg),
        "com_m": _numbers(payload.com_m),
        "parameters": {name: known_or_none(value) for name, value in zip(PAYLOAD_NAMES, payload.parameters, strict=True)},
        "std": {name: known_or_none(value) for name, value in zip(PAYLOAD_NAMES, std, strict=True)},
        "rms_nm": _numbers(payload.rms_nm),
        "relative_rms": _numbers(payload.relative_rms),
        "samples": payload.samples,
        "warnings": [warning.document() for warning in payload.warnings],
    }


def _array(values: Any, count: int) -> Array:
    """(count,) numbers, NaN for null. Raises ValueError or TypeError for anything else."""
    numbers: Array = np.array([math.nan if value is None else float(value) for value in values])
    if len(numbers) != count:
        raise ValueError(f"{len(numbers)} figures where {count} belong")
    return numbers


def _numbers(values: Array) -> list[float | None]:
    return [known_or_none(value) for value in values]
