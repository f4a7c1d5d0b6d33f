"""The simulator as a process: how it starts and ends, its options and its view."""

import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from command_line import ended
from prepared import Process, run
from sim_process import eventually, fresh_address

from monitor.errors import RobotUnreachable
from monitor.simulate.__main__ import main
from monitor.simulate.remote import Remote


def test_a_taken_port_is_named(ur5):
    """A second simulator on the same address ends with exit code 2 and names the port, without a traceback."""
    second = subprocess.run(
        [sys.executable, "-m", "monitor.simulate", "--bind", ur5.address], capture_output=True, text=True, timeout=30, check=False
    )
    assert second.returncode == 2
    assert "30004" in second.stderr
    assert "in use" in second.stderr
    assert "Traceback" not in second.stderr


def test_an_address_of_the_network_is_refused(capsys):
    """The exit code is 2, and no socket was opened."""
    assert main(["--bind", "0.0.0.0"]) == 2
    assert "loopback" in capsys.readouterr().err


def test_an_arm_that_nobody_watches_keeps_its_clock_and_wakes_rarely(spawn):
    """Whenever somebody asks, its time is that of the wall; in between it wakes some ten times a second, not 500 times, and is not late."""
    simulator = spawn("--robot", "ur5e")
    taken_s, began_s, late = [], [], []
    with simulator.remote() as remote:
        woken = wakes(simulator.process.pid)
        for _ in range(20):
            time.sleep(0.23)  # two rests, and part of a third
            asked_s = time.monotonic()
            truth = remote.truth()
            taken_s.append(time.monotonic() - asked_s)
            began_s.append(asked_s - truth["clock_s"] - 0.002 * truth["ticks"]["dropped"])
            late.append(truth["ticks"]["late"])
        woken = wakes(simulator.process.pid) - woken
    quick_s = np.array(began_s)[np.argsort(taken_s)[:8]]  # the other answers say how busy the machine is
    assert np.median(np.abs(quick_s - np.median(quick_s))) < 0.008  # it would be a quarter of a rest, 25 ms
    assert np.sum(np.diff(late) == 0) >= 2  # the machine's other work makes some of them late; by its own, it would be late in each rest
    assert woken < 250


def wakes(pid: int) -> int:
    """How often a process has waited for something."""
    return int(Path(f"/proc/{pid}/status").read_text().partition("\nvoluntary_ctxt_switches:")[2].split()[0])


def test_it_ends_on_sigterm_and_on_command_and_leaves_the_ports_free(spawn):
    """The exit code is 0 and the address is free at once. Then nobody answers there: RobotUnreachable."""
    first = spawn()
    assert first.end() == 0
    again = Process([sys.executable, "-m", "monitor.simulate", "--bind", first.address], stdout=subprocess.PIPE, text=True)
    try:
        assert again.stdout.readline().startswith("listening")
        with Remote(first.address) as remote:
            remote.shutdown()
        assert again.wait(timeout=5) == 0
    finally:
        again.kill()
        again.communicate()
    with pytest.raises(RobotUnreachable, match=first.address):
        Remote(first.address)


def test_it_ends_without_output_while_a_client_is_connected_to_every_port(spawn):
    """Ctrl-C prints no traceback while a client is connected to each port."""
    simulator = spawn("--robot", "ur5")
    wires = [socket.create_connection((simulator.address, port), timeout=5) for port in (29999, 30001, 30002, 30003, 30004, 30020)]
    wires[-1].sendall(b'{"do": "truth"}\n')
    assert wires[-1].recv(10)
    simulator.process.send_signal(signal.SIGINT)
    assert simulator.process.communicate(timeout=10)[1] == ""
    assert simulator.process.returncode == 0
    for wire in wires:
        wire.close()


