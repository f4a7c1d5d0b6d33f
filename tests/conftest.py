"""What the tests share: where the real recordings are, and loopback addresses that no two tests use at once."""

import atexit
import gc
import os
import re
import socket
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: threads for matrices this small only wait for each other

import forked_workers
import prepared
import pytest
import real_time
from hypothesis import settings

ROOT = Path(__file__).parent.parent
settings.register_profile("ours", deadline=None, derandomize=True)  # two noisy cores: no time limits; the same examples everywhere
settings.load_profile("ours")
prepared.prepare_streams()


# What moves an arm in real time, or waits for a few milliseconds of the clock: two chains, each one test after the other on one worker, the
# longest first. Two arms stand beside each other on two processors where both may go before all other work (`real_time`); elsewhere, and
# in the soak, both chains are one. A new such module joins the shorter chain by its name here (`test_house.py` asks for it). Before one is
# added, see `--durations=20` of it, and let it share an arm, a short trajectory (`excitations.short`) and a place near its start.
ONE_ARM = (
    "studies/test_demo.py",
    "cli/test_commands_motion.py",
    *(f"acquire/test_{name}.py" for name in ("replay", "kills", "live_collision", "many_replays", "polyscope_x", "refusals")),
    *(f"acquire/test_{name}.py" for name in ("child", "driver")),
)
ANOTHER_ARM = (
    *(f"acquire/test_{name}.py" for name in ("borrowed_arm", "way_back", "cuts", "fault_matrix", "arms_as_recorded")),
    "service/test_borrowing_daemon.py",
    "service/test_daemon.py",
    "simulate/test_sim_following.py",  # an arm that follows a stream: its client and its controller may sleep 60 ms at most
    *(f"acquire/test_{name}.py" for name in ("happenings", "idle_faults", "joint_limits", "last_resorts", "stop_ours")),
)
REAL_TIME = (*ONE_ARM, *ANOTHER_ARM)
# Modules that mostly wait, for a clock, a client, systemd: one test after the other on a worker of their own, which leaves most of its core
# to the others. Wall clock is over twice their processor time: see before one is added.
WAITING = (
    *(f"simulate/test_sim_{name}.py" for name in ("wire", "conformance", "faults", "judges", "state_bytes")),
    *(f"publish/test_{name}.py" for name in ("reach", "daemon_on_the_bus", "security", "outside_programs", "permit_words", "restarts")),
    *(f"publish/test_{name}.py" for name in ("metrics", "slow_clients", "bus")),
    *(f"service/test_{name}.py" for name in ("under_systemd", "tries")),
    "plant/test_on_the_bus.py",
    "plant/test_access.py",
    "store/test_archive_s3.py",
)
# a long test that begins last keeps everybody waiting
LONG = ("acquire/", "store/test_series.py", "studies/", "test_assess.py", "golden/", "cli/", "design/")
GIVE_WAY = 19  # niceness of the other workers, where the kernel knows no better way to let the arm go first
GIVE_SOME_WAY = 10  # of the worker that waits: before those that only compute, after the arm
# the page has a browser at its other end, and the browser has what the arms in real time leave of one core
ON_THE_WIRE = (*REAL_TIME, "acquire/", "simulate/", "publish/", "views/test_page_browser.py")
# for a client, a browser, a period: two thirds of the time on the wire
MOSTLY_WAITING = ("views/", "service/", "simulate/", "publish/")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is made while the tests are read stays: to look for rubbish in it again and again takes a third of that time, in each worker.

    It goes with the process: libraries that count what is left at its end would tell it as leaks.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        atexit.register(gc.unfreeze)  # not before: the last searches for rubbish of pytest would go through all of it
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # before the plugin that puts the groups into the names: by these it distributes them
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """An arm in real time, its monitor and the child between them are all that one of two cores carries: two such tests at a time, or one.

    These tests take longest, so they begin first; then come those that wait, modules that stay together, folders of long tests.
    A replay gives up when its targets come late, as it must, and on a machine with other work they do: such a test may try again,
    and says that it did. Evidence (`soak`) may not: what it counts, it counts.
    """
    items.sort(key=_rank)
    two_arms = real_time.permitted() and len(os.sched_getaffinity(0)) > 1
    for item in items:
        place = _place(item)
        if place.startswith(ANOTHER_ARM) and two_arms and item.get_closest_marker("soak") is None:
            item.add_marker(pytest.mark.xdist_group("another arm"))
        elif place.startswith(REAL_TIME):
            item.add_marker(pytest.mark.xdist_group("real time"))
        elif place.startswith(WAITING):
            item.add_marker(pytest.mark.xdist_group("waiting"))
        elif item.get_closest_marker("xdist_group") is None and (_has_module_fixture(item) or addresses(item.path)):
            # one worker prepares the fixture once, where others would prepare it again; and no two tests listen at one address at a time
            item.add_marker(pytest.mark.xdist_group(place))
        if place.startswith(ON_THE_WIRE) and item.get_closest_marker("soak") is None:
            item.add_marker(pytest.mark.flaky(reruns=3 if place.startswith(REAL_TIME) else 1, reruns_delay=2))


