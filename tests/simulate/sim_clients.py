"""Programs that use ur-rtde. Tests run each in a process of its own."""

RECEIVE = """
import json, sys, time
from rtde_receive import RTDEReceiveInterface
r = RTDEReceiveInterface(sys.argv[1])
first = r.getTimestamp(); time.sleep(1.0); last = r.getTimestamp()
print(json.dumps(dict(
    q=r.getActualQ(), qd=r.getActualQd(), current=r.getActualCurrent(), temperature=r.getJointTemperatures(), moment=r.getTargetMoment(),
    target_q=r.getTargetQ(), robot_mode=r.getRobotMode(), safety_mode=r.getSafetyMode(), runtime=r.getRuntimeState(),
    status=r.getRobotStatus(), safety=r.getSafetyStatusBits(), pose=r.getActualTCPPose(), scaling=r.getSpeedScaling(),
    joint_mode=r.getJointMode(), main_voltage=r.getActualMainVoltage(), protective=r.isProtectiveStopped(),
    seconds=last - first)))
"""

MOVE_AND_STREAM = """
import json, math, sys, time
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
r, c = RTDEReceiveInterface(sys.argv[1]), RTDEControlInterface(sys.argv[1], 125.0)
goal = r.getActualQ(); goal[0] += 0.2; goal[3] -= 0.1
moved = c.moveJ(goal, 1.0, 1.5)
at = r.getActualQ()
watched = c.setWatchdog(5.0)
start, begun = r.getTargetQ(), r.getTimestamp()
errors, beside = [], []  # while this client was in time, and while it had been asleep just before
last = late = begun
while last - begun < 3.0:
    deadline = time.monotonic() + 1.0
    while r.getTimestamp() == last and time.monotonic() < deadline:
        time.sleep(0.0003)
    now = r.getTimestamp()
    late = now if now - last > 0.012 else late
    last = now
    swing = 0.2 * (1 - math.cos(math.pi * (now - begun)))
    if now - begun > 0.1:
        (errors if now - late > 0.2 else beside).append(max(abs(a - s - swing) for a, s in zip(r.getActualQ(), start)))
    assert c.servoJ([s + swing for s in start], 0.0, 0.0, 0.008, 0.03, 500.0)
stopped = c.servoStop(10.0)
deadline = time.monotonic() + 1.0
while not (steady := c.isSteady()) and time.monotonic() < deadline:  # the arm settles; asking feeds the watchdog
    time.sleep(0.02)
answers = dict(moved=moved, watched=watched, stopped=stopped, steady=steady, payload=c.setPayload(1.0, [0, 0, 0.1]),
               within=c.isJointsWithinSafetyLimits([0.0] * 6), beyond=c.isJointsWithinSafetyLimits([0.0, 0, 4.0, 0, 0, 0]))
c.stopScript()
deadline = time.monotonic() + 1.0
while (runtime := r.getRuntimeState()) != 1 and time.monotonic() < deadline:  # r sees the effect of a command of c one packet later
    time.sleep(0.002)
print(json.dumps(dict(goal=goal, at=at, errors=errors, beside=beside, runtime=runtime, **answers)), flush=True)
"""

STREAM_FOR_EVER = """
import math, sys, time
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
r, c = RTDEReceiveInterface(sys.argv[1]), RTDEControlInterface(sys.argv[1], 125.0)
c.setWatchdog(10.0)
start, begun = r.getTargetQ(), r.getTimestamp()
print("streaming", flush=True)
while True:
    swing = 0.3 * (1 - math.cos(math.pi * (r.getTimestamp() - begun)))
    c.servoJ([s + swing for s in start], 0.0, 0.0, 0.008, 0.03, 500.0)
    time.sleep(0.008)
"""

HOLD_CONTROL = """
import sys, time
from rtde_control import RTDEControlInterface
c = RTDEControlInterface(sys.argv[1])
print("controlling", flush=True)
time.sleep(60)
"""

CONSTRUCT_CONTROL = """
import json, sys
from rtde_control import RTDEControlInterface
try:
    c = RTDEControlInterface(sys.argv[1]); c.stopScript(); answer = "constructed"
except RuntimeError as wrong:
    answer = str(wrong)
print(json.dumps(dict(answer=answer)), flush=True)
"""

DASHBOARD = """
import json, sys
from dashboard_client import DashboardClient
d = DashboardClient(sys.argv[1]); d.connect()
answers = dict(version=d.polyscopeVersion(), mode=d.robotmode(), safety=d.safetymode(), running=d.running(), state=d.programState())
for name in sys.argv[2:]:
    try:
        answers[name] = getattr(d, name)()
    except RuntimeError as wrong:
        answers[name] = str(wrong)
print(json.dumps(answers), flush=True)
"""
