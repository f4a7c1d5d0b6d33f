"""Remaining life in words: what its days assume."""

from collections.abc import Mapping, Sequence
from typing import Any

from monitor.reason import joint_text

STRAIGHT_TEXT = "if friction goes on along a straight line"
PATH_WORDS = {"slowing": "slows down", "straight": "goes on along a straight line", "accelerating": "goes on accelerating"}


def assumption_text(path: str, probability: float, accelerating: float, sooner_days: float | None) -> str:
    """What the days assume: the likeliest path, and when friction reaches the limit on one that accelerates.

    accelerating, sooner_days : probability of such a path, and its median; None where it is too unlikely to be told.
    """
    text = f"if friction {PATH_WORDS[path]} as it has so far (probability {100 * probability:.0f} %)"
    if sooner_days is not None and path != "accelerating":
        text += f"; a path that accelerates (probability {100 * accelerating:.0f} %) reaches the limit in {sooner_days:.0f} d"
    return text


def assumptions_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """One sentence for each joint with a date, from its rows of `friction`; empty where there is none or none says what it assumes."""
    sentences = []
    for row in rows:
        life = row.get("remaining_life") or {}
        if life.get("p50_days") is not None and life.get("assumption"):
            sentences.append(f"{joint_text(row['joint'])}: the limit in {life['p50_days']:.0f} d {life['assumption']}.")
    return " ".join(sentences)
