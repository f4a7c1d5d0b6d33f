"""What happened to an arm: windows that ended alike put together, and what its charts must mark (work, another tool, another payload)."""

from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from typing import Any, NamedTuple, Protocol, TypeVar

from monitor.judge.alerts.life_cycle import SERVICED
from monitor.reason import FREE, Reason


class Ended(Protocol):
    """A window that has ended, or has not."""

    @property
    def state(self) -> str:
        """How it ended."""

    @property
    def reason(self) -> Reason | None:
        """Why."""


Window = TypeVar("Window", bound=Ended)


def cause(reason: Reason | None) -> str:
    """What a window ended by: the condition or the cause that its reason names, else its code; of a free text the whole."""
    if reason is None:
        return ""
    named = reason.parameters.get("condition") or reason.parameters.get("cause")
    if isinstance(named, str):
        return named
    return reason.text if reason.code == FREE else reason.code


def runs(windows: Sequence[Window]) -> list[list[Window]]:
    """The windows in their order, those that ended alike one after another together."""
    found: list[list[Window]] = []
    for window in windows:
        before = found[-1][-1] if found else None
        if before is not None and (before.state, cause(before.reason)) == (window.state, cause(window.reason)):
            found[-1].append(window)
        else:
            found.append([window])
    return found


# --- What happened to an arm that its charts must show: work on a joint, another tool, another payload ---

N_ = str  # marks a text for the catalogue
MAINTENANCE = {
    "greased": N_("greased"),
    "replaced": N_("replaced"),
    "overhauled": N_("overhauled"),
    "maintenance": N_("maintenance"),
    "joint_serials": N_("serial numbers"),
}
RENEWS = ("new_joint", "new_reference")  # outcomes of work after which friction counts anew
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


def mark_text(document: Mapping[str, Any]) -> str | None:
    """What was done to the joint, of a transition that work made; None for another transition of an alert."""
    kind = document.get("serviced_kind")
    because = document.get("kind") == "serviced" or document.get("reasons", {}).get("cleared_why", {}).get("code") == SERVICED.code
    return MAINTENANCE.get(str(kind), str(kind)) if because and kind else None


def marks(maintenance: Sequence[Mapping[str, Any]], contexts: Sequence[Mapping[str, Any]]) -> list[Mark]:
    """The marks in order of time.

    works : on joints, as the history holds them, without those that were taken back; contexts : the ledger of the belief, with what it
    compares and when each was first seen.
    """
    found = []
    for (at, kind), group in groupby(maintenance, key=lambda act: (float(act["at_unix_s"]), str(act["kind"]))):
        same = list(group)
        text, renews = MAINTENANCE.get(kind, kind), [act for act in same if act.get("outcome") in RENEWS]
        if kind in ("maintenance", "joint_serials"):  # declared of the arm: the joints that it moved have a mark that renews them
            found += [Mark(at, None, text, False), *(Mark(at, int(act["joint"]), text, True) for act in renews)]
        else:
            found += [Mark(at, int(act["joint"]), text, act in renews) for act in same]
    ordered = sorted(contexts, key=lambda each: float(each["opened_at_unix_s"]))
    for before, after in pairwise(ordered):
        old, new = before["context"], after["context"]
        changed = [name for name in FACTS if old.get(name) != new.get(name) and new.get(name) is not None]
        at = float(after["opened_at_unix_s"])
        joints = _replaced(old, new)
        found += [Mark(at, joint, FACTS["joint_serials"], True) for joint in joints]
        found += [Mark(at, None, FACTS[name], False) for name in changed if not (name == "joint_serials" and joints)]
    return sorted(found, key=lambda mark: mark.t)


def _replaced(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[int]:
    """The joints (from 1) with another serial number."""
    before, after = old.get("joint_serials"), new.get("joint_serials")
    if not before or not after:
        return []
    return [j + 1 for j, (one, other) in enumerate(zip(before, after, strict=False)) if one != other]


# --- Factors between the units of documents and those that a person reads -------------------------------

PERCENT_PER_MONTH = 100 * 30  # times a fraction a day gives per cent a month of 30 days
