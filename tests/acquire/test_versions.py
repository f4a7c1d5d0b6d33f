"""Every version that the table of software calls played: a replay with the unmodified ur-rtde on a simulated controller of that version."""

from dataclasses import replace

import numpy as np
import pytest
from excitations import short
from simulated_arm import known_gains, simulated_arm

from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.driver import SOFTWARE, UniversalRobots
from monitor.errors import MotionRefused
from monitor.model.robot import load_robot
from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time

PORT = 18082
ALWAYS = {
    "5.9.0",
    "5.26.0",
    "10.11.0",
    "10.14.0",
}  # in each run of the tests: ur-rtde sends each of these another script, or one that it refuses


@pytest.mark.parametrize(
    ("version", "tested"),
    [
        pytest.param(version, span.tested, marks=() if version in ALWAYS else pytest.mark.soak)
        for span in SOFTWARE
        for version in span.played
    ],
)
def test_a_replay_is_played_on_each_version_and_only_the_tested_ones_move_without_the_switch(version, tested):
    """The simulated controller refuses a program that names what its version does not know, as ur-rtde's own does for 5.9.0 and 10.11."""
    model = "ur5" if version.startswith("3.") else "ur5e"
    robot, driver = load_robot(model), UniversalRobots(robot_api_port=PORT)
    options = ("--robot", model, "--robot-api-port", str(PORT), "--polyscope", version)
    settings = ReplaySettings(host="127.0.96.25", allow_motion=True, first_pass=False)

    def played(settings):
        return replay(short(robot=model), robot, settings, installation=known_gains(model), driver=driver)

    with simulated_arm(settings.host, *options) as host, Remote(host) as remote:
        if not tested:
            with pytest.raises(MotionRefused, match=r"software: .*allow_untested_software"):
                played(settings)
            settings = replace(settings, allow_untested_software=True)
        recording = played(settings)
        assert recording.context.firmware.startswith(version)
        assert np.max(np.abs(recording.qd)) > 0.2
        assert remote.truth()["scripts_started"] == 2  # of the first the watchdog is seen to end
