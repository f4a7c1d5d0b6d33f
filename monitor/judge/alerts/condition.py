"""What an alert condition is: one record with its tiers, predicates and texts. The records themselves are in `conditions`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np

from monitor.judge.alerts.health import TIERS, Alert, Attribution, Confirmations, JointHealth, State
from monitor.judge.settings import HealthSettings
from monitor.reason import Reason, Sentence
from monitor.recording import Array

if TYPE_CHECKING:
    from monitor.judge.alerts.evidence import Evidence
    from monitor.judge.belief import Belief
    from monitor.judge.drift.undeclared import UndeclaredChange


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmSituation:
    """One arm after a replay: what the rules of its conditions read."""

    belief: "Belief"
    evidence: "Evidence"
    undeclared: "UndeclaredChange"  # in this replay
    alerts: Mapping[tuple[int | None, str], Alert]  # by joint and condition, before this replay
    settings: HealthSettings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointSituation:
    """One joint after a replay: what the rules of its conditions read."""

    arm: ArmSituation
    j: int  # from 0
    health: JointHealth  # with the confirmations of this replay
    attribution: Attribution | None  # of the joint's change of friction

    @property
    def belief(self) -> "Belief":
        """The arm's belief."""
        return self.arm.belief

    @property
    def settings(self) -> HealthSettings:
        """Of the alerts."""
        return self.arm.settings

    @property
    def heard(self) -> bool:
        """Whether the replay taught anything of the joint's friction, at a known temperature: another one changes no alert of friction."""
        return bool(self.belief.learnt_from[self.j] and np.isfinite(self.belief.temperature_c[self.j]))


class Standing(NamedTuple):
    """Something that has lasted since a time."""

    since_unix_s: float
    reason: Reason | None = None  # as the service knows it
    until_unix_s: float | None = None  # it may last so long; None: for ever, or it may not last at all
    windows: int = 0  # of the schedule that it has cost


class Allowed(NamedTuple):
    """The person who has allowed motion again after a stop."""

    at_unix_s: float
    by: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceSituation:
    """The monitor between replays: what the conditions of the service itself read. None: it is not so."""

    now_unix_s: float
    stop: Standing | None = None  # which a person must look at
    refused: Standing | None = None  # every window, by the arm or its cell
    unlearnt: Standing | None = None  # the last replay that taught something, or the beginning
    unheard: Standing | None = None  # the arm
    due: Standing | None = None  # a replay that waits for the node of the program that lends the arm
    allowed: Allowed | None = None  # the newest


class ConditionStatus(NamedTuple):
    """What a condition looks like after a replay."""

    raise_tier: int | None  # index of the tier to which its alert may be raised; None: it may not be raised
    hold_tier: int | None  # index of the tier at which an active alert may stay; None: the condition is gone
    change: float  # of friction torque, as a fraction; 0 for a condition of the data
    probabilities: Array  # (3,) that the change exceeds the rise of each tier
    text: Callable[[], Reason]  # made only for an alert that is raised, updated or cleared
    attribution: Attribution | None = None
    lowest_at_unix_s: float | None = None  # when the friction was lowest that a rise is counted from; None: the beginning, or no rise
    from_production: bool = False  # whether production shows it
    restated: bool = False  # whether an active alert says from now on what it did not say before


Situation = TypeVar("Situation", ArmSituation, JointSituation)


def enough_replays(confirmations: Confirmations, settings: HealthSettings) -> bool:
    """Whether `min_replays` consecutive replays on `min_days` days show a condition."""
    return confirmations.replays >= settings.min_replays and confirmations.days >= settings.min_days


def two_replays(confirmations: Confirmations, _settings: HealthSettings) -> bool:
    """Whether two consecutive replays show a condition."""
    return confirmations.replays >= 2


@dataclass(frozen=True, slots=True)
class Rule(Generic[Situation]):
    """When a condition of an arm, or of one joint, is raised, and what its alert says."""

    status: Callable[[Situation, Confirmations], ConditionStatus | None]  # after so many confirmations; None: the alert stays as it is
    # whether this replay confirms the condition, None where it cannot tell; no function: the rule needs no count of replays
    shows: Callable[[Situation], bool | None] | None = None
    raises: tuple[str, ...] = ("advisory",)  # the tiers to which the rule may raise the alert


def repeated(
    shows: Callable[[Situation], bool | None],
    text: Sentence | Callable[[Situation, Confirmations], Reason],
    enough: Callable[[Confirmations, HealthSettings], bool] = enough_replays,
) -> Rule[Situation]:
    """A rule that raises an advisory when enough consecutive replays show a condition, and ends it with the first that does not.

    A replay of which `shows` cannot tell (None) changes nothing: missing data do not end a condition.
    text : a sentence with places for `replays`, and of a joint for `joint` and `temperature_c`; or what makes it.
    """
    worded = partial(_in_a_row, text) if isinstance(text, Sentence) else text

    def status(situation: Situation, confirmations: Confirmations) -> ConditionStatus:
        return ConditionStatus(
            raise_tier=0 if enough(confirmations, situation.settings) else None,
            hold_tier=0 if confirmations.replays else None,
            change=0.0,
            probabilities=np.ones(3),
            text=partial(worded, situation, confirmations),
        )

    return Rule(status, shows)


