"""Every call of ur-rtde's four clients, on both generations. The expected results are written here."""

import json

import pytest
from sim_process import result_of

CONTROL = """
import json, math, sys, time
from rtde_control import RTDEControlInterface, Path, PathEntry
from rtde_receive import RTDEReceiveInterface
host, results = sys.argv[1], {}
r, c = RTDEReceiveInterface(host), RTDEControlInterface(host)

def near(a, b, tolerance=2e-3):
    return len(a) == len(b) and all(abs(x - y) < tolerance for x, y in zip(a, b))

def within(seconds, condition):  # of a busy machine's time; a condition that holds at last is enough
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.005)
    return condition()

def check(name, value):
    results[name] = bool(value)

def at(q):
    return within(5, lambda: near(r.getActualQ(), q) and max(map(abs, r.getActualQd())) < 0.01)

def at_pose(pose, tolerance=2e-3):
    return within(5, lambda: near(r.getActualTCPPose(), pose, tolerance) and max(map(abs, r.getActualQd())) < 0.01)

def standing():
    return within(5, lambda: max(map(abs, r.getActualQd())) < 0.01)

def realtime(name, ask, good):  # these commands return what the command before them left: ask until the answer is theirs
    check(name, within(3, lambda: good(ask())))

work = [0.2, -1.3, 1.4, -1.7, -1.57, 0.1]
check("moveJ", c.moveJ(work, 3.0, 8.0) and at(work))
pose = r.getActualTCPPose()
check("isSteady", within(2, c.isSteady))
check("getForwardKinematics", near(c.getForwardKinematics(), pose, 1e-3))
check("getForwardKinematics of q", near(c.getForwardKinematics(work, [0, 0, 1e-9, 0, 0, 0]), pose, 2e-3))  # zeros alone are never sent
check("getInverseKinematics", near(c.getInverseKinematics(pose), work, 5e-3))
check("getInverseKinematics near", near(c.getInverseKinematics(pose, work), work, 5e-3))
has = c.getInverseKinematicsHasSolution
check("getInverseKinematicsHasSolution", has(pose) and not has([9, 0, 0, 0, 0, 0]))
check("poseTrans", near(c.poseTrans([1, 0, 0, 0, 0, math.pi / 2], [1, 0, 0, 0, 0, 0]), [1, 1, 0, 0, 0, math.pi / 2], 1e-9))
check("isPoseWithinSafetyLimits", c.isPoseWithinSafetyLimits(pose) and not c.isPoseWithinSafetyLimits([9, 0, 0, 0, 0, 0]))
check("isJointsWithinSafetyLimits", c.isJointsWithinSafetyLimits(work) and not c.isJointsWithinSafetyLimits([0, 0, 4, 0, 0, 0]))
down = list(pose); down[2] -= 0.08
check("moveL", c.moveL(down, 0.5, 2.0) and at_pose(down))
check("moveJ_IK", c.moveJ_IK(pose, 3.0, 8.0) and at_pose(pose))
q_down = c.getInverseKinematics(down)
check("moveL_FK", c.moveL_FK(q_down, 0.5, 2.0) and at_pose(down))
check("moveJ asynchronous", c.moveJ(work, 0.05, 4.0, True))
check("getTargetWaypoint", near(c.getTargetWaypoint(), pose, 3e-3))
check("asynchronous operation is running", c.getAsyncOperationProgressEx().isAsyncOperationRunning())
check("moveJ asynchronous is not steady", within(2, lambda: not c.isSteady()))
c.moveJ(work, 2.0, 8.0, True)
check("moveJ asynchronous arrives", at(work) and within(2, lambda: not c.getAsyncOperationProgressEx().isAsyncOperationRunning()))
check("moveL asynchronous", c.moveL(down, 0.01, 2.0, True))
check("moveL is on the way", within(5, lambda: r.getActualTCPPose()[2] < pose[2] - 0.005))
check("stopL", c.stopL(5.0) is None and standing())
check("stopL stopped on the way", down[2] + 0.01 < r.getActualTCPPose()[2] < pose[2] - 0.004)
c.moveJ([w + 1.0 for w in work], 0.2, 4.0, True)
within(5, lambda: max(map(abs, r.getActualQd())) > 0.1)
check("stopJ", c.stopJ(8.0) is None and standing())
c.moveJ(work, 3.0, 8.0)
check("speedJ", c.speedJ([0.3, 0, 0, 0, 0, 0], 5.0, 0.0))
check("speedJ turns", within(5, lambda: abs(r.getActualQd()[0] - 0.3) < 0.02))
check("speedStop", c.speedStop(10.0) and standing())
c.moveJ(work, 3.0, 8.0)
check("speedL", c.speedL([0, 0, -0.02, 0, 0, 0], 1.0, 0.0))
check("speedL goes", within(5, lambda: abs(r.getActualTCPSpeed()[2] + 0.02) < 0.004))
check("speedL stop", c.speedStop(5.0) and standing())
c.moveJ(work, 3.0, 8.0)
for i in range(40):
    accepted = c.servoJ([work[0] + 0.004 * i, *work[1:]], 0.0, 0.0, 0.008, 0.05, 300.0)
    time.sleep(0.008)
check("servoJ", accepted and within(5, lambda: abs(r.getActualQ()[0] - work[0] - 0.156) < 0.003))
check("servoStop", c.servoStop(10.0) and standing())
c.moveJ(work, 3.0, 8.0)
for i in range(40):
    c.servoL([*pose[:2], pose[2] - 0.001 * i, *pose[3:]], 0.0, 0.0, 0.008, 0.05, 300.0)
    time.sleep(0.008)
check("servoL", within(5, lambda: abs(r.getActualTCPPose()[2] - pose[2] + 0.039) < 3e-3))
c.servoStop(10.0)
path = [[*work, 3.0, 8.0, 0.0], [work[0] + 0.2, *work[1:], 3.0, 8.0, 0.0]]
check("moveJ of a path", c.moveJ(path) and at(path[1][:6]))
check("moveL of a path", c.moveL([[*pose, 0.5, 2.0, 0.0], [*down, 0.5, 2.0, 0.0]]) and at_pose(down))
route = Path()
route.addEntry(PathEntry(PathEntry.MoveJ, PathEntry.PositionJoints, [*work, 3.0, 8.0, 0.0]))
route.addEntry(PathEntry(PathEntry.MoveL, PathEntry.PositionTcpPose, [*down, 0.5, 2.0, 0.0]))
check("movePath", c.movePath(route, False) and at_pose(down))
check("setTcp", c.setTcp([0, 0, 0.1, 0, 0, 0]) and near(c.getTCPOffset(), [0, 0, 0.1, 0, 0, 0], 1e-9))

def shifted():
    return sum((a - b) ** 2 for a, b in zip(r.getActualTCPPose()[:3], down[:3])) ** 0.5

check("setTcp shows in the pose", within(2, lambda: abs(shifted() - 0.1) < 2e-3))
c.setTcp([0.0] * 6)
check("setPayload", c.setPayload(1.2, [0, 0, 0.05]))
check("setTargetPayload", c.setTargetPayload(0.8, [0, 0, 0.04], [0.0] * 6))
check("payload shows", within(2, lambda: abs(r.getPayload() - 0.8) < 1e-9))
check("setGravity", c.setGravity([0.0, 0.0, 9.82]))
check("zeroFtSensor", c.zeroFtSensor())
realtime("getStepTime", c.getStepTime, lambda step: abs(step - float(sys.argv[2])) < 1e-9)
realtime("getActualJointPositionsHistory", lambda: c.getActualJointPositionsHistory(2), lambda q: near(q, r.getActualQ(), 1e-3))
realtime("getJointTorques", c.getJointTorques, lambda torques: len(torques) == 6 and max(map(abs, torques)) < 40)
realtime("getActualToolFlangePose", c.getActualToolFlangePose, lambda flange: near(flange, down, 3e-3))
realtime("toolContact", lambda: c.toolContact([0, 0, 1, 0, 0, 0]), lambda steps: steps == 0)
check("sendCustomScriptFunction", c.sendCustomScriptFunction("mine", "sleep(0.05)\\nmovej(%s, a=8, v=3)" % work) and at(work))
check("isProgramRunning", c.isProgramRunning())
check("setWatchdog", c.setWatchdog(0.2) and c.kickWatchdog())
check("setPayload of no number is refused", c.setPayload(float("nan"), [0, 0, 0]) is False)
check("the program has ended", within(2, lambda: not c.isProgramRunning()))
check("reuploadScript", c.reuploadScript() and within(5, c.isProgramRunning))
check("triggerProtectiveStop", c.triggerProtectiveStop() is not None)
check("isProtectiveStopped", within(2, r.isProtectiveStopped) and not c.moveJ(work, 1.0, 1.0))
c.disconnect()
print(json.dumps(results), flush=True)
"""

