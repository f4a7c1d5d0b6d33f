"""The text of ur-rtde's control script for one controller, as ur-rtde itself serves it.

The installed library holds the text in pieces, so it is asked for over the wire: ur-rtde connects to the controller, learns the version of
its software, and serves the text on a port of this host, as to an External Control node. Nothing is sent to the controller but a
cleared command, and nothing moves.
"""

import json
import socket
import subprocess
import sys

from monitor.acquire.hand_over.server import REQUEST
from monitor.errors import RobotUnreachable

REQUEST_LINE = REQUEST.decode() + "\n"  # ur-rtde compares the whole line
CHILD_S = 30.0  # connecting takes some tenths of a second; a controller that does not answer takes several
_CHILD = """
import json, socket, sys
from rtde_control import RTDEControlInterface as Control
host, port = sys.argv[1], int(sys.argv[2])
control = Control(host, 125.0, Control.FLAG_USE_EXT_UR_CAP | Control.FLAG_NO_WAIT, port)
with socket.create_connection(("127.0.0.1", port), timeout=2.0) as wire:
    wire.sendall(sys.argv[3].encode())
    wire.settimeout(0.5)
    text = b""
    try:
        while more := wire.recv(65536):
            text += more
    except TimeoutError:
        pass
print("\\n" + json.dumps(text.decode()), flush=True)
import os
os._exit(0)
"""


def control_script(host: str) -> str:
    """The text for the controller at this address. Raises RobotUnreachable where it does not answer."""
    with socket.socket() as wire:  # a free port of this host
        wire.bind(("127.0.0.1", 0))
        port = wire.getsockname()[1]
    command = [sys.executable, "-c", _CHILD, host, str(port), REQUEST_LINE]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=CHILD_S, check=False)
    except subprocess.TimeoutExpired:
        raise RobotUnreachable(f"{host}: no answer within {CHILD_S:g} s while asking for ur-rtde's control script") from None
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no output"])[-1]
        raise RobotUnreachable(f"{host}: ur-rtde could not serve its control script: {last}")
    text: str = json.loads(done.stdout.strip().splitlines()[-1])
    return text
