"""Identified replays as rows of an Arrow file, and back to the last bit: what a verdict needs of an identification, and no code.

What serves people alone is left out: the covariances of another motion, the paper's standard deviations, the sources. The base is that
of the arm and its mounting, and is computed again.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
import pyarrow as pa

from monitor.identify.identification import Identification, ResidualFrictionFit
from monitor.identify.signals.ripple import Ripple
from monitor.identify.warnings import DataWarning
from monitor.judge.document import typed
from monitor.model.base import base_parameters
from monitor.model.friction import friction_law
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Array, Context

IDENTIFIED, UNIDENTIFIABLE, REFUSED, GONE, CHANGED = "identified", "unidentifiable", "refused", "gone", "changed"
_ARRAYS = (
    "values", "covariance", "coulomb_nm", "viscous_nm_s_per_rad", "friction_cov", "temperature_c", "max_speed_rad_s", "rms_nm",
    "relative_rms", "rms_all_nm", "warming_k_per_min", "mean_speed_rad_s", "residual_peak_rad",
)  # fmt: skip
_RESIDUAL = ("rigid", "friction", "load_nm", "rms_nm")
_RIPPLE = ("cycles_per_turn", "amplitude_a", "std_a", "highest_rad_s")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentifiedReplay:
    """One recording after its identification, or why there is none."""

    replay: int  # its number in the ledger
    state: str  # IDENTIFIED; UNIDENTIFIABLE: too little motion; REFUSED: does not fit the arm; GONE: no recording; CHANGED: another one
    reason: str = ""
    sha256: str = ""  # of the file
    context: Context = field(default_factory=Context)
    quality: Mapping[str, Any] = field(default_factory=dict)
    samples: int = 0
    source: str = ""
    identification: Identification | None = None


def to_bytes(replays: Iterable[IdentifiedReplay]) -> bytes:
    """The Arrow file of a month's replays."""
    documents, numbers = [], []
    for replay in replays:
        document = {
            **{f.name: getattr(replay, f.name) for f in fields(replay) if f.name not in ("context", "quality", "identification")},
            "context": asdict(replay.context),
            "quality": dict(replay.quality),
        }
        flat: list[Array] = []
        if replay.identification is not None:
            document["identification"] = _document(replay.identification, flat)
        documents.append(json.dumps(document, default=_plain))
        numbers.append(np.concatenate([np.zeros(0), *(np.ravel(part) for part in flat)]))
    table = pa.table({"document": pa.array(documents, pa.large_string()), "numbers": pa.array(numbers, pa.large_list(pa.float64()))})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as writer:
        writer.write_table(table)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def from_bytes(content: bytes) -> list[IdentifiedReplay]:
    """The replays of `to_bytes`."""
    table = pa.ipc.open_file(pa.BufferReader(content)).read_all()
    rows = zip(table.column("document").to_pylist(), table.column("numbers"), strict=True)
    return [_replay(json.loads(text), np.asarray(row.values.to_numpy())) for text, row in rows]


def _document(found: Identification, flat: list[Array]) -> dict[str, Any]:
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
        "condition_number": found.condition_number,
        "normalised_error_nm": found.normalised_error_nm,
        "samples": found.samples,
        "warnings": found.warnings,
        "residual_law": None if residual is None else residual.law.name,
        "ripple_why": None if ripple is None else ripple.why,
        "shapes": [(name, value.shape) for name, value in known],
    }


def _replay(document: dict[str, Any], numbers: Array) -> IdentifiedReplay:
    identification = document.pop("identification", None)
    context = typed(Context, document.pop("context"), where="context")
    made = None if identification is None else _identification(identification, numbers)
    return IdentifiedReplay(**document, context=context, identification=made)


def _identification(document: dict[str, Any], numbers: Array) -> Identification:
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
        parts = {name: arrays[f"ripple.{name}"] for name in _RIPPLE}
        ripple = Ripple(why=why, **parts)
    found: dict[str, Any] = {name: arrays.get(name) for name in _ARRAYS}
    return Identification(
        robot=document["robot"],
        mounting=mounting,
        method=document["method"],
        names=base.names,
        combination=base.combination,
        columns=base.columns,
        condition_number=document["condition_number"],
        normalised_error_nm=document["normalised_error_nm"],
        samples=document["samples"],
        warnings=tuple(DataWarning(code, text) for code, text in document["warnings"]),
        residual_friction=residual,
        ripple=ripple,
        **found,
    )


def _plain(value: Any) -> Any:
    """JSON of numpy's numbers and arrays, which acquisition may have put into `quality`."""
    return value.tolist()
