"""What a maintenance engineer is told: a state a joint, and alerts that are raised, updated and cleared.

States are those of NAMUR NE 107 as OPC UA spells them. An alert stays until somebody acknowledges it and its condition is
gone; acknowledged and shelved are orthogonal to active (ISA-18.2). `verdict.py` decides, these are the values it decides on.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Interval

from monitor.errors import BadConfiguration, BadInput
from monitor.judge.document import entry, plain
from monitor.recording import Array

NORMAL, CHECK_FUNCTION, OFF_SPEC, MAINTENANCE_REQUIRED, FAILURE = STATES = (
    "NORMAL",
    "CHECK_FUNCTION",  # the data, not the joint, are in doubt
    "OFF_SPEC",  # outside the temperatures that were learnt
    "MAINTENANCE_REQUIRED",
    "FAILURE",  # the configured end of life is reached
)  # in the order of what wins when states are combined
TIERS = ("advisory", "wear", "limit")
STATE_OF_TIER = {"advisory": NORMAL, "wear": MAINTENANCE_REQUIRED, "limit": FAILURE}
WEAR_RISING, SUDDEN_STEP, FRICTION_FALLING, COMMON_MODE = "wear_rising", "sudden_step", "friction_falling", "common_mode"
TEMPERATURE_SENSOR, DATA_QUALITY, OUTSIDE_RANGE = "temperature_sensor", "data_quality", "outside_range"
MOUNTING, PAYLOAD, GAINS = "mounting_contradiction", "payload_contradiction", "gain_contradiction"
RISES = (WEAR_RISING, SUDDEN_STEP)  # of one joint's friction: at most one of them is active
ACTIONS = {
    (WEAR_RISING, "advisory"): "Nothing yet: watch this joint.",
    (WEAR_RISING, "wear"): "Plan an inspection of this joint: lubrication, backlash, noise.",
    (WEAR_RISING, "limit"): "Replace or overhaul this joint: friction has reached the configured limit.",
    (SUDDEN_STEP, "advisory"): "Ask what happened that day: a collision, a service, another load that was not declared.",
    (SUDDEN_STEP, "wear"): "Inspect this joint soon: friction does not jump by itself. Look for a collision, a brake that drags, a seal.",
    (SUDDEN_STEP, "limit"): "Stop using this joint until it is inspected: friction jumped beyond the configured limit.",
    (
        FRICTION_FALLING,
        "advisory",
    ): "Tell the monitor if the joint was greased or replaced; otherwise check its brake, current and temperature.",
    (COMMON_MODE, "advisory"): "Check what all joints share: temperature sensors, supply voltage, payload and mounting as configured.",
    (TEMPERATURE_SENSOR, "advisory"): "Check the temperature reading: without it, or with a wrong one, cold looks like wear.",
    (DATA_QUALITY, "advisory"): "Look at the last recordings: torn rows, lost packets, a trajectory that does not move this joint.",
    (OUTSIDE_RANGE, "advisory"): "Nothing to repair: the monitor has not seen these temperatures yet; replays at them will teach it.",
    (MOUNTING, "advisory"): "Compare [robot] mounting with how the arm stands; nothing is learnt of wear until they agree.",
    (
        PAYLOAD,
        "advisory",
    ): "Compare [robot] payload_kg with what the arm carries in the replay; nothing is learnt of wear until they agree.",
    (
        GAINS,
        "advisory",
    ): "Was a drive replaced or recalibrated? Then declare it (another tool, serial or gains); nothing is learnt of wear until then.",
}
SEVERITY = {"advisory": "low", "wear": "medium", "limit": "high"}


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthSettings:
    """When to speak. Rises are fractions of the friction torque at the beginning."""

    advisory_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.01
    wear_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.05
    limit_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.30
    false_alarms_per_year: Annotated[float, Interval(ge=1e-4, le=10.0)] = (
        0.05  # advisories of a healthy arm: how much evidence they ask for
    )
    wear_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95
    limit_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95
    min_replays: Annotated[int, Interval(ge=1, le=100)] = 3
    min_days: Annotated[int, Interval(ge=1, le=100)] = 2
    clear_fraction: Annotated[float, Interval(gt=0.0, lt=1.0)] = (
        0.6  # of a tier's rise: lower than the raising level, so that an alert does not flap
    )
    update_step: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.02  # an active alert is told again when its change has moved by so much
    common_share: Annotated[float, Interval(ge=1e-6, le=1.0)] = 2.0 / 3.0  # of the joints rising together …
    common_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.9  # … each with this probability, are no wear
    stale_days: Annotated[float, Interval(ge=0.01, le=3650.0)] = 7.0  # without a replay that taught something for so long, a joint is STALE
    contradiction_sigma: Annotated[float, Interval(ge=2.0, le=100.0)] = (
        8.0  # masses that differ by so much from those before contradict them …
    )
    contradiction_kg: Annotated[float, Interval(ge=0.01, le=100.0)] = 0.5  # … a payload by at least so much
    learning_replays: Annotated[int, Interval(ge=0, le=1000)] = 10  # until then a new temperature is learning, not OFF_SPEC

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the figure that is out of order."""
        if not 0 < self.advisory_rise < self.wear_rise < self.limit_rise:
            raise BadConfiguration("health: expected 0 < advisory_rise < wear_rise < limit_rise")
        for name in ("wear_sure", "limit_sure", "common_sure"):
            if not 0.5 <= getattr(self, name) < 1:
                raise BadConfiguration(f"health.{name} = {getattr(self, name)!r}; expected a probability from 0.5 to below 1")
        if not 0 < self.clear_fraction < 1:
            raise BadConfiguration(f"health.clear_fraction = {self.clear_fraction!r}; expected a fraction between 0 and 1")
        if self.min_replays < 1 or self.min_days < 1:
            raise BadConfiguration("health.min_replays and min_days: expected 1 or more")

    @property
    def rises(self) -> Array:
        """(3,) of the tiers."""
        return np.array([self.advisory_rise, self.wear_rise, self.limit_rise])


