"""The Robot API as the monitor asks it: found by itself, over real sockets, from servers that answer well, badly, slowly or elsewhere."""

import contextlib
import json
import time
from collections.abc import Callable

import pytest
from scripted_server import ScriptedServer
from simulated_arm import simulated_arm

from monitor.acquire.driver import OurProgram
from monitor.acquire.replay import check
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.survey import survey
from monitor.acquire.ur.conversation import conversation, playing_program, safety_stop, stop_program
from monitor.acquire.ur.dashboard import Dashboard
from monitor.acquire.ur.driver import UniversalRobots
from monitor.acquire.ur.robot_api import BASE, CONTROL, PROGRAM, RobotApi
from monitor.errors import RobotUnreachable
from monitor.model.fourier import Excitation
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.simulate.remote import Remote

HOST, PORT = "127.0.96.11", 18080


def reply(document, status="200 OK", *headers):
    body = document if isinstance(document, bytes) else json.dumps(document).encode()
    lines = [f"HTTP/1.1 {status}", "Content-Type: application/json", f"Content-Length: {len(body)}", *headers, "", ""]
    return "\r\n".join(lines).encode() + body


class ScriptedApi(ScriptedServer):
    """A server of HTTP on bytes: `answer` gives, for method and path, the bytes of the answer, or pieces with pauses [s] between them."""

    def __init__(self, answer: Callable[[str, str], "bytes | list[bytes | float]"], *, keeps: bool = True, host: str = HOST) -> None:
        self.answer, self.keeps = answer, keeps
        self.asked: list[tuple[str, str, bytes]] = []
        super().__init__(host, PORT)

    def converse(self, peer):
        with contextlib.suppress(OSError):
            while self._one(peer) and self.keeps:
                pass

    def _one(self, peer) -> bool:
        asked = b""
        while b"\r\n\r\n" not in asked or len(asked.partition(b"\r\n\r\n")[2]) < self._length(asked):
            if self.over.is_set():
                return False
            try:
                data = peer.recv(4096)
            except TimeoutError:
                continue
            if not data:
                return False
            asked += data
        method, path, _ = asked.split(b"\r\n")[0].decode().split(" ")
        self.asked.append((method, path.removeprefix(BASE), asked.partition(b"\r\n\r\n")[2]))
        said = self.answer(method, path.removeprefix(BASE))
        for piece in said if isinstance(said, list) else [said]:
            if isinstance(piece, float):
                if self.over.wait(piece):
                    return False
            else:
                peer.sendall(piece)
        return True

    @staticmethod
    def _length(asked: bytes) -> int:
        for line in asked.lower().split(b"\r\n"):
            if line.startswith(b"content-length:"):
                return int(line.split(b":")[1])
        return 0


def well(method, path):
    return reply({"state": "STOPPED"} if path == PROGRAM else {"mode": "REMOTE"} if path == CONTROL else {"mode": "NORMAL"})


def asking(path, said):
    """Everything is answered well but this path."""
    return lambda method, at: said if at == path else well(method, at)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (reply({"message": "Unauthorized"}, "401 Unauthorized"), "401: it asks for a password"),
        (reply({"message": "no", "details": "not from there"}, "403 Forbidden"), r"403: .*not from there"),
        (reply({}, "500 Internal Server Error"), "500"),
        (reply({"mode": "SOMETHING"}), "'SOMETHING'.*expected REMOTE or LOCAL"),
        (reply({"mode": None}), "does not say 'mode'"),
        (reply({"mode": ["REMOTE"]}), "does not say 'mode'"),
        (reply([1, 2]), "else than a JSON object"),
        (reply(b"<html>\x00\xff</html>"), r"else than a JSON object: <html>"),
        (reply(b""), "else than a JSON object"),
        (reply({}, "302 Found", "Location: https://127.0.96.11/login"), "elsewhere, to https"),
        (reply({}, "307 Temporary Redirect", f"Location: http://127.0.96.12:{PORT}{BASE}{CONTROL}"), "elsewhere, to http://127.0.96.12"),
        (reply({}, "307 Temporary Redirect", f"Location: {BASE}{CONTROL}"), "redirects .* more than 3 times"),
        (reply({}, "307 Temporary Redirect", f"Location: http://{HOST}:99999999/"), "elsewhere, to http://127.0.96.11:99999999"),
        (reply({}, "307 Temporary Redirect", "Location: http://[::1"), "elsewhere, to"),
        (reply({}, "307 Temporary Redirect").replace(b"Length: 2", b"Length: 2\r\nLocation: /\xe4"), "elsewhere, to /"),
        pytest.param(reply(b"[" * 100_000), "else than a JSON object", id="nested too deep"),
        (b"robot says hello\n\n", "does not speak HTTP"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\n{", "does not answer|does not speak"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n", "does not speak HTTP"),
        (b"HTTP/1.1 200 OK\r\n\r\n" + bytes(400_000), "longer than"),
        ([5.0], "no whole answer within 0.3 s|timed out"),
        (
            [b"HTTP/1.1 200 OK\r\n", *[piece for i in range(100) for piece in (0.05, b"X: y\r\n"[i % 6 : i % 6 + 1])]],
            "within 0.3 s|HTTP|timed out",
        ),
    ],
)
def test_an_answer_that_is_none_is_an_error_in_words_within_the_time_limit(said, words):
    """Refusals, garbage, redirects, and an answer in drops, each longer than any single wait."""
    with ScriptedApi(asking(CONTROL, said)), RobotApi(HOST, 0.3, port=PORT) as api:
        began = time.monotonic()
        with pytest.raises(RobotUnreachable, match=words):
            api.remote_control()
        assert time.monotonic() - began < 3.0  # the slowest answers take five


