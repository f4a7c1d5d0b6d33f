"""What the gateway speaks of: an arm as it was heard last, one transition of an alert, one delivery that is owed. No I/O, no clock."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from monitor.judge.alerts.health import TIERS
from monitor.plant.links import ArmName
from monitor.publish.timestamps import unix_s

RAISED, GRAVER, MILDER, CLEARED = "raised", "graver", "milder", "cleared"
ACTIVE = "active"  # it was raised before anybody could be told
PLANT, PLANT_SILENT = ArmName("plant", "service"), "plant_silent"  # what a transition of the plant's own service has in an arm's place
ENDED = "none"  # the tier of an alert before it is raised, and after it is cleared


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmState:
    """One arm as the plant heard it last. Each document may lack anything: it came from elsewhere."""

    name: ArmName
    number: int  # in the plant's database
    health: Mapping[str, Any] = field(default_factory=dict)
    monitor: Mapping[str, Any] = field(default_factory=dict)
    info: Mapping[str, Any] = field(default_factory=dict)
    joints: Mapping[int, Mapping[str, Any]] = field(
        default_factory=dict
    )  # newest friction of each joint, by the names of the plant's columns
    heard_at_unix_s: Mapping[str, float] = field(default_factory=dict)  # by document: health, monitor, info
    silent_since_unix_s: float | None = None  # None: its monitor is heard
    silent_why: str | None = None
    problem: str | None = None  # why its history cannot be copied; None: it can

    @property
    def alerts(self) -> tuple[Mapping[str, Any], ...]:
        """The active alerts."""
        listed = self.health.get("alerts")
        return tuple(each for each in listed if isinstance(each, Mapping) and each.get("active")) if isinstance(listed, list) else ()

    @property
    def model(self) -> str | None:
        """The arm's model, as it says it."""
        robot = self.info.get("robot")
        model = robot.get("model") if isinstance(robot, Mapping) else None
        return model if isinstance(model, str) else None

    def alert(self, joint: int | None, condition: str) -> Mapping[str, Any] | None:
        """The active alert of this joint (from 1; None: of the arm) and condition; None where there is none."""
        return next((each for each in self.alerts if each.get("joint") == joint and each.get("condition") == condition), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Transition:
    """One step in the life of an alert: raised, graver, milder, cleared, or what a person did (acknowledged, shelved, …)."""

    id: str  # the same one where the arm's history is copied anew
    arm: ArmName
    joint: int | None  # from 1; None: of the arm
    condition: str
    before: str  # tier: advisory, wear or limit; none before it is raised
    after: str  # tier; none after it is cleared
    kind: str  # one of those above, or the arm's own word: updated, acknowledged, unacknowledged, shelved, unshelved, serviced
    at_unix_s: float
    raised_at_unix_s: float
    text: str
    document: Mapping[str, Any]  # the event as the arm said it

    @property
    def alert_id(self) -> str:
        """Which alert: the same one from its raising to its clearing."""
        return f"{self.arm}/{joint_word(self.joint)}/{self.condition}/{self.raised_at_unix_s:.3f}"

    @property
    def tier(self) -> str:
        """The graver of the tiers before and after."""
        return max(self.before, self.after, key=gravity)

    @property
    def changes_tier(self) -> bool:
        """Whether the alert came, went, or became another one: what people are told of."""
        return self.before != self.after


@dataclass(frozen=True, slots=True, kw_only=True)
class Delivery:
    """Something that is owed to a recipient by a channel. The same key is owed once, for ever."""

    key: str  # unique within the channel: recipient and what it is about
    recipient: str
    kind: str  # for the channel
    document: Mapping[str, Any]
    due_at_unix_s: float = 0.0  # not before
    robot: str | None = None  # site/robot


def gravity(tier: str) -> int:
    """Order of the tiers: 0 for none, and one more for each graver tier."""
    return TIERS.index(tier) + 1 if tier in TIERS else 0


def joint_word(joint: int | None) -> str:
    """A joint in an identifier: `j3`, or `arm`."""
    return "arm" if joint is None else f"j{joint}"


def transition_id(arm: ArmName, joint: int | None, condition: str, kind: str, tier: str, at_unix_s: float) -> str:
    """A transition's name, which the outbox keeps: the same one where the arm's history is copied anew."""
    return f"{arm}/{joint_word(joint)}/{condition}/{kind}/{tier}/{at_unix_s:.3f}"


def time_said(value: Any) -> float | None:
    """A time as an arm's document says it, in seconds since 1970; None where it says none."""
    try:
        return unix_s(value) if isinstance(value, str) else None
    except (ValueError, OverflowError):
        return None


def page_of(link: str, site: str, robot: str, condition: str) -> str:
    """Where the plant's screen, which people reach at `link`, shows an alert; empty where nobody has said how they reach it."""
    if not link:
        return ""
    return f"{link}/" if condition == PLANT_SILENT else f"{link}/arms/{site}/{robot}/"


# --- alerts that were active before the gateway first ran: their raising is told to nobody, so they are told once


def already_active(arms: Iterable[ArmState], told: Collection[str], began_unix_s: float, now_unix_s: float) -> list[Transition]:
    """Those that nobody has acknowledged or shelved. told : names of alerts (`alert_id`) that are told. began_unix_s : of the gateway."""
    found = []
    for state in arms:
        for alert in state.alerts:
            raised, tier, joint = time_said(alert.get("raised_at")), str(alert.get("tier")), alert.get("joint")
            if (
                raised is None
                or raised >= began_unix_s
                or not gravity(tier)
                or not _is_joint(joint)
                or _known_to_a_person(alert, now_unix_s)
            ):
                continue
            one = _initial_transition(state, alert, tier, raised)
            if one.alert_id not in told:
                found.append(one)
    return found


def _initial_transition(arm: ArmState, alert: Mapping[str, Any], tier: str, raised_unix_s: float) -> Transition:
    joint, condition = alert.get("joint"), str(alert.get("condition"))
    return Transition(
        id=transition_id(arm.name, joint, condition, ACTIVE, tier, raised_unix_s),
        arm=arm.name,
        joint=joint,
        condition=condition,
        before=ENDED,
        after=tier,
        kind=ACTIVE,
        at_unix_s=raised_unix_s,
        raised_at_unix_s=raised_unix_s,
        text=str(alert.get("text") or ""),
        document={**alert, "kind": ACTIVE},
    )


def _known_to_a_person(alert: Mapping[str, Any], now_unix_s: float) -> bool:
    """Whether a person knows of it: it is acknowledged, or shelved at this time."""
    until = time_said(alert.get("shelved_until"))
    return bool(alert.get("acknowledged_at")) or (until is not None and until > now_unix_s)


def _is_joint(value: Any) -> bool:
    return value is None or (isinstance(value, int) and not isinstance(value, bool))
