"""Which steps of friction may be unseen yet, in words: what a person reads beside the ± of wear, which does not hold for them."""

from collections.abc import Mapping, Sequence
from typing import Any

from monitor.reason import joint_name


def unseen_step_text(rise: float, days: float) -> str:
    """Of one joint; rise : fraction."""
    return f"a step of the last {days:.0f} days up to {rise:.0%} may be unseen"


def unseen_steps_text(friction: Sequence[Mapping[str, Any]]) -> str:
    """Of all joints, from their friction documents; empty where nothing is known, as in documents of older releases."""
    known = [row for row in friction if row.get("unseen_step") is not None]
    if not known:
        return ""
    each = ", ".join(f"{joint_name(row['joint'])} {row['unseen_step']:.0%}" for row in known)
    days = max(row["unseen_step_days"] for row in known)
    return f"The ± of wear does not hold for a fresh step: one of the last {days:.0f} days may be unseen up to {each}."
