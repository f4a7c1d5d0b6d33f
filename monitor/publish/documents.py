"""Documents: what is published and answered on the bus, as types. Their JSON Schemas are printed by `joint-monitor schema KIND`.

Every kind is `joint-monitor.<kind>.v1`. Within v1 fields are only added: readers ignore what they do not know, and find what v1 had
from the beginning. Times are UTC, RFC 3339; units stand in the names; null means unknown.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import orjson
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat, ValidationError

from monitor.errors import BadInput
from monitor.judge.alerts.health import State
from monitor.judge.document import plain
from monitor.publish.timestamps import outside
from monitor.reason import FREE, Reason, Sentence, reason_from, reason_of, together

Content = TypeVar("Content", bound=BaseModel)
ROUNDING = 1e-9  # by which a sum of weights may leave its bounds


def _rounded(value: object) -> object:
    """A fraction without the rounding of its sum, e.g. 1.0000000000000002."""
    return min(max(value, 0.0), 1.0) if isinstance(value, float) and -ROUNDING <= value <= 1.0 + ROUNDING else value


Fraction = Annotated[float, BeforeValidator(_rounded), Field(ge=0.0, le=1.0)]
Joint = Annotated[int, Field(ge=1, le=8, description="counted from the base, from 1")]
Number = FiniteFloat
Maybe = FiniteFloat | None
Rows = list[Number] | list[list[Number]]


def _in_utc(at: datetime) -> datetime:
    """The time in UTC. Raises ValueError where it names no offset, or lies outside of the years 1 to 9999 there."""
    if at.tzinfo is None:
        raise ValueError("expected a time with its offset, e.g. 2026-01-31T03:00:00Z")
    try:
        return datetime.fromtimestamp(round(at.timestamp(), 6), UTC)
    except OverflowError:
        raise ValueError("its date in UTC is none") from None


def _no_number(at: object) -> object:
    """As it is. Raises ValueError for a number, also one in a text, which pydantic would take for seconds since 1970."""
    if isinstance(at, datetime) or (isinstance(at, str) and "-" in at[1:]):
        return at
    raise ValueError("expected a time, e.g. 2026-01-31T03:00:00Z")


Time = Annotated[datetime, BeforeValidator(_no_number), AfterValidator(_in_utc)]


class Document(BaseModel):
    """What is published: unknown fields come from a newer monitor, and are kept."""

    model_config = ConfigDict(extra="allow", frozen=True, defer_build=True)  # a daemon never needs most of them


class Code(Document):
    """A reason without its text: what it is, and its parameters."""

    code: str
    parameters: dict[str, Any] = Field(default_factory=dict)


class Said(Code):
    """A reason: code, parameters, and the English text for whoever knows no codes."""

    text: str

    @property
    def reason(self) -> Reason:
        """The reason as a value."""
        return reason_from({"code": self.code, "parameters": self.parameters, "text": self.text})


class Worded(Document):
    """A document with English texts under keys of their own."""

    reasons: dict[str, Code] = Field(default_factory=dict, description="of these texts, by their key: codes with parameters")

    def says(self, name: str) -> Reason | None:
        """The reason of the text under this key; a text without a code is one of its own; None where there is no text."""
        text, coded = getattr(self, name), self.reasons.get(name)
        if not text or coded is None:
            return reason_of(text) if text else None
        return reason_from({"code": coded.code, "parameters": coded.parameters, "text": text})


def said(reason: Reason) -> Said:
    """A reason as a document."""
    return Said.model_validate(reason.document())


def worded(**texts: str | Reason | None) -> dict[str, Any]:
    """The fields of a `Worded` document: each text under its key in English, and the codes of those that have one."""
    codes = {name: _code(each) for name, each in texts.items() if isinstance(each, Reason) and each.code != FREE}
    return {**{name: None if each is None else str(each) for name, each in texts.items()}, "reasons": codes}


def _code(reason: Reason) -> Code:
    document = reason.document()
    return Code(code=document["code"], parameters=document["parameters"])


def made(model: type[Content], value: object, **more: object) -> Content:
    """The document of a value of the judge or the history: its fields by their names, times as UTC. Raises ValueError where it is none."""
    fields = outside(plain(value))
    assert isinstance(fields, dict)
    return model.model_validate({**fields, **more})


def read(model: type[Content], document: object) -> Content:
    """The document that came from elsewhere. Raises BadInput that names its first mistake with its place."""
    try:
        return model.model_validate(document)
    except ValidationError as error:
        mistake = error.errors(include_url=False, include_input=False, include_context=False)[0]
        place = ".".join(map(str, mistake["loc"]))
        raise BadInput(f"{place}: {mistake['msg']}" if place else mistake["msg"]) from None


def readable(model: type[Content], documents: Sequence[object]) -> tuple[list[Content], list[tuple[object, str]]]:
    """Those of the documents that are one, and the others, each with what is wrong with it."""
    found: list[Content] = []
    refused: list[tuple[object, str]] = []
    for each in documents:
        try:
            found.append(read(model, each))
        except BadInput as error:
            refused.append((each, str(error)))
    return found, refused


def encoded(document: Document) -> bytes:
    """A document as JSON: arrays as lists, times as RFC 3339, null for a figure that is not finite."""
    return orjson.dumps(document, default=_fields, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_UTC_Z | orjson.OPT_OMIT_MICROSECONDS)


def as_json(document: Document) -> dict[str, Any]:
    """A document as the JSON object that travels."""
    found: dict[str, Any] = orjson.loads(encoded(document))
    return found


def worded_json(**texts: str | Reason | None) -> dict[str, Any]:
    """`worded` as JSON, for a command's document."""
    return as_json(Worded.model_validate(worded(**texts)))


