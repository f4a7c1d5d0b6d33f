"""Whether a recording is one of its trajectory, by the counts that its acquisition made: a disturbed motion would appear as friction."""

from collections.abc import Mapping
from typing import Any

from monitor.identify.settings import QualitySettings


def quality_problem(quality: Mapping[str, Any], samples: int, settings: QualitySettings) -> str | None:
    """The reason why a recording of N `samples` is not used, as a clause; None where it passes. quality : counts by name."""

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
