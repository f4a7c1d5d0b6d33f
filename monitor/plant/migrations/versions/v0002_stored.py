"""The rows that verdicts follow from, as each arm's history holds them."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make their table, and how far each history's are copied: from the beginning."""
    op.add_column("history", sa.Column("stored_cursor", sa.BigInteger, nullable=False, server_default="0"))
    op.create_table(
        "stored",
        sa.Column("arm", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("history", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("of_table", sa.Text, primary_key=True),
        sa.Column("row", sa.Text, primary_key=True),
        sa.Column("content", sa.LargeBinary, nullable=False),
    )
