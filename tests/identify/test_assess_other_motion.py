"""A series whose files turn to another motion, which reads friction differently without any wear."""

from dataclasses import replace

import numpy as np
import pytest
from oracle_arm import GROUND, friction, recording, truth

from monitor.identify.signals.same_motion import with_motions
from monitor.judge.assess import assess
from monitor.model.robot import load_robot
from monitor.recording import Context

UR5 = load_robot("ur5")
DAYS, TURN = 13, 8
READS = 0.88  # of the friction that the first motion reads: by misfit, the real arms' shorter motions read 12–14 % differently


def file_of(day):
    """The recording of a day, of one motion until `TURN` and of a slower one afterwards."""
    known = truth(UR5, repetitions=1, rate_hz=60.0, speed_rad_s=1.5 if day < TURN else 1.0)
    level = (1.0 if day < TURN else READS) * (1.0 + 0.004 * np.sin(7.0 * day))
    made = recording(replace(known, torque=known.torque + (level - 1.0) * friction(known.qd)), seed=day)
    return replace(made, source=f"{day}.csv", context=Context(recorded_at_unix_s=1.7e9 + 86400.0 * day))


@pytest.fixture(scope="module")
def files():
    return [file_of(day) for day in range(DAYS)]


def raised(recordings):
    """The conditions that were raised, and the last assessment."""
    last, conditions = None, set()
    for one in recordings:
        kept = {} if last is None else {"belief": last.belief, "health": last.health, "model": last.model}
        last = assess(one, robot=UR5, mounting=GROUND, **{"belief": None, "health": None, **kept})
        conditions |= {transition.alert.condition for transition in last.transitions}
    return conditions, last


@pytest.mark.slow
def test_another_motion_that_reads_less_friction_is_no_falling_friction(files):
    """Its baseline is its own, as it would not be were both taken for one motion."""
    one_name = [replace(one, context=replace(one.context, trajectory_digest="one")) for one in files]
    _, confused = raised(one_name)
    told, last = raised(with_motions(files))
    assert (len(confused.belief.contexts), len(last.belief.contexts)) == (1, 2)
    assert not told & {"friction_falling", "common_mode"}
    assert all(abs(joint.wear) < 0.03 for joint in last.friction)
