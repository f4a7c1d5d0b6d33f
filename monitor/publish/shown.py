"""How an arm, a joint and an alert are shown: state, pill and the sentence that decides. Pages, reports, messages and protocols ask here.

Pure. A state is one of NAMUR NE 107; None: no replay has been assessed. What it is of is another question: `Age`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.alerts.health import CHECK_FUNCTION, NORMAL, STATES, TIERS, State
from monitor.publish.documents import Alert, Health, JointState
from monitor.reason import Reason, Sentence

N_ = str  # marks a text for the catalogue
NOTHING_ASSESSED = Sentence("nothing_assessed", "no replay has been assessed yet")()
OUT_OF_DATE = Sentence("shown_out_of_date", "What stands here is out of date.")()
NOT_HEARD = Sentence("shown_not_heard", "Nothing is heard of it: {why}.")
TIER_WORDS = {"advisory": N_("notice"), "wear": N_("wear"), "limit": N_("limit")}


class Pill(Enum):
    """What stands in a pill, the mildest first; each has its colour."""

    UNKNOWN = None
    NORMAL = "NORMAL"
    NOTICE = "NOTICE"  # of an alert that leaves its joint NORMAL
    CHECK_FUNCTION = "CHECK_FUNCTION"
    OFF_SPEC = "OFF_SPEC"
    MAINTENANCE_REQUIRED = "MAINTENANCE_REQUIRED"
    FAILURE = "FAILURE"

    @property
    def word(self) -> str:
        """In English."""
        return WORDS[self]


WORDS = {
    Pill.UNKNOWN: N_("Not known yet"),
    Pill.NORMAL: N_("Normal"),
    Pill.NOTICE: N_("Notice"),
    Pill.CHECK_FUNCTION: N_("Check function"),
    Pill.OFF_SPEC: N_("Out of specification"),
    Pill.MAINTENANCE_REQUIRED: N_("Maintenance required"),
    Pill.FAILURE: N_("Failure"),
}


class Age(Enum):
    """Of which time a state is."""

    NOW = "now"
    OUT_OF_DATE = "out_of_date"  # nothing was learnt for too long
    NOT_HEARD = "not_heard"  # nobody hears the arm's monitor


class Grade(Enum):
    """How much an arm needs somebody, the worst first: the order in which arms are listed."""

    SICK = "sick"
    UNSEEN = "unseen"
    DOUBTFUL = "doubtful"
    WELL = "well"

    @property
    def order(self) -> int:
        """0: the worst."""
        return list(Grade).index(self)


class Person(Enum):
    """What a person has done with an alert."""

    WAITS = "waits"  # for a person
    ACKNOWLEDGED = "acknowledged"
    SHELVED = "shelved"
    CLEARED = "cleared"  # nobody need do anything


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """An arm or a joint as it is shown."""

    state: State | None  # the gravest that the arm says, its active alerts included; of the time of `age`
    why: Reason  # the sentence that decides
    said: Reason  # what the arm or the joint says, whether or not it is of now
    age: Age = Age.NOW
    alert: Alert | None = None  # that decides, whose headline is said instead of `why`

    @property
    def pill(self) -> Pill:
        """For people: a state of then that is no worse than CHECK_FUNCTION is one to be checked."""
        pill = Pill(self.state)
        return Pill.CHECK_FUNCTION if self.age is not Age.NOW and pill is Pill.NORMAL else pill

    @property
    def grade(self) -> Grade:
        """The worst that holds."""
        if self.state in ("FAILURE", "MAINTENANCE_REQUIRED"):
            return Grade.SICK
        if self.age is not Age.NOW:
            return Grade.UNSEEN
        return Grade.WELL if self.state == NORMAL else Grade.DOUBTFUL

    @property
    def order(self) -> int:
        """Among arms of one grade: the graver state first, one that is not known last."""
        return -gravity(self.state) if self.state else 1


def gravity(state: State | None) -> int:
    """Order of the states: the graver, the larger; −1 for None."""
    return -1 if state is None else STATES.index(state)


def alert_state(alert: Alert) -> State | None:
    """The state that an active alert gives its joint or the arm; None of a cleared one.

    One whose condition or tier is of another release is to be checked.
    """
    if not alert.active:
        return None
    condition = CONDITIONS.get(alert.condition)
    if alert.awaiting_proof or condition is None or alert.tier not in condition.tiers:
        return CHECK_FUNCTION
    return condition.tiers[alert.tier].state


def alert_pill(alert: Alert) -> Pill:
    """A state, or NOTICE where the joint stays NORMAL; UNKNOWN of a cleared one."""
    state = alert_state(alert)
    return Pill.NOTICE if state == NORMAL else Pill(state)


def person(alert: Alert, now_unix_s: float) -> Person:
    """What a person has done with it. Shelved comes before acknowledged: it ends by itself."""
    if not alert.active:
        return Person.CLEARED
    if alert.shelved_until is not None and alert.shelved_until.timestamp() > now_unix_s:
        return Person.SHELVED
    return Person.ACKNOWLEDGED if alert.acknowledged_at is not None else Person.WAITS


def waiting(alerts: Iterable[Alert], now_unix_s: float) -> list[Alert]:
    """Those that wait for a person: neither acknowledged nor shelved."""
    return [each for each in alerts if person(each, now_unix_s) is Person.WAITS]


def unacknowledged(alerts: Iterable[Alert]) -> list[Alert]:
    """Those that nobody has acknowledged, shelved ones included."""
    return [each for each in alerts if each.acknowledged_at is None]


def gravest_first(alerts: Iterable[Alert]) -> list[Alert]:
    """The gravest tier first, of equal ones the active first, then the oldest."""
    return sorted(alerts, key=lambda each: (-tier_gravity(each.tier), not each.active, each.raised_at))


def tier_gravity(tier: str) -> int:
    """Order of the tiers: 0 for one that is none."""
    return TIERS.index(tier) + 1 if tier in TIERS else 0


def arm_shown(health: Health | None, silence: Reason | None = None) -> Shown:
    """The arm. silence : why nobody hears its monitor; None: it is heard."""
    if health is None:
        return shown_of(None, None, silence=silence)
    return shown_of(health.state, health.says("why"), health.alerts, stale=health.stale, silence=silence)


def joint_shown(joint: JointState | None, silence: Reason | None = None) -> Shown:
    """One joint, whose state has its alerts in it; None: nothing is said of it."""
    if joint is None:
        return shown_of(None, None, silence=silence)
    return shown_of(joint.state, joint.says("why"), stale=joint.stale, silence=silence)


def shown_of(
    state: State | None, why: Reason | None, alerts: Iterable[Alert] = (), *, stale: bool = False, silence: Reason | None = None
) -> Shown:
    """The gravest of a verdict (`state`, `why`) and of active alerts, and what keeps that from being of now.

    Of equally grave alerts the arm's own come first: what they say holds for every joint.
    """
    said, alert = why or NOTHING_ASSESSED, None
    age = Age.NOT_HEARD if silence is not None else Age.OUT_OF_DATE if stale and state is not None else Age.NOW
    for each in sorted((each for each in alerts if each.active), key=lambda each: each.joint is not None):
        of_alert = alert_state(each)
        if of_alert != NORMAL and (gravity(of_alert) > gravity(state) or (of_alert == state and alert is None)):
            state, alert, said = of_alert, each, each.says("text") or said
    of_arm = alert is not None and alert.joint is None and silence is None  # it says itself what keeps the verdict from being of now
    if age is Age.NOW or of_arm or gravity(state) > gravity(CHECK_FUNCTION):
        return Shown(state=state, why=said, said=said, alert=alert, age=age)
    return Shown(state=state, why=OUT_OF_DATE if silence is None else NOT_HEARD(why=silence), said=said, age=age)
