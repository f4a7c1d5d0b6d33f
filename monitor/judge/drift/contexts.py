"""In which contexts an arm has replayed, and which of them are the same: a level of friction belongs to each."""

import math
import re
from dataclasses import replace
from typing import NamedTuple

from monitor.judge.drift.slots import SLOTS
from monitor.recording import Context

COMPARABLE = ("serial", "joint_serials", "firmware", "mounting_rad", "payload_kg", "tool", "trajectory_digest", "maintenance")
LASTING = ("joint_serials", "maintenance")  # a context that does not state one of these has not changed it
CONTEXTS_KEPT = 16  # the ledger's length: more than an arm's usual tools and payloads
TOLERANCES = {"payload_kg": 1e-3, "mounting_rad": math.radians(0.01)}  # a gram, and a hundredth of a degree
_VERSION = re.compile(r"\d+(?:\.\d+)+")


class OpenedContext(NamedTuple):
    """One context of the ledger: when its baseline began, how many replays it has, and in which slot its level is kept."""

    context: Context
    opened_at_unix_s: float
    replays: int
    slot: int | None = 0  # None: another context has taken its slot; if it comes again, its baseline is learned again
    undeclared: bool = False  # whether it is what the replays weigh, and not what is declared; see `undeclared_level`


class Entered(NamedTuple):
    """The contexts of an arm after a replay entered its own: the last one in the list is in force."""

    contexts: tuple[OpenedContext, ...]
    opened: bool  # whether this context begins: its level of friction is not known yet


def comparable(context: Context) -> Context:
    """Only the fields that must be equal for two replays to be compared."""
    return Context(robot=context.robot, **{key: getattr(context, key) for key in COMPARABLE})


def with_lasting_declarations(before: Context | None, after: Context) -> Context:
    """The context after, with past work and joint serials from before where it does not state them.

    A joint that was greased once stays greased. Without this, a context that does not repeat the work would return to the baseline from
    before it.
    """
    if before is None:
        return after
    return replace(after, **{key: getattr(before, key) for key in LASTING if getattr(after, key) is None})


def with_declarations_of(contexts: tuple[OpenedContext, ...], context: Context) -> tuple[OpenedContext, ...]:
    """The ledger with the lasting declarations of a context in every entry.

    Past work and serial numbers are of the arm, whatever it carries: they are events, and no condition that another context leaves again.
    What work did to friction, it did in all contexts alike.
    """
    declared = {key: getattr(context, key) for key in LASTING}
    return tuple(opened._replace(context=replace(opened.context, **declared)) for opened in contexts)


def differences(before: Context, after: Context) -> list[str]:
    """What changed between two contexts, one text for each field.

    Payloads are equal within a gram, angles within a hundredth of a degree, words regardless of case and blanks, firmware by its version.
    """
    pairs = [(key, getattr(before, key), getattr(after, key)) for key in COMPARABLE]
    return [f"{key} {old!r} → {new!r}" for key, old, new in pairs if not _same(key, old, new)]


def enter(
    contexts: tuple[OpenedContext, ...], context: Context, at_unix_s: float, *, undeclared: bool = False, begins: bool = False
) -> Entered:
    """The ledger with another context in force. A context that still has a slot keeps it; a new one takes a free slot or the oldest.

    undeclared : whether it is the level beside that of the declared context; begins : whether that is another one than before.
    """
    ledger = [o for o in contexts if not (begins and _is(o, context, undeclared))]
    known = next((o for o in ledger if o.slot is not None and _is(o, context, undeclared)), None)
    if known is not None:
        ledger.remove(known)
        ledger.append(known)
    else:
        taken = [o.slot for o in ledger if o.slot is not None]  # the context that was left the longest ago comes first
        slot = next((free for free in range(SLOTS) if free not in taken), taken[0])
        ledger = [o._replace(slot=None) if o.slot == slot else o for o in ledger]
        ledger.append(OpenedContext(comparable(context), at_unix_s, 0, slot, undeclared))
    return Entered(tuple(ledger[-CONTEXTS_KEPT:]), known is None)


def declare_level(contexts: tuple[OpenedContext, ...], context: Context) -> tuple[OpenedContext, ...]:
    """The ledger where the undeclared level in force is that of a context that is declared now: what was learnt in it holds."""
    return (*contexts[:-1], contexts[-1]._replace(context=comparable(context), undeclared=False))


def may_be_level(contexts: tuple[OpenedContext, ...], context: Context) -> bool:
    """Whether a context may declare the undeclared level in force: it has another payload or tool, and no level of its own."""
    now = contexts[-1]
    as_now = replace(context, payload_kg=now.context.payload_kg, tool=now.context.tool)
    known = any(o.slot is not None and _is(o, context, False) for o in contexts)
    return now.undeclared and not known and not differences(now.context, as_now)


def _is(opened: OpenedContext, context: Context, undeclared: bool) -> bool:
    """Whether an entry of the ledger is that context, declared or not."""
    return opened.undeclared == undeclared and not differences(opened.context, context)


def _same(key: str, a: object, b: object) -> bool:
    """Whether two values of a context's field are equal for comparison."""
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(_same(key, x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, int | float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=0.0, abs_tol=TOLERANCES.get(key, 0.0))
    if isinstance(a, str) and isinstance(b, str):
        return _normal(key, a) == _normal(key, b)
    return a == b


def _normal(key: str, word: str) -> str:
    """The part of a word that distinguishes contexts."""
    version = _VERSION.search(word) if key == "firmware" else None
    if version:
        return ".".join(str(int(part)) for part in version.group().split("."))
    return " ".join(word.split()).casefold()
