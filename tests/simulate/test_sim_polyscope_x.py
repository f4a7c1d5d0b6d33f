"""A simulated PolyScope X: no dashboard server, a Robot API in its place, and a program node that says nothing where its host is away."""

import contextlib
import http.client
import json
import socket
import struct
import threading
import time

import pytest
from raw_rtde import RawRtde
from sim_process import result_of

from monitor.acquire.ur.node_script import control_script
from monitor.acquire.ur.node_server import HandOverServer
from monitor.acquire.ur.primary import ProgramMessages
from monitor.errors import BadInput
from monitor.simulate.settings import SimulateSettings

API, PORT = "/universal-robots/robot-api", 18080
VERSIONS = {"10.11.0": "3.0.0", "10.12.0": "3.1.4", "10.14.0": "5.0.107"}


def x_arm(spawn, version="10.12.0", *arguments):
    return spawn("--robot", "ur5e", "--polyscope", version, "--robot-api-port", str(PORT), *arguments)


def ask(arm, method, path, document=None):
    """Status and document."""
    connection = http.client.HTTPConnection(arm.address, PORT, timeout=8.0)
    try:
        body = document if document is None or isinstance(document, bytes) else json.dumps(document)
        connection.request(method, API + path, body, {"Content-Type": "application/json"})
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())
    finally:
        connection.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_each_version_has_the_endpoints_that_the_manufacturers_client_asks_it_for(spawn, version):
    """10.11 has programs and power; the modes came with 10.12, who the robot is with 10.14. Each lists them in its own document."""
    arm = x_arm(spawn, version)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((arm.address, 29999), timeout=1.0)
    status, openapi = ask(arm, "GET", "/openapi.json")
    assert (status, openapi["info"]["version"]) == (200, VERSIONS[version])
    minor = int(version.split(".")[1])
    since = {
        "/program/v1/state": 11,
        "/program/v1/loaded": 12,
        "/programs/v1/": 12,
        "/robotstate/v1/robotmode": 12,
        "/robotstate/v1/safetymode": 12,
        "/system/v1/controlmode": 12,
        "/system/v1/operationalmode": 12,
        "/versions/v1": 14,
        "/system/v1/information": 14,
    }
    assert {path: ask(arm, "GET", path)[0] for path in since} == {path: 200 if first <= minor else 404 for path, first in since.items()}
    assert all((path.rstrip("/") in openapi["paths"]) == (first <= minor) for path, first in since.items())
    old, new = ("/program/v1/load", {"programName": "wait_program"}), ("/program/v1/loaded", {"name": "wait_program"})
    assert ask(arm, "PUT", *old)[0] == (200 if minor == 11 else 307)
    assert ask(arm, "PUT", *new)[0] == (404 if minor == 11 else 200)


def test_programs_power_and_stops_as_the_manufacturers_tests_have_them(spawn):
    """Load, play, pause, resume and stop; power off and on; a protective stop that is unlocked within a second."""
    arm = x_arm(spawn)
    state, robot = "/program/v1/state", "/robotstate/v1/state"

    def act(action):
        return ask(arm, "PUT", robot if action.isupper() else state, {"action": action})[0]

    def mode(path):
        return ask(arm, "GET", path)[1]["mode"]

    assert ask(arm, "GET", "/program/v1/loaded")[1]["name"] == "Default program"
    assert act("play") == 409  # there is nothing in it
    assert ask(arm, "PUT", "/program/v1/loaded", {"name": "wait_program"})[0] == 200
    assert ask(arm, "GET", "/program/v1/loaded")[1]["name"] == "wait_program"
    for action, shown in (("play", "PLAYING"), ("pause", "PAUSED"), ("resume", "PLAYING"), ("stop", "STOPPED")):
        assert act(action) == 200
        assert ask(arm, "GET", state)[1]["state"] == shown
    assert [act(action) for action in ("pause", "resume", "stop")] == [409, 409, 409]
    assert ask(arm, "PUT", state, {"action": "dance"})[0] == 422
    assert ask(arm, "PUT", state, [1])[0] == 422
    assert ask(arm, "PUT", state, b"[" * 60_000)[0] == 422
    assert ask(arm, "DELETE", state)[0] == 405
    assert ask(arm, "PUT", "/program/v1/loaded", {"name": "nothing"})[0] == 500
    for action, shown in (("POWER_OFF", "POWER_OFF"), ("POWER_ON", "IDLE"), ("BRAKE_RELEASE", "RUNNING")):
        assert act(action) == 200
        assert mode("/robotstate/v1/robotmode") == shown
    assert act("UNLOCK_PROTECTIVE_STOP") == 409
    with arm.remote() as remote:
        remote.fault("protective_stop")
    assert mode("/robotstate/v1/safetymode") == "PROTECTIVE_STOP"
    assert act("UNLOCK_PROTECTIVE_STOP") == 200
    assert mode("/robotstate/v1/safetymode") == "NORMAL"


