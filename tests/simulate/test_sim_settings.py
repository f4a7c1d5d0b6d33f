"""Settings of a simulated arm are checked."""

import math

import pytest

from monitor.errors import BadInput
from monitor.simulate.settings import SimulateSettings


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"bind": "0.0.0.0"}, "bind"),
        ({"bind": "192.168.56.101"}, "bind"),
        ({"bind": "localhost"}, "bind"),
        ({"robot": "ur7"}, "ur7"),
        ({"version": "5.3.0"}, "version"),
        ({"version": "new"}, "version"),
        ({"robot": "ur5", "version": "5.11.0"}, "for a ur5"),
        ({"robot": "ur20", "version": "3.15.0"}, "for a ur20"),
        ({"payload_kg": -1.0}, "payload_kg"),
        ({"home_rad": (0.0,) * 5}, "home_rad"),
        ({"serial": "abc"}, "serial"),
        ({"ambient_c": 99.0}, "ambient_c"),
        ({"wear_per_revolution": (-1.0,) * 6}, "wear_per_revolution"),
        ({"protective_runtime": "shrugs"}, "protective_runtime"),
        ({"command_port": 0}, "command_port"),
        ({"command_port": 30004}, "command_port"),
        ({"seed": -1}, "seed"),
        ({"wear_per_revolution": (math.nan,) * 6}, "wear_per_revolution"),
        ({"payload_com_m": (0.0, 0.0, math.nan)}, "payload_com_m"),
    ],
)
def test_wrong_settings_are_named(wrong, named):
    """Every mistake is a BadInput that names the field."""
    with pytest.raises(BadInput, match=named):
        SimulateSettings(**wrong)