def _fields(value: object) -> dict[str, Any] | list[Any]:
    if isinstance(value, np.ndarray):  # one whose rows do not lie one after another
        rows: list[Any] = value.tolist()
        return rows
    if not isinstance(value, BaseModel):
        raise TypeError(f"{type(value).__name__} is no part of a document")
    return {**value.__dict__, **(value.__pydantic_extra__ or {})}


class PriorTaken(Worded):
    """Which prior of the plant the joints of an arm began with, or why with none (`[drift] prior = "plant"`)."""

    state: Literal["waits", "taken", "no_answer", "refused", "too_late"] = Field(
        description="waits: for the first replay; no_answer, refused: another one is taken only before the first verdict"
    )
    text: str
    at: Time | None = Field(default=None, description="when the plant was asked last")
    model: str | None = None
    arms: int | None = Field(default=None, description="of the model, that it was learnt from")
    site: str | None = Field(default=None, description="whose arms they are; null: those of the whole plant")
    digest: str | None = Field(default=None, description="of the plant's document, SHA-256, 16 hexadecimal digits")
    made_at: Time | None = None
    software: str | None = Field(default=None, description="that made it")


class Info(Document):
    """Who watches which arm, and since when."""

    robot: dict[str, Any] = Field(description="the section [robot] of its configuration")
    version: str
    host: str
    trajectory_digest: str
    started_at: Time = Field(description="of the monitor")
    boot_id: str | None = Field(default=None, description="another one after every boot of the host")
    configuration_digest: str | None = Field(default=None, description="of every setting in force")
    serial: str | None = Field(default=None, description="as the controller said it with the last replay, else as configured")
    firmware: str | None = None
    mounting: str | None = None
    versions: dict[str, str] = Field(default_factory=dict, description="of Python and of the packages that matter")
    prior: PriorTaken | None = Field(default=None, description="null: the configuration asks the plant for none")


class JointState(Worded):
    """One joint at a glance."""

    joint: Joint
    state: State
    why: str
    since: Time
    stale: bool = Field(default=False, description="nothing was learnt of it for health.stale_days: the state is of then, not of now")
    learnt_at: Time | None = Field(default=None, description="of the last replay that taught something of it")


