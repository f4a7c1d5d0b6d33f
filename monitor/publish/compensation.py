"""The document `compensation`: friction of each joint by its temperature, for a torque controller, and which temperatures are learnt."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.belief import Belief
from monitor.judge.torque.model import CompensatedModel, model_from_document
from monitor.publish.documents import Compensation, FrictionAt, JointCompensation, JointFrictionAt, Model, as_json, made
from monitor.publish.timestamps import unix_s, utc
from monitor.publish.torque import RANGES
from monitor.recording import Array

NODES_C = np.arange(0.0, 50.1, 5.0)  # of the table: the working range of the arms
# replays at one temperature are sought again after so long: only temperatures that differ on both sides of a change tell it from a season
SOUGHT_AGAIN_DAYS = 7.0


def friction_terms(model: CompensatedModel, temperature_c: Array) -> dict[str, Array]:
    """fc(T) and fv(T) with present wear and their whole standard deviations, as the fields of `FrictionAt`, in the shape of (…, J) [°C]."""
    terms: dict[str, Array] = {"temperature_c": temperature_c}
    for name, unit, found in (
        ("coulomb", "nm", model.coulomb_at(temperature_c)),
        ("viscous", "nm_s_per_rad", model.viscous_at(temperature_c)),
    ):
        terms[f"{name}_{unit}"] = found.value
        terms[f"{name}_std_{unit}"] = np.hypot(found.std, found.value * model.wear_std)  # wear is a factor on both
        terms["extrapolated"] = found.extrapolated  # of fv last: it decides, as for predicted torque
    return terms


def replays_at(belief: Belief) -> Array:
    """(N, J) number of replays that each joint was learnt from at the temperatures of NODES_C, ± half their distance."""
    bins = belief.viscous.bins  # (J, BINS, 3): n, ΣT, Σfv
    n = bins[..., 0]
    mean_c = np.divide(bins[..., 1], n, out=np.full_like(n, np.nan), where=n > 0)
    apart = NODES_C[1] - NODES_C[0]
    near: Array = np.abs(mean_c - NODES_C[:, None, None]) <= 0.5 * apart  # (N, J, BINS)
    counted: Array = np.where(near, n, 0.0).sum(axis=-1)
    return counted


def missing_row(replayed_c: Sequence[Array], temperature_c: Array) -> int | None:
    """The index in NODES_C of the joints' middle temperature, of (J,) [°C], where half of them have no replay at their own; else None.

    replayed_c : of each joint the temperatures of the replays of the last SOUGHT_AGAIN_DAYS, J arrays [°C].
    """
    if not np.all(np.isfinite(temperature_c)):
        return None
    row = np.rint(temperature_c / NODES_C[1])
    inside = (row >= 0) & (row < len(NODES_C))
    known = [bool(np.any(np.rint(seen / NODES_C[1]) == here)) for seen, here in zip(replayed_c, row, strict=True)]
    missing = inside & ~np.array(known)
    return int(np.median(row[missing])) if 2 * missing.sum() >= len(row) else None


def compensation(model: CompensatedModel, belief: Belief) -> Compensation:
    """The document after a replay."""
    rows = friction_terms(model, np.repeat(NODES_C[:, None], model.joints, axis=1)) | {"replays": replays_at(belief).astype(int)}
    return Compensation(
        robot=model.robot,
        at=utc(model.at_unix_s),
        model_revision=model.revision,
        joints=[
            made(
                JointCompensation,
                _of_joint(model, j),
                by_temperature=[made(FrictionAt, {name: part[k, j] for name, part in rows.items()}) for k in range(len(NODES_C))],
            )
            for j in range(model.joints)
        ],
    )


def compensation_at(model: CompensatedModel, temperature_c: Sequence[float | None]) -> list[JointFrictionAt]:
    """The terms of each joint at its own temperature, J [°C]. Raises BadInput where one is unknown or out of range."""
    low, high = RANGES["temperature_c"]
    known_c = np.array(temperature_c, dtype=float)
    if known_c.shape != (model.joints,) or np.isnan(known_c).any():
        raise BadInput("compensation: the arm's present temperatures are not known; give one a joint [°C] with --temperature")
    if not np.all((known_c >= low) & (known_c <= high)):
        raise BadInput(f"compensation: temperatures are {known_c.tolist()}; expected {low:g} … {high:g} °C")
    terms = friction_terms(model, known_c)
    return [made(JointFrictionAt, _of_joint(model, j) | {name: part[j] for name, part in terms.items()}) for j in range(model.joints)]


def model_of(document: Model) -> CompensatedModel:
    """The model that a document holds. Raises BadInput where it is of a monitor before 1.0."""
    fields = as_json(document)
    return model_from_document({**fields, "at_unix_s": unix_s(fields.pop("at"))})


def _of_joint(model: CompensatedModel, j: int) -> dict[str, Any]:
    """Wear as a fraction with its standard deviation, and how fc and fv of one joint (from 0) go together."""
    return {
        "joint": j + 1,
        "wear": float(np.expm1(model.wear[j])),
        "wear_std": float(np.exp(model.wear[j]) * model.wear_std[j]),
        "friction_correlation": float(model.friction_correlation[j]),
    }
