"""What the one model reaches, small: it is quiet in a plain world, finds wear there, and its intervals hold."""

import pytest

from monitor.studies.worlds.table import WORLDS
from tests.evidence.friction import document, row

pytestmark = pytest.mark.slow


def test_a_plain_world_is_quiet_and_its_wear_is_found():
    of = document(WORLDS["plain"], arms=8, worn=6, days=560, seed=61)
    assert of["false_per_year"] < 0.6  # six in 11 robot-years
    step, ramp = of["detection"]
    assert step["median_days"] < 30
    assert 40 < ramp["median_days"] < 200
    assert of["interval_90"]["healthy"] > 0.75
    assert row(of).startswith("| plain | ")


def test_a_payload_that_nobody_declared_is_no_wear():
    of = document(WORLDS["payload-03"], arms=3, worn=1, days=260, seed=62)
    assert of["events"]["rising"] <= 2
