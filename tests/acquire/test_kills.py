"""SIGKILL of the child, of the parent, and of both, at random times: the arm always stops, and no process is left."""

import os
import random
import signal
import time

import numpy as np
import pytest
from processes import alive, children, replaying
from simulated_arm import ASIDE, simulated_arm

from monitor.acquire.ur.dashboard import Dashboard
from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time

TOO_EARLY, ATTEMPTS = "before the kill", 4  # a replay that the machine's other work ended says nothing of kills


def stands(host: str, within_s: float) -> str:
    """What is wrong if the arm does not stand within that time, or moves again; an empty text if it stands."""
    deadline = time.monotonic() + within_s
    with Remote(host) as remote:
        while not remote.truth()["standing"]:
            if time.monotonic() > deadline:
                return f"still moving after {within_s:g} s"
            time.sleep(0.01)
        before = np.array(remote.truth()["q"])
        time.sleep(0.3)
        moved_rad = float(np.max(np.abs(np.array(remote.truth()["q"]) - before)))
    # rad: a servo settles by less; an arm that is still sent about goes on by 0.1
    return f"moved on by {moved_rad:.3f} rad" if moved_rad > 4e-3 else ""


def killed(host: str, whom: str, phase: str, at_s: float) -> str:
    """What is wrong after a replay whose child, parent, or both are killed at_s into a phase; an empty text if nothing is."""
    parent = replaying(host)
    try:
        assert parent.stdout is not None
        for line in parent.stdout:
            now, elapsed = line.split()
            if now == "aborted":
                return f"ended by {elapsed} {TOO_EARLY}"
            if now == phase and float(elapsed) >= at_s:
                break
        else:
            return f"the replay never came to its {phase}"
        family = children(parent.pid)
        for pid in {"child": family, "parent": [parent.pid], "both": [parent.pid, *family]}[whom]:
            os.kill(pid, signal.SIGKILL)
        # 0.1 s until the watchdog fires, 0.2 s to brake, the rest is scheduling on noisy cores
        wrong = stands(host, 1.0)
        if whom == "child":
            printed = parent.communicate(timeout=5.0)[0].split()
            wrong = wrong or ("" if printed[-2:] == ["aborted", "child_died"] else f"the parent printed {printed[-2:]}")
        else:
            parent.communicate(timeout=5.0)
    finally:
        parent.kill()
        parent.wait()
    with Dashboard(host) as dashboard:
        if dashboard.ask("running").lower() != "program running: false":
            return wrong or "a program runs"
    return wrong or (f"left: {family}" if any(alive(pid) for pid in family) else "")


def test_three_kills_at_random_moments_leave_a_standing_arm():
    """Each of the three is killed, in the approach or the play; the next replay works until its own kill. `make soak` kills a hundred."""
    rng = random.Random(9)
    with simulated_arm("127.0.2.25", ASIDE) as host:
        for whom in ("child", "parent", "both"):
            phase, longest = rng.choice([("approach", 0.5), ("play", 2.5), ("play", 2.5)])
            at_s = rng.uniform(0.0, longest)
            for _ in range(ATTEMPTS):
                wrong = killed(host, whom, phase, at_s)
                if not wrong.endswith(TOO_EARLY):
                    break
            assert wrong == "", f"{whom} killed {at_s:.2f} s into the {phase}"
