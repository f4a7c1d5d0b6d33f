"""The temperature law of one joint at one temperature in plain numbers: the value of `Line.at` in a fraction of its time."""

import math
from typing import NamedTuple

from monitor.judge.temperature.curves import LARGEST_LOG, NEAREST_POLE_K, VOGEL
from monitor.judge.temperature.laws import LEAST_LEFT, Line

LINEAR = 0  # kind of a straight line, as in `curves.LAWS`


class PointLaw(NamedTuple):
    """The law level + slope·x of one joint, or its exponential; x is T − origin, or 1/(T − pole) − origin."""

    kind: int  # as in `curves.LAWS`
    origin: float
    pole_c: float
    level: float
    slope: float
    least: float  # value below which a straight line does not fall
    c00: float  # covariance of (level, slope)
    c01: float
    c11: float

    def at(self, temperature_c: float) -> tuple[float, float]:
        """Value and variance at a temperature [°C]."""
        kind, origin, pole_c, level, slope, least, c00, c01, c11 = self
        if kind == VOGEL:
            x = 1.0 / max(temperature_c - pole_c, NEAREST_POLE_K) - origin
        else:
            x = temperature_c - origin
        var = max(c00 + (2.0 * c01 + c11 * x) * x, 0.0)  # NaN stays NaN, since it is the first argument
        value = level + slope * x
        if kind == LINEAR:
            return max(value, least), var
        value = math.exp(min(max(value, -LARGEST_LOG), LARGEST_LOG))
        return value, value * value * var


UNKNOWN = PointLaw(LINEAR, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan)  # friction 0 with an unknown standard deviation


def point_law(line: Line, joint: int) -> PointLaw:
    """The law of one joint (from 0) that `line.at` evaluates."""
    curve, j = line.curve, joint
    kind = LINEAR if curve is None else int(curve.kind[j])
    if curve is None or kind == LINEAR:
        least = LEAST_LEFT * abs(float(line.intercept[j]))
        figures, cov, origin, pole_c = (line.intercept[j], line.slope[j], least), line.cov[j], line.reference_c[j], 0.0
    else:
        figures, cov, origin, pole_c = (curve.a[j], curve.b[j], 0.0), curve.cov[j], curve.reference_c[j], float(curve.pole_c[j])
        if kind == VOGEL:
            origin = 1.0 / max(origin - pole_c, NEAREST_POLE_K)
    return PointLaw(kind, float(origin), pole_c, *map(float, figures), *(float(cov[at]) for at in ((0, 0), (0, 1), (1, 1))))
