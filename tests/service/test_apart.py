"""Computations in a process of their own: their results, their errors, and a process that is killed."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from excitations import short
from processes import children

from monitor.config.load import load
from monitor.errors import BadInput, StoreUnavailable
from monitor.judge.document import plain
from monitor.recording import Recording
from monitor.service import replay as replay_cycle
from monitor.service.computing import HERE, Apart, Compute, ComputingFailed
from monitor.service.daemon import Daemon
from monitor.service.history.assess_and_store import EstimatorState, Verdict, inputs_of, keep_and_judge
from monitor.service.motion import written_apart
from monitor.service.page import answered
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import read_recording
from monitor.store.store import Store

NOON = 1.78e9


@pytest.fixture(scope="module")
def recording() -> Recording:
    return stepped_replay(Controller(SimulateSettings(robot="ur5")), replace(short(), repetitions=3))


def of(folder: Path, port: int = 7447):
    (folder / "cell.toml").write_text(
        f'[robot]\nmodel = "ur5"\nsite = "lab"\nid = "a"\n[store]\ndirectory = "history"\n[bus]\nlisten = ["tcp/127.0.0.1:{port}"]\n'
    )
    return load(folder / "cell.toml")


def documents(verdict: Verdict) -> str:
    parts = verdict.document, verdict.belief.as_document(), verdict.health.as_document(), verdict.model.as_document()
    return json.dumps(plain((*parts, verdict.friction, verdict.temperature_c, verdict.sample_var, verdict.maintenance)), default=repr)


def test_a_process_of_its_own_gives_the_same_verdict_to_the_last_bit(tmp_path: Path, recording: Recording):
    """The recording is on disk before its verdict comes; nothing of the child stays."""
    configuration, alive = of(tmp_path), []
    context = replace(recording.context, recorded_at_unix_s=NOON)
    inputs, given = inputs_of(configuration, EstimatorState()), replace(recording, context=context, source="replay.parquet")
    found = []
    for folder, compute in (("here", HERE), ("apart", Apart(lambda: alive.append(True)))):
        path = tmp_path / folder / "replay.parquet"
        path.parent.mkdir()
        steps = compute.steps(keep_and_judge, path, given, inputs)
        assert next(steps) is None
        assert path.is_file()
        (verdict,) = steps
        assert isinstance(verdict, Verdict), verdict
        found.append(documents(verdict))
    assert found[0] == found[1]
    assert alive
    assert children() == []


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        ((read_recording, "/absent.parquet"), BadInput, "no such file"),
        ((int, "x"), ComputingFailed, "internal: ValueError"),
        ((os.kill, 0, signal.SIGKILL), ComputingFailed, "ended by signal 9"),
        ((os._exit, 3), ComputingFailed, "ended early"),
    ],
)
def test_what_ends_a_computation_reaches_its_caller(call: tuple, error: type[Exception], text: str):
    """An error of this program's as itself; a process that was killed as what it is: its group is its own, so that nobody else is."""
    with pytest.raises(error, match=text):
        Apart()(*call)
    assert children() == []


@pytest.mark.parametrize("fails", [(os, "pipe"), (subprocess, "Popen")])
def test_a_machine_without_room_for_a_process_is_told_as_such(monkeypatch, fails: tuple):
    """The recording waits for another try, as after a process that was killed."""

    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(*fails, refused)
    with pytest.raises(ComputingFailed, match="no process can be started: Too many open files"):
        Apart()(abs, -1)


class Failing:
    """Fails so often, before the recording is written or after it, and computes here then."""

    def __init__(self, times: int, *, before_writing: bool = False) -> None:
        self.left, self.before_writing = times, before_writing

    def _fail(self) -> None:
        if self.left:
            self.left -= 1
            raise ComputingFailed("the computing process was ended by signal 9")

    def __call__(self, function: Callable, *args: object) -> object:
        self._fail()
        return function(*args)

    def steps(self, function: Callable, *args: object) -> Generator:
        if self.before_writing:
            self._fail()
        results = function(*args)
        yield next(results)
        self._fail()
        yield from results


@pytest.fixture
def daemon(tmp_path: Path, free_port: int, recording: Recording) -> Iterator[Callable[[Compute], Daemon]]:
    """Makes a daemon that plays one recording."""
    with Store.open(tmp_path / "history") as store:
        made: list[Daemon] = []

        def make(compute: Compute) -> Daemon:
            made.append(Daemon(of(tmp_path, free_port), store, now=lambda: NOON, play=lambda *_: recording, compute=compute))
            return made[-1].__enter__()

        yield make
        for each in made:
            each.__exit__()


