"""What the simulated controller costs: its process's time on a core, idle and with clients, and how fast it is without a wire.

`python -m tests.bench.simulator`; the figures are shares of one core, from the kernel's account of the simulator's process.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from monitor.simulate.controller import Controller
from monitor.simulate.settings import SimulateSettings

SECONDS = 8.0
ADDRESS = "127.0.91.1"
CLIENTS = """
import math, sys, time
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
host, hz, seconds = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
r, c = RTDEReceiveInterface(host, hz), RTDEControlInterface(host, hz)
start, begun = r.getTargetQ(), r.getTimestamp()
print("streaming", flush=True)
end = time.monotonic() + seconds
while time.monotonic() < end:
    t = c.initPeriod()
    swing = 0.3 * (1 - math.cos(2 * (r.getTimestamp() - begun)))
    c.servoJ([s + swing for s in start], 0, 0, 1 / hz, 0.03, 500)
    c.waitPeriod(t)
c.servoStop()
"""


def core_s(process: subprocess.Popen[str]) -> float:
    """Seconds of a core that a process has used."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share(process: subprocess.Popen[str], seconds: float) -> float:
    """Of one core, over the next seconds [%]."""
    before, began = core_s(process), time.monotonic()
    time.sleep(seconds)
    return 100.0 * (core_s(process) - before) / (time.monotonic() - began)


def on_the_wire(robot: str, hz: float) -> tuple[float, float]:
    """Idle, and while ur-rtde receives everything and streams servoJ at this rate [% of a core]."""
    command = [sys.executable, "-m", "monitor.simulate", "--robot", robot, "--bind", ADDRESS]
    simulator = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    clients = None
    try:
        assert simulator.stdout is not None
        simulator.stdout.readline()
        idle = share(simulator, SECONDS)
        clients = subprocess.Popen([sys.executable, "-c", CLIENTS, ADDRESS, str(hz), str(SECONDS + 3)], stdout=subprocess.PIPE, text=True)
        assert clients.stdout is not None
        while "streaming" not in clients.stdout.readline():
            pass
        return idle, share(simulator, SECONDS)
    finally:
        if clients is not None:
            clients.kill()
            clients.communicate()
        simulator.terminate()
        simulator.communicate()


def stepped(robot: str, *, moving: bool) -> float:
    """Times faster than real time, without a wire."""
    controller = Controller(SimulateSettings(robot=robot))
    ticks, a_target = round(SECONDS / controller.tick_s), round(0.008 / controller.tick_s)
    home = controller.reference.q.copy()
    began = time.process_time()
    for k in range(ticks):
        if moving and k % a_target == 0:
            t = k * controller.tick_s
            controller.reference.follow([home + 0.3 * (1 - np.cos(2.0 * t))], 0.008, 0.03, 500.0)
        controller.step()
    return SECONDS / (time.process_time() - began)


def main() -> None:
    """A line a robot."""
    print(f"{'robot':<8}{'at rest':>14}{'moving':>14}{'idle':>10}{'receive+control':>18}")
    for robot, hz in (("ur5", 125.0), ("ur5e", 125.0), ("ur5e", 500.0)):
        rest, moving = stepped(robot, moving=False), stepped(robot, moving=True)
        idle, busy = on_the_wire(robot, hz)
        print(f"{robot:<8}{rest:>8.0f} × rt{moving:>10.0f} × rt{idle:>8.1f} %{busy:>9.1f} % at {hz:.0f} Hz")


if __name__ == "__main__":
    main()