def test_in_local_control_everything_is_told_and_nothing_is_done(spawn):
    """403 for whatever acts. Manual mode ends remote control."""
    arm = x_arm(spawn)
    with arm.remote() as remote:
        remote.fault("manual_mode")
    assert ask(arm, "GET", "/system/v1/operationalmode")[1]["mode"] == "MANUAL"
    assert ask(arm, "GET", "/system/v1/controlmode")[1]["mode"] == "LOCAL"
    assert ask(arm, "GET", "/program/v1/state")[0] == 200
    for path, document in (
        ("/program/v1/loaded", {"name": "wait_program"}),
        ("/program/v1/state", {"action": "stop"}),
        ("/robotstate/v1/state", {"action": "POWER_OFF"}),
    ):
        status, why = ask(arm, "PUT", path, document)
        assert (status, "remote control" in why["details"]) == (403, True)
    assert ask(arm, "GET", "/robotstate/v1/robotmode")[1]["mode"] == "RUNNING"
    with arm.remote() as remote:
        remote.fault("clear")
    assert ask(arm, "GET", "/system/v1/controlmode")[1]["mode"] == "REMOTE"


@pytest.mark.parametrize(("answer", "status"), [("unauthorized", 401), ("forbidden", 403), ("failing", 500), ("elsewhere", 307)])
def test_a_faulty_robot_api_answers_so_until_the_fault_is_cleared(spawn, answer, status):
    """Every request gets it; afterwards all is as before."""
    arm = x_arm(spawn)
    with arm.remote() as remote:
        remote.fault("robot_api", answer=answer)
        assert ask(arm, "GET", "/program/v1/state")[0] == status
        remote.fault("robot_api", answer="garbage")
        with pytest.raises(ValueError, match="Expecting value"):
            ask(arm, "GET", "/program/v1/state")
        remote.fault("clear")
    assert ask(arm, "GET", "/program/v1/state")[0] == 200


def test_what_is_no_http_ends_the_connection_and_nothing_else(spawn):
    """A body without end, a line of text, and a request in pieces over one connection."""
    arm = x_arm(spawn)
    for nonsense in (b"programState\n\n", b"PUT / HTTP/1.1\r\nHost: a\r\nContent-Length: 100000\r\n\r\n" + bytes(100_000)):
        with socket.create_connection((arm.address, PORT), timeout=2.0) as wire:
            wire.sendall(nonsense)
            wire.settimeout(2.0)
            with contextlib.suppress(ConnectionResetError):
                assert wire.recv(10) == b""
    with socket.create_connection((arm.address, PORT), timeout=2.0) as wire:
        for piece in (b"GET ", f"{API}/program/v1/state HTTP/1.1\r\n".encode(), b"Host: arm\r\n", b"\r\n"):
            wire.sendall(piece)
            time.sleep(0.02)
        assert b"200" in wire.recv(1000)
        wire.sendall(f"GET {API}/system/v1/controlmode HTTP/1.1\r\nHost: arm\r\n\r\n".encode())
        assert b"REMOTE" in wire.recv(1000)


CELL = """name = "cell"
loop = false
[[node]]
external_control = "127.0.0.1:{port}"
[[node]]
wait = 30.0
"""