IO = """
import json, sys, time
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface
io, r = RTDEIOInterface(sys.argv[1]), RTDEReceiveInterface(sys.argv[1])
results = {}
def check(name, sent, seen):
    deadline = time.monotonic() + 3
    while not seen() and time.monotonic() < deadline:
        time.sleep(0.01)
    results[name] = bool(sent) and bool(seen())
check("setStandardDigitalOut", io.setStandardDigitalOut(3, True), lambda: r.getActualDigitalOutputBits() == 1 << 3)
check("setConfigurableDigitalOut", io.setConfigurableDigitalOut(1, True), lambda: r.getDigitalOutState(9))
check("setToolDigitalOut", io.setToolDigitalOut(0, True), lambda: r.getDigitalOutState(16))
check("switched off", io.setStandardDigitalOut(3, False), lambda: r.getActualDigitalOutputBits() == (1 << 9 | 1 << 16))
check("setAnalogOutputVoltage", io.setAnalogOutputVoltage(0, 0.5), lambda: abs(r.getStandardAnalogOutput0() - 5.0) < 1e-9)
check("setAnalogOutputCurrent", io.setAnalogOutputCurrent(1, 0.25), lambda: abs(r.getStandardAnalogOutput1() - 0.008) < 1e-9)
check("setSpeedSlider", io.setSpeedSlider(0.5), lambda: abs(r.getTargetSpeedFraction() - 0.5) < 1e-9)
check("target speed fraction follows", True, lambda: abs(r.getTargetSpeedFraction() - 0.5) < 1e-9)
check("setInputIntRegister", io.setInputIntRegister(19, 7), lambda: True)
check("setInputDoubleRegister", io.setInputDoubleRegister(19, 2.5), lambda: True)
results["connected"] = io.isConnected() and r.isConnected()
print(json.dumps(results), flush=True)
"""

