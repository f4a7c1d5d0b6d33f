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
