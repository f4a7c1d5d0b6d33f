"""Checks an arm without moving it: what every condition finds now. The arm is only listened to, and no program is uploaded."""

import time

from monitor.acquire.driver import Driver
from monitor.acquire.safety.conditions import conditions
from monitor.acquire.safety.gate import AskPermit
from monitor.acquire.safety.inputs import ConditionInputs, ConditionResult, LastMotion, Permit
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.acquire.ur.driver import UNIVERSAL_ROBOTS
from monitor.errors import RobotUnreachable
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Context


def check(
    settings: ReplaySettings,
    excitation: Excitation,
    robot: Robot,
    context: Context,
    *,
    installation: Installation | None = None,
    last: LastMotion | None = None,
    ask: AskPermit | None = None,
    driver: Driver = UNIVERSAL_ROBOTS,
) -> tuple[ConditionResult, ...]:
    """Every condition as it is now.

    last : how the last motion ended; None: there was none. `ask` asks for somebody else's permit. An arm that does not answer fails the
    conditions that need its answer; nothing is raised for it.
    """
    identity, unreachable, last = None, "", last or LastMotion()
    try:
        identity = driver.identity(settings.host)
    except RobotUnreachable as error:
        unreachable = str(error)
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
            identity=identity,
            unreachable=unreachable,
            state=driver.state(settings.host, settings.rate_hz, settings.startup_timeout_s),
            stopped_before=last.stopped_before,
            expected_serial=last.expected_serial,
            permit=permit,
            installation=installation or Installation(),
            left=last.left,
        )
    )
