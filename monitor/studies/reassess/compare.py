"""What alerts said then, beside what they would say now: earlier, later, gone, new. Pure."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.alerts.health import TIERS
from monitor.recording import DAY_S

SAME, EARLIER, LATER, GONE, NEW = "same", "earlier", "later", "gone", "new"
UNKNOWN = "unknown"  # a replay said it that cannot be judged any more
CHANGES = (EARLIER, LATER, GONE, NEW, UNKNOWN, SAME)


class Said(NamedTuple):
    """One transition of an alert."""

    kind: str  # raised, updated, serviced, cleared, …
    joint: int | None  # from 1; None: the arm
    condition: str
    tier: str
    raised_at_unix_s: float
    at_unix_s: float
    cleared_at_unix_s: float | None

    @classmethod
    def of(cls, kind: str, alert: Mapping[str, Any]) -> "Said":
        """From the alert's document."""
        return cls(
            kind, alert["joint"], alert["condition"], alert["tier"], alert["raised_at_unix_s"], alert["updated_at_unix_s"],
            alert.get("cleared_at_unix_s"),
        )  # fmt: skip


class Episode(NamedTuple):
    """One alert from its beginning to its end, with the time of each tier that it reached."""

    joint: int | None
    condition: str
    raised_at_unix_s: float
    tiers: dict[str, float]
    ended_at_unix_s: float  # infinite while it is active


def episodes(said: Sequence[Said]) -> list[Episode]:
    """The alerts that replays have raised, in order of time; the monitor's alerts about itself are left out."""
    found: dict[tuple[int | None, str, float], Episode] = {}
    for each in said:
        if of_the_monitor(each.condition):
            continue
        key = (each.joint, each.condition, each.raised_at_unix_s)
        episode = found.setdefault(key, Episode(*key, {}, math.inf))
        episode.tiers.setdefault(each.tier, each.at_unix_s if episode.tiers else each.raised_at_unix_s)
        if each.cleared_at_unix_s is not None:
            found[key] = episode._replace(ended_at_unix_s=each.cleared_at_unix_s)
    return sorted(found.values(), key=lambda each: (each.raised_at_unix_s, each.joint or 0, each.condition))


def changed_alerts(then: Sequence[Episode], now: Sequence[Episode], unjudged: Collection[float] = ()) -> list[dict[str, Any]]:
    """One row for each tier of each alert: when it was reached then and now, and what changed.

    Two alerts of one joint and condition are the same alert where their times overlap. unjudged : times of the replays that cannot be
    judged any more: what only they have said is neither gone nor the same.
    """
    rows, left = [], list(now)
    for old in then:
        match = next((new for new in left if _same_alert(old, new)), None)
        if match is not None:
            left.remove(match)
        rows += _rows(old, match, unjudged)
    for new in left:
        rows += _rows(None, new, unjudged)
    return sorted(rows, key=lambda row: (min(at for at in (row["then_unix_s"], row["now_unix_s"]) if at is not None), row["joint"] or 0))


def of_the_monitor(name: str) -> bool:
    """Whether a condition is one of the monitor itself, which no replay raises."""
    condition = CONDITIONS.get(name)
    return condition is not None and condition.joint is None and condition.arm is None


def counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """How many rows of each change."""
    return {change: sum(row["change"] == change for row in rows) for change in CHANGES}


def _same_alert(old: Episode, new: Episode) -> bool:
    if (old.joint, old.condition) != (new.joint, new.condition):
        return False
    return old.raised_at_unix_s <= new.ended_at_unix_s and new.raised_at_unix_s <= old.ended_at_unix_s


def _rows(old: Episode | None, new: Episode | None, unjudged: Collection[float]) -> list[dict[str, Any]]:
    one = old or new
    assert one is not None
    reached = [{} if each is None else each.tiers for each in (old, new)]
    tiers = [tier for tier in TIERS if tier in reached[0] or tier in reached[1]]
    return [_row(one, tier, reached[0].get(tier), reached[1].get(tier), unjudged) for tier in tiers]


def _row(one: Episode, tier: str, then: float | None, now: float | None, unjudged: Collection[float]) -> dict[str, Any]:
    days = None
    if then in unjudged:
        change, now = UNKNOWN, None if now == then else now  # equal: only copied
    elif then is None or now is None:
        change = NEW if then is None else GONE
    else:
        days = (now - then) / DAY_S
        change = SAME if days == 0.0 else EARLIER if days < 0.0 else LATER
    return {
        "joint": one.joint, "condition": one.condition, "tier": tier, "change": change, "then_unix_s": then, "now_unix_s": now, "days": days
    }  # fmt: skip
