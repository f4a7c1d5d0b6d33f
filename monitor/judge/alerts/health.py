"""Values of a verdict: settings, the state of the arm and its joints, alerts that are raised, updated and cleared, and all that as JSON.

The states are those of NAMUR NE 107 in the spelling of OPC UA. An alert is latched: it clears only after somebody has acknowledged it
and its condition is gone. Acknowledged and shelved are independent of active (ISA-18.2). `rules.judge` makes these values.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

from monitor.judge.document import plain, typed
from monitor.reason import Reason, Sentence

State = Literal["NORMAL", "CHECK_FUNCTION", "OFF_SPEC", "MAINTENANCE_REQUIRED", "FAILURE"]
STATES: tuple[State, ...] = get_args(State)  # in ascending order of precedence: the last one of several states wins
NORMAL: State = "NORMAL"
CHECK_FUNCTION: State = "CHECK_FUNCTION"  # the data are unreliable; the joint itself may be sound
OFF_SPEC: State = "OFF_SPEC"  # outside the temperatures learned so far
MAINTENANCE_REQUIRED: State = "MAINTENANCE_REQUIRED"
FAILURE: State = "FAILURE"  # the configured end of life is reached


# --- Settings of the alerts ------------------------------------------------------------------------------


# --- Values of a verdict ---------------------------------------------------------------------------------

TIERS = ("advisory", "wear", "limit")  # how grave an alert is, in ascending order
SEVERITY = {"advisory": "low", "wear": "medium", "limit": "high"}
NOTHING_KNOWN = Sentence("nothing_known", "nothing is known yet")()


class Confirmations(NamedTuple):
    """Consecutive replays that show a condition."""

    replays: int = 0
    days: int = 0  # UTC days on which they lie
    last_day: int = -1  # the last of these days, counted from 1970-01-01; −1: none


NO_CONFIRMATIONS = Confirmations()


class Attribution(NamedTuple):
    """The causes of a change of friction torque, each as a logarithm; the causes add up to the whole."""

    whole: float  # from the mean of the first replays to the last replay
    temperature: float
    payload: float  # of another payload, or of another difference between the contexts
    wear: float
    rest: float  # noise of the last replay


@dataclass(frozen=True, slots=True, kw_only=True)
class JointHealth:
    """State of one joint, why and since when, and the confirmations counted so far."""

    joint: int  # 1…J
    state: str = NORMAL
    why: Reason = NOTHING_KNOWN
    since_unix_s: float = 0.0
    confirmations: tuple[tuple[str, Confirmations], ...] = ()  # of conditions of the data, by name
    learnt_at_unix_s: float | None = None  # of the last replay that updated the joint


class Gravest(NamedTuple):
    """What an alert said at its gravest moment: of the highest tier, and of that the largest change."""

    at_unix_s: float
    tier: str
    change: float
    probability: float
    text: Reason
    attribution: Attribution | None = None  # of the change
    lowest_at_unix_s: float | None = None


class Acknowledgement(NamedTuple):
    """One person's acknowledgement of an alert, and who took it back."""

    at_unix_s: float
    by: str
    why: str
    undone_at_unix_s: float | None = None
    undone_by: str | None = None
    undone_why: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Alert:
    """One condition of one joint, or of the arm, through its life."""

    joint: int | None  # 1…J; None is the arm
    condition: str
    tier: str
    raised_at_unix_s: float
    updated_at_unix_s: float
    cleared_at_unix_s: float | None = None
    change: float  # of friction torque, as a fraction
    probability: float  # that the change exceeds the tier's rise
    text: Reason
    action: Reason
    severity: str = "low"
    attribution: Attribution | None = None
    acknowledged_at_unix_s: float | None = None
    acknowledged_by: str | None = None
    acknowledged_why: str | None = None
    shelved_until_unix_s: float | None = None
    shelved_by: str | None = None
    shelved_why: str | None = None
    lowest_at_unix_s: float | None = None  # when the friction was lowest that a rise is counted from; None: the beginning, or no rise
    from_production: bool = False  # that the arm's ordinary work shows it, and no replay has confirmed it yet
    over_since_unix_s: float | None = None  # of a condition of the service: since when it is over, while nobody has acknowledged it
    gravest: Gravest | None = None  # None: what the alert says now is all that is known
    acknowledgements: tuple[Acknowledgement, ...] = ()  # all of them, the first one first; `acknowledged_*` is the first that is in force
    cleared_why: Reason | None = None
    serviced_at_unix_s: float | None = None  # of the last work on the joint that was declared while the alert was active
    serviced_kind: str | None = None
    serviced_by: str | None = None
    serviced_why: str | None = None
    awaiting_proof: bool = False  # that work is declared, and the next replays shall show whether it helped

    @property
    def active(self) -> bool:
        """Whether the alert is raised and not cleared."""
        return self.cleared_at_unix_s is None

    @property
    def key(self) -> tuple[int | None, str]:
        """Joint and condition. There is at most one alert with a key."""
        return self.joint, self.condition

    @property
    def gravest_so_far(self) -> Gravest:
        """The gravest moment; of an alert that has none, what it says now."""
        if self.gravest is not None:
            return self.gravest
        return Gravest(self.updated_at_unix_s, self.tier, self.change, self.probability, self.text, self.attribution, self.lowest_at_unix_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """The arm, its joints, and the last alert of every joint and condition, cleared alerts included.

    Before the first assessment there are no joints and no state, and at most alerts that the service has raised about itself.
    """

    state: str = NORMAL
    why: Reason = NOTHING_KNOWN
    since_unix_s: float = 0.0
    joints: tuple[JointHealth, ...]
    alerts: tuple[Alert, ...] = ()
    confirmations: tuple[tuple[str, Confirmations], ...] = ()  # of the arm, by condition

    @property
    def active_alerts(self) -> tuple[Alert, ...]:
        """Active alerts, the oldest first."""
        return tuple(sorted((alert for alert in self.alerts if alert.active), key=lambda alert: alert.raised_at_unix_s))

    def as_document(self) -> dict[str, Any]:
        """The health as a JSON object; `health_from_document` is the exact inverse."""
        document: dict[str, Any] = plain(self)
        return document


class Transition(NamedTuple):
    """One change of an alert."""

    kind: str  # "raised", "updated", "serviced" or "cleared"
    alert: Alert


# --- Health and alerts as JSON objects -------------------------------------------------------------------


def alert_document(alert: Alert) -> dict[str, Any]:
    """One alert as a JSON object, with the key `active` in addition."""
    return {**plain(alert), "active": alert.active}


def alert_from_document(document: Mapping[str, Any]) -> Alert:
    """An Alert from a JSON object that may hold more, for example an event. Raises BadInput naming what is missing or wrong."""
    return typed(Alert, document, where="alert", complete=False)


def health_from_document(document: Any) -> Health:
    """A Health from `Health.as_document()`. Raises BadInput naming what is missing or wrong."""
    return typed(Health, document, where="health")
