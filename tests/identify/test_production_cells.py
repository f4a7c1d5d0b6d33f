"""What work tells of friction in simulated cells, whose physics the monitor does not know: a sample of `test_production_cells_soak.py`."""

import numpy as np
import pytest
from more_disturbances import heavier
from simulated_production import listened

from monitor.simulate.production import ProductionSettings

FALSE_SHIFT = 3.0  # deviations that no estimate may be off by: one of 400 joints would be, by chance


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One folder: the replay of an arm with its tool is made once."""
    return tmp_path_factory.mktemp("production")


@pytest.mark.slow
def test_production_holds_the_true_friction_of_the_joints_that_it_moves(folder):
    """Half a minute of pick-and-place with joint 1 worn by 10 % holds the friction; joint 5 does not move, and stays unknown."""
    found = listened(folder, ProductionSettings(cell="pick-and-place", hours=22.0 / 3600.0), wear=(1.1, 1, 1, 1, 1, 1))
    assert found.known[[0, 2, 3, 5]].all()
    assert not found.known[4]
    assert np.nanmax(np.abs(found.z)) < FALSE_SHIFT
    assert found.friction_nm[0] / found.document["replay"]["friction_nm"][0] > 1.04  # of 10 %, the arm being 2 K colder than in the replay


@pytest.mark.soak
def test_a_hand_in_freedrive_is_recognised_and_shifts_nothing(folder):
    """No button is held and the program plays: the time is left out as disturbed, and what remains is true."""
    found = listened(folder, ProductionSettings(cell="hand-guiding", hours=22.0 / 3600.0))
    assert found.document["left_out_s"]["disturbed"] > 5.0
    assert not (np.abs(found.z) > FALSE_SHIFT).any()  # NaN where nothing is told


@pytest.mark.soak
def test_a_tool_that_drags_where_one_joint_moves_alone_is_no_friction_of_that_joint(folder):
    """Polishing at 60 %, in force control that no column tells: along the strokes joint 1 feels 45 % more than its friction."""
    found = listened(folder, ProductionSettings(cell="polishing", hours=20.0 / 3600.0, seed=41, speed=0.6))
    left = found.document["left_out_s"]
    assert sum(left.get(cause, 0.0) for cause in ("payload_unknown", "disturbed", "contact")) > 10.0
    assert not found.known[0]
    assert not (np.abs(found.z) > FALSE_SHIFT).any()


@pytest.mark.soak
def test_another_tool_that_nobody_declared_is_left_out_as_a_whole(folder):
    """It is 1 kg heavier than the tool of the replay, at all times."""
    found = listened(folder, ProductionSettings(cell="pick-and-place", hours=10.0 / 3600.0), disturb=heavier)
    assert not np.isfinite(found.friction_nm).any()
    assert found.document["left_out_s"]["payload_unknown"] > 5.0
