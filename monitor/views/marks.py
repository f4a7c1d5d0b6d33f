"""What happened to an arm that its charts must show: work on a joint, another tool, another payload."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

N_ = str  # marks a text for the catalogue
SERVICED = "serviced"  # kind of the events of work on a joint
WORK = {"greased": N_("greased"), "replaced": N_("replaced"), "overhauled": N_("overhauled"), "serviced": N_("serviced")}
RENEWS = ("replaced", "overhauled")  # what begins friction anew
FACTS = {  # of a context, with the text of its change
    "tool": N_("tool changed"),
    "payload_kg": N_("payload changed"),
    "mounting_rad": N_("mounting changed"),
    "trajectory_digest": N_("trajectory changed"),
    "serial": N_("another arm"),
    "joint_serials": N_("joint replaced"),
    "maintenance": N_("maintenance"),
}


class Mark(NamedTuple):
    """One of them."""

    t: float  # [s since 1970]
    joint: int | None  # from 1; None: the whole arm
    text: str
    renews: bool  # whether friction of the joint is compared with what it was from then on


class Event(Protocol):
    """An event of the history."""

    @property
    def at_unix_s(self) -> float:
        """When it happened."""

    @property
    def document(self) -> dict[str, Any]:
        """What happened."""


def mark_text(document: Mapping[str, Any]) -> str | None:
    """What an event of work says; None for a transition of an alert."""
    if document.get("kind") != SERVICED:
        return None
    return WORK.get(_work(document), WORK[SERVICED])


def marks(events: Iterable[Event], contexts: Sequence[Mapping[str, Any]]) -> list[Mark]:
    """The marks in order of time.

    events : of the history; contexts : the ledger of the belief, with what it compares and when each was first seen.
    """
    found = [
        Mark(float(event.at_unix_s), event.document.get("joint"), text, _work(event.document) in RENEWS)
        for event in events
        if (text := mark_text(event.document)) is not None
    ]
    ordered = sorted(contexts, key=lambda each: float(each["opened_at_unix_s"]))
    for before, after in pairwise(ordered):
        old, new = before["context"], after["context"]
        changed = [name for name in FACTS if old.get(name) != new.get(name) and new.get(name) is not None]
        at = float(after["opened_at_unix_s"])
        joints = _replaced(old, new)
        found += [Mark(at, joint, FACTS["joint_serials"], True) for joint in joints]
        found += [Mark(at, None, FACTS[name], False) for name in changed if not (name == "joint_serials" and joints)]
    return sorted(found, key=lambda mark: mark.t)


def _work(document: Mapping[str, Any]) -> str:
    """The name of the work in an event of work."""
    return next((str(document[name]) for name in ("work", "what", "how", "service") if document.get(name)), SERVICED)


def _replaced(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[int]:
    """The joints (from 1) with another serial number."""
    before, after = old.get("joint_serials"), new.get("joint_serials")
    if not before or not after:
        return []
    return [j + 1 for j, (one, other) in enumerate(zip(before, after, strict=False)) if one != other]
