"""Only what is known to be ours is stopped: the dashboard's part, against a dashboard whose program starts and ends by the clock."""

import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest
from scripted_server import ScriptedServer

from monitor.acquire.driver import OurProgram
from monitor.acquire.ur.conversation import stop_program
from monitor.acquire.ur.dashboard import PORT

pytestmark = pytest.mark.real_time

HOST = "127.0.2.65"
BESIDE = tuple(f"127.0.68.{number}" for number in range(1, 6))  # where handovers are tried at the same time


class ScriptedDashboard(ScriptedServer):
    """Serves PolyScope's lines. `state` gives the program's state by the seconds since the start; a stop is obeyed from the n-th one on."""

    def __init__(self, state: Callable[[float], str], obeys: int = 1, answers_after_s: float = 0.0, host: str = HOST) -> None:
        self.state, self.obeys, self.answers_after_s = state, obeys, answers_after_s
        self.stops: list[tuple[float, str]] = []  # when, and the state in which it met the program
        self.began = time.monotonic()
        super().__init__(host, PORT)

    @property
    def now_s(self) -> float:
        return time.monotonic() - self.began

    def _present(self) -> str:
        return "STOPPED" if len(self.stops) >= self.obeys else self.state(self.now_s)

    def converse(self, peer: socket.socket):
        peer.sendall(b"Connected: Universal Robots Dashboard Server\n")
        while not self.over.is_set():
            try:
                line = peer.recv(200)
            except TimeoutError:
                continue
            if not line:
                return
            time.sleep(self.answers_after_s)
            if line == b"stop\n":
                self.stops.append((self.now_s, self._present()))
                peer.sendall(b"Stopped\n")
            elif line == b"programState\n":
                peer.sendall(f"{self._present()} cell.urp\n".encode())


@pytest.mark.parametrize(
    ("state", "obeys", "stops"),
    [
        (lambda _: "PLAYING", 1, 1),
        (lambda _: "PLAYING", 3, 3),  # it ignores two: our program has run without an interruption, so it is told again
        (lambda _: "PAUSED", 1, 1),  # by a protective stop
        (lambda _: "STOPPED", 1, 0),
        (lambda t: "STOPPED" if t < 0.15 else "PLAYING", 1, 0),  # the cell's own program comes after ours
    ],
)
def test_our_program_is_stopped_and_no_program_after_it(state, obeys, stops):
    """Until the controller has shown once that no program runs."""
    with ScriptedDashboard(state, obeys) as dashboard:
        assert stop_program(HOST, OurProgram(time.monotonic()), within_s=0.5) == "ended"
        time.sleep(0.2)
        assert len(dashboard.stops) == stops


@pytest.mark.parametrize("ours", [OurProgram(None), OurProgram(time.monotonic() - 0.2), OurProgram(time.monotonic() + 1e6, "paused")])
def test_a_program_that_is_not_known_to_be_ours_is_never_stopped(ours):
    """Nothing was ours, or too long ago, or ours was seen to end: what plays is somebody else's, and our end was not shown."""
    with ScriptedDashboard(lambda _: "PLAYING") as dashboard:
        assert stop_program(HOST, ours, within_s=0.3) == "not_shown"
        assert dashboard.stops == []


@pytest.mark.parametrize("state", ["PLAYING", "PAUSED"])
@pytest.mark.parametrize(("known", "end", "stops"), [(True, "ended", 1), (False, "not_shown", 0)])
def test_a_program_that_a_witness_knows_for_ours_is_stopped_however_long_the_session_was_silent(state, known, end, stops):
    """A network that was away for a second, a call that blocked: the program played on."""
    with ScriptedDashboard(lambda _: state, 1) as dashboard:
        assert stop_program(HOST, OurProgram(None, runs=lambda: known), within_s=0.5) == end
    assert len(dashboard.stops) == stops


def test_a_program_of_another_name_has_taken_the_place_of_ours_and_is_not_stopped():
    """It came over ours without a pause in which nothing ran; our own name is stopped."""
    with ScriptedDashboard(lambda _: "PLAYING") as dashboard:
        assert stop_program(HOST, OurProgram(time.monotonic(), name="ours.urp"), within_s=0.3) == "replaced"
        assert dashboard.stops == []
        assert stop_program(HOST, OurProgram(time.monotonic(), name="cell.urp"), within_s=0.3) == "ended"
        assert len(dashboard.stops) == 1


def test_a_controller_that_answers_late_gets_no_stop():
    """Its answer is older than the time in which a cell may start a program of its own."""
    with ScriptedDashboard(lambda _: "PLAYING", answers_after_s=0.15) as dashboard:
        assert stop_program(HOST, OurProgram(time.monotonic()), within_s=0.5) == "not_shown"
        assert dashboard.stops == []


@pytest.mark.parametrize(("starts_s", "stops"), [(0.04, 1), (0.25, 0)])
def test_a_program_that_was_being_sent_is_stopped_where_it_starts_at_once(starts_s, stops):
    """Later it may be somebody else's."""
    with ScriptedDashboard(lambda t: "STOPPED" if t < starts_s else "PLAYING") as dashboard:
        assert stop_program(HOST, OurProgram(time.monotonic(), "starting"), within_s=1.0) == "ended"
        assert len(dashboard.stops) == stops


def test_the_cells_program_lives_in_a_hundred_handovers():
    """Ours ends 0 to 100 ms after the session, the cell's starts 0.15 s after ours: no stop ever meets the cell's program."""

    def met(host: str, numbers: range) -> list[float]:
        """When a stop met the cell's program."""
        found = []
        for number in numbers:
            ends_s = 0.1 * number / 100.0
            state = lambda t, end=ends_s: "PLAYING" if t < end or t > end + 0.15 else "STOPPED"  # noqa: E731
            with ScriptedDashboard(state, obeys=99, host=host) as dashboard:
                stop_program(host, OurProgram(time.monotonic()), within_s=0.3)
                found += [at for at, seen in dashboard.stops if seen == "PLAYING" and at > ends_s]
        return found

    with ThreadPoolExecutor(len(BESIDE)) as beside:
        parts = [beside.submit(met, host, range(first, 100, len(BESIDE))) for first, host in enumerate(BESIDE)]
    assert [part.result() for part in parts] == [[]] * len(BESIDE)
