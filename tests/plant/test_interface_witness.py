"""Somebody else's judgement of the plant's interface: schemathesis holds the running server against its own OpenAPI document."""

import subprocess
import sys
from pathlib import Path

import pytest
import sqlalchemy as sa
from plant_screen import NOW, PlantOfATest

from monitor.plant.tables import friction

ROLES = ("configure", "acknowledge@hall-1")
OPERATIONS = 15  # all but the stream, which never ends


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    with PlantOfATest(tmp_path_factory.mktemp("plant"), roles=ROLES) as made:
        row = {"arm": 2, "history": 1, "joint": 3, "wear": 0.05, "wear_std": 0.01, "reference_torque_nm": 12.0}
        with made.database.write() as connection:
            connection.execute(sa.insert(friction), [{**row, "recorded_at": NOW + 3600.0 * k, "replay": k + 1} for k in range(5)])
        yield made


@pytest.mark.slow
@pytest.mark.timeout(500)
@pytest.mark.parametrize(
    ("role", "examples"),
    [
        ("configure", 5),
        pytest.param("configure", 200, marks=pytest.mark.soak),
        pytest.param("acknowledge@hall-1", 50, marks=pytest.mark.soak),
    ],
)
def test_schemathesis_finds_nothing(plant, role, examples, tmp_path, monkeypatch):
    """Every operation: what the document shows as an example, each bound of it from both sides, and what chance makes of it."""
    monkeypatch.setattr("monitor.plant.screen.interface.WRONG_TOKEN_DELAY_S", 0.0)
    program, document = Path(sys.executable).with_name("st"), f"{plant.url}api/openapi.json"
    options = ["--header", f"Authorization: Bearer {plant.tokens[role]}", "--exclude-operation-id", "streamEvents", "--seed", "1"]
    phases = ["--phases", "examples,coverage,fuzzing", "--max-examples", str(examples), "--generation-database", "none"]
    said = subprocess.run(
        [program, "run", document, *options, *phases, "--no-color"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert said.returncode == 0, said.stdout[-5000:] + said.stderr
    assert f"Tested: {OPERATIONS}" in said.stdout
