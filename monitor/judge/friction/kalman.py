"""Predict and update of Kalman filters with one scalar measurement each (Särkkä, 2013, ch. 4).

One arm goes through filterpy's `predict` and `update`, a fleet through the same algebra on arrays, which is some hundred times faster. The
tests compare the two.
"""

import numpy as np

from monitor.recording import Array

ONE_ARM = 16  # up to so many filters belong to one arm and go through filterpy


def predict(mean: Array, cov: Array, F: Array, Q: Array) -> tuple[Array, Array]:
    """Means (N, S) and covariances (N, S, S) after x⁺ = F·x + noise of covariance Q; F, Q are (N, S, S)."""
    if len(mean) <= ONE_ARM:
        from filterpy.kalman import predict as filterpy_predict  # 0.7 s: only where replays are judged

        steps = [filterpy_predict(x, P, A, B) for x, P, A, B in zip(mean, cov, F, Q, strict=True)]
        return np.array([x for x, _ in steps]), symmetric(np.array([P for _, P in steps]))
    x = np.einsum("nab,nb->na", F, mean)
    return x, symmetric(F @ cov @ np.swapaxes(F, 1, 2)) + Q


def update(mean: Array, cov: Array, y: Array, R: Array, H: Array) -> tuple[Array, Array]:
    """Means and covariances after y = H·x + noise of variance R; y, R are (N,), H is (N, S)."""
    if len(mean) <= ONE_ARM:
        from filterpy.kalman import update as filterpy_update

        steps = [
            filterpy_update(x, P, np.array([z]), np.array([[r]]), h[None, :]) for x, P, z, r, h in zip(mean, cov, y, R, H, strict=True)
        ]  # fmt: skip
        return np.array([x for x, _ in steps]), symmetric(np.array([P for _, P in steps]))
    PH = np.einsum("nab,nb->na", cov, H)
    S = np.einsum("na,na->n", PH, H) + R
    K = PH / S[:, None]
    x = mean + K * (y - np.einsum("na,na->n", H, mean))[:, None]
    # (I − KH)·P·(I − KH)ᵀ + K·R·Kᵀ with H of one row, multiplied out: as robust to rounding in K as Joseph's form
    cross = K[:, :, None] * PH[:, None, :]
    return x, cov - cross - np.swapaxes(cross, 1, 2) + (S[:, None] * K)[:, :, None] * K[:, None, :]


def update_kinds(x: Array, P: Array, H: Array, y: Array, R: Array, shown: np.ndarray, *, by_filterpy: bool) -> None:
    """The filters of every kind of noise after y = H·x + noise of variance R, in place.

    x : (K, S, N), P : (K, S, S, N), H : (S, N), y : (N,), R : (K, N); only of the channels `shown` (N,).
    by_filterpy : whether those of one arm go through filterpy.
    """
    if len(shown) > ONE_ARM or not by_filterpy:
        Ph = np.einsum("kijn,jn->kin", P, H)
        S = np.einsum("kin,in->kn", Ph, H) + R
        e = np.where(shown, y, 0.0) - np.einsum("kin,in->kn", x, H)
        K = Ph / S[:, None] * shown
        x += K * e[:, None]
        for k in range(len(P)):
            P[k] -= K[k][:, None] * Ph[k]
        return
    from filterpy.kalman import update as filterpy_update

    for k in range(len(P)):
        for n in np.flatnonzero(shown):
            h, z, r = H[None, :, n], np.array([y[n]]), np.array([[R[k, n]]])
            x[k, :, n], after = filterpy_update(x[k, :, n], P[k, :, :, n], z, r, h)
            P[k, :, :, n] = symmetric(after)


def symmetric(P: Array) -> Array:
    """The symmetric part of a covariance: rounding leaves it slightly asymmetric."""
    even: Array = 0.5 * (P + np.swapaxes(P, -1, -2))
    return even
