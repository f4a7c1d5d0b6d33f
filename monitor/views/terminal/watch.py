"""The lines of `joint-monitor watch`: one for each document of the bus, in colour where standard output is a terminal."""

import json
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.text import Text

from monitor.views.terminal.figures import STATE_STYLE, TIER_STYLE

LONGEST_JSON = 160  # characters: two lines of a terminal that is 80 wide
# of a transition of an alert
KIND_STYLE = {"raised": "bold red", "updated": "yellow", "cleared": "green", "serviced": "cyan"}
KIND_STYLE |= dict.fromkeys(("acknowledged", "unacknowledged", "shelved", "unshelved"), "cyan")
Document = dict[str, Any]


class DocumentPrinter:
    """Prints each document of the bus as one line."""

    def __init__(self) -> None:
        self._console = Console(highlight=False, soft_wrap=True)

    def print(self, key: str, document: Document) -> None:
        """Print one line at once, so that a program that reads it from a pipe does not wait."""
        self._console.print(line(key, document))
        self._console.file.flush()


def line(key: str, document: Document) -> Text:
    """One document as one line. A kind that this module does not know is shown as JSON of at most LONGEST_JSON characters."""
    formatted = next((formatted for matches, formatted in _FORMATS if matches(key)), None)
    if formatted is not None:
        try:
            return formatted(key, document)
        except (KeyError, TypeError, ValueError):  # a document lacks a field that v1 promises: it is shown as JSON
            pass
    text = json.dumps(document, ensure_ascii=False)
    return Text(f"{key}  {text if len(text) <= LONGEST_JSON else text[: LONGEST_JSON - 1] + '…'}")


def _health(key: str, document: Document) -> Text:
    state = document.get("state")
    if state is None:
        return Text(f"{key}  UNKNOWN: no replay has been assessed yet")
    text = Text(f"{key}  ").append(state, STATE_STYLE.get(state, ""))
    if document.get("stale"):
        text.append(" STALE", "yellow")
    for joint in document["joints"]:
        text.append(f"  J{joint['joint']} ").append(joint["state"], STATE_STYLE.get(joint["state"], ""))
        if joint.get("stale"):
            text.append(" STALE", "yellow")
    return text


def _alert(key: str, document: Document) -> Text:
    active = document["active"]
    text = Text(f"{key}  ").append("ACTIVE" if active else "cleared", TIER_STYLE.get(document["tier"] if active else "cleared", ""))
    text.append(f"  {document['text']}")
    if active and document.get("acknowledged_by"):
        text.append(f"  (seen by {document['acknowledged_by']})", "dim")
    if active and document.get("shelved_until"):
        text.append(f"  (shelved until {document['shelved_until']})", "dim")
    return text


def _event(key: str, document: Document) -> Text:
    place = "arm" if document["joint"] is None else f"j{document['joint']}"
    text = Text(f"{key} {document['seq']}  ").append(document["kind"], KIND_STYLE.get(document["kind"], ""))
    return text.append(f"  {place}/{document['condition']}  {document['text']}")


def _friction(key: str, document: Document) -> Text:
    temperature = document["temperature_c"]
    return Text(
        f"{key}  fc {document['coulomb_nm']:.2f} Nm  fv {document['viscous_nm_s_per_rad']:.2f} Nm·s/rad  "
        f"at {'–' if temperature is None else format(temperature, '.1f')} °C  "
        f"wear {100 * document['wear']:+z.1f} ± {100 * document['wear_std']:.1f} %"
    )


def _live(key: str, document: Document) -> Text:
    text, residual = Text(f"{key}  "), document["residual_nm"]
    for j, predicted in enumerate(document["predicted_nm"]):
        text.append(f"J{j + 1} {predicted:z.1f}")
        if residual is not None:
            std = document["std_nm"][j]
            text.append(f" {residual[j]:+z.1f}", "yellow" if std is not None and abs(residual[j]) > 3.0 * std else "dim")
        text.append("  ")
    return text.append("Nm: predicted, and measured − predicted" if residual is not None else "Nm: predicted", "dim")


def _info(key: str, document: Document) -> Text:
    robot = document["robot"]
    serial = f" {document['serial']}" if document.get("serial") else ""
    return Text(
        f"{key}  {robot['model']}{serial} on {document['host']}, joint-monitor {document['version']} since {document['started_at']}"
    )


def _model(key: str, document: Document) -> Text:
    return Text(f"{key}  revision {document['revision']} of {document['at']}")


def _compensation(key: str, document: Document) -> Text:
    return Text(f"{key}  {known_temperatures(document)}")


def known_temperatures(document: Document) -> str:
    """Which temperatures of 0 to 50 °C the friction of each joint is known at, by the document `compensation`."""
    spans = []
    for joint in document["joints"]:
        known = [row["temperature_c"] for row in joint["by_temperature"] if not row["extrapolated"]]
        spans.append(f"J{joint['joint']} {known[0]:.0f}–{known[-1]:.0f}" if known else f"J{joint['joint']} none")
    return f"known of 0 to 50 °C: {'  '.join(spans)}"


def _replay(key: str, document: Document) -> Text:
    text = Text(f"{key}  ").append(document["state"], "bold yellow" if document["state"] == "announced" else "")
    if document["state"] == "announced":
        return text.append(f": the arm moves at {document['moves_at']} for {document['duration_s']:.0f} s")
    return text.append(f": {document['verdict']}{': ' + document['reason'] if document.get('reason') else ''}")


def _monitor(key: str, document: Document) -> Text:
    problems, due = document["troubles"], document["next_replay_due"]
    text = Text(f"{key}  ").append(
        " ".join("; ".join(f"{one['name']}: {one['text']}" for one in problems).split()) or "no trouble", "yellow" if problems else ""
    )
    if waits := document.get("due"):
        text.append(f"  replay due since {waits['since']}, {waits['text']}")
    return text.append(f"  next replay {due or 'none'}", "dim")


# the first entry whose predicate holds for a key formats its documents
_FORMATS: list[tuple[Callable[[str], bool], Callable[[str, Document], Text]]] = [
    (lambda key: key == "health", _health),
    (lambda key: key.startswith("alert/"), _alert),
    (lambda key: key == "event", _event),
    (lambda key: key.endswith("/friction"), _friction),
    (lambda key: key == "torque/live", _live),
    (lambda key: key == "info", _info),
    (lambda key: key == "model", _model),
    (lambda key: key == "compensation", _compensation),
    (lambda key: key == "replay", _replay),
    (lambda key: key == "monitor", _monitor),
]
