"""What a joint is believed to have of its own: as much as the joints of its arm differ beyond chance (James and Stein, 1961).

Shapes: A arms, J joints per arm.
"""

import numpy as np

from monitor.recording import Array


def shrunk(away: Array, chance: Array, *, prior_var: float, prior_joints: float, clear: float = 1.0, told: Array | float = 1.0) -> Array:
    """(A, J) how far each joint is from the middle of its arm, nearer to it the less the joints of this arm differ.

    away : (A, J) the distance as it was seen. chance : (A, J) its variance if all joints were alike. prior_var : variance between the
    joints of any arm, which weighs as `prior_joints` joints. clear : times the variance of chance from which joints differ.
    told : (A, J) as how much of a joint each counts in how far they differ.
    """
    counts = np.broadcast_to(told, away.shape)
    differ = np.maximum(np.sum(counts * (away**2 - clear * chance), axis=1, keepdims=True), 0.0)
    between = (prior_joints * prior_var + differ) / (prior_joints + counts.sum(axis=1, keepdims=True) - 1.0)
    nearer: Array = away * between / (between + chance)
    return nearer