def _rank(item: pytest.Item) -> tuple[int, int, str]:
    """Where a test stands in the order: in real time, waiting, of a group, other; within these, by folders of long tests.

    The module's name comes last, so that the order is the same in workers that read the folders in another one.
    """
    place = _place(item)
    if place.startswith(REAL_TIME):
        return 0, next(rank for rank, prefix in enumerate(REAL_TIME) if place.startswith(prefix)), place
    if place.startswith(WAITING):
        return 1, next(rank for rank, prefix in enumerate(WAITING) if place.startswith(prefix)), place
    order = (*LONG, *MOSTLY_WAITING)
    within = next((rank for rank, prefix in enumerate(order) if place.startswith(prefix)), len(order))
    together = _has_module_fixture(item) or item.get_closest_marker("xdist_group") is not None
    return (2 if together and not place.startswith(MOSTLY_WAITING) else 3), within, place


def _place(item: pytest.Item) -> str:
    """A test's module, from the folder of all tests."""
    return _place_of(item.path)


@cache
def _place_of(module: Path) -> str:
    return module.relative_to(ROOT / "tests").as_posix()


def pytest_configure(config: pytest.Config) -> None:
    """Tests are handed out in the order in which they are sorted: xdist would begin with the groups of the most tests, not the longest."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    """The workers are forked from one process that has read the tests."""
    forked_workers.fork_workers(config.args)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that does other work gives way to the worker with the arm in real time, one that computes also to one that waits.

    A worker cannot rise again: real-time tests come first, then those that wait.

    A process of the idle class ends its turn at once when the arm wakes up; one that is only nice may first use up a part of it.
    """
    place = _place(item)
    real_time.wanted = place.startswith(REAL_TIME)
    if "PYTEST_XDIST_WORKER" not in os.environ or place.startswith(REAL_TIME):
        return
    if place.startswith(WAITING):
        os.nice(max(GIVE_SOME_WAY - os.nice(0), 0))
        return
    try:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    except (AttributeError, OSError):  # not Linux, or a container that forbids it
        os.nice(GIVE_WAY - os.nice(0))


@cache
def addresses(module: Path) -> frozenset[str]:
    """The loopback addresses that a module of tests names for itself; 127.0.0.1 is everybody's, with ports that the kernel chooses."""
    return frozenset(re.findall(r"127\.(?!0\.0\.)\d+\.\d+\.\d+", module.read_text(encoding="utf-8")))


def _has_module_fixture(item: pytest.Item) -> bool:
    """Whether a fixture of the test is prepared once for its module."""
    if not isinstance(item, pytest.Function):
        return False
    definitions = (each for several in item._fixtureinfo.name2fixturedefs.values() for each in several)
    return any(definition.scope == "module" for definition in definitions)


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
