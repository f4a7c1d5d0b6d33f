"""The documents about inspection duties: operating hours, stops of the safety system, and checks with their due dates."""

from datetime import datetime
from typing import Annotated

from pydantic import Field

from monitor.publish.documents import Document, Joint, Maybe, Number, Request, Who, Why


class SafetyStop(Document):
    """A stop that the arm's safety system made by itself."""

    at: datetime
    kind: str = Field(description="protective_stop, violation or fault")
    ended_at: datetime | None = Field(default=None, description="null: it stands, or nobody heard its end")
    joint: Joint | None = Field(default=None, description="where the controller told it")
    code: str | None = Field(default=None, description="of the controller, e.g. C153A2")
    during_replay: bool = False


class JointStops(Document):
    """How many stops the controller blamed on one joint."""

    joint: Joint
    stops: int


class InspectionItem(Document):
    """One check that comes again and again."""

    name: str
    every_days: Maybe = Field(default=None, description="null: not by date")
    every_hours: Maybe = Field(default=None, description="null: not by operating hours")
    after_collision: bool = Field(default=False, description="asked for after a heavy collision as well")
    last_done: datetime | None = Field(default=None, description="null: nobody has recorded it")
    last_by: str | None = None
    last_why: str | None = None
    state: str = Field(description="unrecorded, done, soon or due")
    due: datetime | None = Field(default=None, description="by date or by hours, whichever comes first")
    days_left: Maybe = Field(default=None, description="negative: overdue")
    hours_left: Maybe = Field(default=None, description="that the arm may still be on; null: not by hours, or not known")
    stops_since: int = Field(default=0, description="stops of the safety system since it was done")


class Inspection(Document):
    """What an arm has done and borne, as far as the monitor heard it, and which checks are due."""

    said_at: datetime
    counted_since: datetime | None = Field(description="null: nothing was heard yet")
    heard_h: Number = Field(description="hours in which the arm was heard")
    on_h: Number = Field(description="of these under power")
    moving_h: Number = Field(description="of these in motion")
    operating_h: Number = Field(description="`on_h` and `[inspection] hours_before`")
    on_h_per_day: Number = Field(description="usual, of the last four weeks")
    stops: int = Field(description="by the arm's safety system, since `counted_since`")
    stops_28_days: int
    stops_by_joint: list[JointStops] = Field(description="where the controller told the joint")
    last_stops: list[SafetyStop] = Field(description="the newest first, at most 20")
    plan: str | None = Field(description="where the manufacturer has published the checks; null: the file lists them")
    items: list[InspectionItem]


class InspectedRequest(Request):
    """A check was made."""

    item: Annotated[str, Field(min_length=1, max_length=100)]
    by: Who
    why: Annotated[str, Field(min_length=1, max_length=2000, pattern=r"\S", description="what was found")]
    at: str | None = Field(default=None, description="when it was made, e.g. 2026-01-31; null: now")


class UndoInspectedRequest(Request):
    """The last record of a check was a mistake, and is taken back."""

    item: Annotated[str, Field(min_length=1, max_length=100)]
    by: Who
    why: Why = ""
