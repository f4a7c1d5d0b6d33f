"""The program that makes a result: its version, the text of its modules, the packages. A result of another program is another result."""

import hashlib
import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

import monitor
from monitor import __version__
from monitor.store.provenance import provenance

# what decides an identification, and what decides a verdict besides: another text of one of them makes another result
IDENTIFIES = (
    "recording.py", "errors.py", "identify", "model", "judge/assess.py", "store/formats/columns.py", "store/formats/recordings.py",
    "studies/reassess/identified.py", "studies/reassess/identify_month.py",
)  # fmt: skip
JUDGES = (*IDENTIFIES, "judge", "service/history", "studies/reassess")


@cache
def program(parts: tuple[str, ...]) -> dict[str, Any]:
    """The program as far as it decides a result, as plain JSON; the processor is left out: it is told beside."""
    facts = {key: value for key, value in provenance().items() if key != "processor"}
    return {**facts, "text": _text_digest(parts)}


def address_of(*parts: Any) -> str:
    """The address of a result by all that it was made from: SHA-256 of the parts as JSON, in hexadecimal digits."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def worker_facts() -> dict[str, Any]:
    """What a worker is: asked of each before it gets work."""
    return {"python": ".".join(map(str, sys.version_info[:2])), "joint_monitor": __version__, "program": program(JUDGES), **_processor()}


def _processor() -> dict[str, str]:
    facts = provenance()
    return {"processor": facts["processor"], "threads": facts["threads"]}


def _text_digest(parts: tuple[str, ...]) -> str:
    """16 hexadecimal digits of the text of these modules and folders."""
    folder, digest = Path(monitor.__file__).parent, hashlib.sha256()
    for part in parts:
        path = folder / part
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
