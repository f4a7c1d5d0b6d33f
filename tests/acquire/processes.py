"""A process that replays, and which processes of ours run, by /proc."""

import os
import subprocess
import sys
from pathlib import Path

from prepared import Process, waiting

ROOT = Path(__file__).parent.parent.parent
PARENT = """
import sys
sys.path[:0] = [sys.argv[2]]
from excitations import short
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.replay import replay
from monitor.acquire.watch import Caller
from monitor.errors import ReplayAborted
from monitor.model.robot import load_robot
try:
    replay(short(), load_robot("ur5"), ReplaySettings(host=sys.argv[1], allow_motion=True, first_pass=False, approach_speed_rad_s=1.0),
           caller=Caller(on_progress=lambda p: print(p.phase, p.elapsed_s, flush=True)))
except ReplayAborted as error:
    print("aborted", error.cause, flush=True)
"""


def replaying(host: str) -> subprocess.Popen[str]:
    """A process that replays once on a simulated arm; it prints phase and time in it, and `aborted` with the cause at an early end."""
    command = [sys.executable, "-c", PARENT, host, str(ROOT / "tests" / "acquire")]
    return Process(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)


def children(parent: int | None = None, naming: str = "monitor.acquire") -> list[int]:
    """Ids of the processes whose parent is this process, or the given one, and whose command line contains `naming`."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) in waiting():
            continue
        try:
            stat = (entry / "stat").read_text()
            command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:  # it ended while we looked
            continue
        if int(stat.rpartition(")")[2].split()[1]) == (parent or os.getpid()) and naming in command:
            found.append(int(entry.name))
    return sorted(found)


def alive(pid: int) -> bool:
    """Whether the process runs or sleeps; a zombie does not."""
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] not in {"Z", "X"}
    except OSError:
        return False
