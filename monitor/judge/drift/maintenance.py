"""Maintenance of a joint: what a person did to it, and what the filter makes of that.

A joint that was replaced is another joint: everything that was learnt of it begins anew. A joint that was greased or overhauled is the same
one, but its friction may have moved either way: its wear is uncertain for a moment, while the level that wear counts from, the temperature
law and the noise stay as they are. The next replays show where friction is, and by that the maintenance is judged (`settle`). Where it
moved, that becomes the new reference; where a worn joint is as worn as before, nothing is forgotten.
"""

import math
from typing import NamedTuple

from monitor.judge.friction.figures import found_wear
from monitor.judge.friction.step import FrictionState
from monitor.reason import Reason, Sentence, together

REPLACED, OVERHAULED, GREASED = "replaced", "overhauled", "greased"  # a person names the joint and the kind
MAINTENANCE, SERIALS = "maintenance", "joint_serials"  # a declaration that changed: which joints it was is not known
PERSONAL = (REPLACED, OVERHAULED, GREASED)
NEW_JOINT, NEW_REFERENCE, UNCHANGED, STILL_WORN = "new_joint", "new_reference", "unchanged", "still_worn"  # outcomes
RECOVERED = 0.5  # of the wear before: a worn joint with more left is still worn
MOVED_SIGMAS, LEAST_MOVED = 2.0, 0.01  # [σ], [log] a smaller change is none
KNOWN_STD = 0.04  # [log] of wear, from which maintenance can be judged
MOST_REPLAYS = 20  # after so many maintenance is taken as it was declared: the context has changed with it, and nothing can be compared

ACTS = {  # what was done; `by` says who and why
    REPLACED: Sentence("joint_replaced", "{joint:joint} was replaced on {at_unix_s:day} ({by})"),
    OVERHAULED: Sentence("joint_overhauled", "{joint:joint} was overhauled on {at_unix_s:day} ({by})"),
    GREASED: Sentence("joint_greased", "{joint:joint} was greased on {at_unix_s:day} ({by})"),
    MAINTENANCE: Sentence("joint_maintained", "{joint:joint} had maintenance on {at_unix_s:day} ({by})"),
    SERIALS: Sentence("joint_serial_changed", "{joint:joint} may have been replaced on {at_unix_s:day} ({by})"),
}
DONE = Sentence("maintenance_done", "{act}.")
PENDING = Sentence("maintenance_pending", "The next replays show what it did to friction: {replays} so far.")
OUTCOMES = {
    NEW_JOINT: Sentence("new_joint", "It is a new joint: everything is learnt anew, and what was found before is of the old one."),
    NEW_REFERENCE: Sentence("new_reference", "Friction counts from this level now."),
    UNCHANGED: Sentence("unchanged", "That is no change: it counts from the same level as before."),
    STILL_WORN: Sentence("still_worn", "The joint is as worn as before, or nearly: the maintenance has not brought its friction back."),
}
MOVED = Sentence("friction_moved", "Friction moved by {change:+z.1%} ± {std:.1%} with it.")


class Maintenance(NamedTuple):
    """Maintenance of one joint, and its outcome."""

    joint: int  # from 1
    kind: str
    at_unix_s: float  # when it was done
    declared_at_unix_s: float
    by: str
    why: str
    wear_before: float = 0.0  # [log] above the level that wear counts from, when it was declared
    change_before: float = 0.0  # [log] of friction over that at the beginning, likewise
    replays: int = 0  # that were learnt from since
    days: int = 0  # UTC days with such a replay
    last_day: int = -1
    outcome: str | None = None  # None: the next replays will show it
    change: float | None = None  # fraction by which friction moved with it; None: not known
    change_std: float | None = None

    @property
    def waiting(self) -> bool:
        """Whether the outcome is still open."""
        return self.outcome is None

    @property
    def act(self) -> Reason:
        """What was done, when and by whom, as a clause."""
        return ACTS[self.kind](joint=self.joint, at_unix_s=self.at_unix_s, by=self.by)

    @property
    def meaning(self) -> Reason:
        """What the replays have shown of it."""
        if self.outcome is None:
            return PENDING(replays=self.replays)
        moved = None
        if self.change is not None and self.outcome != NEW_JOINT:
            moved = MOVED(change=self.change, std=self.change_std or 0.0)
        return together(moved, OUTCOMES[self.outcome]())

    @property
    def reason(self) -> Reason:
        """What was done and its outcome, in sentences."""
        by = f"{self.by}: {self.why}" if self.why else self.by
        return together(DONE(act=ACTS[self.kind](joint=self.joint, at_unix_s=self.at_unix_s, by=by)), self.meaning)


def count_replay(act: Maintenance, day: int) -> Maintenance:
    """The maintenance with one more replay that was learnt from."""
    return act._replace(replays=act.replays + 1, days=act.days + (day != act.last_day), last_day=day)


def judged(act: Maintenance, state: FrictionState, *, least_replays: int, least_days: int, worn: float) -> Maintenance:
    """The maintenance with its outcome, where the replays since then suffice for one. state : of one arm.

    worn : [log] wear from which a joint is worn, so that maintenance has something to prove.
    """
    j = act.joint - 1
    of_wear, of_std = found_wear(state)
    wear, std, moved_before = float(of_wear[j]), float(of_std[j]), float(state.of_joints(state.moved)[j])
    change = wear + moved_before - act.change_before
    if act.replays < least_replays or act.days < least_days or (std > KNOWN_STD and act.replays < MOST_REPLAYS):
        return act
    if std > KNOWN_STD:
        return act._replace(outcome=NEW_REFERENCE)
    moved = abs(change) > max(MOVED_SIGMAS * std, LEAST_MOVED)
    named = act.kind in PERSONAL
    if act.wear_before >= worn:
        recovered = moved and (wear <= RECOVERED * act.wear_before or wear < worn)
        outcome = NEW_REFERENCE if recovered else STILL_WORN if named or moved else UNCHANGED
    else:
        fallen_before = moved_before < -LEAST_MOVED
        outcome = NEW_REFERENCE if named or moved or fallen_before else UNCHANGED
    return act._replace(outcome=outcome, change=math.expm1(change), change_std=math.exp(change) * std)
