"""What the command `reassess` prints."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.views.terminal.figures import standard_output, table_of

MOST_ROWS = 60  # of the table; all of them are in the document
MOST_ERRORS = 10


def print_reassessment(document: dict[str, Any], pictures: Sequence[str] = ()) -> None:
    """Print what would have been said otherwise, and what it rests on."""
    console = standard_output(120)

    def say(text: str) -> None:
        console.print(text, highlight=False, markup=False, soft_wrap=True)

    basis = "with the settings of then" if not document["changes"] else f"with {', '.join(_changed(document['changes']))}"
    say(f"{document['judged']} of {document['replays']} replays of {document['arms']} arms judged once more, {basis}")
    if (verdicts := document.get("verdicts")) is not None:
        say(
            f"{verdicts['identical']} verdicts come out the same to the last bit, {verdicts['different']} differ, "
            f"{verdicts['not_recomputable']} cannot be recomputed"
        )
        for line in document["changed_since"]:
            say(f"  changed since: {line}")
    if len(document["processors"]) > 1:
        say(f"computed on several kinds of processors, whose last digits may differ: {'; '.join(document['processors'])}")
    for name, text in (
        ("gone", "have no recording any more, and nothing that could be judged in its place"),
        ("changed", "have another recording than was made"),
        ("rejected", "are rejected"),
        ("unknown_state", "follow one of these, up to the next state that the history has kept"),
    ):
        if document["left_out"][name]:
            say(f"{document['left_out'][name]} replays {text}")
    if document["of_parts"]:
        say(f"{document['of_parts']} replays have no recording any more, and are judged of what was identified then")
    if document["newly_accepted"]:
        say(f"{document['newly_accepted']} replays that were rejected then are accepted")
    alerts = document["alerts"]
    unknown = f", {alerts['unknown']} unknown" if alerts["unknown"] else ""
    say(
        f"alerts, by tier: {alerts['same']} as they were, {alerts['earlier']} earlier, {alerts['later']} later, {alerts['gone']} gone, "
        f"{alerts['new']} new{unknown}"
    )
    rows = document["changed_alerts"]
    if rows:
        table = table_of(
            ("arm", "joint", "alert", "tier", "then", "now", "days", "change"), left=("arm", "joint", "alert", "tier", "change")
        )
        for row in rows[:MOST_ROWS]:
            joint = "arm" if row["joint"] is None else f"J{row['joint']}"
            days = "" if row["days"] is None else f"{row['days']:+.1f}"
            table.add_row(
                row["arm"], joint, row["condition"], row["tier"], _day(row["then_unix_s"]), _day(row["now_unix_s"]), days, row["change"]
            )
        console.print(table)
        if len(rows) > MOST_ROWS:
            say(f"and {len(rows) - MOST_ROWS} more: --json has them all")
    for path in pictures:
        say(f"picture: {path}")
    for error in document["errors"][:MOST_ERRORS]:
        say(f"error: {error['arm']}, replay {error['replay']}: {error['reason']}")
    if len(document["errors"]) > MOST_ERRORS:
        say(f"and {len(document['errors']) - MOST_ERRORS} more errors: --json has them all")
    for arm in document["failed"]:
        say(f"not judged: {arm['arm']}: {arm['reason']}")


def _changed(changes: dict[str, Any], place: str = "") -> list[str]:
    """The changed settings, e.g. `health.wear_rise = 0.2`."""
    lines = []
    for key, value in changes.items():
        lines += _changed(value, f"{place}{key}.") if isinstance(value, dict) else [f"{place}{key} = {value}"]
    return lines


def _day(at_unix_s: float | None) -> str:
    return "–" if at_unix_s is None else str(np.datetime64(int(at_unix_s), "s").astype("datetime64[D]"))
