"""One look at an arm, receive-only: what every condition says, without uploading a program and without moving anything.

ur-rtde lives in a child process (`python -m monitor.acquire.check`), as everywhere.
"""

import time

import numpy as np

from monitor.acquire.safety.conditions import ConditionInputs, ConditionResult, Permit, conditions
from monitor.acquire.safety.gate import AskPermit
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState, arm_state
from monitor.acquire.ur.child import Child, ChildLost
from monitor.acquire.ur.dashboard import identity
from monitor.errors import RobotUnreachable
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Array, Context

LOOKS = 13  # rows whose accelerometer is averaged: 0.1 s at 125 Hz


def check(
    settings: ReplaySettings,
    excitation: Excitation,
    robot: Robot,
    context: Context,
    *,
    stopped_before: str | None = None,
    ask: AskPermit | None = None,
) -> tuple[ConditionResult, ...]:
    """Every condition as it is now. An arm that does not answer is told by its conditions; nothing is raised for it."""
    try:
        who = identity(settings.host)
    except RobotUnreachable:
        who = None
    permit: Permit | None = None
    if settings.permit == "zenoh" and ask is not None:
        permit = ask({"robot": robot.name, "only_a_check": True}, settings.permit_timeout_s)
        permit = permit or Permit(False, f"permit/replay: no answer within {settings.permit_timeout_s:g} s")
    return conditions(
        ConditionInputs(
            settings=settings,
            excitation=excitation,
            robot=robot,
            context=context,
            now_unix_s=time.time(),
            identity=who,
            state=look(settings.host, settings.rate_hz, settings.startup_timeout_s),
            stopped_before=stopped_before,
            permit=permit,
        )
    )


def look(host: str, rate_hz: float, timeout_s: float) -> ArmState | None:
    """The arm's state now; None where no RTDE data comes in that time."""
    child = Child("monitor.acquire.check", {"host": host, "rate_hz": rate_hz})
    until = time.monotonic() + timeout_s
    try:
        while time.monotonic() < until:
            for frame in child.frames(0.05):
                if isinstance(frame, dict):
                    return None
                return arm_state(frame)
    except ChildLost:
        return None
    finally:
        child.end()
    return None


def main() -> None:
    """The child: one row, its accelerometer averaged, or why there is none; never returns."""
    from monitor.acquire.rows import COLUMN, Torn, connect_receiver, snapshot
    from monitor.acquire.ur.child import begin, leave

    job, outbox, lifeline = begin()
    try:
        receive, signals = connect_receiver(job["host"], job["rate_hz"])
        rows: list[Array] = []
        told_s = None
        while receive.isConnected() and len(rows) < LOOKS:
            if receive.getTimestamp() != told_s:
                row, _ = snapshot(receive, signals)
                told_s = row[0]
                rows.append(row)
            lifeline.word()
            time.sleep(0.001)
        if len(rows) == LOOKS:
            place = COLUMN["actual_tool_accelerometer"]
            rows[-1][place] = np.mean([row[place] for row in rows], axis=0)
            outbox.row(rows[-1])
            leave(0)
        outbox.message("lost", text="the RTDE connection was lost")
    except (RuntimeError, Torn) as error:
        outbox.message("lost", text=f"RTDE: {error}")
    leave(1)


if __name__ == "__main__":
    main()
