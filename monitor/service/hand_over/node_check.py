"""What `joint-monitor check` finds of the way between a program's node and its text: address, port, and the number of the text. I/O."""

import socket
from contextlib import suppress
from ipaddress import ip_address

from monitor.acquire.safety.inputs import ConditionResult
from monitor.acquire.settings import HandOver
from monitor.acquire.ur.node_server import REQUEST
from monitor.config.schema import Configuration
from monitor.service.hand_over.node_server import NO_TEXT
from monitor.service.hand_over.node_text import MARK, kept, number_of, version_of

NAME = "hand_over"
PATIENCE_S = 3.0  # for the connection, and for each part of the answer; the daemon is on this host, which may be busy
EVERYWHERE = "0.0.0.0"  # noqa: S104 - a setting is compared with it


def node_conditions(configuration: Configuration) -> tuple[ConditionResult, ...]:
    """One condition where a program lends the arm, else none. What is not known yet does not speak against running the service."""
    lent = configuration.replay.lent
    if lent is None:
        return ()
    return (_served(configuration, lent) if lent.serves else _on_the_controller(configuration),)


def own_address(host: str) -> str | None:
    """The address of this host by which a controller reaches it, as the routes say; None where none leads there. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire, suppress(OSError):
        wire.connect((host, 9))
        return str(wire.getsockname()[0])
    return None


def _served(configuration: Configuration, lent: HandOver) -> ConditionResult:
    address = own_address(configuration.robot.host)
    if address is None:
        text = f"no route leads to {configuration.robot.host}: the program's node cannot reach this host"
        return ConditionResult(name=NAME, holds=False, text=text)
    if ip_address(address).is_loopback and ip_address(lent.bind).is_loopback:
        address = lent.bind  # a simulated controller, on this host, reaches every such address
    if lent.bind not in {EVERYWHERE, address}:
        text = f"the controller reaches this host as {address}, the server listens on {lent.bind} alone (replay.hand_over_listen)"
        return ConditionResult(name=NAME, holds=False, text=text)
    where = f"External Control at {address}, port {lent.port}"
    answer = _answer(address, lent.port)
    if answer is None:
        text = f"{where}: nothing answers: while the daemon does not run, a program that is played stops at the node with a popup"
        return ConditionResult(name=NAME, holds=True, text=text, checked=False)
    number = number_of(answer)
    if number is not None:
        told = f"{where}: a node gets text {number}, {answer.count(chr(10))} lines"
        return _compared(configuration, number, told, "stop it and play it again")
    if answer == NO_TEXT:
        text = f"{where}: the daemon does not know this controller yet: a node does nothing until the program is played again"
        return ConditionResult(name=NAME, holds=True, text=text, checked=False)
    text = f"{where}: another program answers; end it, or name another port (replay.hand_over_listen) here and in the node"
    return ConditionResult(name=NAME, holds=False, text=text)


def _on_the_controller(configuration: Configuration) -> ConditionResult:
    node = kept(configuration.state_directory)
    if node is not None:
        made = f"made for software {node.software}" if node.software else "made for a controller that says no software"
        told = f"the file of the program's Script node must begin with {MARK}{node.number} ({made})"
        return _compared(configuration, node.number, told, "write the file again, copy it to the controller, and play the program again")
    text = "which text the program's Script node needs is not known yet: joint-monitor script-node writes it"
    return ConditionResult(name=NAME, holds=True, text=text, checked=False)


def _compared(configuration: Configuration, number: str, told: str, remedy: str) -> ConditionResult:
    """The text of today against what the node of the program that was played last says of its own.

    Another one does not speak against running the service: its arm is not taken, or taken as ever, and the program works.
    """
    says = configuration.driver.node_says(configuration.robot.host)
    if says is None or not says.reached:
        why = "the controller does not say it" if says is None else "no node was reached yet"
        return ConditionResult(name=NAME, holds=True, text=f"{told}; what the program has: {why}", checked=False)
    reached = f"its nodes were reached {says.reached} times"
    if says.version == version_of(number):
        return ConditionResult(name=NAME, holds=True, text=f"{told}; the program that was played last has it, {reached}")
    text = f"{told}; THE PROGRAM THAT WAS PLAYED LAST HAS ANOTHER TEXT: {remedy} ({reached})"
    return ConditionResult(name=NAME, holds=True, text=text, checked=False)


def _answer(address: str, port: int) -> str | None:
    """What the port answers to a node's request; None where nobody listens."""
    answer = b""
    try:
        with socket.create_connection((address, port), timeout=PATIENCE_S) as wire, suppress(TimeoutError):
            wire.sendall(REQUEST + b"\n")
            while data := wire.recv(65536):
                answer += data
    except ConnectionResetError:
        pass
    except OSError:
        return None
    return answer.decode("utf-8", errors="replace")
