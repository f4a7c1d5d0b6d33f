"""What the gateway speaks of: one transition of an alert, one delivery that is owed. No I/O, no clock."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from monitor.config.notify import PLANT_SILENT
from monitor.plant.arm import ArmName, HeardArm
from monitor.publish.documents import Alert, as_json, read
from monitor.publish.shown import tier_gravity

RAISED, GRAVER, MILDER, CLEARED = "raised", "graver", "milder", "cleared"
ACTIVE = "active"  # its arm says it, and its raising was told to nobody
PLANT = ArmName("plant", "service")  # what a transition of the plant's own service has in an arm's place
ENDED = "none"  # the tier of an alert before it is raised, and after it is cleared


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
    alert: Alert  # as it is after this step
    seq: int = 0  # its number in the arm's log; 0: it stands in none

    @property
    def alert_id(self) -> str:
        """Which alert: the same one from its raising to its clearing."""
        return f"{self.place}/{self.raised_at_unix_s:.3f}"

    @property
    def place(self) -> str:
        """Which condition of which joint; it has one alert at a time."""
        return place(self.arm, self.joint, self.condition)

    @property
    def tier(self) -> str:
        """The graver of the tiers before and after."""
        return max(self.before, self.after, key=tier_gravity)

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


def joint_word(joint: int | None) -> str:
    """A joint in an identifier: `j3`, or `arm`."""
    return "arm" if joint is None else f"j{joint}"


def place(arm: ArmName, joint: int | None, condition: str) -> str:
    """A condition of a joint or of the arm."""
    return f"{arm}/{joint_word(joint)}/{condition}"


def transition_id(arm: ArmName, joint: int | None, condition: str, kind: str, tier: str, at_unix_s: float, seq: int = 0) -> str:
    """A transition's name, which the outbox keeps: the same one where the arm's history is copied anew.

    seq : its number in the arm's log, as a clock may show the same time twice; 0: it stands in none.
    """
    return f"{place(arm, joint, condition)}/{kind}/{tier}/{at_unix_s:.3f}" + (f"/{seq}" if seq else "")


def document_of(transition: Transition) -> dict[str, Any]:
    """What is kept of a transition until it is told, and is posted; `transition_of` reads it back."""
    kept = {each.name: getattr(transition, each.name) for each in fields(Transition) if each.name not in ("arm", "alert")}
    more = {**transition.arm._asdict(), "alert_id": transition.alert_id, "tier": transition.tier, "text": transition.alert.text}
    return {**kept, **more, "event": as_json(transition.alert)}


def transition_of(document: Mapping[str, Any]) -> Transition:
    """The transition of a delivery."""
    kept = {each.name: document[each.name] for each in fields(Transition) if each.name not in ("arm", "alert")}
    return Transition(arm=ArmName(document["site"], document["robot"]), alert=read(Alert, document["event"]), **kept)


def page_of(link: str, told: Transition) -> str:
    """Where the plant's screen, which people reach at `link`, shows an alert; empty where nobody has said how they reach it."""
    if not link:
        return ""
    return f"{link}/" if told.condition == PLANT_SILENT else f"{link}/arms/{told.arm}/"


# --- alerts that an arm says and its log does not: raised before anybody could be told, or of a history that cannot be copied


def active(arm: HeardArm, alert: Alert) -> Transition:
    """The transition by which such an alert is told."""
    raised = alert.raised_at.timestamp()
    return Transition(
        id=transition_id(arm.name, alert.joint, alert.condition, ACTIVE, alert.tier, raised),
        arm=arm.name,
        joint=alert.joint,
        condition=alert.condition,
        before=ENDED,
        after=alert.tier,
        kind=ACTIVE,
        at_unix_s=raised,
        raised_at_unix_s=raised,
        alert=alert,
    )
