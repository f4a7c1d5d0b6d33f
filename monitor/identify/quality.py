"""Whether a recording is one of its trajectory, by the counts that its acquisition made: a disturbed motion would appear as friction."""

from collections.abc import Mapping
from typing import Any

from monitor.identify.detectors import CURRENT_STUCK
from monitor.identify.diagnosis import LIKELY_CAUSE, POOR, UNIT_SIZE
from monitor.identify.explanations import OTHER_GAIN, OTHER_MOUNTING, OTHER_OFFSET
from monitor.identify.gain_check import GAIN_DOUBTFUL
from monitor.identify.identification import Identification
from monitor.identify.settings import QualitySettings
from monitor.reason import Reason, Sentence

OF_THE_ARM = {cause.code for cause in (OTHER_GAIN, OTHER_OFFSET, OTHER_MOUNTING)}
TICKS_MISSING = Sentence("ticks_missing", "{percent:.1f} % of the ticks are missing from the recording; at most {most_percent:g} %")
MANY_TARGETS_LATE = Sentence(
    "many_targets_late", "{percent:.1f} % of the targets came late, which jerks the arm; at most {most_percent:g} %"
)
FELL_BEHIND = Sentence("motion_fell_behind", "the motion fell {behind_s:.2f} s behind its trajectory; at most {most_s:g} s")
SLIDER_WENT_DOWN = Sentence("slider_went_down", "the speed slider went to {percent:.0f} %: it was another trajectory")


def quality_problem(quality: Mapping[str, Any], samples: int, settings: QualitySettings) -> Reason | None:
    """Why a recording of N `samples` is not used; None where it passes. quality : counts by name."""

    def known(name: str) -> float | None:
        value = quality.get(name)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    missed, late, slipped, scaling = (known(name) for name in ("missed_ticks", "late_share", "slipped_s", "min_speed_scaling"))
    if missed is not None and missed > settings.max_missed_share * (samples + missed):
        return TICKS_MISSING(percent=100.0 * missed / (samples + missed), most_percent=100.0 * settings.max_missed_share)
    if late is not None and late > settings.max_late_share:
        return MANY_TARGETS_LATE(percent=100.0 * late, most_percent=100.0 * settings.max_late_share)
    if slipped is not None and slipped > settings.max_slipped_s:
        return FELL_BEHIND(behind_s=slipped, most_s=settings.max_slipped_s)
    if scaling is not None and scaling < settings.min_speed_scaling:
        return SLIDER_WENT_DOWN(percent=100.0 * scaling)
    return None


def not_of_the_arm(identification: Identification) -> Reason | None:
    """Why the recordings are not what they were given as, whatever the arm does: other columns, signs, units.

    None where they may be. Gain, offset and mounting are the arm's own matter: a drive may have been changed, an arm mounted anew.
    """
    for warning in identification.warnings:
        why, cause, left = (warning.parameters.get(name) for name in ("why", "cause", "left"))
        surely = isinstance(left, float) and left < POOR
        if warning.code == LIKELY_CAUSE.code and surely and isinstance(cause, Reason) and cause.code not in OF_THE_ARM:
            return warning
        if warning.code == GAIN_DOUBTFUL.code and isinstance(why, Reason) and why.code == UNIT_SIZE.code:
            return why
    return None


def silent_drive(identification: Identification) -> Reason | None:
    """The first drive that says nothing in a whole recording: friction of its joint is unknown, and what the other joints say is sound."""
    stuck = (warning for warning in identification.warnings if warning.code == CURRENT_STUCK.code)
    return next((warning for warning in stuck if warning.parameters["share"] == 1.0), None)