@pytest.mark.parametrize(("pause_s", "whole"), [(0.05, True), (0.3, False), (None, False)])
def test_its_program_node_reads_until_a_tenth_of_a_second_of_silence_and_says_nothing_where_nobody_answers(
    spawn, tmp_path, free_port, pause_s, whole
):
    """The text is taken as it is by then; without any the program plays on, without a popup."""
    served = threading.Event()

    def serve(server):
        peer, _ = server.accept()
        with peer:
            peer.recv(100)
            peer.sendall(b"write_output_integer_register(12, 7)\n")
            time.sleep(pause_s)
            try:
                peer.sendall(b"write_output_integer_register(13, 8)\n")
                served.wait(5.0)
            except OSError:
                pass

    (tmp_path / "cell.toml").write_text(CELL.format(port=free_port))
    arm = x_arm(spawn, "10.12.0", "--program", str(tmp_path / "cell.toml"))
    if pause_s is not None:
        server = socket.create_server(("127.0.0.1", free_port))
        threading.Thread(target=serve, args=(server,), daemon=True).start()
    assert ask(arm, "PUT", "/program/v1/state", {"action": "play"})[0] == 200
    time.sleep(0.1)
    with RawRtde(arm.address) as wire:
        wire.ask(b"V", struct.pack(">H", 2))
        wire.stream("output_int_register_12,output_int_register_13")
        kind, row = wire.packet()
    assert kind == b"U"
    assert struct.unpack(">2i", row[1:]) == ((0, 0) if pause_s is None else (7, 8 if whole else 0))
    assert ask(arm, "GET", "/program/v1/state")[1]["state"] == "PLAYING"
    served.set()


UR_RTDE = """
import json, os, sys
from rtde_control import RTDEControlInterface as Control
from rtde_receive import RTDEReceiveInterface
host = sys.argv[1]
r = RTDEReceiveInterface(host, 125.0)
c = Control(host, 125.0)
home = r.getActualQ()
moved = c.moveJ([home[0] + 0.05, *home[1:]], 1.0, 5.0)
there = r.getActualQ()[0] - home[0]
servo = all(c.servoJ([home[0] + 0.05, *home[1:]], 0.0, 0.0, 0.008, 0.05, 400.0) for _ in range(10)) and c.servoStop(5.0)
c.stopScript()
print("\\n" + json.dumps(dict(moved=moved, servo=servo, there=there, runs=c.isProgramRunning())), flush=True)
os._exit(0)
"""


@pytest.mark.parametrize("version", ["10.11.0", "10.12.0"])
def test_a_version_that_does_not_know_a_name_in_ur_rtdes_script_refuses_it_whole(spawn, version):
    """1.6.5 gives `direct_torque` a parameter that these have not, and takes them for versions that have it; 10.12.1 has it."""
    arm = x_arm(spawn, version)
    text = f"def rtde_control():\n{control_script(arm.address)}\nend\n".encode()
    told = ProgramMessages.of(arm.address)
    with socket.create_connection((arm.address, 30003)) as script:
        script.sendall(text)
        until = time.monotonic() + 10.0
        started = told.started()
        while not told.mistake and time.monotonic() < until:
            time.sleep(0.02)
            started += told.started()
    assert "compile_error_name_not_found:viscous_scale:" in told.mistake
    assert started == []


@pytest.mark.parametrize("version", ["10.12.1", "10.14.0"])
def test_unmodified_ur_rtde_uploads_its_script_and_moves_the_arm(spawn, client, version):
    """It asks a PolyScope X for no dashboard, and for more registers."""
    arm = x_arm(spawn, version)
    result = result_of(client(UR_RTDE, arm.address))
    assert result["there"] == pytest.approx(0.05, abs=2e-3)
    assert (result["moved"], result["servo"], result["runs"]) == (True, True, False)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"version": "10.8.0", "robot": "ur5e"}, "10.11 or newer"),
        ({"version": "10.12.0"}, "3.4 … 3.15 for a ur5"),
        ({"version": "10.12.0", "robot": "ur5e", "robot_api_port": 30004}, "robot_api_port = 30004"),
        ({"version": "10.12.0", "robot": "ur5e", "robot_api_port": 30020}, "both 30020"),
    ],
)
def test_a_polyscope_x_that_cannot_be_is_refused(wrong, words):
    """With the setting, its value and what is expected."""
    with pytest.raises(BadInput, match=words):
        SimulateSettings(**wrong)


def test_the_server_of_the_node_leaves_the_end_of_the_connection_to_the_controller():
    """A node that reads until nothing has come for 0.1 s would take an end for more text, again and again."""
    with HandOverServer("text\n", bind="127.0.0.1", port=0) as server, socket.create_connection(("127.0.0.1", server.port)) as wire:
        wire.sendall(b"request_program\n")
        wire.settimeout(1.0)
        assert wire.recv(100) == b"text\n"
        wire.settimeout(0.1)
        with pytest.raises(TimeoutError):
            wire.recv(100)
