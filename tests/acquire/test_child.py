"""A child process that hangs, and a controller that does not answer or is absent: both ends of the pipes, without a robot."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from excitations import short
from prepared import Process, run
from processes import children

from monitor.acquire.child import EXIT_ORPHANED
from monitor.acquire.listen import Listener, ListenSettings
from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.errors import MotionRefused, RobotUnreachable
from monitor.model.robot import load_robot

pytestmark = pytest.mark.real_time

ANSWERS = {
    "get robot model": "UR5",
    "get serial number": "2016331234",
    "PolyscopeVersion": "URSoftware 3.15.8.106339 (Sep 2021)",
    "is in remote control": "could not understand: is in remote control",
}


@contextmanager
def mute_controller(host, answers=ANSWERS):
    """A controller that accepts RTDE connections and never answers; its dashboard server works."""

    def talk(listening):
        while True:
            try:
                peer, _ = listening.accept()
            except OSError:
                return
            with peer, peer.makefile("rw", newline="\n") as lines:
                lines.write("Connected: Universal Robots Dashboard Server\n")
                lines.flush()
                for line in lines:
                    asked.append(line.strip())
                    lines.write(answers.get(line.strip(), "could not understand") + "\n")
                    lines.flush()

    asked = []
    with ExitStack() as stack:
        rtde = stack.enter_context(socket.create_server((host, 30004)))
        rtde.listen()
        dashboard = stack.enter_context(socket.create_server((host, 29999)))
        thread = threading.Thread(target=talk, args=(dashboard,), daemon=True)
        thread.start()
        yield asked
        dashboard.shutdown(socket.SHUT_RDWR)
        thread.join(2.0)


def test_a_controller_that_never_answers_is_given_up_and_its_child_reaped():
    """ur-rtde's constructor waits for ever, until the parent ends it. No `stop` is sent, because no program of ours runs."""
    settings = ReplaySettings(host="127.0.2.1", allow_motion=True, startup_timeout_s=1.5)
    with mute_controller("127.0.2.1") as asked:
        begun = time.monotonic()
        with pytest.raises(RobotUnreachable, match=r"no RTDE connection.*longer than 1\.5 s"):
            replay(short(), load_robot("ur5"), settings)
    took_s = time.monotonic() - begun
    assert took_s < 6.0  # 1.5 s of patience in each of two phases, an interpreter to start, and noise
    assert children() == []
    assert "stop" not in asked


def test_an_address_where_nobody_listens_is_unreachable():
    """The error comes within seconds and names the port that was tried."""
    with pytest.raises(RobotUnreachable, match="port 29999"):
        replay(short(), load_robot("ur5"), ReplaySettings(host="127.0.2.2", allow_motion=True))


@pytest.mark.parametrize(
    ("command", "answer", "words"),
    [("get robot model", "UR10", "UR10.*ur5"), ("is in remote control", "false", "local control")],
)
def test_a_controller_that_is_not_the_one_expected_is_refused_before_anything_starts(command, answer, words):
    """The controller says that it is another model, or that it is in local control."""
    with mute_controller("127.0.2.3", {**ANSWERS, command: answer}), pytest.raises(MotionRefused, match=words):
        replay(short(), load_robot("ur5"), ReplaySettings(host="127.0.2.3", allow_motion=True))
    assert children() == []


def test_a_listener_waits_longer_after_each_failure_and_reports_why():
    """The pauses between two tries grow; no process is started for them."""
    with socket.create_server(("127.0.2.4", 30004)) as controller:
        controller.setblocking(False)
        listener = Listener(ListenSettings(host="127.0.2.4", first_pause_s=0.1, longest_pause_s=10.0))
        tried, until = [], time.monotonic() + 30.0
        listener.start()
        while len(tried) < 4 and time.monotonic() < until:
            assert listener.poll() == []
            with suppress(BlockingIOError):
                controller.accept()[0].close()
                tried.append(time.monotonic())
            time.sleep(0.005)
        while not listener.problem and time.monotonic() < until:
            listener.poll()
    assert [later - earlier > pause for earlier, later, pause in zip(tried, tried[1:], (0.1, 0.2, 0.4), strict=False)] == [True] * 3
    assert not listener.reachable
    assert listener.latest() is None
    assert "127.0.2.4" in str(listener.problem)
    assert children() == []
    listener.stop()


def test_a_listener_gives_up_on_a_mute_controller():
    """The connection that says nothing is closed, and a later one is tried."""
    with mute_controller("127.0.2.5"):
        listener = Listener(ListenSettings(host="127.0.2.5", startup_timeout_s=1.0, first_pause_s=5.0))
        listener.start()
        until = time.monotonic() + 5.0
        while listener.problem is None and time.monotonic() < until:
            listener.poll()
            time.sleep(0.02)
        assert "no RTDE data" in str(listener.problem)
        assert children() == []
        listener.stop()


def test_a_prepared_streaming_process_is_what_the_program_itself_starts():
    """Parent, session, open files, and that it ends with its lifeline: the suite's quick start changes nothing but the time it takes."""
    seen = []
    for start in (subprocess.Popen, Process):
        reading, writing = os.pipe()
        command = [sys.executable, "-m", "monitor.acquire.ur.stream"]
        how = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "bufsize": 0}
        with start(command, **how, pass_fds=[writing], start_new_session=True) as child:
            os.close(writing)
            about = Path(f"/proc/{child.pid}")
            deadline = time.monotonic() + 30.0
            while not int(ignored(about), 16) & (1 << (signal.SIGTERM - 1)) and time.monotonic() < deadline:  # until it has begun
                time.sleep(0.01)
            parent, _, session = (about / "stat").read_text().rpartition(")")[2].split()[1:4]
            files = {int(file.name) for file in (about / "fd").iterdir()} == {0, 1, 2, writing}
            child.stdin.close()
            seen.append((int(parent), int(session) == child.pid, files, child.wait(10.0), child.stdout.read(), os.read(reading, 1)))
        os.close(reading)
    assert seen == [(os.getpid(), True, True, EXIT_ORPHANED, b"", b"")] * 2


def test_a_prepared_process_runs_a_script_without_arguments(tmp_path):
    """As `python script` does: the script's place is all of its arguments."""
    script = tmp_path / "script.py"
    script.write_text("import sys\nprint(sys.argv)\n")
    assert run([sys.executable, str(script)], 30.0).stdout == f"{[str(script)]}\n"


def ignored(about: Path) -> str:
    """The signals that a process ignores, as a hexadecimal number."""
    return next(line.split()[1] for line in (about / "status").read_text().splitlines() if line.startswith("SigIgn"))
