"""One row of docs/faults.md from end to end: simulated, replayed, identified, judged."""

import numpy as np

from monitor.judge.settings import AssessSettings

from .faults import Cell, judged, played

WRIST = 4  # from 0


def test_an_encoder_off_its_centre_is_told_by_ripple_and_by_nothing_else():
    """On a wrist's motor: the current ripples once a turn, and friction is what it was; a sound arm is told nothing."""
    settings, rooms_c = AssessSettings(), (18.0, 26.0)
    sound, same, broken = (played(cell, WRIST, settings, rooms_c) for cell in (None, None, Cell("motor_encoder", 1.0)))
    assert broken.ripple_a(WRIST)[0] > 0.015 > sound.ripple_a(WRIST)[0]
    told = judged(sound, [same, broken], WRIST, settings, arms=1)
    assert np.isinf([days[0, 0] for days in told.values()]).all()
    assert {name for name, days in told.items() if np.isfinite(days[1, 0])} == {"ripple"}
    assert 3.0 <= told["ripple"][1, 0] <= 20.0