class Attribution(Document):
    """What a change of friction torque is made of, each as a logarithm: they add up to the whole."""

    whole: Number = Field(description="from the mean of the first replays to the last one, nothing taken out")
    temperature: Number
    payload: Number = Field(description="what another context made of it")
    wear: Number
    rest: Number = Field(description="of this replay: noise")


class Gravest(Worded):
    """What an alert said at its gravest moment: of the highest tier, and of that the largest change."""

    at: Time
    tier: str
    change: Number
    probability: Number
    text: str
    attribution: Attribution | None = None
    lowest_at: Time | None = None


class Acknowledgement(Document):
    """One person's acknowledgement of an alert, and who took it back."""

    at: Time
    by: str
    why: str
    undone_at: Time | None = None
    undone_by: str | None = None
    undone_why: str | None = None


class Alert(Worded):
    """One condition of one joint or of the arm, through its life: raised, updated, cleared; acknowledged and shelved are orthogonal."""

    joint: Joint | None
    condition: str
    tier: str
    active: bool
    raised_at: Time
    updated_at: Time
    cleared_at: Time | None = None
    change: Number = Field(description="fraction of friction torque")
    probability: Number
    text: str
    action: str
    severity: str = "low"
    attribution: Attribution | None = None
    acknowledged_at: Time | None = None
    acknowledged_by: str | None = None
    acknowledged_why: str | None = None
    shelved_until: Time | None = None
    shelved_by: str | None = None
    shelved_why: str | None = None
    gravest: Gravest | None = Field(default=None, description="the evidence of its gravest moment, which stays when the alert is cleared")
    acknowledgements: list[Acknowledgement] = Field(default_factory=list, description="everyone's; acknowledged_by is the first in force")
    cleared_why: str | None = None
    lowest_at: Time | None = Field(default=None, description="when friction was lowest, from which a rise counts; null: the beginning")
    from_production: bool = Field(default=False, description="the arm's ordinary work shows it, and no replay has confirmed it yet")
    over_since: Time | None = Field(default=None, description="since when it is over, while nobody has acknowledged it")
    serviced_at: Time | None = Field(default=None, description="of the last work on the joint while the alert was active")
    serviced_kind: str | None = Field(default=None, description="replaced, overhauled, greased, maintenance or joint_serials")
    serviced_by: str | None = None
    serviced_why: str | None = None
    awaiting_proof: bool = Field(default=False, description="work is declared, and the next replays shall show whether it helped")

    @property
    def where(self) -> str:
        """Its place in the key: j1, j2, … or arm."""
        return "arm" if self.joint is None else f"j{self.joint}"


class ProductionEvidence(Document):
    """What normal work, listened to since the last replay, says of one joint: it may pull a replay forward, and raises no alert."""

    joint: Joint
    change: Number = Field(description="fraction of friction beyond what is usual in this work")
    std: Number
    observations: int = Field(description="spans of motion that it is the mean of")
    probability: Fraction = Field(description="that friction has risen at all")


class Ripple(Document):
    """Gear ripple of one joint's current, a figure for each number of cycles a turn."""

    cycles_per_turn: list[int] = Field(description="of the joint: once, twice and four times a turn of its motor")
    amplitude_a: list[Maybe] = Field(description="of the last replay, from its unfiltered current; null: not seen")
    std_a: list[Maybe]
    track_a: list[Maybe] = Field(description="over all replays of this context")
    track_std_a: list[Maybe]
    first_a: list[Maybe] = Field(description="mean of the first replays of this context")
    replays: list[int] = Field(description="of this context that have shown it")


class JointRipple(Ripple):
    """Gear ripple, and of which joint."""

    joint: Joint


