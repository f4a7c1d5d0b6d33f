"""What idle daemons cost a host: `python -m tests.bench.idle [--daemons 10] [--arms 1] [--seconds 20] [--listen-hz 10] [--work]`.

Each daemon has a history with one assessed replay, its own bus, and listens to a simulated arm; `--arms` of them are shared by all. Told
are the proportional memory (PSS: what several processes share counts once) and the share of a core, each with every child, of one
daemon alone and of all together. The simulated arms are not counted. Ends with 1 where a further daemon costs more than is asked, or
one of them ended, or hears no arm. Within `--minutes` those are measured that have started by then; all are ended at the end.
"""

import argparse
import ctypes
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from monitor.config.load import load
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import write_recording

MOST_MIB, MOST_SHARE = 56.0, 0.8  # of each further daemon, its listener included; % of a core
ARMS = "127.0.92."  # addresses of simulated arms
BUSES = "127.0.93."  # of the daemons
UNIT = Path(__file__).parents[2] / "deploy" / "joint-monitor@.service"
SETTLING_S = 12.0  # from ready until the figures are those of an idle daemon
A_MINUTE_OF_PRODUCTION_S = 75.0  # with --work: until the first rows were gathered, and the model of the arm was made for them
AT_ONCE = 4  # daemons that start side by side
MOST_DAEMONS = 250  # addresses
PDEATHSIG = 1  # of prctl


