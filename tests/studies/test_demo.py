"""The main job as a new user meets it."""

import json
import subprocess
import sys

import pytest


@pytest.mark.timeout(300)
def test_the_demo_finds_the_worn_joint_and_no_other():
    """Exit 0, five live replays, an alert for joint 3 alone; wear within 5 % of friction.

    Torque in motion within 4 % of the truth, the worn joint's within 10 %.
    """
    ended = subprocess.run([sys.executable, "-m", "monitor", "demo", "--json"], capture_output=True, text=True, timeout=280, check=False)
    assert ended.returncode == 0, ended.stderr
    seen = json.loads(ended.stdout)
    assert seen["live_replays"] >= 5
    assert {alert["joint"] for alert in seen["alerts"]} == {3}
    for joint in seen["wear"]:
        assert joint["estimated"] == pytest.approx(joint["true"], abs=0.05)
    torque = seen["torque"]
    for joint, (error, size) in enumerate(zip(torque["rms_error_nm"], torque["rms_torque_nm"], strict=True), start=1):
        assert error < (0.1 if joint == 3 else 0.04) * size
    assert seen["live_torque_samples"] > 50
