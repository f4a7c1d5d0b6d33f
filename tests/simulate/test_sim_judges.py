"""Other RTDE clients judge the wire: the manufacturer's own, and urx on ports 30002 and 30003. Both come from PyPI."""

import numpy as np
import pytest
from sim_process import result_of

MANUFACTURERS = """
import json, sys, time
from third_party.rtde import rtde
host, hz = sys.argv[1], int(sys.argv[2])
con = rtde.RTDE(host, 30004); con.connect()
version = con.get_controller_version()
names = ["timestamp", "actual_q", "target_q", "joint_temperatures", "robot_mode", "safety_status", "runtime_state", "joint_mode",
         "elbow_position", "tcp_force_scalar", "actual_digital_output_bits", "payload", "output_int_register_0", "input_int_register_20"]
types = ["DOUBLE", "VECTOR6D", "VECTOR6D", "VECTOR6D", "INT32", "INT32", "UINT32", "VECTOR6INT32", "VECTOR3D", "DOUBLE", "UINT64", "DOUBLE",
         "INT32", "INT32"]
outputs = con.send_output_setup(names, types, frequency=hz)
inputs = con.send_input_setup(["input_int_register_20", "input_double_register_20"], ["INT32", "DOUBLE"])
slider = con.send_input_setup(["speed_slider_mask", "speed_slider_fraction"], ["UINT32", "DOUBLE"])
taken = rtde.RTDE(host, 30004); taken.connect()
try:
    taken.send_input_setup(["input_int_register_20"]); in_use = "not reported"
except ValueError as wrong:
    in_use = str(wrong)
taken.disconnect()
started = con.send_start()
inputs.input_int_register_20, inputs.input_double_register_20 = 42, 1.5
con.send(inputs)
stamps, end, state = [], time.monotonic() + 2.0, None
while time.monotonic() < end:
    state = con.receive()
    stamps.append(state.timestamp)
paused = con.send_pause()
print(json.dumps(dict(version=version, outputs=outputs, started=started, paused=paused, stamps=stamps, in_use=in_use,
    skipped=con.skipped_package_count, q=state.actual_q, mode=state.robot_mode, register=state.input_int_register_20,
    elbow=state.elbow_position, joint_mode=state.joint_mode, safety=state.safety_status)), flush=True)
"""

URX = """
import json, sys, time, warnings
warnings.simplefilter("ignore")
from urx.ursecmon import SecondaryMonitor
from urx.urrtmon import URRTMonitor
host = sys.argv[1]
slow, fast = SecondaryMonitor(host), URRTMonitor(host)
fast.start()
fast.wait(); slow.wait()
fast.start_buffering()
slow.send_program("movej([0.2,-1.4,0.1,-1.5,0.1,0.3], a=4, v=2)")
goal, end = [0.2, -1.4, 0.1, -1.5, 0.1, 0.3], time.monotonic() + 15
while time.monotonic() < end and max(abs(a - b) for a, b in zip(fast.get_all_data(wait=True)["qActual"], goal)) > 2e-3:
    pass
time.sleep(0.5)
buffered = fast.get_buffer()
everything = slow.get_all_data()
data = fast.get_all_data(wait=True)
slow.close(); fast.stop()
print(json.dumps(dict(
    mode=everything["RobotModeData"], joints=everything["JointData"], pose=everything["CartesianInfo"], tool=everything["ToolData"],
    board=everything["MasterBoardData"], q=list(data["qActual"]), target=list(data["qTarget"]),
    stamps=[float(row[1]) for row in buffered]), default=str), flush=True)
"""


@pytest.mark.parametrize(("robot", "hz", "version"), [("ur5", 125, [3, 15, 8, 106339]), ("ur5e", 500, [5, 11, 0, 108249])])
def test_the_manufacturers_own_rtde_client_productions(spawn, client, robot, hz, version):
    """It checks the version, the types of outputs and inputs, IN_USE, the start, data without a gap, and the pause."""
    result = result_of(client(MANUFACTURERS, spawn("--robot", robot).address, str(hz)))
    assert result["version"] == version
    assert result["outputs"]
    assert result["started"]
    assert result["paused"]
    assert "already in use" in result["in_use"]
    assert result["register"] == 42
    assert result["mode"] == 7
    assert result["safety"] == 1
    assert result["joint_mode"] == [253] * 6
    assert np.allclose(result["q"], [0, -np.pi / 2, 0, -np.pi / 2, 0, 0], atol=1e-3)
    assert result["elbow"][2] > 0.4  # an upright upper arm
    steps = np.rint(np.diff(result["stamps"]) * hz)
    assert np.sum(steps - 1) <= result["skipped"]  # what is missing, the client itself threw away as older than the newest
    assert result["stamps"][-1] - result["stamps"][0] < 2.2  # a busy machine may take time from the controller, never give it any


@pytest.mark.parametrize("robot", ["ur5", "ur3e"])
def test_urx_reads_the_secondary_and_the_realtime_port_and_moves_the_arm(spawn, client, robot):
    """urx decodes modes, joints, tool pose and temperatures by its own layouts. A program that it writes to 30002 runs."""
    result = result_of(client(URX, spawn("--robot", robot).address))
    goal = [0.2, -1.4, 0.1, -1.5, 0.1, 0.3]
    assert np.allclose(result["q"], goal, atol=3e-3)
    assert np.allclose(result["target"], goal, atol=1e-6)
    assert np.allclose([result["joints"][f"q_actual{i}"] for i in range(6)], goal, atol=3e-3)
    assert np.allclose([result["joints"][f"T_motor{i}"] for i in range(6)], 25.0, atol=0.3)
    assert [result["joints"][f"jointMode{i}"] for i in range(6)] == [253] * 6
    mode = result["mode"]
    assert (mode["robotMode"], mode["isPowerOnRobot"], mode["isEmergencyStopped"], mode["isSecurityStopped"]) == (7, True, False, False)
    if robot == "ur5":  # urx knows no robot mode package of 5.x, takes the controller for one before 3.0, and misreads what differs
        assert (mode["speedFraction"], mode["speedScaling"]) == (1.0, 1.0)
        assert result["board"]["robotVoltage48V"] == 48.0
    assert result["tool"]["toolMode"] == 253
    assert 0.1 < abs(result["pose"]["Z"]) < 1.5
    assert np.median(np.diff(result["stamps"])) == pytest.approx(0.008 if robot == "ur5" else 0.002, abs=1e-6)