class Health(Worded):
    """NE 107 states of arm and joints; `state` is null until a replay has been assessed."""

    state: State | None
    why: str | None = None
    since: Time | None = None
    joints: list[JointState]
    alerts: list[Alert]
    next_replay_due: Time | None
    said_at: Time
    stale: bool = Field(default=False, description="of the arm: of any of its joints")
    stale_why: str | None = Field(default=None, description="of which joints nothing was learnt, and for how long")
    nothing_learnt: str | None = Field(default=None, description="for how long no replay was learnt from, and why, where that is too long")
    production: list[ProductionEvidence] = Field(default_factory=list, description="joints that normal work has told enough of")
    ripple: list[JointRipple] = Field(default_factory=list, description="gear ripple of each joint")


class RemainingLife(Document):
    """Days until friction reaches the limit; null: no trend, or not within foresight."""

    trend_probability: Fraction
    p10_days: Maybe
    p50_days: Maybe
    p90_days: Maybe
    verdict: str
    before_service_probability: Fraction = Field(default=0.0, description="that the limit is met before the next service")
    path: str | None = Field(default=None, description="the likeliest path of friction: slowing, straight or accelerating")
    path_probability: Fraction | None = Field(default=None, description="of that path; null: a straight one is assumed")
    accelerating_probability: Fraction | None = Field(default=None, description="that friction rises faster and faster")
    accelerating_p50_days: Maybe = Field(default=None, description="the median, should it")
    rate_per_day: Maybe = Field(default=None, description="wear rate now, a fraction per usual day, averaged over the paths")
    rate_std_per_day: Maybe = None
    assumption: str | None = Field(default=None, description="what the days assume, in words")


class Friction(Document):
    """One joint after one replay."""

    joint: Joint
    coulomb_nm: Maybe
    coulomb_std_nm: Maybe
    viscous_nm_s_per_rad: Maybe
    viscous_std_nm_s_per_rad: Maybe
    temperature_c: Maybe
    reference_speed_rad_s: Number
    reference_temperature_c: Number
    reference_torque_nm: Maybe
    reference_torque_std_nm: Maybe
    wear: Number = Field(description="fraction of friction torque since the beginning")
    wear_std: Number
    wear_rate_per_day: Number
    wear_rate_std_per_day: Number
    remaining_life: RemainingLife
    revolutions: float | None = Field(default=None, description="counted until this replay; null where nobody counts")
    revolutions_per_day: float | None = Field(default=None, description="usual")
    remaining_revolutions: list[Maybe] = Field(default=[None, None, None], description="P10, P50, P90 of remaining life, in use")
    replay_torque_nm: Maybe = Field(default=None, description="at reference speed and temperature, of this replay alone")
    replay_torque_std_nm: Maybe = Field(default=None, description="what one replay differs from the next included")
    unseen_step: Maybe = Field(
        default=None, description="fraction; a larger step of friction, unseen_step_days ago, would have been detected in nine of ten"
    )
    unseen_step_days: Maybe = Field(default=None, description="null with unseen_step: nothing is known of so short a time yet")
    ripple: Ripple | None = Field(default=None, description="of the gear; null: not seen, or of an earlier release")


class Event(Alert):
    """One transition of an alert, numbered without gaps."""

    seq: Annotated[int, Field(ge=1)]
    at: Time
    kind: str = Field(description="raised, updated, cleared, acknowledged, unacknowledged, shelved, unshelved or serviced")
    by: str | None = Field(default=None, description="the person of this transition; null: a replay or the monitor itself")
    why: str | None = None


UNREADABLE = Sentence(
    "alert_unreadable", "A part of what its arm says of this alert cannot be read ({why}), and stands here as 0 or as nothing."
)
AnAlert = TypeVar("AnAlert", bound=Alert)


