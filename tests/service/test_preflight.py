"""What `joint-monitor check` finds of the host itself."""

from pathlib import Path

import pytest

from monitor.config.load import from_document
from monitor.service import preflight


def socket_lock(folder: Path, *, allow_motion: bool):
    replay = {"allow_motion": allow_motion, "cell": "unchecked"}
    document = {"robot": {"model": "ur5", "site": "lab", "id": "a"}, "replay": replay, "store": {"directory": "history"}}
    configuration = from_document(document, folder / "monitor.toml")
    return {each.name: each for each in preflight.service_conditions(configuration)}["socket_lock"]


def test_check_tries_whether_the_kernel_lets_a_process_forbid_itself_new_connections(tmp_path: Path):
    """The filter is set for good, so a process of its own tries it; this one goes on connecting."""
    found = socket_lock(tmp_path, allow_motion=True)
    assert found.holds
    assert found.checked


@pytest.mark.parametrize(("allow_motion", "holds"), [(True, False), (False, True)])
def test_where_the_kernel_refuses_check_says_so_before_a_window_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, allow_motion, holds):
    """A monitor that may not move an arm anyway needs no such filter."""
    monkeypatch.setattr(preflight, "SOCKET_LOCK", "print('seccomp is not available: Function not implemented')")
    found = socket_lock(tmp_path, allow_motion=allow_motion)
    assert found.holds == holds
    assert "seccomp is not available" in found.text
    assert "systemd unit must permit" in found.text


NOVEMBER_UNIX_S = 1_795_996_800.0  # 2026-11-30 00:00 UTC


@pytest.mark.parametrize(
    ("schedule", "windows_utc", "said"),
    [
        ({"cron": "0 3 31 2 *"}, [], "cron = '0 3 31 2 *' names no time within 400 days"),
        ({"cron": "0 3 * * *"}, ["12:00-13:00"], "no window of the schedule within 400 days lies in windows_utc (12:00-13:00)"),
        ({"cron": "", "every_h": 24.0}, ["12:00-13:00"], "no window of the schedule within 400 days lies in windows_utc"),
        ({"cron": "0 3 * * *"}, [], None),
        ({"cron": "55 11 * * *"}, ["12:00-13:00"], None),  # it is open for ten minutes, and the arm may move in the last five
        ({"cron": "0 3,12 * * *"}, ["12:00-13:00"], None),
        ({"cron": ""}, ["12:00-13:00"], None),  # by request alone
    ],
)
def test_check_names_a_schedule_in_which_the_arm_would_never_move(tmp_path: Path, schedule, windows_utc, said):
    """No date within the days that are searched, or none within the hours in which the arm may move."""
    document = {"robot": {"model": "ur5", "site": "lab", "id": "a"}, "replay": {"windows_utc": windows_utc}, "schedule": schedule}
    configuration = from_document(document, tmp_path / "monitor.toml")
    found = {each.name: each for each in preflight.service_conditions(configuration, NOVEMBER_UNIX_S)}["schedule"]
    assert found.holds == (said is None)
    assert said is None or said in found.text
