"""PostgreSQL: the course of one joint is read from the index alone; its rows lie scattered, one a day between those of all other arms."""

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

KEY = "arm, history, joint, recorded_at, replay"
SHOWN = "reference_torque_nm, reference_torque_std_nm, wear, wear_std, temperature_c"  # what the course of a joint shows


def upgrade() -> None:
    """Put what is shown beside the primary key. SQLite keeps its rows in the order of the key already."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute("ALTER TABLE friction DROP CONSTRAINT friction_pkey")
        op.execute(f"ALTER TABLE friction ADD PRIMARY KEY ({KEY}) INCLUDE ({SHOWN})")