def family(pid: int) -> list[int]:
    """A process and all below it."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += family(int(child))
    return found


def core_s(pid: int) -> float:
    """Processor time of a process and all below it [s]."""
    total = 0.0
    for each in family(pid):
        fields = Path(f"/proc/{each}/stat").read_text().rsplit(")", 1)[1].split()
        total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def pss_mib(pid: int) -> float:
    """Proportional memory of a process and all below it [MiB]."""
    total = 0.0
    for each in family(pid):
        for line in Path(f"/proc/{each}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                total += int(line.split()[1]) / 1024
    return total


def unit_environment() -> dict[str, str]:
    """What the shipped unit sets."""
    lines = [line.removeprefix("Environment=") for line in UNIT.read_text().splitlines() if line.startswith("Environment=")]
    values = dict(word.split("=", 1) for line in lines for word in line.split())
    return {name: value for name, value in values.items() if name != "HOME"}


class Measured(NamedTuple):
    """What all daemons cost together."""

    mib: float
    share: float  # % of a core
    worst_mib: float  # of one of them
    worst_share: float
    load: float  # of the machine

    def line(self, title: str) -> str:
        """The figures for people."""
        return f"{title:<60} {self.mib:6.1f} MiB, {self.share:5.2f} % of a core; load {self.load:.1f}"


class Daemon(NamedTuple):
    """One daemon."""

    process: "subprocess.Popen[str]"
    log: Path
    directory: Path  # its history

    def watches(self) -> bool:
        """Whether it has started. Raises AssertionError where it ended."""
        said = self.log.read_text()
        assert self.process.poll() is None, said
        return "watching" in said

    def hears(self) -> bool:
        """Whether it runs and hears its arm, as it says itself."""
        file = self.directory / "monitor.json"
        return self.process.poll() is None and file.is_file() and json.loads(file.read_text())["arm"]["heard"] is True


def _ends_with_its_parent() -> None:
    """In a child: nothing that was started here outlives a bench that is killed."""
    ctypes.CDLL(None).prctl(PDEATHSIG, signal.SIGKILL)


class Host:
    """Simulated arms and the daemons beside them; a context manager that ends all of them."""

    def __init__(self, folder: Path, arms: int, listen_hz: float, *, production: bool) -> None:
        self.folder, self.listen_hz, self.production = folder, listen_hz, production
        self.processes: list[subprocess.Popen[str]] = []
        self.daemons: list[Daemon] = []
        self.hosts = [f"{ARMS}{n + 1}" for n in range(arms)]

    def __enter__(self) -> "Host":
        try:
            self._prepare()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _prepare(self) -> None:
        for host in self.hosts:
            arm = self._start([sys.executable, "-m", "monitor.simulate", "--bind", host], stdout=subprocess.PIPE)
            assert arm.stdout is not None
            assert "listening" in arm.stdout.readline()
        loaded = load(self._config("first", 0))
        recording = stepped_replay(Controller(SimulateSettings(robot="ur5")), replace(loaded.excitation, repetitions=1))
        file = self.folder / "one.parquet"
        write_recording(file, replace(recording, context=replace(loaded.context, recorded_at_unix_s=time.time() - 3600)))
        command = [sys.executable, "-m", "monitor", "import", "--config", str(self.folder / "first.toml"), str(file)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

    def __exit__(self, *_: object) -> None:
        every = [daemon.process for daemon in self.daemons] + self.processes
        for process in every:
            process.terminate()
        until = time.monotonic() + 60.0
        for process in every:
            try:
                process.wait(max(until - time.monotonic(), 0.0))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self, command: list[str], **more: Any) -> "subprocess.Popen[str]":
        environment = os.environ | unit_environment()
        process = subprocess.Popen(command, text=True, env=environment, preexec_fn=_ends_with_its_parent, **more)  # noqa: PLW1509 - one thread
        self.processes.append(process)
        return process

    def _config(self, name: str, number: int) -> Path:
        config = self.folder / f"{name}.toml"
        host = self.hosts[number % len(self.hosts)]
        config.write_text(
            f'[robot]\nmodel = "ur5"\nsite = "bench"\nid = "{name}"\nhost = "{host}"\nlisten_hz = {self.listen_hz}\n'
            f'[store]\ndirectory = "{self.folder / name}"\n'
            f'[bus]\nlisten = ["tcp/{BUSES}{number + 1}:7447"]\nlive_rate_hz = 10.0\n'
            f"[production]\nlisten = {str(self.production).lower()}\n"
        )
        return config

    def start(self, count: int, until: float) -> int:
        """Start daemons until there are so many, some at a time; how many there are, once each watches or the time is over."""
        starting: list[Daemon] = []
        while (len(self.daemons) < count or starting) and time.monotonic() < until:
            starting = [daemon for daemon in starting if not daemon.watches()]
            while len(starting) < AT_ONCE and len(self.daemons) < count:
                starting.append(self._daemon(len(self.daemons)))
            time.sleep(0.05)
        return len(self.daemons)

    def _daemon(self, number: int) -> Daemon:
        name = f"arm-{number + 1}"
        shutil.copytree(self.folder / "first", self.folder / name)
        log = self.folder / f"{name}.log"
        with log.open("w") as errors:
            process = self._start([sys.executable, "-m", "monitor", "run", "--config", str(self._config(name, number))], stderr=errors)
        self.processes.remove(process)
        self.daemons.append(Daemon(process, log, self.folder / name))
        return self.daemons[-1]

    def measured(self, seconds: float) -> Measured:
        """What all daemons cost over so many seconds, once they idle."""
        time.sleep(SETTLING_S + (A_MINUTE_OF_PRODUCTION_S if self.production else 0.0))
        pids = [each.process.pid for each in self.daemons]
        before, began = [core_s(pid) for pid in pids], time.monotonic()
        time.sleep(seconds)
        shares = [100.0 * (core_s(pid) - at) / (time.monotonic() - began) for pid, at in zip(pids, before, strict=True)]
        memory = [pss_mib(pid) for pid in pids]
        return Measured(sum(memory), sum(shares), max(memory), max(shares), os.getloadavg()[0])


def available_mib() -> float:
    """Memory that the kernel could give away [MiB]."""
    lines = Path("/proc/meminfo").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("MemAvailable")).split()[1]) / 1024


def main() -> int:
    """One daemon, then all."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.idle", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--daemons", type=int, default=10)
    parser.add_argument("--arms", type=int, help="simulated arms, which all daemons share; default: one for each 25 daemons")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each measurement")
    parser.add_argument("--listen-hz", type=float, default=10.0)
    parser.add_argument("--production", action="store_true", help="friction is estimated from ordinary work as well: [production] listen")
    parser.add_argument("--minutes", type=float, default=8.0, help="after which no further daemon is waited for")
    arguments = parser.parse_args()
    count = min(max(arguments.daemons, 2), MOST_DAEMONS)
    until = time.monotonic() + 60.0 * arguments.minutes
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most if most == resource.RLIM_INFINITY or most < 65_536 else 65_536, most))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))
    arms = arguments.arms or -(-count // 25)
    with tempfile.TemporaryDirectory() as folder, Host(Path(folder), arms, arguments.listen_hz, production=arguments.production) as host:
        free = available_mib()
        host.start(1, until)
        one = host.measured(arguments.seconds)
        print(one.line(f"one idle daemon, live torque at 10 Hz{', ordinary work' if arguments.production else ''}"), flush=True)
        began = time.monotonic()
        started = host.start(count, until)
        took = time.monotonic() - began
        every = host.measured(arguments.seconds)
        print(every.line(f"{started} of them"), flush=True)
        further = started - 1
        memory, share = (every.mib - one.mib) / further, (every.share - one.share) / further
        asked = f"(at most {MOST_MIB:g} MiB and {MOST_SHARE:g} % are asked)"
        print(f"{'each further one':<60} {memory:6.1f} MiB, {share:5.2f} % of a core {asked}")
        print(f"{'the one that costs most':<60} {every.worst_mib:6.1f} MiB, {every.worst_share:5.2f} % of a core")
        hear = sum(daemon.hears() for daemon in host.daemons)
        taken = free - available_mib()
        print(f"{further} started in {took:.0f} s; {hear} of {started} run and hear their arm; the host has {taken:.0f} MiB less")
        right = memory <= MOST_MIB and share <= MOST_SHARE and started == count and hear == started
        print(f"{'✓' if right else '✗'} {count} idle daemons, each further one at most {MOST_MIB:g} MiB and {MOST_SHARE:g} % of a core")
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
