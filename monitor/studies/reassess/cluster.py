"""What a worker does once, before its first task."""

import importlib
import logging
import os
import secrets
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from monitor.errors import BadInput, MonitorError
from monitor.store.provenance import differences, provenance
from monitor.studies.reassess.identify_month import JUDGES, Results, program, worker_facts

if TYPE_CHECKING:
    from distributed import Client

# loaded where they are used, because most commands never need them: a second of the processor
USED = ("filterpy.kalman", "pandas", "pyarrow.fs", "pyarrow.parquet", "scipy.optimize", "scipy.signal")


def warm_up() -> None:
    """Load what the first task would load, in all workers at once."""
    for name in USED:
        importlib.import_module(name)


# --- The processes that compute: a Dask cluster of this machine, or one that others have started. I/O ---

CONNECT_S = 15.0  # a scheduler that has not answered by then is not there
# Dask looks at itself fifty times a second, and at the stacks and the memory of its workers: a twentieth of a core, for pages that nobody
# opens, and for limits that tasks this small do not reach
QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "5s",
    "distributed.scheduler.work-stealing-interval": "2s",
    "distributed.admin.system-monitor.interval": "60s",
    "distributed.admin.tick.interval": "5s",
    "distributed.admin.tick.limit": "60s",
}
PROBE = "probe"  # kind of a result that only shows that a worker reaches the place
OF_WORKERS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}  # matrices this small lose by more


@contextmanager
def cluster(scheduler: str | None, workers: int | None, place: str) -> Iterator["Client"]:
    """A client of the scheduler at this address, or of a cluster on this machine with so many processes; one a core where None.

    place : of the results, which all workers reach. Raises BadInput where nobody answers, or the workers run
    another program or do not reach the results; ResultsRefused where this process does not.
    """
    import dask
    from distributed import Client

    for name in ("distributed", "distributed.worker", "distributed.nanny", "distributed.scheduler", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # workers that die are told in our own words
    options = QUIET | {"distributed.comm.timeouts.connect": CONNECT_S, "distributed.admin.large-graph-warning-threshold": "1GB"}
    with dask.config.set(options):
        if scheduler is None:
            with _local(workers or os.cpu_count() or 1) as local, Client(local, set_as_default=False) as client:
                client.run(warm_up)
                yield client
            return
        client = _connected(scheduler)
        try:
            _check(client, scheduler)
            _reached(client, scheduler, place)
            client.run(warm_up, on_error="ignore")  # a worker that ends now is seen by its tasks
            yield client
        finally:
            with suppress(Exception):  # the scheduler may be gone: that is told already
                client.close(timeout=2.0)


@contextmanager
def _local(workers: int) -> Iterator[Any]:
    """Processes of this machine, each with one thread. Nobody else on it may give them work: they run whatever they are sent.

    Ctrl-C is for this process alone, which ends them: a terminal sends it to all, and each would tell where it was.
    """
    from distributed import LocalCluster

    with _interrupt_held() as interrupted:
        local = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",  # not the usual port, which may be another cluster's
            host="127.0.0.1",
            env=OF_WORKERS | {f"DASK_{name.replace('.', '__').replace('-', '_').upper()}": str(value) for name, value in QUIET.items()},
            security=True,  # TLS with keys of this run
            silence_logs=logging.CRITICAL,
        )
    with local:
        if interrupted:
            raise KeyboardInterrupt
        yield local


@contextmanager
def _interrupt_held() -> Iterator[list[int]]:
    """Ctrl-C does nothing meanwhile but to be in the list that is given; processes and threads that begin never hear of it."""
    held: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield held
        return
    handler = signal.signal(signal.SIGINT, lambda number, _: held.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield held
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)  # one that came is delivered here
        signal.signal(signal.SIGINT, handler)


def _connected(scheduler: str) -> "Client":
    from distributed import Client

    try:
        return Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, TimeoutError) as wrong:
        text = str(wrong).splitlines()[0] if str(wrong) else type(wrong).__name__
        raise BadInput(
            f"--scheduler {scheduler}: no Dask scheduler answers ({text}); expected the address that `dask scheduler` says, e.g. tcp://host:8786"
        ) from None


def _check(client: "Client", scheduler: str) -> None:
    """Raises BadInput where there is no worker, or one that would compute something else than this process."""
    versions: Any = client.get_versions(check=False)
    mine = dict(versions["client"]["host"])["python"].split(".")[:2]
    for address, theirs in versions["workers"].items():
        python = dict(theirs["host"])["python"].split(".")[:2]
        if python != mine:
            raise BadInput(
                f"--scheduler {scheduler}: the worker {address} runs Python {'.'.join(python)}, this is {'.'.join(mine)}: "
                "results would not agree; start the workers with the same Python"
            )
    if not versions["workers"]:
        raise BadInput(f"--scheduler {scheduler}: has no worker; start some with `dask worker {scheduler} --nthreads 1`")
    found = client.run(worker_facts, on_error="return")
    for address, facts in found.items():
        if isinstance(facts, BaseException):
            raise BadInput(
                f"--scheduler {scheduler}: the worker {address} cannot run joint-monitor ({facts}); install the same version there"
            )
        if facts["threads"] != provenance()["threads"]:
            raise BadInput(
                f"--scheduler {scheduler}: the worker {address} computes with {facts['threads']} threads, this process with "
                f"{provenance()['threads']}: figures would differ in their last digits; start it with OMP_NUM_THREADS=1"
            )
        if facts["program"] != (own := program(JUDGES)):
            raise BadInput(f"--scheduler {scheduler}: the worker {address} runs another program: {_difference(facts['program'], own)}")


def _reached(client: "Client", scheduler: str, place: str) -> None:
    """Raises BadInput where a worker does not find what this process puts into the place of the results."""
    token = secrets.token_hex(16)
    results = Results(place)
    results.write(PROBE, token, token.encode())
    for address, found in client.run(probe_found, place, token, on_error="return").items():
        if found is not True:
            why = f" ({found})" if isinstance(found, BaseException) else ""
            raise BadInput(
                f"--scheduler {scheduler}: the worker {address} does not reach --results {place}{why}; expected what "
                "this computer and all workers share"
            )


def probe_found(place: str, token: str) -> bool:
    """Whether this process reads at a place of results what another one has put there. The workers call it."""
    return Results(place).read(PROBE, token) is not None


def _difference(theirs: Mapping[str, Any], own: Mapping[str, Any]) -> str:
    return "; ".join(f"{line} here" for line in differences(dict(theirs), dict(own)))


def threads_of(client: "Client") -> int:
    """How many tasks the workers compute at once."""
    threads: Any = client
    return sum(threads.nthreads().values())


class SchedulerLost(MonitorError):
    """The scheduler went away; what was finished is kept."""