DASHBOARD = """
import json, sys, time
from dashboard_client import DashboardClient
d = DashboardClient(sys.argv[1]); d.connect()
results = {}
def ask(name, *arguments):
    try:
        results[name] = getattr(d, name)(*arguments)
    except RuntimeError as wrong:
        results[name] = "RuntimeError " + str(wrong)
for name in ("isConnected", "polyscopeVersion", "robotmode", "safetymode", "safetystatus", "running", "programState", "getLoadedProgram",
             "isProgramSaved", "getSerialNumber", "getRobotModel", "isInRemoteControl", "stop", "play", "pause", "closePopup",
             "closeSafetyPopup", "restartSafety", "powerOff"):
    ask(name)
time.sleep(0.3)
results["mode after powerOff"] = d.robotmode()
for name in ("powerOn", "brakeRelease"):
    ask(name)
time.sleep(0.3)
results["mode after brakeRelease"] = d.robotmode()
ask("popup", "hello"); ask("addToLog", "hello"); ask("loadURP", "nothing.urp"); ask("unlockProtectiveStop")
d.quit()
print(json.dumps(results), flush=True)
"""

NOT_ON_3 = {"getTargetWaypoint", "payload shows", "getStepTime", "getActualJointPositionsHistory"}  # ur-rtde leaves them out of its script
GENERATIONS = [("ur5", "0.008"), ("ur5e", "0.002")]


@pytest.mark.parametrize(
    ("robot", "tick", "script"),
    [
        ("ur5", "0.008", "executed"),
        ("ur5e", "0.002", "modelled"),
        pytest.param("ur5", "0.008", "modelled", marks=pytest.mark.soak),
        pytest.param("ur5e", "0.002", "executed", marks=pytest.mark.soak),
    ],
)
def test_the_control_and_receive_clients_agree_with_every_call(spawn, client, robot, tick, script):
    """The calls cover moves, streams, stops, paths, kinematics, settings, custom scripts and refusals.

    An executed script is the text that ur-rtde sends, run line by line with its threads. Each generation and each kind of script once;
    the other two pairs are in the soak tests.
    """
    results = result_of(client(CONTROL, spawn("--robot", robot, "--control-script", script).address, tick), timeout_s=90)
    assert len(results) > 50
    assert {name for name, good in results.items() if not good} == (NOT_ON_3 if (robot, script) == ("ur5", "executed") else set())


@pytest.mark.parametrize(("robot", "tick"), GENERATIONS)
def test_the_io_client_sets_what_the_receive_client_sees(spawn, client, robot, tick):
    """The calls set digital and analogue outputs, the speed slider and registers."""
    results = result_of(client(IO, spawn("--robot", robot).address))
    assert [name for name, good in results.items() if not good] == []


@pytest.mark.parametrize(("robot", "tick"), GENERATIONS)
def test_the_dashboard_client_gets_an_answer_to_every_command(spawn, client, robot, tick):
    """ur-rtde compares the replies word by word. It reports an error for `play` without a program and for a file that does not exist."""
    result = result_of(client(DASHBOARD, spawn("--robot", robot).address))
    assert result["isConnected"] is True
    assert result["polyscopeVersion"] == {"ur5": "3.15.8.106339", "ur5e": "5.11.0.108249"}[robot]
    assert result["robotmode"] == "Robotmode: RUNNING"
    assert "POWER_OFF" in result["mode after powerOff"]
    assert "RUNNING" in result["mode after brakeRelease"]
    assert result["play"].startswith("RuntimeError Failed to execute")
    assert result["pause"].startswith("RuntimeError Failed to execute")
    assert "not found" in result["loadURP"]
    commands = ("stop", "closePopup", "closeSafetyPopup", "restartSafety", "powerOff", "powerOn", "brakeRelease", "popup", "addToLog")
    assert {name: result[name] for name in commands} == dict.fromkeys(commands)
    assert json.dumps(result)  # every answer is text, a number or nothing
