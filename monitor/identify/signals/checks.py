"""Whether recordings and a robot belong together."""

from collections.abc import Sequence

import numpy as np

from monitor.errors import BadInput
from monitor.model.robot import Robot
from monitor.recording import Recording


def refuse_other_arm(recording: Recording, robot: Robot) -> None:
    """Raises BadInput where the recording names another robot model than the one given. A recording without a name passes."""
    made_by = recording.context.robot
    if made_by is not None and made_by != robot.name:
        raise BadInput(f"{recording.source or 'recording'}: recorded on a {made_by}; the robot given is {robot.name}")


def refuse_twice(recordings: Sequence[Recording]) -> None:
    """Raises BadInput where one recording is given twice: it would count as two independent measurements."""
    for number, one in enumerate(recordings):
        for other in recordings[:number]:
            if one.samples == other.samples and np.array_equal(one.t_s, other.t_s) and np.array_equal(one.q, other.q):
                raise BadInput(f"{one.source or 'recording'} is {other.source or 'recording'} once more: it says nothing new; give it once")
