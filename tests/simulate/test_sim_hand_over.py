"""A production program lends the arm to unmodified ur-rtde, by a node that PolyScope asks for at Play, and goes on at its next node."""

import pytest
from sim_process import result_of

from monitor.acquire.ur.node_script import control_script, hand_over_script
from monitor.acquire.ur.node_server import HandOverServer

BORROW = """
import json, os, socket, sys, threading, time, urllib.request
from rtde_control import RTDEControlInterface as Control
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface
host, cycles = sys.argv[1], int(sys.argv[2])
with socket.socket() as free:
    free.bind(("127.0.0.1", 0)); port = free.getsockname()[1]
r, io = RTDEReceiveInterface(host), RTDEIOInterface(host)
c = Control(host, 125.0, Control.FLAG_USE_EXT_UR_CAP | Control.FLAG_NO_WAIT, port)
lock = threading.Lock()
def write(register, value):
    with lock:
        io.setInputIntRegister(register, value)
def beat():
    number = 0
    while True:
        number = number % 1000 + 1
        write(21, number); time.sleep(0.02)
def dash(line):
    try:
        with socket.create_connection((host, 29999), timeout=10) as wire, wire.makefile("rw") as file:
            file.readline(); file.write(line + "\\n"); file.flush()
            return file.readline().strip()
    except ConnectionRefusedError:  # a PolyScope X
        play = json.dumps(dict(action="play")).encode() if line == "play" else None
        place = f"http://{host}:18080/universal-robots/robot-api/program/v1/state"
        with urllib.request.urlopen(urllib.request.Request(place, play, method="PUT" if play else "GET")) as answer:
            return "Starting program" if play else json.load(answer)["state"] + " cell.urp"
def until(*states):
    end = time.monotonic() + 10
    while r.getOutputIntRegister(19) not in states and time.monotonic() < end:
        time.sleep(0.001)
    return r.getOutputIntRegister(19)
results = []
threading.Thread(target=beat, daemon=True).start()
write(22, 1)
played = dash("play")
for cycle in range(cycles):
    until(1)
    write(20, r.getOutputIntRegister(18))
    taken, home = until(2), r.getTargetQ()
    moved = [c.moveJ([home[0] + 0.3, *home[1:]], 3.0, 8.0), c.moveJ(home, 3.0, 8.0)]
    for i in range(40):
        moved.append(c.servoJ([home[0] + 0.001 * min(i, 40 - i), *home[1:]], 0.0, 0.0, 0.008, 0.05, 400.0)); time.sleep(0.008)
    moved.append(c.servoStop(10.0))
    moved.append(c.moveJ(home, 1.0, 4.0))
    write(20, 0)
    back = until(0, 1)
    results.append(dict(taken=taken, moved=all(moved), back=back, state=dash("programState")))
write(22, 0)
time.sleep(0.5)
print("\\n" + json.dumps(dict(played=played, results=results, state=dash("programState"))), flush=True)
os._exit(0)
"""
CELL = """name = "cell"
[[node]]
move = [0.1, -1.57, 0.0, -1.57, 0.0, 0.0]
[[node]]
external_control = "{address}:{port}"
[[node]]
move = [0.0, -1.57, 0.0, -1.57, 0.0, 0.0]
"""


@pytest.mark.parametrize(
    ("arguments", "cycles"),
    [
        (("--robot", "ur5e"), 2),
        *(
            pytest.param(("--robot", robot, "--polyscope", version), 50, marks=(pytest.mark.soak, pytest.mark.timeout(400)))
            for robot, version in (("ur5", "3.15.8"), ("ur5e", "5.11.0"), ("ur5e", "5.22.0"))
        ),
        (("--robot", "ur5e", "--polyscope", "10.12.0", "--robot-api-port", "18080"), 1),
    ],
)
def test_ur_rtde_borrows_the_arm_and_the_program_goes_on(spawn, client, tmp_path, arguments, cycles):
    """Each cycle the arm is taken, moved, streamed, brought back and given back; the program never stops."""
    asked = spawn(*arguments)
    text = hand_over_script(control_script(asked.address))
    assert text.isascii()  # the node of a PolyScope X takes no other letters
    with HandOverServer(text, bind=asked.address, port=50002) as server:
        asked.end()
        (tmp_path / "cell.toml").write_text(CELL.format(address=asked.address, port=server.port))
        simulator = spawn(*arguments, "--program", str(tmp_path / "cell.toml"))
        result = result_of(client(BORROW, simulator.address, str(cycles)), timeout_s=30 + 5 * cycles)
        assert server.served == 1
    assert result["played"] == "Starting program"
    for cycle in result["results"]:
        assert cycle.pop("back") in (0, 1)  # the program may have come to the node again already
        assert cycle == {"taken": 2, "moved": True, "state": "PLAYING cell.urp"}
    assert len(result["results"]) == cycles
    assert result["state"] == "PLAYING cell.urp"
    with simulator.remote() as remote:
        truth = remote.truth()
    assert truth["stops"] == []
    assert truth["refused_commands"] == []
