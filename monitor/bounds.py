"""Bounds that a setting carries with its type: `Annotated[float, between(0.5, 50.0)]`, checked where configurations are read."""

from annotated_types import Interval


def between(least: float, most: float) -> Interval:
    """Both ends allowed."""
    return Interval(ge=least, le=most)


def inside(least: float, most: float) -> Interval:
    """Neither end allowed."""
    return Interval(gt=least, lt=most)