def mended(model: type[AnAlert], document: object) -> tuple[AnAlert, str | None]:
    """An alert or a transition, and what was wrong with its document: a person is told all the same.

    Raises BadInput where it does not say which joint, condition, tier and time.
    """
    try:
        return read(model, document), None
    except BadInput as error:
        if not isinstance(document, Mapping):
            raise
        why = str(error)
    at = document.get("at", document.get("raised_at"))
    nothing = {"change": 0.0, "probability": 0.0, "text": "", "action": "", "active": document.get("kind") != "cleared"}
    nothing |= {"raised_at": at, "updated_at": at}
    core = {name for name, field in model.model_fields.items() if field.is_required()} - nothing.keys()
    kept = {name: document.get(name) for name in core} | nothing
    if readable(model, [kept])[1]:
        raise BadInput(why)
    for name in document.keys() - core:
        with suppress(BadInput):
            read(model, kept | {name: document[name]})
            kept[name] = document[name]
    found = read(model, kept)
    more = worded(text=together(found.says("text"), UNREADABLE(why=why)))
    return found.model_copy(update={**more, "reasons": {**found.reasons, **more["reasons"]}}), why


def mended_alerts(listed: object) -> list[Alert]:
    """The alerts of a list; those of which nobody can be told are left out."""
    found = []
    for each in listed if isinstance(listed, list) else []:
        with suppress(BadInput):
            found.append(mended(Alert, each)[0])
    return found


class Events(Document):
    """Answer to a query on `event`: the transitions after `after`, oldest first; without `limit` the newest 100 at most.

    With `limit` they are the oldest ones, and `next` is the parameter `after` of the next page: so nothing is skipped.
    """

    events: list[Event]
    first_kept: int | None = Field(description="the oldest transition in the history; null where there is none")
    last: int | None = Field(description="the newest one")
    next: int | None = Field(default=None, description="the parameter `after` of the next page; null at the end, and without `limit`")
    history_id: str | None = Field(default=None, description="another one means another history, whose numbers mean something else")


class Model(Document):
    """The temperature-compensated model, complete: torque = Y·values + s(q̇)·fc(T) + q̇·fv(T) + what is `residual_friction`.

    Older ones lack what may be null: friction is then fc and fv alone, and `residual_rms_nm` stands for both doubts.
    """

    robot: str
    mounting: dict[str, Number]
    revision: int
    at: Time
    columns: list[int]
    values: list[Number]
    coulomb: dict[str, Any]
    viscous: dict[str, Any]
    friction_correlation: list[Number]
    wear: list[Number]
    wear_std: list[Number]
    residual_rms_nm: list[Maybe]
    residual_friction: dict[str, Any] | None = Field(
        default=None, description="friction beyond fc and fv: of s, q̇, |τ|·s, |q̇|^½·s at temperature_c, in proportion to fv(T)"
    )
    error_rms_nm: list[Maybe] | None = Field(default=None, description="of the torque itself, as replays foreseen have shown it")
    measured_rms_nm: list[Maybe] | None = Field(default=None, description="of single unfiltered samples from it, likewise")


class FrictionAt(Document):
    """Friction of one joint at one temperature, present wear included: it opposes the motion with coulomb·s(q̇) + viscous·q̇."""

    temperature_c: Number
    coulomb_nm: Maybe = Field(description="null: never resolved")
    coulomb_std_nm: Maybe
    viscous_nm_s_per_rad: Maybe
    viscous_std_nm_s_per_rad: Maybe
    extrapolated: bool = Field(description="outside the temperatures seen so far: missing")
    replays: int | None = Field(default=None, description="that were learnt from within 2.5 K of this temperature")


class JointWear(Document):
    """What is the same of a joint at all temperatures."""

    joint: Joint
    wear: Number = Field(description="fraction of friction torque since the beginning; the terms contain it")
    wear_std: Number
    friction_correlation: Maybe = Field(description="of the errors of fc and fv")


class JointFrictionAt(JointWear, FrictionAt):
    """Friction of one joint at its own temperature."""


