"""One joint's temperature law at one temperature, as plain numbers: what `Line.at` says, without the price of arrays."""

import math
from typing import NamedTuple

from monitor.judge.temperature.curves import LARGEST_LOG, NEAREST_POLE_K, VOGEL
from monitor.judge.temperature.laws import LEAST_LEFT, Line


class PointLaw(NamedTuple):
    """Of one joint: level + slope·x, or its exponential; x is T − origin, or 1/(T − pole) − origin."""

    kind: int  # as in `curves.LAWS`
    origin: float
    pole_c: float
    level: float
    slope: float
    least: float  # a straight line goes no lower
    c00: float  # covariance of (level, slope)
    c01: float
    c11: float

    def at(self, temperature_c: float) -> tuple[float, float]:
        """Value and variance."""
        kind, origin, pole_c, level, slope, least, c00, c01, c11 = self
        if kind == VOGEL:
            x = 1.0 / max(temperature_c - pole_c, NEAREST_POLE_K) - origin
        else:
            x = temperature_c - origin
        var = max(c00 + (2.0 * c01 + c11 * x) * x, 0.0)  # of NaN: NaN
        value = level + slope * x
        if kind == 0:
            return max(value, least), var
        value = math.exp(min(max(value, -LARGEST_LOG), LARGEST_LOG))
        return value, value * value * var


UNKNOWN = PointLaw(0, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan)  # no friction, of unknown deviation


def point_law(line: Line, joint: int) -> PointLaw:
    """The law of one joint (from 0) by which `line.at` answers."""
    curve, j = line.curve, joint
    kind = 0 if curve is None else int(curve.kind[j])
    if curve is None or kind == 0:
        least = LEAST_LEFT * abs(float(line.intercept[j]))
        figures, cov, origin, pole_c = (line.intercept[j], line.slope[j], least), line.cov[j], line.reference_c[j], 0.0
    else:
        figures, cov, origin, pole_c = (curve.a[j], curve.b[j], 0.0), curve.cov[j], curve.reference_c[j], float(curve.pole_c[j])
        if kind == VOGEL:
            origin = 1.0 / max(origin - pole_c, NEAREST_POLE_K)
    return PointLaw(kind, float(origin), pole_c, *map(float, figures), *(float(cov[at]) for at in ((0, 0), (0, 1), (1, 1))))