class Confirmations(NamedTuple):
    """Replays in a row that agree, and on how many UTC days."""

    replays: int = 0
    days: int = 0
    last_day: int = -1


NO_CONFIRMATIONS = (Confirmations(),) * len(TIERS)


class Attribution(NamedTuple):
    """What a change of friction torque is made of, each as a logarithm: they add up to the whole."""

    whole: float  # from the mean of the first replays to the last one, nothing taken out
    temperature: float
    payload: float  # what another context made of it
    wear: float
    rest: float  # of this replay: noise


@dataclass(frozen=True, slots=True, kw_only=True)
class JointHealth:
    """One joint's state, why and since when, and the evidence gathered so far."""

    joint: int  # 1…J
    state: str = NORMAL
    why: str = "nothing is known yet"
    since_unix_s: float = 0.0
    rising: tuple[Confirmations, ...] = NO_CONFIRMATIONS  # one a tier
    falling: Confirmations = NO_CONFIRMATIONS[0]
    troubled: tuple[tuple[str, Confirmations], ...] = ()  # what else was seen, by condition
    told_unix_s: float | None = None  # of the last replay that taught something of it


@dataclass(frozen=True, slots=True, kw_only=True)
class Alert:
    """One condition of one joint, or of the arm, through its life."""

    joint: int | None  # 1…J; None is the arm
    condition: str
    tier: str
    raised_at_unix_s: float
    updated_at_unix_s: float
    cleared_at_unix_s: float | None = None
    change: float  # fraction of friction torque
    probability: float  # that the change exceeds the tier's rise
    text: str
    action: str
    severity: str = "low"
    split: Attribution | None = None
    acknowledged_at_unix_s: float | None = None
    acknowledged_by: str | None = None
    acknowledged_why: str | None = None
    shelved_until_unix_s: float | None = None
    shelved_by: str | None = None
    shelved_why: str | None = None

    @property
    def active(self) -> bool:
        """Raised and not cleared."""
        return self.cleared_at_unix_s is None

    @property
    def key(self) -> tuple[int | None, str]:
        """What there is at most one alert of."""
        return self.joint, self.condition


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """The arm and its joints, and the last alert of every condition, cleared ones included."""

    state: str = NORMAL
    why: str = "nothing is known yet"
    since_unix_s: float = 0.0
    joints: tuple[JointHealth, ...]
    alerts: tuple[Alert, ...] = ()
    common: Confirmations = field(default_factory=Confirmations)
    troubled: tuple[tuple[str, Confirmations], ...] = ()  # of the arm

    @property
    def active_alerts(self) -> tuple[Alert, ...]:
        """Raised and not cleared, the oldest first."""
        return tuple(sorted((alert for alert in self.alerts if alert.active), key=lambda alert: alert.raised_at_unix_s))

    def as_document(self) -> dict[str, Any]:
        """Plain JSON; `health_from_document` is its exact inverse."""
        document: dict[str, Any] = plain(self)
        return document


