"""The other side of `prepared.py`: import what is named, then fork for each request and run what it asks for.

The forked process is forked twice, and the one between them ends: so the new process becomes a child of the test's process, which has
asked the kernel for that, and which waits for it like for any other child.
"""

import fcntl
import gc
import importlib
import json
import os
import runpy
import socket
import subprocess
import sys
import time
import types
from contextlib import suppress
from typing import Any

DESCRIPTORS_MAX = 8  # of one request: the standard streams, and what else the process gets
PRIORITIES = {"monitor.simulate": 20, "monitor.acquire.ur.stream": 19}  # of SCHED_RR: the arm goes before its client, both before others


def main() -> None:
    """Fork for each request until the other side ends; only forked processes return from `requests`."""
    wire = socket.socket(fileno=int(sys.argv[1]))
    for name in sys.argv[2:]:
        importlib.import_module(name)
    gc.collect()
    gc.freeze()
    try:
        wire.sendall(b"\n")
        request = requests(wire)
    except KeyboardInterrupt:  # Ctrl-C ends the tests, which say so
        request = None
    if request is not None:
        become(request)


def requests(wire: socket.socket) -> dict[str, Any] | None:
    """In the process that forks: None at the end. In a forked one: its request, with its standard streams in place."""
    while True:
        head, streams, _, _ = socket.recv_fds(wire, 4, DESCRIPTORS_MAX)
        if not head:
            return None
        request: dict[str, Any] = json.loads(wire.recv(int.from_bytes(head, "big"), socket.MSG_WAITALL))
        assert len(os.listdir("/proc/self/task")) == 1, "a process with threads cannot be forked"
        reading, writing = os.pipe()
        between = os.fork()
        if between == 0:
            parent = os.getpid()
            pid = os.fork()
            if pid != 0:
                os.write(writing, pid.to_bytes(8, "big"))
                os._exit(0)
            for fd in (reading, writing):
                os.close(fd)
            wire.close()  # before its number is taken for another
            put(streams, [0, 1, 2, *request["descriptors"]])
            while os.getppid() == parent:
                time.sleep(0.0005)
            return request
        assert os.waitpid(between, 0)[1] == 0, "no process could be forked"  # nobody has written to the pipe
        wire.sendall(os.read(reading, 8))
        for fd in (reading, writing, *streams):
            os.close(fd)


def put(streams: list[int], numbers: list[int]) -> None:
    """Give each open file the number that it has in the process that asked; nothing else stays open."""
    above = max(*streams, *numbers) + 1
    apart = [fcntl.fcntl(stream, fcntl.F_DUPFD_CLOEXEC, above) for stream in streams]  # where no number is wanted
    for stream in streams:
        os.close(stream)
    for stream, number in zip(apart, numbers, strict=True):
        os.dup2(stream, number)
        os.close(stream)


def let_streams_go_first() -> None:
    """What a daemon of this process starts to stream targets gets the priority that it has where a test starts it."""
    from monitor.acquire import child

    def start(command: list[str], **how: Any) -> "subprocess.Popen[bytes]":
        process = subprocess.Popen(command, **how)
        if command[2] in PRIORITIES:
            with suppress(OSError):  # where the system permits none
                os.sched_setscheduler(process.pid, os.SCHED_RR, os.sched_param(PRIORITIES[command[2]]))
        return process

    child.subprocess = types.SimpleNamespace(**{**vars(subprocess), "Popen": start})  # type: ignore[assignment]


def become(request: dict[str, Any]) -> None:
    """Do in this process what `python` does with these arguments. Its standard streams are there: they read and write the same numbers."""
    what, *rest = request["arguments"]
    if request["policy"] != os.sched_getscheduler(0):
        os.sched_setscheduler(0, request["policy"], os.sched_param(0))
    if what == "-m" and rest[0] in PRIORITIES and request["real_time"]:
        with suppress(OSError):  # where the system permits none
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITIES[rest[0]]))
    elif request["real_time"]:
        let_streams_go_first()
    if request["niceness"] > os.nice(0):
        os.nice(request["niceness"] - os.nice(0))
    if request["session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    time.tzset()
    sys.orig_argv = [sys.executable, what, *rest]
    if what == "-m":
        sys.argv, sys.path[0] = rest, request["folder"]
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    elif what == "-c":
        sys.argv, sys.path[0] = ["-c", *rest[1:]], ""
        sys.modules["__main__"] = program = types.ModuleType("__main__")
        exec(compile(rest[0], "<string>", "exec"), program.__dict__)
    else:
        sys.argv, sys.path[0] = [what, *rest], os.path.dirname(what)
        runpy.run_path(what, run_name="__main__")


if __name__ == "__main__":
    main()