class JointCompensation(JointWear):
    """Friction of one joint over 0 to 50 °C."""

    by_temperature: list[FrictionAt] = Field(
        description="every 5 K, the coldest first: a controller interpolates at its joint's temperature"
    )


class Compensation(Document):
    """Friction of every joint by its temperature, as a torque controller adds it, and which temperatures are known."""

    robot: str
    at: Time = Field(description="of the last replay")
    model_revision: int
    joints: list[JointCompensation]


class Torque(Document):
    """Answer to `torque`: joint torque at temperature, its parts and standard deviations, in the shape of the question."""

    torque_nm: Rows
    rigid_nm: Rows
    friction_nm: Rows
    std_nm: list[Maybe] | list[list[Maybe]] = Field(description="of the torque itself")
    measured_std_nm: list[Maybe] | list[list[Maybe]] | None = Field(default=None, description="of one unfiltered measurement of it")
    extrapolated: list[bool] | list[list[bool]]
    temperature_c: Rows
    model_revision: int


class TorqueLive(Document):
    """One sample of the arm's present motion; may be dropped."""

    at: Time
    q_rad: list[Number]
    qd_rad_s: list[Number]
    temperature_c: list[Maybe]
    predicted_nm: list[Number]
    std_nm: list[Maybe] = Field(description="of the residual: model and measurement")
    torque_std_nm: list[Maybe] | None = Field(default=None, description="of the torque itself")
    measured_nm: list[Number] | None
    residual_nm: list[Number] | None
    extrapolated: list[bool]
    model_revision: int


class HistoryRow(Friction):
    """One joint after one past replay."""

    replay: int
    recorded_at: Time


class HistoryChange(Document):
    """One replay's rows were written, or taken back."""

    seq: Annotated[int, Field(ge=1, description="numbered in the order in which that was done, never given out twice")]
    replay: int
    at: Time = Field(description="by the clock of the monitor's host")
    rows: list[HistoryRow] = Field(description="of the replay, as they are now; empty: they were taken back")
    set_aside: list[Said] = Field(default_factory=list, description="which rows of the replay are none, and why")


ROW_ASIDE = Sentence("row_set_aside", "joint {joint} of replay {replay}: {why}")


def rows_of(documents: Sequence[object]) -> tuple[list[HistoryRow], list[Said]]:
    """The rows that are one, and the names of the others with what is wrong with each."""
    rows, refused = readable(HistoryRow, documents)
    return rows, [said(ROW_ASIDE(joint=_of(each, "joint"), replay=_of(each, "replay"), why=why)) for each, why in refused]


def _of(document: object, name: str) -> str:
    return str(document.get(name, "?")) if isinstance(document, Mapping) else "?"


class StoredRow(Document):
    """One row of the tables that a verdict follows from, as the history holds it."""

    seq: Annotated[int, Field(ge=1, description="of its last change, never given out twice")]
    table: str
    row: str = Field(description="by which the table knows it")
    content: str | None = Field(description="its columns as JSON, compressed by zlib, in base64; null: it was taken away")


class History(Document):
    """Answer to `history`: rows, oldest first; `next` is the parameter `after` of the next page, null at the end.

    With the parameter `changed_after` it holds no rows but `changes`, with `stored_after` no rows but `stored`; `next` is then this
    parameter of the next page.
    """

    rows: list[HistoryRow]
    next: int | None
    changes: list[HistoryChange] = Field(default_factory=list, description="oldest first; a replay's rows stand in each of its changes")
    stored: list[StoredRow] = Field(default_factory=list, description="in the order of their last changes")
    set_aside: list[Said] = Field(default_factory=list, description="which rows of the page are none, and why")
    history_id: str | None = Field(default=None, description="another one means another history, whose numbers mean something else")


class Trouble(Said):
    """Something is wrong with the monitor itself, and since when."""

    name: str = Field(description="disk, clock, clock_behind, store, backup, retention, arm, fault, …")
    since: Time


