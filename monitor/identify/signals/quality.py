"""Is a recording as good as its own account of how it was taken? What was disturbed while it was taken would be read as friction.

Pure: of the quality that acquisition counted, and of nothing else; a foreign file says nothing of itself and is taken as it is.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class QualitySettings:
    """How much a replay may have been disturbed and still be learnt from."""

    max_missed_share: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.02  # of the ticks; alone on two cores none are missed
    max_late_share: Annotated[float, Interval(ge=0.0, le=1.0)] = (
        0.1  # of the cycles with a target late by half a tick; at 3 % nothing is seen, at 30 % fc was 20 % off
    )
    max_slipped_s: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.1  # that the motion fell behind its trajectory: another trajectory
    min_speed_scaling: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.999  # less is another trajectory too


def quality_problem(quality: Mapping[str, Any], samples: int, settings: QualitySettings) -> str | None:
    """Why a recording of N samples is not to be learnt from, in words; None where nothing speaks against it."""

    def known(name: str) -> float | None:
        value = quality.get(name)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    missed, late, slipped, scaling = (known(name) for name in ("missed_ticks", "late_share", "slipped_s", "min_speed_scaling"))
    if missed is not None and missed > settings.max_missed_share * (samples + missed):
        share = 100.0 * missed / (samples + missed)
        return f"{share:.1f} % of the ticks are missing from the recording; at most {100.0 * settings.max_missed_share:g} %"
    if late is not None and late > settings.max_late_share:
        return f"{100.0 * late:.1f} % of the targets came late, which jerks the arm; at most {100.0 * settings.max_late_share:g} %"
    if slipped is not None and slipped > settings.max_slipped_s:
        return f"the motion fell {slipped:.2f} s behind its trajectory; at most {settings.max_slipped_s:g} s"
    if scaling is not None and scaling < settings.min_speed_scaling:
        return f"the speed slider went to {100.0 * scaling:.0f} %: it was another trajectory"
    return None
