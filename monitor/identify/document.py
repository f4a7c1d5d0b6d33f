"""The object that `identify --json` prints: plain JSON, units in the names, null for unknown."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.identify.payload import NAMES as PAYLOAD_NAMES
from monitor.identify.payload import Payload
from monitor.identify.solve import Identification, Validation
from monitor.recording import Array


def document(identification: Identification, validations: Sequence[Validation] = ()) -> dict[str, Any]:
    """The identification, and how it fared on other recordings. No NaN and no infinity: unknown is None."""
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
            "condition_number": _number(found.condition_number),
            "names": list(found.names),
            "values": _numbers(found.values),
            "std": _numbers(found.std),
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
            "law": _law(found),
        },
        "fit": {
            "samples": found.samples,
            "rms_nm": _numbers(found.rms_nm),
            "relative_rms": _numbers(found.relative_rms),
            "rms_all_nm": _numbers(found.rms_all_nm),
            "normalised_error_nm": _number(found.normalised_error_nm),
        },
        "validation": [
            {
                "file": validation.file,
                "samples": validation.samples,
                "rms_nm": _numbers(validation.rms_nm),
                "relative_rms": _numbers(validation.relative_rms),
                "r2": _numbers(validation.r2),
                "rms_all_nm": _numbers(validation.rms_all_nm),
                "normalised_error_nm": _number(validation.normalised_error_nm),
                "nominal_rms_nm": _numbers(validation.nominal_rms_nm),
            }
            for validation in validations
        ],
        "warnings": [{"code": caveat.code, "text": caveat.text} for caveat in found.caveats],
    }


def _misfit(found: Identification) -> dict[str, Any]:
    """What another motion would change beyond noise, because the law is not quite the arm's."""
    if found.misfit_cov is None:
        return {}
    fc, fv = np.sqrt(found.misfit_cov[:, [0, 1], [0, 1]]).T
    return {"coulomb_misfit_std_nm": _numbers(fc), "viscous_misfit_std_nm_s_per_rad": _numbers(fv)}


def _law(found: Identification) -> dict[str, Any]:
    """The friction law; of laws richer than the paper's, each parameter by joint."""
    told: dict[str, Any] = {"name": found.law.name, "parameters": list(found.law.parameters)}
    if found.friction:
        fitted = found.friction
        std = np.sqrt(np.diagonal(fitted.covariance, axis1=1, axis2=2))  # (J, K)
        told |= {
            "values": {name: _numbers(fitted.values[:, k]) for k, name in enumerate(fitted.law.parameters)},
            "std": {name: _numbers(std[:, k]) for k, name in enumerate(fitted.law.parameters)},
            "exponent": fitted.law.exponent,
            "load_nm": _numbers(fitted.load_nm),
        }
    if found.held_out:
        told["held_out"] = {name: _number(error) for name, error in found.held_out.items()}
    return told


def payload_document(payload: Payload) -> dict[str, Any]:
    """A payload at the flange, in the last DH frame."""
    std = np.sqrt(np.diag(payload.covariance))
    return {
        "mass_kg": _number(payload.mass_kg),
        "mass_std_kg": _number(payload.mass_std_kg),
        "com_m": _numbers(payload.com_m),
        "parameters": {name: _number(value) for name, value in zip(PAYLOAD_NAMES, payload.parameters, strict=True)},
        "std": {name: _number(value) for name, value in zip(PAYLOAD_NAMES, std, strict=True)},
        "rms_nm": _numbers(payload.rms_nm),
        "relative_rms": _numbers(payload.relative_rms),
        "samples": payload.samples,
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(values: Array) -> list[float | None]:
    return [_number(value) for value in values]