@pytest.mark.parametrize("before_writing", [False, True])
def test_a_replay_whose_verdict_died_is_kept_told_and_assessed_later(daemon, monkeypatch, before_writing: bool):
    """The recording is on disk in any case. It is not tried again at once; what waits is said, until it is assessed."""
    monkeypatch.setattr(replay_cycle, "RETRY_S", 600.0)
    made = daemon(Failing(1, before_writing=before_writing))
    row = made.monitor.perform(NOON)
    if before_writing:  # it was written here; the verdict comes with the next look
        assert "ended by signal 9" not in str(made.monitor.unassessed or "")
    else:
        assert "replay 1 waits for its assessment" in str(made.monitor.unassessed)
        made.monitor.recover()
        assert made._store.ledger.row(row.id).state == "recorded"
        monkeypatch.setattr(made.monitor, "_retry_at", time.monotonic())
    assert row.state == "recorded"
    assert made._store.recordings.path(row.id).is_file()
    made.monitor.recover()
    assert made._store.ledger.row(row.id).state == "assessed"
    assert made.monitor.unassessed is None
    assert made.state.torque_model is not None


def test_a_replay_waits_behind_an_older_one_that_is_not_assessed_yet(daemon, monkeypatch):
    """One that is asked for in the pause before the next try: what is older could not be learned from afterwards."""
    monkeypatch.setattr(replay_cycle, "RETRY_S", 600.0)
    made = daemon(Failing(2))
    older = made.monitor.perform(NOON)
    monkeypatch.setattr(made.monitor, "_now", lambda: NOON + 60.0)
    newer = made.monitor.perform(NOON + 60.0)
    for expected in ("recorded", "recorded", "assessed"):
        assert [made._store.ledger.row(row.id).state for row in (older, newer)] == [expected, expected]
        monkeypatch.setattr(made.monitor, "_retry_at", time.monotonic())
        made.monitor.recover()


def test_a_recording_that_kills_every_process_is_rejected_so_that_later_ones_are_learnt_from(daemon, monkeypatch):
    """After three tries its window ends with the reason."""
    monkeypatch.setattr(replay_cycle, "RETRY_S", 0.0)
    made = daemon(Failing(3))
    row = made.monitor.perform(NOON)
    made.monitor.recover()
    assert made._store.ledger.row(row.id).state == "recorded"
    made.monitor.recover()
    row = made._store.ledger.row(row.id)
    assert row.state == "rejected"
    assert "not assessed in 3 tries: the computing process was ended by signal 9" in row.reason_text
    assert made.monitor.unassessed is None


def test_the_main_loop_does_not_wait_for_what_is_computed(daemon):
    """Its look at the monitor itself comes again; a service manager would end a service whose main loop stands for a minute."""
    made = daemon(HERE)
    made.monitor.perform(NOON)
    look = threading.Thread(target=made.look, daemon=True)
    with made.state.revising:
        look.start()
        look.join(timeout=30.0)
        assert not look.is_alive()


def test_a_disk_that_refuses_the_recording_ends_the_window(daemon, monkeypatch):
    """As it did before: nothing was recorded, and the row says why."""

    def refuses(*_: object) -> None:
        raise StoreUnavailable("replay-000001.parquet: no space is left")

    monkeypatch.setattr("monitor.store.formats.recordings.write_recording", refuses)
    row = daemon(HERE).monitor.perform(NOON)
    assert (row.state, row.reason_text) == ("aborted", "replay-000001.parquet: no space is left")


def test_a_first_pass_whose_process_died_is_written_all_the_same(tmp_path: Path, recording: Recording):
    """Here, because nothing of a motion may be lost."""
    written_apart(Failing(1), tmp_path / "first-pass.parquet", recording)
    assert read_recording(tmp_path / "first-pass.parquet").samples == recording.samples


def test_a_report_whose_process_died_is_refused_with_a_sentence():
    """Whoever looks at the page reads what to do."""
    with pytest.raises(BadInput, match="try again: the computing process was ended by signal 9"):
        answered(Failing(1), str)
    assert answered(HERE, str, "made") == "made"


def test_reports_are_made_one_after_another():
    """Each takes a process with all that drawing loads; several at once would take the memory of a replay under way."""
    entered, second, most = [], threading.Event(), []

    def slow(function: Callable, *args: object) -> object:
        entered.append(True)
        if len(entered) > 1:
            second.set()
        second.wait(0.3)  # so long another may come
        most.append(len(entered))
        entered.pop()
        return function(*args)

    readers = [threading.Thread(target=answered, args=(slow, str, "made"), daemon=True) for _ in range(2)]
    for reader in readers:
        reader.start()
    for reader in readers:
        reader.join(timeout=30.0)
    assert most == [1, 1]


def test_what_the_service_loads_at_its_start_holds_nothing_that_a_verdict_needs():
    """In an interpreter of its own, because this one has loaded everything."""
    heavy = ("scipy.linalg", "scipy.special", "scipy.signal", "filterpy", "pinocchio", "pyarrow", "pandas", "matplotlib", "clarabel")
    heavy += ("rtde_receive", "uvicorn", "starlette", "prometheus_client", "sqlalchemy", "duckdb")
    code = f"import sys, monitor.cli.daemon, monitor.service.run; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=110)
    assert done.stdout.strip() == "[]"
