"""What a maintenance engineer is told: a state a joint, and alerts that are raised, updated and cleared.

States are those of NAMUR NE 107 as OPC UA spells them. An alert stays until somebody acknowledges it and its condition is
gone; acknowledged and shelved are orthogonal to active (ISA-18.2). `verdict.py` decides, these are the values it decides on.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from monitor.judge.document import plain

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
