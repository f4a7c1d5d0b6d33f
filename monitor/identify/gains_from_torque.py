"""Joint gains from currents beside torques: an e-Series controller from software 5.23 on reports both."""

import numpy as np

from monitor.recording import Array

LARGEST_MISFIT = 0.01  # of the torque, RMS: beyond it the reported torque is no multiple of the current
LEAST_CURRENT_A = 1e-3  # RMS: a joint with less says nothing


def gains_from_torque(current_a: Array, torque_nm: Array) -> Array:
    """(J,) torque per ampere [N·m/A]; NaN for a joint whose torque is no multiple of its current.

    current_a, torque_nm : (N, J) of the same ticks. A controller may report a torque from which gravity has been taken away; that torque
    is no multiple of the current while the arm stands in different attitudes, and for it no gain is given.
    """
    square = np.mean(current_a**2, axis=0)  # (J,) [A²]
    with np.errstate(invalid="ignore", divide="ignore"):
        gains = np.mean(current_a * torque_nm, axis=0) / square
        misfit = np.sqrt(np.mean((torque_nm - gains * current_a) ** 2, axis=0) / np.mean(torque_nm**2, axis=0))
    shown = (np.sqrt(square) > LEAST_CURRENT_A) & (gains > 0.0) & (misfit <= LARGEST_MISFIT)
    return np.where(shown, gains, np.nan)
