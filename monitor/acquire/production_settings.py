"""Whether and how the arm's ordinary work is listened to: the settings of `[production]`. Nothing of it moves an arm."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductionListenSettings:
    """How the arm is listened to at work."""

    listen: bool = False  # whether friction is estimated from ordinary work; off: work counts revolutions and residuals alone
    rate_hz: Annotated[float, Interval(ge=10.0, le=125.0)] = 25.0  # [Hz] rows a second, where that is more than robot.listen_hz
    deviation: Annotated[float, Interval(ge=0.01, le=0.5)] = 0.05  # fraction of friction: one standard deviation at which a joint is known
    period_days: Annotated[float, Interval(ge=1.0, le=30.0)] = 7.0  # [d] work of so many days may be added up until a joint is known