class Borrowed(Document):
    """A replay whose arm a running program lent."""

    program: str | None = Field(description="as the controller calls it; null: it tells no names")
    due_since: Time
    taken_at: Time
    waited_s: Maybe = Field(description="from the taking of the arm until the program went on; null: it did not")
    given_back: bool


class DueReplay(Said):
    """A replay that waits for the node of the program that lends the arm: for what, and why the arm was not taken at the last node."""

    since: Time
    until: Time = Field(description="without a replay by then its window is skipped")
    kind: str = Field(description="scheduled or requested")
    why: str = Field(description="what opened its window: cron, every, learning, cold start, evidence, missing temperature, asked for")
    tries: int = Field(description="replays begun for it that this machine or the network ended")


class LastReplay(Worded):
    """The newest window of the ledger."""

    replay: int
    window: Time
    state: str
    reason: str | None
    ended_at: Time | None
    borrowed: Borrowed | None = Field(default=None, description="null: no program lent the arm")


class ArmLink(Worded):
    """Whether the arm is heard."""

    heard: bool
    trouble: str | None = None


class Waiting(Document):
    """Documents and queries that wait, and documents dropped since the start."""

    to_send: int
    to_answer: int
    dropped: int


class ArchiveState(Document):
    """How many recordings the archive has, and how many wait for it."""

    address: str
    recordings: int
    waiting: int
    waiting_since: Time | None


class HistoryState(Document):
    """The history on disk, and how far it is: whoever copies it sees without a question whether there is something new."""

    history_bytes: int
    last_backup_at: Time | None
    free_bytes: int | None
    sqlite: str
    history_id: str | None = None
    last_event: int | None = None
    last_change: int | None = None
    archive: ArchiveState | None = None


class Process(Document):
    """Memory, processor time with that of ended children, and threads of the monitor's process."""

    resident_bytes: int | None
    cpu_s: Number
    threads: int
    pid: int
    pid_namespace: str | None


class Reload(Document):
    """The outcome of the last reload of the configuration."""

    at: Time
    done: bool
    text: str
    waiting: list[str] = Field(default_factory=list, description="sections that a restart takes")
    held: list[str] = Field(default_factory=list)


class Monitor(Document):
    """How the monitor itself is: every ten seconds."""

    version: str
    programs: dict[str, Any]
    started_at: Time
    uptime_s: Number
    said_at: Time
    troubles: list[Trouble]
    last_replay: LastReplay | None
    next_replay_due: Time | None
    next_replay_why: str | None
    due: DueReplay | None = Field(default=None, description="the replay that waits for the program's node; null: none does")
    lag_s: Maybe = Field(description="of the last scheduled replay, from the opening of its window")
    arm: ArmLink
    bus: Waiting
    store: HistoryState
    process: Process
    workers: dict[str, Number] = Field(description="seconds since each was last known to be alive")
    reload: Reload | None
    overrides: list[str]
    trial: bool = Field(default=False, description="its clock is not the host's")
    stopped_at: Time | None = Field(default=None, description="it was stopped")


class Maintenance(Worded):
    """Work on one joint, as it was declared, and what the replays after it have shown."""

    joint: Joint
    kind: str = Field(description="replaced, overhauled or greased; maintenance or joint_serials: declared in the configuration")
    at: Time = Field(description="when it was done")
    declared_at: Time
    by: str
    why: str
    outcome: str | None = Field(description="new_joint, new_reference, unchanged or still_worn; null: the next replays will show it")
    change: Maybe = Field(default=None, description="fraction by which friction moved with the work")
    change_std: Maybe = None
    replays: int = Field(default=0, description="learnt from between the work and its outcome")
    days: int = 0
    text: str
    meaning: str | None = Field(default=None, description="what it means from now on, without what was done")
    undone_at: Time | None = None
    undone_by: str | None = None
    undone_why: str | None = None