@pytest.mark.parametrize(
    ("said", "remote"),
    [
        (reply({"mode": "REMOTE"}), True),
        (reply({"mode": "LOCAL", "message": "ok"}), False),
        (reply({"message": "not known"}, "404 Not Found"), None),
        ([b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", 0.02, b'10\r\n{"mode":"REMOTE"\r\n1\r\n}\r\n0\r\n\r\n'], True),
        (b'HTTP/1.0 200 OK\r\n\r\n{"mode": "REMOTE"}', None),
    ],
)
def test_what_is_told_is_taken_and_what_a_version_does_not_have_is_not_known(said, remote):
    """In one piece or in chunks; 404 is an older version."""
    closes = isinstance(said, bytes) and said.startswith(b"HTTP/1.0")
    with ScriptedApi(asking(CONTROL, said), keeps=not closes), RobotApi(HOST, 1.0, port=PORT) as api:
        assert api.remote_control() is (True if closes else remote)


def test_a_redirect_on_the_same_server_is_followed_with_what_was_asked():
    """As where an endpoint has moved between versions."""
    moved = "/program/v2/state"

    def answer(method, path):
        return reply({}, "308 Permanent Redirect", f"Location: {BASE}{moved}") if path == PROGRAM else reply({"state": "PLAYING"})

    with ScriptedApi(answer) as server, RobotApi(HOST, 1.0, port=PORT) as api:
        api.stop()
        assert server.asked[-1] == ("PUT", moved, b'{"action": "stop"}')


def test_a_connection_that_the_controller_closes_is_opened_again_and_no_proxy_is_asked(monkeypatch):
    """After each answer; the next question is answered all the same."""
    for name in ("http_proxy", "HTTP_PROXY", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.2.199:9")
    with ScriptedApi(well, keeps=False), RobotApi(HOST, 1.0, port=PORT) as api:
        assert [api.remote_control() for _ in range(3)] == [True, True, True]


def test_neither_server_is_an_error_that_names_both_and_a_web_page_is_no_robot_api():
    """Nobody there at all; and a device with a page of its own on that port."""
    began = time.monotonic()
    with pytest.raises(RobotUnreachable, match=rf"no dashboard on port 29999 .*no Robot API on port {PORT}.*is the robot on"):
        playing_program(HOST, 30.0, robot_api_port=PORT)
    assert time.monotonic() - began < 10.0  # neither is waited for
    with ScriptedApi(lambda *_: reply({}, "404 Not Found")), pytest.raises(RobotUnreachable, match=r"29999 .*404.*10\.11"):
        playing_program(HOST, robot_api_port=PORT)
    with ScriptedApi(lambda *_: reply(b"<html>")), pytest.raises(RobotUnreachable, match=r"29999 .*JSON"):
        playing_program(HOST, robot_api_port=PORT)


def test_the_server_is_found_again_where_another_controller_takes_the_address():
    """First a PolyScope X, then an e-Series with a dashboard, then none."""
    with ScriptedApi(well):
        for _ in range(2):
            with conversation(HOST, 1.0, robot_api_port=PORT) as api:
                assert isinstance(api, RobotApi)
    with simulated_arm(HOST), conversation(HOST, 1.0, robot_api_port=PORT) as dashboard:
        assert isinstance(dashboard, Dashboard)
    with ScriptedApi(well), conversation(HOST, 1.0, robot_api_port=PORT) as api:
        assert api.program() == ("STOPPED", None)


@pytest.mark.parametrize(
    ("states", "stops", "ended"),
    [
        (["PLAYING", "PLAYING", "STOPPED"], 1, True),
        (["PAUSED", "PAUSED", "STOPPED"], 1, True),
        (["STOPPED"], 0, True),
        (["PLAYING"], 0, False),
    ],
)
def test_our_program_is_stopped_over_the_robot_api_and_nobody_elses(states, stops, ended):
    """The last row: what plays was never known to be ours."""
    shown = iter(states)
    last = [states[-1]]

    def answer(method, path):
        if method == "PUT":
            return reply({"message": "ok"})
        last[0] = next(shown, last[0])
        return reply({"state": last[0]})

    with ScriptedApi(answer) as server:
        ours = OurProgram(time.monotonic() if ended else None)
        assert stop_program(HOST, ours, within_s=0.4, robot_api_port=PORT) == ("ended" if ended else "not_shown")
        assert len([each for each in server.asked if each[0] == "PUT"]) == stops


def test_a_stop_that_is_not_answered_is_not_sent_again_without_another_look():
    """It may have been taken, and what plays since may be somebody else's."""
    asked: list[str] = []

    def answer(method, path):
        asked.append(method)
        if method == "PUT":
            raise ConnectionAbortedError
        return reply({"state": "PLAYING"})

    with ScriptedApi(answer), RobotApi(HOST, 0.5, port=PORT) as api:
        with pytest.raises(RobotUnreachable, match="without an answer"):
            api.stop()
        assert asked.count("PUT") == 1


def test_a_controller_that_closes_after_each_answer_without_saying_so_can_be_stopped():
    """Its last connection looks open until something is asked."""
    stopped: list[float] = []

    def answer(method, path):
        if method == "PUT":
            stopped.append(time.monotonic())
        return reply({"state": "STOPPED" if stopped else "PLAYING"})

    with ScriptedApi(answer, keeps=False):
        assert stop_program(HOST, OurProgram(time.monotonic()), within_s=1.0, robot_api_port=PORT) == "ended"
    assert len(stopped) == 1


def test_a_stop_that_is_refused_is_told_and_is_no_end(caplog):
    """In local control: 403, once in the log; the end is not confirmed."""

    def answer(method, path):
        return reply({"details": "local control"}, "403 Forbidden") if method == "PUT" else reply({"state": "PLAYING"})

    with ScriptedApi(answer):
        assert stop_program(HOST, OurProgram(time.monotonic()), within_s=0.4, robot_api_port=PORT) == "not_shown"
    assert len([record for record in caplog.records if "cannot be stopped from here" in record.getMessage()]) == 1


@pytest.mark.parametrize(
    ("mode", "cause"), [("PROTECTIVE_STOP", "protective_stop"), ("EMERGENCY_STOP", "emergency_stop"), ("FAULT", "safety")]
)
def test_a_stop_by_the_safety_system_is_told_by_its_cause(mode, cause):
    """By the API's own words for it."""
    with ScriptedApi(lambda method, path: reply({"state": "PAUSED", "mode": mode})):
        assert safety_stop(HOST, robot_api_port=PORT).cause == cause
    with ScriptedApi(lambda method, path: reply({"state": "PAUSED"}) if path == PROGRAM else reply({}, "404 Not Found")):
        assert safety_stop(HOST, robot_api_port=PORT) is None


def excitation() -> Excitation:
    from excitations import short

    return short(robot="ur5e")


@pytest.mark.parametrize(
    ("version", "serial", "remote", "sources"),
    [
        ("10.11.0", None, None, "Robot API, software by RTDE, model by the primary port"),
        ("10.12.0", None, True, "Robot API, software by RTDE, model by the primary port"),
        ("10.14.0", "20180500001", True, "Robot API, software by RTDE"),
    ],
)
def test_what_the_robot_api_does_not_tell_is_asked_of_rtde_and_the_primary_port(version, serial, remote, sources):
    """Model, software, limits and control by version; `check` says who told what, and what nobody told."""
    driver = UniversalRobots(robot_api_port=PORT)
    settings = ReplaySettings(host=HOST, allow_untested_software=True)
    with simulated_arm(HOST, "--robot", "ur5e", "--robot-api-port", str(PORT), "--polyscope", version):
        identity = driver.identity(HOST)
        assert (identity.model, identity.serial, identity.firmware) == ("UR5", serial, f"{version}.0")
        assert (identity.remote_control, identity.sources, identity.robot_api) == (remote, sources, True)
        assert identity.joint_limits is not None
        assert survey(HOST, driver=driver).model == "ur5e"
        checked = check(settings, excitation(), load_robot("ur5e"), Context(serial=serial or "7"), driver=driver)
        found = {each.name: each for each in checked}
        assert sources in found["robot_model"].text
        assert ("untested" in found["software"].text) is (version == "10.11.0")
        assert found["serial"].checked is (serial is not None)
        assert found["remote_control"].checked is (remote is not None)
        if version == "10.12.0":
            with Remote(HOST) as arm:
                arm.fault("robot_api", answer="unauthorized")
            lost = {each.name: each for each in check(settings, excitation(), load_robot("ur5e"), Context(), driver=driver)}
            assert "401" in lost["robot_model"].text
            assert not lost["remote_control"].holds
            assert lost["safety_mode"].holds  # RTDE answers all the same
