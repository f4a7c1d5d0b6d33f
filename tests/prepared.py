"""Processes that begin at once: each is forked from one that has done the imports of our program, or of the simulator, already.

The suite starts these dozens of times, and the imports are most of what a start costs: 0.4 s of processor time for a simulated arm and for
the process that streams targets, 1 s for the daemon. What runs is the same code in a process of its own, a child of the test's process: it
can be killed, waited for and measured like any other. `python -m monitor` itself is started by the tests that say so, and by everything
outside of the tests; a daemon or a command in a process of its own starts its streaming process as it does everywhere.
"""

import atexit
import ctypes
import inspect
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from monitor.acquire import child as process

ROOT = Path(__file__).parent.parent
SERVER = ROOT / "tests" / "prepared_start.py"
PR_SET_CHILD_SUBREAPER = 36  # option of prctl(2): orphans become children of this process
IMPORTS = {
    "simulate": ("monitor.simulate.server",),
    "monitor": ("monitor.cli.main", "monitor.service.run"),
    # what the module imports, and not itself: it is run as a program
    "stream": ("monitor.acquire.ur.lend", "monitor.acquire.ur.upload", "monitor.acquire.driver"),
}
STREAMS = "monitor.acquire.ur.stream"
KINDS = {"monitor.simulate": "simulate", STREAMS: "stream"}  # by the module that is run; else "monitor"
# what a prepared process cannot do otherwise
PLAIN = {"preexec_fn": None, "executable": None, "close_fds": True, "shell": False, "restore_signals": True, "umask": -1}
PLAIN |= {"process_group": -1, "uid": None, "gid": None, "gids": None}
real_time = False  # whether arms and streams that are started now go before other work, where the system permits it
_adopting = threading.Lock()  # one start at a time, of whatever kind: whether orphans are adopted is a state of this whole process


class _Preparation:
    """One process with some imports done. It forks when it is asked, and ends with the test's process."""

    def __init__(self, kind: str) -> None:
        self._wire, theirs = socket.socketpair()
        with theirs:
            command = [sys.executable, str(SERVER), str(theirs.fileno()), *IMPORTS[kind]]
            path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))  # this checkout, whatever is installed
            # no threads of numpy, none of pyarrow's memory: a process with threads cannot be forked
            alone = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "JE_ARROW_MALLOC_CONF": "background_thread:false"}
            environment = {**os.environ, "PYTHONPATH": path, **alone}
            self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, env=environment)
        self._wire.recv(1)  # the imports are done: from now on a start takes milliseconds, and orphans are adopted for no longer
        atexit.register(self._end)

    def start(self, request: dict[str, Any], streams: list[int]) -> int:
        """Fork. The id of the new process, which is a child of this one."""
        text = json.dumps(request).encode()
        prctl = ctypes.CDLL(None, use_errno=True).prctl
        with _adopting:
            prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
            try:
                socket.send_fds(self._wire, [len(text).to_bytes(4, "big")], streams)
                self._wire.sendall(text)
                answer = self._wire.recv(8, socket.MSG_WAITALL)
            except BaseException:
                self._wire.close()  # the next start would take this one's answer for its own
                raise
            finally:
                prctl(PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)
        if len(answer) < 8:
            raise RuntimeError(f"{SERVER.name} has ended: {self._process.wait()}")
        pid = int.from_bytes(answer, "big")
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)  # raises where it is no child: its end would be told as 0
        return pid

    @property
    def pid(self) -> int:
        """The id of the process that forks."""
        return self._process.pid

    def _end(self) -> None:
        self._wire.close()
        self._process.wait()


_prepared: dict[str, _Preparation] = {}
_preparing = threading.Lock()


def _preparation(kind: str) -> _Preparation:
    with _preparing:
        if kind not in _prepared:
            _prepared[kind] = _Preparation(kind)
        return _prepared[kind]


def permitted() -> bool:
    """Whether the system lets a process of ours go before others."""
    return (
        subprocess.run(["chrt", "--rr", "20", "true"], capture_output=True, check=False).returncode == 0 if shutil.which("chrt") else False
    )


def waiting() -> set[int]:
    """The ids of the processes that only wait to be forked: children of this process too."""
    return {preparation.pid for preparation in _prepared.values()}


class Process(subprocess.Popen):
    """`subprocess.Popen` of `[sys.executable, "-m", module, …]`, `["-c", code, …]` or `[script, …]` that saves the imports."""

    def _kind(self, command: list[str]) -> str:
        return KINDS.get(command[2], "monitor") if command[1] == "-m" else "monitor"

    def _execute_child(self, *given: Any, **named: Any) -> None:
        how = inspect.signature(subprocess.Popen._execute_child).bind(self, *given, **named).arguments
        command = list(map(str, how["args"]))
        assert command[0] == sys.executable
        assert {name: how[name] for name in PLAIN} == PLAIN
        environment = dict(how["env"] or os.environ)
        assert environment.get("PYTHONPATH") == os.environ.get("PYTHONPATH"), "where imports are found was decided before"
        pipes = [how[name] for name in ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")]
        streams = [stream if stream != -1 else number for number, stream in enumerate((pipes[0], pipes[3], pipes[5]))]
        request = {
            "arguments": command[1:],
            "folder": str(how["cwd"] or Path.cwd()),
            "environment": environment,
            "niceness": os.nice(0),
            "policy": os.sched_getscheduler(0),
            "real_time": real_time,
            "session": how["start_new_session"],
            "descriptors": [int(number) for number in how["pass_fds"]],
        }
        self.pid = _preparation(self._kind(command)).start(request, [*streams, *request["descriptors"]])
        self._child_created = True
        self._close_pipe_fds(*pipes)


def run(command: list[str], timeout_s: float, cwd: Path | None = None) -> "subprocess.CompletedProcess[str]":
    """The command with its output, at its end."""
    with Process(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd) as process:
        try:
            output, errors = process.communicate(timeout=timeout_s)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(command, process.returncode, output, errors)


def _start(command: list[str], **how: Any) -> "subprocess.Popen[bytes]":
    """What streams targets for this process is started like a `Process`; its other children as everywhere."""
    return (Process if command[2] == STREAMS else subprocess.Popen)(command, **how)


process.subprocess = SimpleNamespace(**{**vars(subprocess), "Popen": _start})  # type: ignore[assignment]
