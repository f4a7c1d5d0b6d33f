"""A reassessment on a Dask cluster that `dask scheduler` and `dask worker` have started, its recordings and results on a real S3 server."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from pyarrow import fs
from s3_server import KEYS, S3Server, s3_server
from test_reassess import BEGAN_S, DAY_S, lived  # noqa: F401 - a fixture

from monitor.store.archive.archive import Archive, key_of
from monitor.store.archive.places import ArchiveSettings
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.store.store import Store

if find_spec("distributed") is None:
    pytest.skip("dask is absent: it is of the extra `archive`", allow_module_level=True)
pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]

ROOT = Path(__file__).parents[2]
ARMS = 5  # of two months each
SOON_S = 120.0  # on a machine with other work


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[S3Server]:
    with s3_server(tmp_path_factory.mktemp("s3")) as running, pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", running.endpoint)
        patch.setenv("AWS_ACCESS_KEY_ID", KEYS[0])
        patch.setenv("AWS_SECRET_ACCESS_KEY", KEYS[1])
        yield running


@pytest.fixture(scope="module")
def plant(lived: Path, server: S3Server, tmp_path_factory) -> Path:  # noqa: F811
    """Histories whose recordings are in the archive alone. The first arm is as it lived; the recordings of the others have other noise."""
    folder, rng = tmp_path_factory.mktemp("plant"), np.random.default_rng(7)
    archive = Archive.open(ArchiveSettings(address=f"s3://{server.bucket}/plant", endpoint=server.endpoint))
    for k in range(ARMS):
        home = folder / f"arm-{k}"
        shutil.copytree(lived / "site=north" / "press", home)
        with Store.open(home) as store:
            store.archived.note_place(archive.settings)
            for number, path in store.recordings.numbered():
                if k:
                    made = read_recording(path)
                    write_recording(path, replace(made, current=made.current + 1e-4 * rng.normal(size=made.current.shape)))
                content = path.read_bytes()
                key = key_of("lab", f"arm-{k}", BEGAN_S + (number - 1) * DAY_S, number, content)
                store.archived.add(number, archive.put(content, key), BEGAN_S)
                path.unlink()
    return folder


@contextmanager
def dask(folder: Path, *words: str, within: Sequence[str] = ()) -> Iterator["subprocess.Popen[bytes]"]:
    """One process of Dask's own commands, begun by the command `within`. What it leaves behind ends with it."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_TEMPORARY_DIRECTORY": str(folder)}
    with (folder / f"{words[0]}.log").open("ab") as log:
        process = subprocess.Popen(
            [*within, sys.executable, "-m", "dask", *words], stdout=log, stderr=log, env=environment, cwd=folder, start_new_session=True
        )
    try:
        yield process
    finally:
        end(process)


