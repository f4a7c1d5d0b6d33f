"""The motions of recordings that are fitted together: they move the arm enough if all of them together do."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.signals.motion import Motion, SignalSettings, motion
from monitor.identify.signals.order import quantiles
from monitor.recording import Recording

ANY_JOINT = 1e-6  # fraction of the joints: one that moves is enough
LEAST_S = 2.0  # [s] the filter needs it


def motions_of(recordings: Sequence[Recording], settings: SignalSettings) -> list[Motion]:
    """The motion of each recording, as `motion` makes it. Of several, each must move one joint, and all together most of them.

    A sweep of one joint shows that joint's friction; the sweeps of all joints show that of the arm. Raises as `motion`, and Unidentifiable
    where all together are too short or move too few joints.
    """
    if len(recordings) < 2:
        return [motion(recording, settings) for recording in recordings]
    least_s = min(LEAST_S, settings.min_duration_s)
    alone = replace(settings, min_moving_share=min(ANY_JOINT, settings.min_moving_share), min_duration_s=least_s)
    motions = [motion(recording, alone) for recording in recordings]
    joints = motions[0].q.shape[1]
    fastest = np.max([quantiles(np.abs(moved.qd), 0.99) for moved in motions], axis=0)  # (J,)
    moving = int(np.sum(fastest >= settings.min_speed_rad_s))
    needed = int(np.ceil(settings.min_moving_share * joints))
    if moving < needed:
        still = ", ".join(str(j + 1) for j in np.flatnonzero(fastest < settings.min_speed_rad_s))
        raise Unidentifiable(
            f"the {len(motions)} recordings together move {moving} of {joints} joints, not joints {still}; friction shows only in motion: "
            f"expected {settings.min_speed_rad_s:g} rad/s or more on at least {needed} joints"
        )
    duration_s = sum(moved.duration_s for moved in motions)
    if duration_s < settings.min_duration_s:
        raise Unidentifiable(
            f"the {len(motions)} recordings together are {duration_s:.3g} s long; expected at least {settings.min_duration_s:g} s of motion"
        )
    return motions
