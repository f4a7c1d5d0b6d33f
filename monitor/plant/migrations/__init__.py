"""The steps of the plant's schema, for Alembic; `monitor.plant.database` runs them."""
