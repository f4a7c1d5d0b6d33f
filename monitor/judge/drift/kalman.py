"""Predict and update of N Kalman filters of S states, one for each joint, with one scalar measurement each (Särkkä, 2013, ch. 4).

One arm goes through products of stacked matrices, in the order in which filterpy multiplies them: the tests find filterpy's figures, to the
last bit. A fleet goes through the same algebra multiplied out, which is faster still; the tests compare the two.
"""

import numpy as np

from monitor.recording import Array

ONE_ARM = 16  # up to so many filters belong to one arm


def predict(mean: Array, cov: Array, F: Array, Q: Array) -> tuple[Array, Array]:
    """Means (N, S) and covariances (N, S, S) after x⁺ = F·x + noise of covariance Q; F, Q are (N, S, S)."""
    if len(mean) <= ONE_ARM:
        return (F @ mean[:, :, None])[:, :, 0], symmetric(F @ cov @ np.swapaxes(F, 1, 2) + Q)
    x = np.einsum("nab,nb->na", F, mean)
    return x, symmetric(F @ cov @ np.swapaxes(F, 1, 2)) + Q


def update(mean: Array, cov: Array, y: Array, R: Array, H: Array) -> tuple[Array, Array]:
    """Means and covariances after y = H·x + noise of variance R; y, R are (N,), H is (N, S)."""
    if len(mean) <= ONE_ARM:
        return _update_one_arm(mean[:, :, None], cov, y[:, None, None], R[:, None, None], H[:, None, :])
    PH = np.einsum("nab,nb->na", cov, H)
    S = np.einsum("na,na->n", PH, H) + R
    K = PH / S[:, None]
    x = mean + K * (y - np.einsum("na,na->n", H, mean))[:, None]
    # (I − KH)·P·(I − KH)ᵀ + K·R·Kᵀ with H of one row, multiplied out: as robust to rounding in K as Joseph's form
    cross = K[:, :, None] * PH[:, None, :]
    return x, cov - cross - np.swapaxes(cross, 1, 2) + (S[:, None] * K)[:, :, None] * K[:, None, :]


def _update_one_arm(x: Array, P: Array, y: Array, R: Array, H: Array) -> tuple[Array, Array]:
    """`update` in matrices: x (N, S, 1), y and R (N, 1, 1), H (N, 1, S); the covariance in Joseph's form."""
    HT = np.swapaxes(H, 1, 2)
    K = P @ HT @ (1.0 / (H @ P @ HT + R))
    rest = np.eye(P.shape[1]) - K @ H
    x = x + K @ (y - H @ x)
    return x[:, :, 0], symmetric(rest @ P @ np.swapaxes(rest, 1, 2) + K @ R @ np.swapaxes(K, 1, 2))


def symmetric(P: Array) -> Array:
    """The symmetric part of a covariance: rounding leaves it slightly asymmetric."""
    even: Array = 0.5 * (P + np.swapaxes(P, -1, -2))
    return even
