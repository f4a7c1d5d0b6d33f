"""The process from which others are forked, by itself."""

import os
import signal
import socket
import subprocess
import sys

import pytest
from prepared import ROOT, SERVER


@pytest.mark.parametrize("reads", [["json"], ["--tests", "tests/model/test_joint_names.py"]], ids=["modules", "tests"])
def test_ctrl_c_ends_it_without_a_traceback(reads):
    """A terminal interrupts every process of the tests; what was interrupted, pytest alone says."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        with_signal = ["env", "--default-signal=INT"]  # what runs in the background of a script has inherited that SIGINT is ignored
        command = [*with_signal, sys.executable, str(SERVER), str(theirs.fileno()), *reads]
        path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        with subprocess.Popen(
            command, pass_fds=[theirs.fileno()], stderr=subprocess.PIPE, text=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": path}
        ) as process:
            try:
                assert ours.recv(1) == b"\n"  # it has read all, and waits
                process.send_signal(signal.SIGINT)
                _, said = process.communicate(timeout=30)
            finally:
                process.kill()
    assert process.returncode == 0, said
    assert said == ""
