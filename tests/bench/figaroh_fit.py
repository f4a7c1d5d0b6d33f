"""What figaroh makes of a motion: the package that others would take, in the same run as `identify`."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np


class Figaroh:
    """The same motion through figaroh as its examples do: regressor, elimination, two QR, standard deviations.

    It gets the signals already filtered; `identify` filters them itself, checks the mounting and resamples its residuals.
    """

    def __init__(self, model: Any) -> None:
        """Raises ImportError where figaroh is not installed."""
        from figaroh.identification import identification_tools
        from figaroh.tools import qrdecomposition, regressor

        self._tools, self._qr, self._regressor = identification_tools, qrdecomposition, regressor
        self._robot = SimpleNamespace(model=model, data=model.createData())
        self._settings = {"has_friction": True, "has_actuator_inertia": True, "is_joint_torques": True, "act_idxv": list(range(model.nv))}

    def _columns(self, moved: Any) -> np.ndarray:
        W: np.ndarray = self._regressor.build_regressor_basic(self._robot, moved.q, moved.qd, moved.qdd, self._settings)
        return W

    def fit(self, moved: Any, torque: np.ndarray) -> tuple[list[int], np.ndarray]:
        """The columns that it keeps, and their parameters."""
        W, stacked = self._columns(moved), torque.T.ravel()
        reduced, kept = self._regressor.eliminate_non_dynaffect(W, {f"p{k}": 0.0 for k in range(W.shape[1])})
        base, _, expressions, values, *_ = self._qr.QRDecomposer().double_decomposition(stacked, reduced, kept)
        self._tools.relative_stdev(base, values, stacked)
        return [int(re.findall(r"p(\d+)", text)[0]) for text in expressions], values

    def predict(self, fitted: tuple[list[int], np.ndarray], moved: Any) -> np.ndarray:
        """Torque (N, J) along another motion."""
        columns, values = fitted
        return (self._columns(moved)[:, columns] @ values).reshape(self._robot.model.nv, -1).T
