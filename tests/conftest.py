"""What the tests share: how they are handed to workers, where the real recordings are, a port of loopback."""

import gc
import os
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: threads for matrices this small only wait for each other

import prepared
import pytest
from hypothesis import settings

ROOT = Path(__file__).parent.parent
ON_THE_WIRE = {"acquire", "simulate", "publish", "views"}  # folders whose tests wait for a client or a browser on a busy machine
settings.register_profile(
    "ours", deadline=None, derandomize=True, max_examples=40
)  # no time limits on a busy machine; the same examples everywhere
settings.load_profile("ours")
gc.disable()  # until the tests are read: to look for rubbish in what stays takes a third of that time, in each worker


@pytest.hookimpl(tryfirst=True)  # before the plugin that distributes by these groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A module stays on one worker, so that what it prepares is prepared once. First comes what moves an arm in real time (`real_time`).

    Its modules follow each other on two workers where their processes may go before others, else on one. A replay ends as `late` on a
    machine with other work, as it must: such a test may run again, and says so; evidence (`soak`) may not.
    """
    modules = sorted({str(item.path) for item in items if item.get_closest_marker("real_time")})
    arms = 2 if prepared.permitted() and len(os.sched_getaffinity(0)) > 1 else 1
    moving = {module: number % arms for number, module in enumerate(modules)}  # on which of the workers with an arm
    items.sort(key=lambda item: (str(item.path) not in moving, item.get_closest_marker("xdist_group") is None))
    for item in items:
        soak, arm = item.get_closest_marker("soak") is not None, moving.get(str(item.path))
        if arm is not None:
            item.add_marker(pytest.mark.xdist_group(f"arm {0 if soak else arm}"))
        elif item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.stem))
        if not soak and (arm is not None or item.path.parent.name in ON_THE_WIRE):
            item.add_marker(pytest.mark.flaky(reruns=1 if arm is None else 2, reruns_delay=2))


def pytest_configure(config: pytest.Config) -> None:
    """Groups are handed out in this order: xdist would begin with those of the most tests."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_collection_finish() -> None:
    """From here on, rubbish is looked for, and not among what all tests share."""
    gc.freeze()
    gc.enable()


def pytest_sessionfinish() -> None:
    """At the end everything is: libraries complain of what is left."""
    gc.unfreeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that does other work gives way to an arm in real time; those come first, because nobody may rise again."""
    prepared.real_time = item.get_closest_marker("real_time") is not None
    if "PYTEST_XDIST_WORKER" in os.environ and not prepared.real_time:
        with suppress(AttributeError, OSError):  # not Linux, or a container that forbids it
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))  # ends its turn at once when the arm wakes up


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings, which are not ours to ship."""
    folder = Path(os.environ.get("JOINT_MONITOR_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("the real recordings are absent: set JOINT_MONITOR_DATA to their folder")
    return folder


@pytest.fixture
def soak_row(record_property: Callable[[str, object], None]) -> Callable[[str, str, str], None]:
    """A line of the table that a soak ends with: what was done, what came out, what was asked."""
    return lambda what, found, asked: record_property("soak", f"{what}|{found}|{asked}")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The soak's table."""
    reports = [report for kind in ("passed", "failed") for report in terminalreporter.getreports(kind)]
    rows = [(str(value).split("|"), report.outcome) for report in reports for name, value in report.user_properties if name == "soak"]
    if rows:
        terminalreporter.section("soak")
        for (what, found, asked), outcome in rows:
            terminalreporter.write_line(f"{what:<60} {found:>24}   asked {asked:<16} {outcome}")


@pytest.fixture
def free_port() -> int:
    """A TCP port of 127.0.0.1 that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
