"""What the interface answers, as types: the OpenAPI document is made of them, and so are the clients of other programs."""

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model

from monitor.plant.tables import FIGURES, LIFE_FIGURES
from monitor.publish.documents import Time

MOST_AT_ONCE, AT_ONCE = 1000, 100  # rows of a page
SITE, ROBOT = "hall-1", "cell-2"  # of the examples
BEFORE = "next_cursor of the page before"
CURSOR = "next_cursor of the page before; null: there is no further page"


class Problem(BaseModel):
    """Why a request came to nothing (RFC 9457)."""

    type: str = Field(default="about:blank", description="about:blank: title and status say of which kind it is")
    title: str
    status: int
    detail: str = Field(description="one sentence for a person")
    errors: list[str] = Field(default_factory=list, description="each mistake of the request with its place, where there are several")


class Ticket(BaseModel):
    """The maintenance system's ticket of an alert."""

    number: str | None
    url: str | None


class ActiveAlert(BaseModel):
    """An active alert."""

    joint: int | None = Field(description="from 1; null: of the arm")
    condition: str = Field(examples=["wear_rising"])
    tier: str = Field(description="advisory, wear or limit", examples=["wear"])
    raised_at: datetime
    acknowledged_at: datetime | None
    acknowledged_by: str | None
    shelved_until: datetime | None
    pill: str | None = Field(description="how it is shown: NOTICE, CHECK_FUNCTION, OFF_SPEC, MAINTENANCE_REQUIRED or FAILURE")
    person: str = Field(description="waits (for a person), acknowledged or shelved")
    text: str = Field(description="one sentence, in the language that was asked for")
    ticket: Ticket | None


class AlertOfArm(ActiveAlert):
    """An active alert and whose it is."""

    site: str = Field(examples=[SITE])
    robot: str = Field(examples=[ROBOT])


class Alerts(BaseModel):
    """A page of alerts, in the order of site, robot, joint and condition."""

    alerts: list[AlertOfArm]
    next_cursor: str | None = Field(description=CURSOR)


class Arm(BaseModel):
    """One arm, as it was heard last."""

    site: str = Field(examples=[SITE])
    robot: str = Field(examples=[ROBOT])
    grade: str = Field(description="how much it needs somebody: sick, unseen, doubtful or well")
    model: str | None = Field(examples=["ur5e"])
    state: str | None = Field(description="NE 107: NORMAL, CHECK_FUNCTION, OFF_SPEC, MAINTENANCE_REQUIRED or FAILURE; null: none yet")
    pill: str | None
    age: str = Field(description="of which time the state is: now, out_of_date or not_heard")
    why: str
    since: datetime | None
    stale: bool
    silent_since: datetime | None = Field(description="null: its monitor is heard")
    silent_why: str | None
    problem: str | None = Field(description="why its history cannot be copied; null: it can")
    set_aside: str | None = Field(description="which rows of its history cannot be read; null: all can")
    alerts: list[ActiveAlert]
    waiting: int = Field(description="alerts that wait for a person")
    troubles: list[str] = Field(description="of its monitor")
    clock_ahead_s: float | None = Field(description="of its clock before the plant's; null: they agree, or it is not known")
    last_replay: datetime | None
    version: str | None = Field(description="of its monitor")
    histories: int = Field(description="one more after each restoration of its history from a backup")
    same_history: list[str] = Field(description="arms with the same history")
    joints: list[str | None] = Field(description="of each joint, how it is shown")


class Arms(BaseModel):
    """Every arm, the worst first."""

    not_running: str | None = Field(description="why all of this is old; null: the plant runs")
    ways: dict[str, bool] = Field(description="by router: whether it answers")
    version: str = Field(default="", description="of the plant")
    said_at: datetime
    arms: list[Arm]


def _figures(name: str, doc: str, **more: Any) -> type[BaseModel]:
    """A type with the figures of the plant's table `friction`."""
    figures: dict[str, Any] = dict.fromkeys((*FIGURES, *LIFE_FIGURES), (float | None, None))
    made: type[BaseModel] = create_model(name, __doc__=doc, recorded_at=(datetime, ...), replay=(int, ...), **figures, **more)
    return made


Replay = _figures("Replay", "The friction of a joint after one replay; units stand in the names.")


class Joint(BaseModel):
    """One joint at a glance."""

    joint: int = Field(description="from 1, counted from the base")
    pill: str | None = Field(description="how it is shown: NORMAL, NOTICE, CHECK_FUNCTION, OFF_SPEC, MAINTENANCE_REQUIRED or FAILURE")
    why: str
    since: datetime | None
    age: str
    newest: Replay | None = Field(description="its friction after the newest copied replay")  # type: ignore[valid-type]


class Joints(BaseModel):
    """The joints of an arm."""

    joints: list[Joint]


class History(BaseModel):
    """A page of the history of a joint, the oldest replay first."""

    replays: list[Replay]  # type: ignore[valid-type]
    next_cursor: str | None = Field(description=CURSOR)


class Peer(BaseModel):
    """The last figures of the same joint of an arm of the same model."""

    site: str
    robot: str
    this: bool = Field(description="whether it is the arm that was asked for")
    recorded_at: datetime
    wear: float | None
    wear_std: float | None
    wear_rate_per_day: float | None
    reference_torque_nm: float | None


class Peers(BaseModel):
    """One joint among its peers."""

    model: str | None
    joint: int
    peers: list[Peer]


class AuditLine(BaseModel):
    """Who did what, or was refused it."""

    at: datetime
    who: str
    act: str
    robot: str | None = Field(description="site/robot; null: the plant")
    text: str


class Audit(BaseModel):
    """A page of the audit, the newest line first."""

    rows: list[AuditLine]
    next_cursor: str | None = Field(description=CURSOR)


# --- what is asked in the query of an address; a word that is not known is a mistake


class Asked(BaseModel):
    """Of every request."""

    model_config = ConfigDict(extra="forbid")
    lang: Literal["en", "de"] | None = Field(default=None, description="of the sentences; without it, that of Accept-Language")


class PageAsked(Asked):
    """Which page of many rows."""

    limit: int = Field(default=AT_ONCE, ge=1, le=MOST_AT_ONCE)


class AuditAsked(PageAsked):
    """Which lines of the audit."""

    cursor: str | None = Field(default=None, pattern="^[0-9]{1,18}$", description=BEFORE)


class AlertsAsked(PageAsked):
    """Which alerts."""

    cursor: str | None = Field(default=None, pattern="^[a-z0-9_-]{1,100}/[a-z0-9_-]{1,100}/[0-9]/[^/]{0,200}$", description=BEFORE)
    state: Literal["waits", "acknowledged", "shelved"] | None = Field(default=None, description="what a person did", examples=["waits"])
    tier: str | None = Field(default=None, description="advisory, wear or limit", examples=["wear"])
    site: str | None = Field(default=None, examples=[SITE])
    robot: str | None = Field(default=None, examples=[ROBOT])


class HistoryAsked(PageAsked):
    """Which replays."""

    cursor: str | None = Field(default=None, pattern=r"^-?[0-9]{1,12}(\.[0-9]{1,20})?/[0-9]{1,18}$", description=BEFORE)
    since: Time | None = Field(default=None, description="none before this time", examples=["2026-01-01T00:00:00Z"])
    until: Time | None = Field(default=None, description="none from this time on")
