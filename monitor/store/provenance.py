"""The provenance of a figure: programs, processor and threads, as far as they can change its last bit."""

import os
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from monitor import __version__

PACKAGES = ("numpy", "scipy", "filterpy", "pyarrow")  # their arithmetic, or their reading of a file, is in every figure


@cache
def provenance() -> dict[str, Any]:
    """The provenance of every figure that this process computes, as plain JSON."""
    import numpy as np

    blas = np.show_config(mode="dicts").get("Build Dependencies", {}).get("blas", {})
    return {
        "joint_monitor": __version__,
        "python": ".".join(platform.python_version_tuple()[:2]),
        "packages": {name: _version(name) for name in PACKAGES},
        "blas": f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip(),
        "processor": processor_family(),
        "threads": os.environ.get("OMP_NUM_THREADS") or os.environ.get("OPENBLAS_NUM_THREADS") or f"all of {os.cpu_count()}",
    }


def differences(then: dict[str, Any], now: dict[str, Any], where: str = "") -> list[str]:
    """The differences between two documents, one line each: `packages.numpy: 2.4.1, now 2.5.0`; lists are counted from 1."""
    found = []
    for key in [*then, *(key for key in now if key not in then)]:
        before, after = then.get(key), now.get(key)
        if before == after:
            continue
        if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
            before, after = ({str(k): value for k, value in enumerate(values, start=1)} for values in (before, after))
        if isinstance(before, dict) and isinstance(after, dict):
            found += differences(before, after, f"{where}{key}.")
        else:
            found.append(f"{where}{key}: {before}, now {after}")
    return found


def processor_family() -> str:
    """Architecture and vector instructions, by which numerical libraries choose their kernels.

    numpy asks the processor itself; a sandboxed service cannot read /proc/cpuinfo.
    """
    import numpy as np

    simd: Any = np.show_config(mode="dicts").get("SIMD Extensions", {})
    found = [str(name) for key in ("baseline", "found") for name in simd.get(key, [])]
    return " ".join((platform.machine(), *found[-3:]))


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
