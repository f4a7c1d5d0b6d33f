"""What `joint-monitor gateway` owes: how far it has taken each arm's transitions, and its deliveries."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

Document = sa.JSON().with_variant(postgresql.JSONB(), "postgresql")
Counter = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
At = sa.Float().with_variant(sa.DateTime(timezone=True), "postgresql")


def upgrade() -> None:
    """Make the two tables."""
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
