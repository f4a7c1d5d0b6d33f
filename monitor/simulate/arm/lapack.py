"""LAPACK's `dposv` from scipy, without the rest of `scipy.linalg`: that takes a third of the time in which a simulator starts."""

from collections.abc import Callable
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path

import scipy

from monitor.recording import Array

Solved = tuple[Array, Array, int]


def _dposv() -> Callable[[Array, Array], Solved]:
    """The function of the compiled module alone; where scipy has another layout, that of the package."""
    spec = PathFinder.find_spec("scipy.linalg._flapack", [str(Path(scipy.__file__).parent / "linalg")])
    if spec is not None and spec.loader is not None:
        compiled = module_from_spec(spec)
        spec.loader.exec_module(compiled)
        found: Callable[[Array, Array], Solved] = compiled.dposv
        return found
    from scipy.linalg.lapack import dposv

    whole: Callable[[Array, Array], Solved] = dposv
    return whole


dposv = _dposv()  # (A, b) → factor of A, x with A·x = b, 0 where A is positive definite
