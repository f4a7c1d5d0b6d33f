"""What `status` prints of inspection duties."""

from collections.abc import Mapping
from typing import Any

from monitor.reason import joint_text

NEWEST = 3  # stops that are printed


def inspection_lines(found: Mapping[str, Any] | None) -> list[str]:
    """Operating hours, stops and checks, as lines; none where [inspection] asks for nothing."""
    if not found:
        return []
    if found["counted_since"] is None:
        lines = ["operating hours and stops: the arm was not heard yet"]
    else:
        lines = [
            f"operating hours {found['operating_h']:.1f} h; since {found['counted_since'][:10]} heard {found['heard_h']:.1f} h, "
            f"on {found['on_h']:.1f} h, in motion {found['moving_h']:.1f} h",
            f"stops of the safety system: {found['stops']}, in the last 28 days {found['stops_28_days']}",
        ]
    lines += [f"  {stop['at']}  {stop_words(stop)}" for stop in found["last_stops"][:NEWEST]]
    return [*lines, *(f"check {_item(item)}" for item in found["items"])]


def stop_words(stop: Mapping[str, Any]) -> str:
    """A stop in words: its kind, and what the controller told."""
    told = [joint_text(stop["joint"])] if stop["joint"] is not None else []
    told += [stop["code"]] if stop["code"] else []
    told += ["during a replay"] if stop["during_replay"] else []
    told += ["it stands"] if stop["ended_at"] is None else []
    return f"{stop['kind'].replace('_', ' ')}{': ' if told else ''}{', '.join(told)}"


def _item(item: Mapping[str, Any]) -> str:
    """One check in words."""
    if item["state"] == "unrecorded":
        return f"{item['name']}: due, nobody has recorded when it was done last"
    since = f"; {item['stops_since']} stops since" if item["after_collision"] and item["stops_since"] else ""
    by = f" by {item['last_by']}" if item["last_by"] else ""
    last = f"last done {item['last_done'][:10]}{by}{since}"
    if item["due"] is None:
        return f"{item['name']}: {last}; its hours are not known yet"
    what = {"due": "DUE since", "soon": "due soon,", "done": "due"}[item["state"]]
    hours = "" if item["hours_left"] is None else f", {item['hours_left']:.0f} h left"
    return f"{item['name']}: {what} {item['due'][:10]}{hours}; {last}"