def _in_a_row(sentence: Sentence, situation: ArmSituation | JointSituation, confirmations: Confirmations) -> Reason:
    """A sentence that replays in a row show."""
    if isinstance(situation, ArmSituation):
        return sentence(replays=confirmations.replays)
    temperature_c = float(situation.belief.temperature_c[situation.j])
    known = {"temperature_c": temperature_c} if np.isfinite(temperature_c) else {}
    return sentence(joint=situation.j + 1, replays=confirmations.replays, **known)


class AlertTier(NamedTuple):
    """One tier of a condition."""

    state: State  # NE 107 state of the joint or the arm while an alert of this tier is active
    advice: str  # what a person shall do; published as the alert's `action`
    meaning: str  # when the tier is raised, for the documentation


class Headlines(NamedTuple):
    """What a page or a message leads with, by whom the alert concerns; empty: the alert's own text.

    `{joint:name}` is the joint, `{rise}` the size of the change of friction, `{since}` the day with which it is compared.
    """

    joint: str = ""
    arm: str = ""
    arm_fallen: str = ""  # where the arm's friction has fallen; empty: as `arm`


NO_HEADLINES = Headlines()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AlertCondition:
    """Everything that is known of one alert condition: rules, texts, page, metrics and documentation read this record.

    Headlines, advice and `probability_of` are sentences of the codes `<name>.joint`, `<name>.arm`, `<name>.arm_fallen`, `<name>.<tier>` and
    `<name>.probability`.

    `name` is the condition's key in `CONDITIONS`, in alerts, on the bus and in the history. `tiers` has the tier names of `health.TIERS`
    (advisory, wear, limit) in that order: every tier that a rule raises, and at least one. The service raises its own conditions as an
    advisory. Raises ValueError naming the condition where a record breaks this.
    """

    name: str
    tiers: Mapping[str, AlertTier]  # by the name of the tier, in ascending order
    headlines: Headlines = NO_HEADLINES  # for people; a page says them in its reader's language
    joint: Rule[JointSituation] | None = None  # how the condition of a joint is raised
    arm: Rule[ArmSituation] | None = None  # how the condition of the arm is raised; neither: the service itself raises it
    service: Callable[[ServiceSituation], Reason | None] | None = None  # the text while the service's own condition holds, else None
    probability_of: str | None = None  # what the friction does with the alert's probability; None: the alert is not of friction

    def __post_init__(self) -> None:
        """Refuses a record whose first alert would fail."""
        if not self.name:
            raise ValueError("alert condition: its name is empty; expected the key of the condition, e.g. 'data_quality'")
        names = tuple(self.tiers)
        if unknown := [name for name in names if name not in TIERS]:
            raise ValueError(f"alert condition {self.name!r}: unknown tiers {unknown}; expected some of {', '.join(TIERS)}")
        if list(names) != sorted(names, key=TIERS.index):
            raise ValueError(f"alert condition {self.name!r}: tiers in the order {', '.join(names)}; expected the order {', '.join(TIERS)}")
        rules = [rule.raises for rule in (self.joint, self.arm) if rule is not None] or [("advisory",)]
        if missing := [name for name in TIERS if any(name in raises for raises in rules) and name not in names]:
            raise ValueError(f"alert condition {self.name!r}: raises {', '.join(missing)}, which its tiers {list(names)} do not have")
        advice = {name: tier.advice for name, tier in self.tiers.items()}
        for part, text in {**self.headlines._asdict(), **advice, "probability": self.probability_of}.items():
            if text:
                Sentence(f"{self.name}.{part}", text)

    def action(self, tier: str) -> Reason:
        """What a person shall do about an alert of this tier."""
        return Reason(f"{self.name}.{tier}")

    def headline(self, joint: int | None, change: float, rise: str, since: str) -> Reason | None:
        """What a page leads with; None where the condition has no headline. rise, since : as the reader's language words them."""
        part = "joint" if joint is not None else "arm_fallen" if change < 0 and self.headlines.arm_fallen else "arm"
        return Reason(f"{self.name}.{part}", {"joint": joint, "rise": rise, "since": since}) if getattr(self.headlines, part) else None

    @property
    def change_probable(self) -> Reason | None:
        """What the friction does with the alert's probability; None: the alert is not of friction."""
        return None if self.probability_of is None else Reason(f"{self.name}.probability")
