"""A history is of one model, and refers its friction to one speed: another one is named before anything runs with it."""

from pathlib import Path

import pytest
from command_line import ended
from lived_monitor import identified, live_through

from monitor.config.load import load
from monitor.service.preflight import service_conditions
from monitor.store.store import Store

CONFIG = """
[robot]
model = "{model}"
site = "hall-2"
id = "cell-1"
payload_kg = 1.2
tool = "gripper"
[store]
directory = "history"
[drift]
reference_speed_rad_s = {speed}
"""


@pytest.mark.parametrize(
    ("model", "speed", "why"),
    [
        ("ur5", 0.5, "refers to 0.4 rad/s, drift.reference_speed_rad_s is 0.5"),
        ("ur10", 0.4, "it is of a ur5, robot.model is ur10"),
    ],
)
def test_a_history_of_another_arm_is_named_and_a_start_with_it_is_refused(tmp_path: Path, model, speed, why):
    """`check` says it, and `run` ends as for a wrong configuration: every replay would be rejected, one after the other."""
    config = tmp_path / "cell.toml"
    config.write_text(CONFIG.format(model="ur5", speed=0.4))
    right = load(config)
    with Store.open(right.state_directory) as store:
        live_through(store, right.assess, *identified(), 2)
    [found] = [each for each in service_conditions(right) if each.name == "history"]
    assert found.holds, found.text
    config.write_text(CONFIG.format(model=model, speed=speed))
    [found] = [each for each in service_conditions(load(config)) if each.name == "history"]
    assert not found.holds
    assert why in found.text
    result = ended("run", "--config", config)
    assert result.returncode == 78, result.stderr
    assert why in result.stderr
    assert "begin a new history" in result.stderr
    assert "Traceback" not in result.stderr
