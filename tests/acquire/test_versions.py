"""Versions of both sides: a replay on a simulated controller of each that the table of software names, and with the newest ur-rtde."""

import struct
import subprocess
import sys
import tomllib
import warnings
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitations import short
from raw_rtde import RawRtde
from simulated_arm import known_gains, simulated_arm

from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur import driver as ur
from monitor.acquire.ur.driver import SOFTWARE, TESTED_LIBRARY, UniversalRobots
from monitor.errors import MotionRefused, ReplayAborted
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


def model_of(version):
    return "ur5" if version.startswith("3.") else "ur5e"


@contextmanager
def arm_of(version, host):
    """A simulated arm whose controller has this version."""
    with simulated_arm(host, "--robot", model_of(version), "--robot-api-port", str(PORT), "--polyscope", version), Remote(host) as remote:
        yield remote


def played(version, settings):
    """One short replay on the arm of this version."""
    model, driver = model_of(version), UniversalRobots(robot_api_port=PORT)
    return replay(short(robot=model), load_robot(model), settings, installation=known_gains(model), driver=driver)


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
    settings = ReplaySettings(host="127.0.96.25", allow_motion=True, first_pass=False)
    with arm_of(version, settings.host) as remote:
        if not tested:
            with pytest.raises(MotionRefused, match=r"software: .*allow_untested_software"):
                played(version, settings)
            settings = replace(settings, allow_untested_software=True)
        recording = played(version, settings)
        assert recording.context.firmware.startswith(version)
        assert np.max(np.abs(recording.qd)) > 0.2
        assert remote.truth()["scripts_started"] == 2  # of the first the watchdog is seen to end


def test_a_controller_that_refuses_the_program_is_told_by_what_it_says_and_nothing_moves(monkeypatch):
    """As if nobody knew yet that this release of ur-rtde names too much for this version."""
    monkeypatch.setattr(ur, "NAMES_TOO_EARLY", ())
    settings = ReplaySettings(host="127.0.96.26", allow_motion=True, first_pass=False)
    with arm_of("10.12.0", settings.host) as remote:
        with pytest.raises(
            ReplayAborted, match=r"refused the control program of ur-rtde [\d.]+: line \d+, column \d+: .*viscous_scale"
        ) as ended:
            played("10.12.0", settings)
        assert ended.value.cause == "no_control"
        assert remote.truth()["scripts_started"] == 0
        assert not remote.truth()["motions"]


def test_nothing_is_written_to_a_register_while_somebody_elses_program_plays():
    """ur-rtde clears its command register as soon as it connects, also where it is only asked for its text."""
    settings = ReplaySettings(host="127.0.96.28", allow_motion=True, first_pass=False)
    with arm_of("10.12.0", settings.host) as remote:
        with RawRtde(settings.host) as other:
            other.ask(b"V", struct.pack(">H", 2))
            recipe = other.ask(b"I", b"input_int_register_0")[:1]
            other.send(b"U", recipe + struct.pack(">i", 7))
            remote.fault("foreign_program", seconds=60.0, moves="off")
        with pytest.raises(MotionRefused, match="no_other_program"):
            played("10.12.0", settings)
        with RawRtde(settings.host) as other:
            other.ask(b"V", struct.pack(">H", 2))
            other.stream("input_int_register_0", 10.0)
            assert struct.unpack(">i", other.packet()[1][1:]) == (7,)


def test_a_replay_is_played_with_the_newest_release_of_ur_rtde_that_is_allowed(tmp_path, monkeypatch):
    """pyproject.toml admits releases that nobody has tried yet. The one that an installation gets today plays a replay here; where it is
    not the pinned one, a warning says so."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))["project"]
    (allowed,) = [each for each in project["dependencies"] if each.startswith("ur-rtde")]
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--target", str(tmp_path)]
    installed = subprocess.run([*pip, allowed], capture_output=True, text=True, check=False)
    if installed.returncode != 0:
        pytest.skip(f"{allowed} cannot be had here: {installed.stderr.strip().splitlines()[-1]}")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # of the process that moves the arm
    asked = "import rtde_control; from importlib.metadata import version; print(rtde_control.__file__, version('ur_rtde'))"
    place, newest = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True).stdout.split()
    assert Path(place).parent == tmp_path
    if newest != TESTED_LIBRARY:
        warnings.warn(f"{allowed} admits {newest}; constraints.txt pins the tested {TESTED_LIBRARY}", stacklevel=1)
    settings = ReplaySettings(host="127.0.96.27", allow_motion=True, first_pass=False)
    with arm_of("5.26.0", settings.host) as remote:
        assert np.max(np.abs(played("5.26.0", settings).qd)) > 0.2
        assert remote.truth()["scripts_started"] == 2