class Transition(NamedTuple):
    """What happened to an alert: "raised", "updated" or "cleared"."""

    kind: str
    alert: Alert


def acknowledge(health: Health, joint: int | None, condition: str, *, by: str, why: str, at_unix_s: float) -> Health:
    """The same health with one active alert acknowledged; it clears by itself once its condition is gone.

    Raises BadInput where there is no such active alert, or nobody says who acknowledges.
    """
    alert = _active(health, joint, condition, by)
    done = replace(alert, acknowledged_at_unix_s=at_unix_s, acknowledged_by=by, acknowledged_why=why)
    return replace(health, alerts=tuple(done if other is alert else other for other in health.alerts))


def shelve(health: Health, joint: int | None, condition: str, *, by: str, why: str, until_unix_s: float, at_unix_s: float) -> Health:
    """The same health with one active alert shelved: it stays active, and need not be shown until then.

    Raises BadInput where there is no such active alert, nobody says who shelves, or the end lies in the past.
    """
    alert = _active(health, joint, condition, by)
    if not until_unix_s > at_unix_s:
        raise BadInput("shelve: the end lies in the past; expected a time to come")
    done = replace(alert, shelved_until_unix_s=until_unix_s, shelved_by=by, shelved_why=why)
    return replace(health, alerts=tuple(done if other is alert else other for other in health.alerts))


def alert_document(alert: Alert) -> dict[str, Any]:
    """One alert, with `active` said outright."""
    return {**plain(alert), "active": alert.active}


def health_from_document(document: Any) -> Health:
    """A Health from `Health.as_document()`. Raises BadInput naming what is missing or wrong."""
    try:
        joints = tuple(
            JointHealth(
                **{
                    **o,
                    "rising": tuple(Confirmations(**e) for e in o["rising"]),
                    "falling": Confirmations(**o["falling"]),
                    "troubled": _troubled(o),
                }
            )
            for o in entry(document, "joints", where="health")
        )
        alerts = tuple(
            Alert(**{**o, "split": Attribution(**o["split"]) if o.get("split") else None})
            for o in entry(document, "alerts", where="health")
        )
        plainly = {f.name for f in fields(Health)} - {"joints", "alerts", "common", "troubled"}
        rest = {name: entry(document, name, where="health") for name in plainly}
        common = Confirmations(**entry(document, "common", where="health"))
        return Health(joints=joints, alerts=alerts, common=common, troubled=_troubled(document), **rest)
    except (TypeError, KeyError, ValueError) as wrong:
        raise BadInput(f"health: {wrong}") from None


def _active(health: Health, joint: int | None, condition: str, by: str) -> Alert:
    """The one active alert of that name. Raises BadInput."""
    if not by.strip():
        raise BadInput("by: expected the name of the person who acts")
    for alert in health.alerts:
        if alert.active and alert.key == (joint, condition):
            return alert
    active = ", ".join(f"{alert.joint or 'arm'}/{alert.condition}" for alert in health.alerts if alert.active) or "none"
    raise BadInput(f"no active alert {joint or 'arm'}/{condition}; active: {active}")


def _troubled(document: dict[str, Any]) -> tuple[tuple[str, Confirmations], ...]:
    return tuple((str(condition), Confirmations(**evidence)) for condition, evidence in document.get("troubled", ()))
