"""Which joints no replay has updated for a long time. A stale joint is neither good nor bad, and is shown as stale."""

from collections.abc import Sequence

from monitor.judge.alerts.health import Health
from monitor.judge.alerts.settings import HealthSettings
from monitor.reason import joint_name
from monitor.recording import DAY_S


def stale_joints(health: Health, now_unix_s: float, settings: HealthSettings) -> tuple[bool, ...]:
    """(J,) whether the last replay that updated a joint is older than `stale_days`, or there is none."""
    limit = now_unix_s - settings.stale_days * DAY_S
    return tuple(joint.learnt_at_unix_s is None or joint.learnt_at_unix_s < limit for joint in health.joints)


def stale_text(stale: Sequence[int], joints: int, since: str, then: str) -> str:
    """The sentence that bus, page and report publish of stale joints.

    stale : numbers of the stale joints, from 1; joints : J; since : for how long; then : the time that the state does not stand for.
    """
    who = "all joints" if len(stale) == joints else ", ".join(map(joint_name, stale))
    return f"STALE: {who}: nothing was learnt {since}: the state is of then, not of {then}"
