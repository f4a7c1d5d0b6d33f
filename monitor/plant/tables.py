"""The tables of the plant's database, for SQLite and for PostgreSQL. Alembic's steps in `migrations` make them.

A time is a number of seconds since 1970 in Python; `timestamp with time zone` in PostgreSQL, REAL in SQLite.
"""

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Column,
    DateTime,
    Dialect,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    SmallInteger,
    Table,
    Text,
    TypeDecorator,
    UniqueConstraint,
)
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.types import TypeEngine

from monitor.reason import Reason, reason_from

metadata = MetaData()
Document = JSON().with_variant(JSONB(), "postgresql")
Counter = BigInteger().with_variant(Integer(), "sqlite")  # only INTEGER counts by itself there


class At(TypeDecorator[float]):
    """Seconds since 1970."""

    impl = Float
    cache_ok = True

    def load_dialect_impl(self, dialect: Dialect) -> TypeEngine[Any]:
        """The type of the database."""
        return dialect.type_descriptor(DateTime(timezone=True) if dialect.name == "postgresql" else Float())

    def process_bind_param(self, value: float | None, dialect: Dialect) -> Any:
        """To the database."""
        return datetime.fromtimestamp(value, UTC) if value is not None and dialect.name == "postgresql" else value

    def process_result_value(self, value: Any, dialect: Dialect) -> float | None:  # noqa: ARG002 - SQLAlchemy's interface
        """From the database."""
        return value.timestamp() if isinstance(value, datetime) else value


class Said(TypeDecorator[Reason]):
    """A reason, as JSON with its code, parameters and text."""

    impl = JSON
    cache_ok = True

    def load_dialect_impl(self, dialect: Dialect) -> TypeEngine[Any]:
        """The type of the database; no reason is NULL there."""
        return dialect.type_descriptor(JSONB(none_as_null=True) if dialect.name == "postgresql" else JSON(none_as_null=True))

    def process_bind_param(self, value: Reason | None, dialect: Dialect) -> Any:  # noqa: ARG002 - SQLAlchemy's interface
        """To the database."""
        return None if value is None else value.document()

    def process_result_value(self, value: Any, dialect: Dialect) -> Reason | None:  # noqa: ARG002 - SQLAlchemy's interface
        """From the database."""
        return None if value is None else reason_from(value)


arm = Table(
    "arm",
    metadata,
    Column("id", Counter, primary_key=True),
    Column("site", Text, nullable=False),
    Column("robot", Text, nullable=False),
    Column("first_seen", At, nullable=False),
    Column("history", Integer, nullable=False),  # the number of its present history
    Column("silent_since", At),  # none: its monitor is heard
    Column("silent_why", Said),
    Column("problem", Said),  # why its history cannot be copied; none: it can
    UniqueConstraint("site", "robot"),
)

