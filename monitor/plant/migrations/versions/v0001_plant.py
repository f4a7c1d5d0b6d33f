"""Arms, their histories, their last values, the audit, and what `joint-monitor gateway` owes."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

# a step does not change with `tables`: its types stand here once more
Document = sa.JSON().with_variant(postgresql.JSONB(), "postgresql")
Counter = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
At = sa.Float().with_variant(sa.DateTime(timezone=True), "postgresql")
FIGURES = (
    *("coulomb_nm", "coulomb_std_nm", "viscous_nm_s_per_rad", "viscous_std_nm_s_per_rad", "temperature_c", "reference_speed_rad_s"),
    *("reference_temperature_c", "reference_torque_nm", "reference_torque_std_nm", "wear", "wear_std", "wear_rate_per_day"),
    *("wear_rate_std_per_day", "revolutions", "replay_torque_nm", "replay_torque_std_nm"),
    *("trend_probability", "p10_days", "p50_days", "p90_days"),
)
KEY = "arm, history, joint, recorded_at, replay"
SHOWN = "reference_torque_nm, reference_torque_std_nm, wear, wear_std, temperature_c"  # what the course of a joint shows


def upgrade() -> None:
    """Make the tables; PostgreSQL's large ones in partitions, which the plant makes as months come."""
    op.create_table(
        "arm",
        sa.Column("id", Counter, primary_key=True),
        sa.Column("site", sa.Text, nullable=False),
        sa.Column("robot", sa.Text, nullable=False),
        sa.Column("first_seen", At, nullable=False),
        sa.Column("history", sa.Integer, nullable=False),
        sa.Column("silent_since", At),
        sa.Column("silent_why", Document),
        sa.Column("problem", Document),
        sa.UniqueConstraint("site", "robot"),
    )
    op.create_table(
        "history",
        sa.Column("arm", Counter, sa.ForeignKey("arm.id"), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("history_id", sa.Text),
        sa.Column("began_at", At, nullable=False),
        sa.Column("why", Document),
        sa.Column("event_cursor", sa.BigInteger, nullable=False),
        sa.Column("event_mark", sa.Text, nullable=False),
        sa.Column("change_cursor", sa.BigInteger, nullable=False),
        sa.Column("change_mark", sa.Text, nullable=False),
        sa.Column("newest_replay", sa.BigInteger, nullable=False),
        sa.Column("set_aside", Document),
        sa.Column("events_before", sa.BigInteger),
    )
    op.create_table(
        "transition",
        sa.Column("arm", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("history", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("at", At, primary_key=True),
        sa.Column("joint", sa.SmallInteger),
        sa.Column("condition", sa.Text, nullable=False),
        sa.Column("tier", sa.Text, nullable=False),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("by", sa.Text),
        sa.Column("document", Document, nullable=False),
        postgresql_partition_by="RANGE (at)",
        sqlite_with_rowid=False,
    )
    op.create_table(
        "friction",
        sa.Column("arm", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("history", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("joint", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("recorded_at", At, primary_key=True),
        sa.Column("replay", sa.BigInteger, primary_key=True, autoincrement=False),
        *(sa.Column(name, sa.Float) for name in FIGURES),
        postgresql_partition_by="RANGE (recorded_at)",
        sqlite_with_rowid=False,
    )
    op.create_table(
        "last_value",
        sa.Column("arm", Counter, sa.ForeignKey("arm.id"), primary_key=True),
        sa.Column("key", sa.Text, primary_key=True),
        sa.Column("heard_at", At, nullable=False),
        sa.Column("document", Document, nullable=False),
    )
    op.create_table(
        "audit",
        sa.Column("id", Counter, primary_key=True),
        sa.Column("at", At, nullable=False),
        sa.Column("who", sa.Text, nullable=False),
        sa.Column("act", sa.Text, nullable=False),
        sa.Column("robot", sa.Text),
        sa.Column("text", sa.Text, nullable=False),
    )
    op.create_table(
        "note", sa.Column("key", sa.Text, primary_key=True), sa.Column("at", At, nullable=False), sa.Column("document", Document)
    )
    op.create_table(
        "gateway_cursor",
        sa.Column("arm", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("history", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("seq", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "delivery",
        sa.Column("id", Counter, primary_key=True),
        sa.Column("key", sa.Text, nullable=False, unique=True),
        sa.Column("channel", sa.Text, nullable=False),
        sa.Column("recipient", sa.Text, nullable=False),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("robot", sa.Text),
        sa.Column("document", Document, nullable=False),
        sa.Column("made_at", At, nullable=False),
        sa.Column("due_at", At, nullable=False),
        sa.Column("state", sa.Text, nullable=False),
        sa.Column("message", sa.Text),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("ended_at", At),
        sa.Column("error", sa.Text),
        sa.Column("answer", Document),
    )
    op.create_index("delivery_owed", "delivery", ["channel", "state", "due_at"])
    if op.get_bind().dialect.name == "postgresql":  # for times that no clock of ours should have: nothing is refused
        op.execute("CREATE TABLE transition_other PARTITION OF transition DEFAULT")
        op.execute("CREATE TABLE friction_other PARTITION OF friction DEFAULT")
        # the course of one joint is read from the index alone; its rows lie scattered, one a day between those of all other arms
        op.execute("ALTER TABLE friction DROP CONSTRAINT friction_pkey")
        op.execute(f"ALTER TABLE friction ADD PRIMARY KEY ({KEY}) INCLUDE ({SHOWN})")
