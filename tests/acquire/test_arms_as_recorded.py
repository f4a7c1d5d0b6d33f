"""Replays on simulated arms that publish what real arms were recorded to publish, in a process of their own."""

import numpy as np
import pytest
from excitations import short
from simulated_arm import known_gains, simulated_arm

from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.watch import Caller
from monitor.errors import MotionRefused, ReplayAborted
from monitor.model.robot import load_robot
from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time

START = short().at(np.zeros(1)).q[0]
TWO_TURNS = 4.0 * np.pi


def home(q):
    return "--home=" + ",".join(f"{each:.6f}" for each in q)


def test_a_ur3e_with_its_wrist_two_turns_on_plays_around_it():
    """As in the real recording: speed_scaling is 0 while idle, wrist 3 is at +12.6 rad. The trajectory keeps its digest."""
    host, on = "127.0.94.11", START.copy()
    on[5] += TWO_TURNS + 0.2
    settings = ReplaySettings(host=host, allow_motion=True, first_pass=False)
    with simulated_arm(host, "--robot", "ur3e", "--personality", "recorded", home(on)):
        recording = replay(short(robot="ur3e"), load_robot("ur3e"), settings, installation=known_gains("ur3e"))
    assert recording.context.trajectory_digest == short(robot="ur3e").digest
    swing = np.ptp(short(robot="ur3e").at(np.linspace(0.0, 3.0, 300)).q[:, 5])
    assert np.all(np.abs(recording.q[:, 5] - START[5] - TWO_TURNS) <= swing + 0.05)  # rad: with the servo's lag


def test_the_freedrive_button_ends_a_motion_and_forbids_the_next():
    """Somebody who holds it is at the arm: the arm stops, and a person says when it may move again."""
    host = "127.0.94.12"
    settings = ReplaySettings(host=host, allow_motion=True, first_pass=False)
    with simulated_arm(host), Remote(host) as remote:
        pressed = []

        def on_progress(progress):
            if progress.phase == "play" and progress.elapsed_s > 0.5 and not pressed:
                pressed.append(remote.fault("teach_button", state="on"))

        with pytest.raises(ReplayAborted) as aborted:
            replay(short(), load_robot("ur5"), settings, caller=Caller(on_progress=on_progress))
        assert aborted.value.cause == "teach_button"
        assert aborted.value.needs_a_person
        with pytest.raises(MotionRefused, match="teach_button"):
            replay(short(), load_robot("ur5"), settings)
