"""When a replay is needed, where the arm's ordinary work is observed."""

import math

import pytest

from monitor.acquire.schedule.needed import EVERY_WINDOW, Need, Told, need, needed_windows, suspicion_asks
from monitor.acquire.schedule.windows import ScheduleSettings, Window
from monitor.errors import BadInput
from monitor.reason import reason_of

DAY = 86_400.0
NOW = 1_780_272_000.0
SETTINGS = ScheduleSettings(replay="when_needed", at_most_days=30.0, unobserved_days=7.0, learning_days=14.0)
LEARNT = Told(NOW - 90 * DAY, NOW - 10 * DAY, (NOW,) * 6)


@pytest.mark.parametrize(
    ("told", "from_unix_s", "why"),
    [
        (Told(), -math.inf, "nothing is learnt yet"),
        (LEARNT._replace(began_unix_s=NOW - 20 * DAY), -math.inf, "the first 14 days"),
        (LEARNT._replace(asks=(2, 5)), -math.inf, "joints 2, 5"),
        (LEARNT._replace(suspects=(3,)), NOW - 8.5 * DAY, "work makes wear of joint 3 likely"),
        (LEARNT._replace(replayed_unix_s=NOW - DAY, suspects=(3,)), NOW + 0.5 * DAY, "replays shall tell"),
        (LEARNT._replace(replayed_unix_s=NOW - DAY, suspects=(3,), asks=(3,)), -math.inf, "work alone has found wear of joint 3"),
        (LEARNT._replace(replayed_unix_s=NOW - DAY, suspects=(3,), doubted=(5,)), -math.inf, "make a change of joint 5 likely"),
        (LEARNT._replace(doubted=(5,)), -math.inf, "the last replays make a change of joint 5 likely"),
        (LEARNT._replace(joints_unix_s=(NOW, NOW, NOW, NOW - 5 * DAY, NOW, NOW)), NOW + 2 * DAY, "enough of joint 4:"),
        (LEARNT._replace(joints_unix_s=(NOW, -math.inf, NOW, NOW, NOW, NOW)), -math.inf, "enough of joint 2:"),
        (LEARNT, NOW + 7 * DAY, "joints 1, 2, 3, 4, 5, 6"),
        (LEARNT._replace(replayed_unix_s=NOW - 26 * DAY), NOW + 4 * DAY, "30 days after the last replay"),
    ],
)
def test_a_replay_is_needed_from_the_first_reason_on(told, from_unix_s, why):
    found = need(SETTINGS, told)
    assert found.from_unix_s == from_unix_s
    assert why in found.why.text


MONTH = ScheduleSettings(replay="when_needed", unobserved_days=30.0, at_most_days=30.0, learning_days=14.0)


@pytest.mark.parametrize(("settings", "days_asked"), [(SETTINGS, [0, 2, 4, 6, 8]), (ScheduleSettings(), [0, 2, 4, 6, 8]), (MONTH, [0, 5])])
@pytest.mark.parametrize("hour", [0.5, 3.0, 12.0, 22.0])
def test_a_suspicion_asks_on_every_second_day_or_more_rarely_where_joints_may_be_untold_for_long(settings, days_asked, hour):
    """The work of a day is judged at midnight, and the window is after it."""
    replayed, days = None, []
    for day in range(10):
        midnight = NOW + day * DAY
        if suspicion_asks(settings, replayed, midnight):
            replayed = midnight + hour * 3600.0
            days.append(day)
    assert days == days_asked


def test_a_suspicion_asks_every_five_days_where_joints_may_be_untold_for_a_month():
    assert need(MONTH, LEARNT._replace(replayed_unix_s=NOW - DAY, suspects=(3,))).from_unix_s == NOW + 3.5 * DAY


@pytest.mark.parametrize(
    ("settings", "joints_unix_s", "from_unix_s", "why"),
    [
        (MONTH, (NOW, NOW, NOW, -math.inf, NOW, NOW), -math.inf, "enough of joint 4:"),
        (MONTH, (NOW, NOW, NOW, NOW - 29 * DAY, NOW, NOW), NOW + DAY, "enough of joint 4:"),
        (ScheduleSettings(replay="when_needed", unobserved_days=1.0, at_most_days=1.0), (NOW,) * 6, NOW, "1 days after the last replay"),
    ],
)
def test_a_suspicion_puts_off_no_replay_that_is_needed_without_it(settings, joints_unix_s, from_unix_s, why):
    told = LEARNT._replace(replayed_unix_s=NOW - DAY, joints_unix_s=joints_unix_s)
    assert need(settings, told) == need(settings, told._replace(suspects=(3,)))
    assert need(settings, told).from_unix_s == from_unix_s
    assert why in need(settings, told).why.text


def test_without_the_setting_every_window_needs_a_replay():
    assert need(ScheduleSettings(), LEARNT) == Need(-math.inf, EVERY_WINDOW())


def test_a_window_of_evidence_is_needed_whatever_production_has_told():
    windows = [Window(NOW, NOW, NOW + 600.0, why) for why in ("cron", "evidence")]
    assert [window.why for window in needed_windows(windows, Need(NOW + DAY, reason_of("later")))] == ["evidence"]


def test_a_joint_may_not_stay_untold_for_longer_than_the_arm_without_a_replay():
    with pytest.raises(BadInput, match="unobserved_days"):
        ScheduleSettings(replay="when_needed", at_most_days=5.0, unobserved_days=7.0)
