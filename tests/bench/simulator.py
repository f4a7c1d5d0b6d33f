"""The processor time of the simulated controller, idle and with clients, and its speed without a wire.

Run `python -m tests.bench.simulator`. The figures are shares of one core, from the kernel's account of the simulator's process. There
are three parts: the arm (servo, motion, heat, wear); the rest of the controller's physics (servoj's filter, sensor noise, limits); and
everything beyond physics (programs, poses, the wire). They are measured inside the running process. The system calls of the measurement
cost about 0.1 % of a core and count as beyond physics.

A core that sleeps between control periods wakes with cold caches and a low clock, so the same work takes up to one and a half times as
long. Each line is therefore measured twice. The second time, processes of the lowest class (SCHED_IDLE) keep the cores awake.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import numpy as np

from monitor.simulate.controller.controller import Controller
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
    if not c.servoJ([s + swing for s in start], 0, 0, 1 / hz, 0.03, 500):
        print("ended", flush=True)  # ur-rtde's destructors may hang: the output shows that this client no longer streams
        sys.exit()
    c.waitPeriod(t)
c.servoStop()
"""


METERED = """
import functools, runpy, signal, sys, time
from monitor.simulate.machine.moves import Limits
from monitor.simulate.arm.physics import Arm
from monitor.simulate.arm.reference import Reference
from monitor.simulate.arm.sensors import Sensors
spent = {"arm": 0.0, "controller": 0.0}
def metered(part, method):
    @functools.wraps(method)
    def call(*given):
        began = time.thread_time()
        try:
            return method(*given)
        finally:
            spent[part] += time.thread_time() - began
    return call
for part, kind, names in (
    ("arm", Arm, ("step", "stand", "settle")),
    ("controller", Reference, ("steps",)),
    ("controller", Sensors, ("read",)),
    ("controller", Limits, ("broken",)),
):
    for name in names:
        setattr(kind, name, metered(part, getattr(kind, name)))
signal.signal(signal.SIGUSR1, lambda *_: print(time.monotonic(), time.process_time(), *spent.values(), flush=True))
sys.argv = ["monitor.simulate", *sys.argv[1:]]
runpy.run_module("monitor.simulate", run_name="__main__")
"""


class Metered:
    """A simulator in a process of its own. Its time is divided into the arm, the rest of physics, and everything else."""

    def __init__(self, robot: str) -> None:
        command = [sys.executable, "-c", METERED, "--robot", robot, "--bind", ADDRESS]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self._line()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def _spent(self) -> np.ndarray:
        self.process.send_signal(signal.SIGUSR1)
        return np.array([float(word) for word in self._line().split()])

    def share(self, seconds: float) -> tuple[float, float, float]:
        """Shares of one core over the next seconds: the arm, the rest of physics, and everything else [%]."""
        before = self._spent()
        time.sleep(seconds)
        wall, core, arm, controller = self._spent() - before
        return 100.0 * arm / wall, 100.0 * controller / wall, 100.0 * (core - arm - controller) / wall


@contextmanager
def awake() -> Iterator[None]:
    """Keep the cores awake by processes that run only when no other process wants to."""
    spinning = [
        subprocess.Popen([sys.executable, "-c", "import os\nos.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\nwhile True: pass"])
        for _ in range(os.cpu_count() or 1)
    ]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


def on_the_wire(robot: str, hz: float) -> tuple[float, float, float, float]:
    """Shares of a core [%]: idle, then arm, rest of physics and everything else while ur-rtde receives and streams servoJ at this rate."""
    simulator, clients = Metered(robot), None
    try:
        idle = sum(simulator.share(SECONDS))
        clients = subprocess.Popen([sys.executable, "-c", CLIENTS, ADDRESS, str(hz), str(SECONDS + 5)], stdout=subprocess.PIPE, text=True)
        assert clients.stdout is not None
        while "streaming" not in clients.stdout.readline():
            pass
        time.sleep(1.0)
        found = idle, *simulator.share(SECONDS)
        clients.kill()
        if "ended" in clients.stdout.read():
            raise SystemExit(f"{robot}: the client ended before the measurement did: this machine is too busy, targets came late")
        return found
    finally:
        if clients is not None:
            clients.kill()
            clients.wait()
        simulator.process.terminate()
        simulator.process.communicate()


def stepped(robot: str, *, moving: bool) -> float:
    """Simulated time over processor time, without a wire."""
    controller = Controller(SimulateSettings(robot=robot))
    ticks, a_target = round(SECONDS / controller.clock.tick_s), round(0.008 / controller.clock.tick_s)
    home = controller.reference.q.copy()
    began = time.process_time()
    for k in range(ticks):
        if moving and k % a_target == 0:
            t = k * controller.clock.tick_s
            controller.reference.follow([home + 0.3 * (1 - np.cos(2.0 * t))], 0.008, 0.03, 500.0)
        controller.step()
    return SECONDS / (time.process_time() - began)


def main() -> None:
    """Print two lines for each robot and rate."""
    print(f"{'robot':<8}{'at rest':>14}{'moving':>14}{'cores':>10}{'idle':>10}{'receive+control: arm':>24}{'controller':>14}{'beyond':>10}")
    for robot, hz in (("ur5", 125.0), ("ur5e", 125.0), ("ur5e", 500.0)):
        rest, moving = stepped(robot, moving=False), stepped(robot, moving=True)
        for kept, how in (("sleep", nullcontext), ("awake", awake)):
            with how():
                idle, arm, controller, beyond = on_the_wire(robot, hz)
            print(
                f"{robot:<8}{rest:>8.0f} × rt{moving:>10.0f} × rt{kept:>10}{idle:>8.1f} %{arm:>22.1f} %{controller:>12.1f} %"
                f"{beyond:>8.1f} % at {hz:.0f} Hz",
                flush=True,
            )


if __name__ == "__main__":
    main()
