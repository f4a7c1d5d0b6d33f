"""One small plant a test."""

import pytest
from small_plant import SmallPlant


@pytest.fixture
def plant(tmp_path):
    made = SmallPlant(tmp_path / "plant.sqlite")
    yield made
    made.close()
