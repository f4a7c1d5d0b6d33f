"""What the tests share: where the real recordings are, and loopback addresses that no two tests use at once."""

import os
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Generator
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: threads for matrices this small only wait for each other

import pytest
from hypothesis import settings

ROOT = Path(__file__).parent.parent
settings.register_profile("ours", deadline=None, derandomize=True)  # two noisy cores: no time limits; the same examples everywhere
settings.load_profile("ours")


# what moves an arm in real time, or waits for a few milliseconds of the clock
REAL_TIME = (
    "studies/test_demo.py",
    *(
        f"acquire/test_{name}.py"
        for name in (
            "arms_as_recorded",
            "child",
            "cuts",
            "driver",
            "fault_matrix",
            "idle_faults",
            "joint_limits",
            "kills",
            "last_resorts",
            "live_collision",
            "many_replays",
            "refusals",
            "replay",
            "stop_ours",
        )
    ),
    "cli/test_commands_motion.py",
    "service/test_daemon.py",
)
# a long test that begins last keeps everybody waiting
LONG = ("acquire/", "store/test_series.py", "studies/", "test_assess.py", "golden/", "cli/", "design/")
GIVE_WAY = 19  # niceness of the other workers: they hardly delay the arm, and get what it leaves
ON_THE_WIRE = (*REAL_TIME, "acquire/", "simulate/", "publish/")
BESIDE_THE_ARM = 2  # workers; further ones begin when no arm moves in real time any more, and use the time in which tests wait
# for a client, a browser, a period: two thirds of the time on the wire; they come when there are more workers, the longest first
MOSTLY_WAITING = ("views/", "service/", "simulate/", "publish/")
SHARED = "JOINT_MONITOR_TESTS"  # environment: a folder of this run, which all workers see
AT_MOST_S = 1200.0  # the worker with the arm was killed


@pytest.hookimpl(tryfirst=True)  # before the plugin that puts the groups into the names: by these it distributes them
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """An arm in real time, its monitor and the child between them are all that one of two cores carries: one such test at a time.

    These tests take longest, so they begin first; then come modules that stay together, then folders of long tests.
    A replay gives up when its targets come late, as it must, and on a machine with other work they do: such a test may try again,
    and says that it did. Evidence (`soak`) may not: what it counts, it counts.
    """
    items.sort(key=_rank)
    for item in items:
        place = item.path.relative_to(ROOT / "tests").as_posix()
        if place.startswith(REAL_TIME):
            item.add_marker(pytest.mark.xdist_group("real time"))
        elif item.get_closest_marker("xdist_group") is None and _has_module_fixture(item):
            item.add_marker(
                pytest.mark.xdist_group(place)
            )  # one worker prepares the fixture once; three workers would prepare it three times
        if place.startswith(ON_THE_WIRE) and item.get_closest_marker("soak") is None:
            item.add_marker(pytest.mark.flaky(reruns=2 if place.startswith(REAL_TIME) else 1, reruns_delay=2))


def _rank(item: pytest.Item) -> int:
    """Where a test stands in the order: in real time, with a fixture of its module, in folders of long tests, mostly waiting, other."""
    place = item.path.relative_to(ROOT / "tests").as_posix()
    if place.startswith(REAL_TIME):
        return next(rank for rank, prefix in enumerate(REAL_TIME) if place.startswith(prefix))
    if _has_module_fixture(item) and not place.startswith(MOSTLY_WAITING):
        return len(REAL_TIME)
    order = (*LONG, *MOSTLY_WAITING)
    return len(REAL_TIME) + next((rank for rank, prefix in enumerate(order, start=1) if place.startswith(prefix)), len(order) + 1)


def _in_real_time(item: pytest.Item | None) -> bool:
    return item is not None and item.path.relative_to(ROOT / "tests").as_posix().startswith(REAL_TIME)


def pytest_configure(config: pytest.Config) -> None:
    """The process that starts the workers makes the folder that they share."""
    if not hasattr(config, "workerinput"):
        os.environ[SHARED] = tempfile.mkdtemp(prefix="joint-monitor-tests-")


def pytest_unconfigure(config: pytest.Config) -> None:
    """It removes the folder at the end."""
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ[SHARED], ignore_errors=True)


@pytest.hookimpl(wrapper=True, tryfirst=True)  # around the time limit: waiting is no part of a test
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, object, object]:
    """A worker that would be one too many beside an arm in real time waits until the last such test is over."""
    number = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    if number >= BESIDE_THE_ARM and not _in_real_time(item) and any(map(_in_real_time, item.session.items)):
        until = time.monotonic() + AT_MOST_S
        while not _over().exists() and time.monotonic() < until:
            time.sleep(0.5)
    result = yield
    if _in_real_time(item) and not _in_real_time(nextitem):
        _over().touch()
    return result


def pytest_sessionfinish() -> None:
    """A worker that ends, for whatever reason, keeps nobody waiting."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        _over().touch()


def _over() -> Path:
    """It exists once no test of this run moves an arm in real time any more."""
    return Path(os.environ[SHARED]) / "no arm moves"


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that does other work gives way to the worker with the arm in real time. It cannot rise again: real-time tests come first."""
    place = item.path.relative_to(ROOT / "tests").as_posix()
    if os.environ.get("PYTEST_XDIST_WORKER") and not place.startswith(REAL_TIME) and os.nice(0) < GIVE_WAY:
        os.nice(GIVE_WAY - os.nice(0))


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
