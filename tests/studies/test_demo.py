"""The demo, run as a new user runs it."""

import json
import subprocess
import sys

import pytest


@pytest.mark.timeout(300)
def test_the_demo_finds_the_worn_joint_and_no_other():
    """Three live replays or more, an alert for joint 3 alone, wear within 5 % of friction.

    The RMS error of torque in motion is below 4 % of its RMS, for the worn joint below 10 %.
    """
    ended = subprocess.run([sys.executable, "-m", "monitor", "demo", "--json"], capture_output=True, text=True, timeout=280, check=False)
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert document["live_replays"] >= 3
    assert {alert["joint"] for alert in document["alerts"]} == {3}
    for joint in document["wear"]:
        assert joint["estimated"] == pytest.approx(joint["true"], abs=0.05)
    torque = document["torque"]
    for joint, (error, size) in enumerate(zip(torque["rms_error_nm"], torque["rms_torque_nm"], strict=True), start=1):
        assert error < (0.1 if joint == 3 else 0.04) * size
    assert document["live_torque_samples"] > 50