def end(process: "subprocess.Popen[bytes]") -> None:
    """Kill a process of `dask` with its children; its session is its own."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def wait_for(what: Callable[[], object], why: str) -> None:
    begin = time.monotonic()
    while not what():
        assert time.monotonic() - begin < SOON_S, why
        time.sleep(0.05)


def scheduler_of(folder: Path, stack: ExitStack, name: str, host: str = "127.0.0.1") -> tuple[str, "subprocess.Popen[bytes]"]:
    file = folder / f"{name}.json"
    words = ("scheduler", "--host", host, "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    process = stack.enter_context(dask(folder, *words))
    wait_for(lambda: file.is_file() and file.read_text().strip().endswith("}"), f"{name} does not start")
    return json.loads(file.read_text())["address"], process


def worker_of(folder: Path, stack: ExitStack, address: str) -> "subprocess.Popen[bytes]":
    return stack.enter_context(dask(folder, "worker", address, "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"))


def kept(client: fs.S3FileSystem, server: S3Server, kind: str) -> int:
    selector = fs.FileSelector(f"{server.bucket}/results/{kind}", recursive=True, allow_not_found=True)
    return sum(each.type == fs.FileType.File for each in client.get_file_info(selector))


def test_killed_workers_and_a_killed_scheduler_lose_only_what_was_under_way(plant: Path, server: S3Server, tmp_path: Path):
    """A worker dies: its task is done by another process. The scheduler dies: the command says so, and the next one goes on from there.

    No arm-month that was finished is computed again, and the first arm's verdicts come out the same to the last bit.
    """
    client, command = server.client(), [sys.executable, "-m", "monitor", "reassess", str(plant), "--json"]
    command += ["--results", f"s3://{server.bucket}/results", "--scheduler"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    with ExitStack() as stack:
        address, scheduler = scheduler_of(tmp_path, stack, "first")
        workers = [worker_of(tmp_path, stack, address) for _ in range(2)]
        wait_for(lambda: (tmp_path / "worker.log").read_text().count("Registered to") >= 2, "no worker")
        running = subprocess.Popen([*command, address], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        wait_for(lambda: kept(client, server, "identified") >= 1, "nothing is kept")
        end(workers[0])
        enough = kept(client, server, "identified") + 2
        wait_for(lambda: kept(client, server, "identified") >= enough, "the other worker does not go on")
        assert running.poll() is None
        end(scheduler)
        _, said = running.communicate(timeout=SOON_S)
        assert running.returncode == 1, said
        assert "the scheduler went away" in said
        assert "the same command goes on from there" in said
    before = kept(client, server, "identified")
    assert enough <= before < 2 * ARMS, "the test is to stop it in the midst of its work"
    with ExitStack() as stack:
        address, _ = scheduler_of(tmp_path, stack, "second")
        worker_of(tmp_path, stack, address)
        wait_for(lambda: (tmp_path / "worker.log").read_text().count("Registered to") >= 3, "no worker")
        done = subprocess.run([*command, address], capture_output=True, text=True, env=environment, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["cost"]["arm_months"] == 2 * ARMS
    assert document["cost"]["arm_months_found"] == before
    assert kept(client, server, "identified") == 2 * ARMS, "one result a month: none was computed under two names"
    assert (document["failed"], document["errors"]) == ([], [])
    assert document["by_arm"][0]["arm"] == "arm-0"
    assert all(row["arm"] != "arm-0" for row in document["differing"])
    assert document["verdicts"]["not_recomputable"] == 0


def test_ctrl_c_keeps_what_is_finished_and_leaves_no_process(plant: Path, server: S3Server, tmp_path: Path):
    """The processes of this machine end with the command; its exit code is that of Ctrl-C."""
    results = tmp_path / "results"
    command = [sys.executable, "-m", "monitor", "reassess", str(plant), "--results", str(results), "--workers", "2"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_TEMPORARY_DIRECTORY": str(tmp_path)}
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True)
    wait_for(lambda: results.is_dir() and any(path.is_file() for path in results.glob("identified/*/[!.]*")), "nothing is kept")
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=SOON_S)
    assert (running.returncode, "what is finished is kept" in said) == (130, True), said
    wait_for(lambda: not alive(running.pid), "processes are left")


@pytest.mark.parametrize("after_s", [1.0, 2.0, 3.0, 5.0])
def test_ctrl_c_while_the_processes_start_is_one_sentence(plant: Path, tmp_path: Path, after_s: float):
    """A terminal sends it to every process of the command, in the midst of what it loads: none tells where it was."""
    command = [sys.executable, "-m", "monitor", "reassess", str(plant), "--results", str(tmp_path / "results"), "--workers", "2"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_TEMPORARY_DIRECTORY": str(tmp_path)}
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True)
    time.sleep(after_s)  # somewhere in the start, wherever a busy machine is then
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=SOON_S)
    assert running.returncode in {130, -signal.SIGINT}, said
    assert "Traceback" not in said, said
    wait_for(lambda: not alive(running.pid), "processes are left")


def alive(session: int) -> bool:
    """Whether any process of this session is left."""
    try:
        os.killpg(session, 0)
    except ProcessLookupError:
        return False
    return True