history = Table(  # an arm has another one after each restoration from a backup; what was copied before stays, and is told apart
    "history",
    metadata,
    Column("arm", ForeignKey("arm.id"), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("history_id", Text),  # as the arm says it; none: it has not said it yet
    Column("began_at", At, nullable=False),
    Column("why", Said),  # what was noticed; none: it is the first one
    Column("event_cursor", BigInteger, nullable=False),
    Column("event_mark", Text, nullable=False),
    Column("change_cursor", BigInteger, nullable=False),
    Column("change_mark", Text, nullable=False),
    Column("newest_replay", BigInteger, nullable=False),  # of those copied; a later one cannot be here already
    Column("set_aside", Said),  # how many of its rows cannot be read, and the newest of them; none: all can
    # its newest transition when the plant first asked, 0 of a later history; none: it was not asked yet
    Column("events_before", BigInteger),
    Column("stored_cursor", BigInteger, nullable=False, server_default="0"),  # of the rows in `stored`
)

# the rows that verdicts follow from, as the arm's own history holds them: what was judged, of what, and with which settings
stored = Table(
    "stored",
    metadata,
    Column("arm", BigInteger, primary_key=True, autoincrement=False),
    Column("history", Integer, primary_key=True, autoincrement=False),
    Column("of_table", Text, primary_key=True),
    Column("row", Text, primary_key=True),
    Column("content", LargeBinary, nullable=False),
)

# partitions, a month each, in PostgreSQL; its key holds the time for that reason. The cursor keeps a transition from coming twice
transition = Table(
    "transition",
    metadata,
    Column("arm", BigInteger, primary_key=True, autoincrement=False),
    Column("history", Integer, primary_key=True, autoincrement=False),
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("at", At, primary_key=True),
    Column("joint", SmallInteger),  # none: of the arm
    Column("condition", Text, nullable=False),
    Column("tier", Text, nullable=False),
    Column("kind", Text, nullable=False),
    Column("by", Text),
    Column("document", Document, nullable=False),
)

FIGURES = (  # of the document `friction`, by their published names
    "coulomb_nm",
    "coulomb_std_nm",
    "viscous_nm_s_per_rad",
    "viscous_std_nm_s_per_rad",
    "temperature_c",
    "reference_speed_rad_s",
    "reference_temperature_c",
    "reference_torque_nm",
    "reference_torque_std_nm",
    "wear",
    "wear_std",
    "wear_rate_per_day",
    "wear_rate_std_per_day",
    "revolutions",
    "replay_torque_nm",
    "replay_torque_std_nm",
)
LIFE_FIGURES = ("trend_probability", "p10_days", "p50_days", "p90_days")  # of its remaining_life

friction = Table(
    "friction",
    metadata,
    Column("arm", BigInteger, primary_key=True, autoincrement=False),
    Column("history", Integer, primary_key=True, autoincrement=False),
    Column("joint", SmallInteger, primary_key=True, autoincrement=False),
    Column("recorded_at", At, primary_key=True),
    Column("replay", BigInteger, primary_key=True, autoincrement=False),
    *(Column(name, Float) for name in (*FIGURES, *LIFE_FIGURES)),
)
PARTITIONED = {"transition": "at", "friction": "recorded_at"}  # by which column

last_value = Table(  # health, monitor, info, alert/…: as the arm said it last
    "last_value",
    metadata,
    Column("arm", ForeignKey("arm.id"), primary_key=True),
    Column("key", Text, primary_key=True),
    Column("heard_at", At, nullable=False),
    Column("document", Document, nullable=False),
)

audit = Table(  # what happened to the plant's own data, and who did it; no arm knows it, so backups alone keep it
    "audit",
    metadata,
    Column("id", Counter, primary_key=True),
    Column("at", At, nullable=False),
    Column("who", Text, nullable=False),
    Column("act", Text, nullable=False),
    Column("robot", Text),  # site/robot; none: the plant
    Column("text", Text, nullable=False),
)

note = Table("note", metadata, Column("key", Text, primary_key=True), Column("at", At, nullable=False), Column("document", Document))

# --- of `joint-monitor gateway`, which runs beside the plant

gateway_cursor = Table(  # how far the gateway has taken the transitions of a history
    "gateway_cursor",
    metadata,
    Column("arm", BigInteger, primary_key=True, autoincrement=False),
    Column("history", Integer, primary_key=True, autoincrement=False),
    Column("seq", BigInteger, nullable=False),
)

delivery = Table(  # what the gateway owes to somebody, or has delivered
    "delivery",
    metadata,
    Column("id", Counter, primary_key=True),
    Column("key", Text, nullable=False, unique=True),  # channel, recipient and what it is about: nothing is owed twice
    Column("channel", Text, nullable=False),
    Column("recipient", Text, nullable=False),
    Column("kind", Text, nullable=False),
    Column("robot", Text),  # site/robot; none: of several
    Column("document", Document, nullable=False),
    Column("made_at", At, nullable=False),
    Column("due_at", At, nullable=False),  # not before
    Column("state", Text, nullable=False),  # owed, delivered, dropped (no longer needed), dead (given up, and told)
    Column("message", Text),  # of which message it is a part; the message is the same again after a crash
    Column("attempts", Integer, nullable=False),
    Column("ended_at", At),
    Column("error", Text),  # of the last attempt
    Column("answer", Document),  # what the other side said, e.g. the number of a ticket
    Index("delivery_owed", "channel", "state", "due_at"),
)

FROM_ARMS = (
    gateway_cursor,
    friction,
    transition,
    stored,
    last_value,
    history,
    arm,
)  # what comes back from the arms; in the order in which it may be deleted
EVERY_TABLE = (arm, history, transition, friction, stored, last_value, gateway_cursor, audit, delivery, note)  # in the order of filling
NUMBERED = (arm, audit, delivery)  # tables whose rows the database numbers
