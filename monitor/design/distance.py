"""Distances between simple shapes, many at once. A shape is the set of points within its radius of a segment, a box or a half-space."""

import numpy as np

from monitor.recording import Array

TINY_M2 = 1e-18  # squared length; a segment shorter than a nanometre counts as a point
GOLDEN = 0.5 * (5.0**0.5 - 1.0)
SEARCH_STEPS = 32  # golden sections: the remaining interval is 2e-7 of the segment's length


def between_segments(p1: Array, q1: Array, p2: Array, q2: Array) -> Array:
    """(…) least distance of the segments p1–q1 and p2–q2, each (…, 3): Ericson (2005), section 5.1.9."""
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a, e = _dot(d1, d1), _dot(d2, d2)
    b, c, f = _dot(d1, d2), _dot(d1, r), _dot(d2, r)
    squared_sine = a * e - b * b
    slanted = squared_sine > 1e-12 * a * e
    s = np.where(slanted, np.clip((b * f - c * e) / np.where(slanted, squared_sine, 1.0), 0.0, 1.0), 0.0)
    t = np.clip((b * s + f) / np.maximum(e, TINY_M2), 0.0, 1.0)
    s = np.clip((b * t - c) / np.maximum(a, TINY_M2), 0.0, 1.0)
    t = np.clip((b * s + f) / np.maximum(e, TINY_M2), 0.0, 1.0)  # for parallel segments the first s was arbitrary
    gap = r + s[..., None] * d1 - t[..., None] * d2
    distance: Array = np.sqrt(_dot(gap, gap))
    return distance


def segment_to_box(p: Array, q: Array, half: Array) -> Array:
    """(…) signed distance of the segments p–q (…, 3) to the box with half sizes (…, 3) about the origin; negative inside.

    The distance to a convex body is convex along a segment, so golden section finds its minimum. The distance that the search may have
    missed is subtracted. So the result is never too large, and too small by 1e-6 of the segment's length at most.
    """
    low, high = np.zeros(p.shape[:-1]), np.ones(p.shape[:-1])
    way = q - p

    def at(t: Array) -> Array:
        return _point_to_box(p + t[..., None] * way, half)

    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    f_left, f_right = at(left), at(right)
    for _ in range(SEARCH_STEPS):
        keep_left = f_left < f_right
        low, high = np.where(keep_left, low, left), np.where(keep_left, right, high)
        new = np.where(keep_left, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
        f_new = at(new)
        left, right = np.where(keep_left, new, right), np.where(keep_left, left, new)
        f_left, f_right = np.where(keep_left, f_new, f_right), np.where(keep_left, f_left, f_new)
    missed = (high - low) * np.sqrt(_dot(way, way))  # the distance changes by the length of the interval at most
    ends = np.minimum(at(np.zeros_like(low)), at(np.ones_like(low)))
    least: Array = np.minimum(np.minimum(f_left, f_right) - missed, ends)
    return least


def segment_to_half_space(p: Array, q: Array, point: Array, normal: Array) -> Array:
    """(…) signed distance of the segments p–q (…, 3) to the space behind the plane; the unit normal points to the free side."""
    height: Array = np.minimum(_dot(p - point, normal), _dot(q - point, normal))
    return height


def _point_to_box(x: Array, half: Array) -> Array:
    """(…) signed distance of points (…, 3) to the box with half sizes (…, 3) about the origin."""
    beyond = np.abs(x) - half
    outside = np.maximum(beyond, 0.0)
    signed: Array = np.sqrt(_dot(outside, outside)) + np.minimum(np.max(beyond, axis=-1), 0.0)
    return signed


def _dot(u: Array, v: Array) -> Array:
    """(…) scalar products of vectors (…, 3)."""
    product: Array = u[..., 0] * v[..., 0] + u[..., 1] * v[..., 1] + u[..., 2] * v[..., 2]
    return product
