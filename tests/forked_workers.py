"""Workers that are forked from one process that has read the tests: to import all of them costs 9 s of processor time, once a worker.

A worker looks for its tests as everywhere, and finds their modules imported. What it runs is the same, in a process of its own, which ends
without taking down what was imported.
"""

import io
import os
import subprocess
from contextlib import redirect_stdout
from typing import Any

import prepared
import pytest
from execnet import gateway_base, gateway_io

KIND = "tests"
READ = "--tests"  # before the paths of the tests, in the place of modules to import


def fork_workers(paths: list[str]) -> None:
    """From now on, the workers that this process starts for the tests of `paths` are forked."""
    prepared.IMPORTS[KIND] = (READ, *paths)
    gateway_io.Popen2IOMaster.__init__ = _begin  # type: ignore[method-assign]


class _Worker(prepared.Process):
    """A worker, from the command by which execnet starts it."""

    def _kind(self, command: list[str]) -> str:
        return KIND


def _begin(master: gateway_io.Popen2IOMaster, command: list[str], execmodel: Any) -> None:
    python, unbuffered, *code = command
    assert unbuffered == "-u", command  # no file of the worker is buffered that execnet reads or writes
    master.popen = _Worker([python, *code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    gateway_base.Popen2IO.__init__(master, master.popen.stdin, master.popen.stdout, execmodel)


class _WithoutReruns:
    """What stands for the plugin that runs a test again, which listens in a thread: its mark."""

    @staticmethod
    def pytest_configure(config: pytest.Config) -> None:
        config.addinivalue_line("markers", "flaky: a test that may run again")


def read(paths: list[str]) -> None:
    """Import the tests of these paths, as pytest does it. What cannot be imported, each worker finds again and reports."""
    os.environ.pop("PYTEST_ADDOPTS", None)
    with redirect_stdout(io.StringIO()):
        pytest.main([*paths, "--collect-only", "-qq", "-p", "no:cacheprovider", "-p", "no:rerunfailures"], [_WithoutReruns()])