class JointFromProduction(Worded):
    """One joint, by the newest period of ordinary work."""

    joint: Joint
    known: bool = Field(description="whether work tells its friction to `[production] deviation`")
    share: Maybe = Field(default=None, description="information held beside what is needed; 1 and more: known")
    friction_nm: Maybe = Field(default=None, description="at the reference speed and `temperature_c`")
    deviation_nm: Maybe = Field(default=None, description="one standard deviation against what a replay would find")
    temperature_c: Maybe = None
    learnt_at: Time | None = Field(default=None, description="end of the last period that the judge learned from")
    learnt_from_replays: int = Field(description="observations by replays, since the arm is observed")
    learnt_from_production: int = Field(description="observations by periods of work")
    reason: str = Field(default="", description="why it is not known")


class NextReplay(Worded):
    """From when the next replay is needed."""

    replay: str = Field(description="`[schedule] replay`: always or when_needed")
    needed_from: Time | None = Field(default=None, description="null: now, or in every window")
    why: str


class FromProduction(Document):
    """What came from the arm's ordinary work, and what from replays."""

    period_began_at: Time
    period_ended_at: Time
    observations: int = Field(description="periods of work that were judged")
    seen_s: float = Field(description="seconds of work listened to in the period")
    left_out_s: dict[str, float] = Field(description="seconds of these that did not count, by cause")
    asks: list[int] = Field(description="joints whose wear work alone has found: a replay shall confirm it")
    suspects: list[int] = Field(default=[], description="joints of which work makes wear likely: replays shall tell")
    next_replay: NextReplay
    joints: list[JointFromProduction]


class SafetyStop(Document):
    """A stop that the arm's safety system made by itself."""

    at: Time
    kind: str = Field(description="protective_stop, violation or fault")
    ended_at: Time | None = Field(default=None, description="null: it stands, or nobody heard its end")
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
    last_done: Time | None = Field(default=None, description="null: nobody has recorded it")
    last_by: str | None = None
    last_why: str | None = None
    state: str = Field(description="unrecorded, done, soon or due")
    due: Time | None = Field(default=None, description="by date or by hours, whichever comes first")
    days_left: Maybe = Field(default=None, description="negative: overdue")
    hours_left: Maybe = Field(default=None, description="that the arm may still be on; null: not by hours, or not known")
    stops_since: int = Field(default=0, description="stops of the safety system since it was done")


class Inspection(Document):
    """What an arm has done and borne, as far as the monitor heard it, and which checks are due."""

    said_at: Time
    counted_since: Time | None = Field(description="null: nothing was heard yet")
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


class Replay(Worded):
    """What is going to happen to the arm, or has: for people nearby and for the cell's own programs."""

    state: str = Field(description="announced, then ended")
    said_at: Time
    replay: int | None = None
    robot: str | None = None
    moves_at: Time | None = None
    trajectory_digest: str | None = None
    duration_s: Maybe = None
    time_scale: Maybe = None
    verdict: str | None = Field(default=None, description="assessed, rejected, skipped or aborted")
    reason: str | None = None


class Permit(Document):
    """The question `permit/replay`: may the arm move now?"""

    robot: str
    moves_at: Time
    trajectory_digest: str
    duration_s: Number
    time_scale: Number
    moving: bool = Field(default=False, description="the arm moves already, and goes on only where the answer is still yes")


class PermitAnswer(Document):
    """What the cell's own program answers; anything else is a no."""

    allow: bool
    why: str = "no reason given"


class Answer(Document):
    """Answer to a command: done, and what it made of it; a refusal is an error reply."""

    done: str
    alert: Alert | None = None
    replay: int | None = None
    maintenance: Maintenance | None = None
    inspection: InspectionItem | None = Field(default=None, description="the check, as an item of the document `inspection`")
    alerts: list[Alert] = Field(default_factory=list, description="those that the work changed")
    text: list[str] = Field(default_factory=list, description="what the work means, a sentence each")


class Error(Document):
    """What an error reply says."""

    error: str