def test_a_shutdown_by_the_dashboard_is_the_end_of_the_controller(spawn, client):
    """The dashboard replies, and the process ends with exit code 0."""
    simulator = spawn()
    code = "import sys; from dashboard_client import DashboardClient; d = DashboardClient(sys.argv[1]); d.connect(); d.shutdown()"
    assert client(code, simulator.address).wait(timeout=20) == 0
    assert simulator.process.wait(timeout=5) == 0


def test_the_view_shows_the_arm_and_ends_with_it(tmp_path):
    """`simulate --view` shows a table of the joints. SIGINT ends view and simulator."""
    address = fresh_address()
    with_signal = ["env", "--default-signal=INT"]  # what runs in the background of a script has inherited that SIGINT is ignored
    command = [*with_signal, sys.executable, "-m", "monitor", "simulate", "--bind", address, "--scenario", "hot-summer", "--view"]
    with (tmp_path / "screen").open("w") as screen:
        view = subprocess.Popen(command, stdout=screen, stderr=subprocess.PIPE, text=True)
        try:
            assert eventually(lambda: "running" in (tmp_path / "screen").read_text(), 30.0)
            assert _answers(address)
            view.send_signal(signal.SIGINT)
            assert view.wait(timeout=15) == 0, view.stderr.read()
        finally:
            view.kill()
            view.communicate()
    assert not _answers(address)
    shown = (tmp_path / "screen").read_text()
    assert "hot-summer" in shown
    assert "grease" in shown
    assert "running" in shown


def test_a_view_into_a_pipe_shows_one_picture_after_the_other_and_ends_with_its_reader():
    """View and simulator end when the reader ends, as in `--view | head`."""
    address = fresh_address()
    command = [sys.executable, "-m", "monitor", "simulate", "--bind", address, "--view"]
    view = Process(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert "running, normal" in view.stdout.readline()
        assert _answers(address)
        view.stdout.close()
        assert view.wait(timeout=15) in {0, 1}  # as of every command whose reader has gone
        assert view.stderr.read() == ""
    finally:
        view.kill()
        view.wait()
    assert not _answers(address)


def test_a_view_of_an_address_in_use_gives_a_message(spawn):
    """One line and exit code 2, as without the view."""
    command = [sys.executable, "-m", "monitor", "simulate", "--bind", spawn().address, "--view"]
    second = run(command, 60.0)
    assert second.returncode == 2, second.stderr
    assert "in use" in second.stderr
    assert len(second.stderr.strip().splitlines()) == 1


def test_processes_that_threads_start_at_once_end_with_their_own_exit_codes():
    """Of two kinds: the one was no child of this process while the other one began, and every end of it was told as 0."""
    simulator, program = [sys.executable, "-m", "monitor.simulate", "--bind", "0.0.0.0"], [sys.executable, "-c", "raise SystemExit(3)"]

    def ends(command: list[str]) -> set[int]:
        return {run(command, 60.0).returncode for _ in range(6)}

    with ThreadPoolExecutor(2) as beside:
        assert list(beside.map(ends, (simulator, program))) == [{2}, {3}]


def _answers(address: str) -> bool:
    try:
        Remote(address).close()
    except RobotUnreachable:
        return False
    return True


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--command-port", "30004"], "own ports"),
        (["--seed", "-1"], "seed = -1"),
        (["--scenario", "sunshine"], "cold-mondays"),
        (["--fault", "stall"], "seconds is missing"),
        (["--mounting", "sideways"], "sideways"),
        (["--payload", "500"], "payload_kg"),
        (["--polyscope", "5.11.0"], "for a ur5"),
        (["--robot", "ur5e", "--polyscope", "3.15"], "for a ur5e"),
        (["--protective-runtime", "shrugs"], "protective_runtime"),
    ],
)
def test_wrong_options_give_a_message(arguments, named):
    """The exit code is 2 and there is no traceback."""
    wrong = ended("simulate", "--bind", fresh_address(), *arguments)
    assert wrong.returncode == 2
    assert named in wrong.stderr
    assert "Traceback" not in wrong.stderr
