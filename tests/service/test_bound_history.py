"""A history is of one model, and refers its friction to one speed: another one is named before anything runs with it."""

import dataclasses

import pytest
from lived_monitor import configuration, identified, live_through

from monitor.errors import BadConfiguration
from monitor.judge.drift.settings import DriftSettings
from monitor.service.maintenance.preflight import service_conditions
from monitor.service.run import check_fits
from monitor.store.store import Store


def test_a_history_of_another_reference_speed_is_named_and_a_start_with_it_is_refused(tmp_path):
    """`check` says it, and `run` ends: every replay would be rejected, one after the other."""
    settings = configuration(tmp_path)
    other = dataclasses.replace(settings.assess, drift=DriftSettings(reference_speed_rad_s=0.5))
    wrong = dataclasses.replace(settings, assess=other)
    with Store.open(settings.state_directory) as store:
        live_through(store, settings.assess, *identified(), 2)
        check_fits(settings, store)
        with pytest.raises(BadConfiguration, match=r"set it back to 0.4, or begin a new history"):
            check_fits(wrong, store)
    [right] = [each for each in service_conditions(settings) if each.name == "history"]
    assert right.holds, right.text
    [found] = [each for each in service_conditions(wrong) if each.name == "history"]
    assert not found.holds
    assert "refers to 0.4 rad/s, drift.reference_speed_rad_s is 0.5" in found.text
