"""The program's hand-over node: its text, the server that gives it, and what `joint-monitor check` finds of the way between the two. I/O.

The text is made for one controller. What is kept of it is the library's part, for a start at which that controller is off: it depends on
the controller's software and on the library alone.
"""

import hashlib
import json
import logging
import os
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from typing import NamedTuple, Self

from monitor.acquire.driver import Driver, usual_driver
from monitor.acquire.safety.inputs import ConditionResult
from monitor.acquire.settings import HandOver
from monitor.config.schema import Configuration
from monitor.errors import BadInput, MonitorError
from monitor.reason import Reason, Sentence
from monitor.service.problems import Problems

FILE = "hand-over-node.json"
MARK = "# joint-monitor node "  # begins the first line of the text; its number follows


class NodeText(NamedTuple):
    """What a node of the program gets."""

    software: str | None  # of the controller that it was made for; None: it does not say
    control: str  # the library's part of it
    text: str

    @classmethod
    def of(cls, software: str | None, control: str, driver: Driver) -> Self:
        """The text around the library's. Raises BadInput where that is not as expected."""
        number = hashlib.sha256(driver.node_text(control).encode()).hexdigest()[:12]
        return cls(software, control, f"{MARK}{number}\n{driver.node_text(control, version=version_of(number))}")

    @property
    def number(self) -> str:
        """The number in the first line: two texts with one number are the same."""
        return number_of(self.text) or ""


def version_of(number: str) -> int:
    """What a program that has the text of this number says in the register VERSION: its first seven digits, within 32 bits, and never 0."""
    return int(number[:7], 16) or 1


def node_text(host: str, *, driver: Driver | None = None) -> NodeText:
    """The text for the controller at this address. Raises RobotUnreachable where it does not answer, BadInput for an unknown library."""
    driver = driver or usual_driver()
    return NodeText.of(driver.identity(host).firmware, driver.node_control(host), driver)


def number_of(text: str) -> str | None:
    """The number in the first line of a node's text; None where it is not ours."""
    first = text.partition("\n")[0].strip()
    return first.removeprefix(MARK) if first.startswith(MARK) else None


def keep(directory: Path, node: NodeText, driver: Driver | None = None) -> None:
    """Keep the library's part beside the history, whole or not at all; where the disk refuses, the next start asks the controller again."""
    library = (driver or usual_driver()).client_library
    path = directory / FILE
    temporary = path.with_suffix(".tmp")
    with suppress(OSError):
        temporary.write_text(json.dumps({"software": node.software, "control": node.control, "library": library}), "utf-8")
        os.replace(temporary, path)


def kept(directory: Path, driver: Driver | None = None) -> NodeText | None:
    """The text that was kept last; None where there is none, or another library is installed since."""
    try:
        document = json.loads((directory / FILE).read_text("utf-8"))
        driver = driver or usual_driver()
        if document["library"] != driver.client_library:
            return None
        return NodeText.of(document["software"], str(document["control"]), driver)
    except (OSError, ValueError, TypeError, KeyError, BadInput):
        return None


# --- the server ------------------------------------------------------------------------------------

log = logging.getLogger(__name__)

PROBLEM = "hand_over"
NODE_DOES_NOTHING = Sentence("node_does_nothing", "a program that is played now gets a node that does nothing: {why}")
ASK_EVERY_S = 10.0  # until the controller has said which software it runs
LOOK_EVERY_S = 600.0  # whether its software has changed since
# what a node gets before the text is known: the program plays, and its node does nothing
NO_TEXT = 'textmsg("joint-monitor does not know this controller yet: this node does nothing until the program is played again")\n'


class NodeServer:
    """Answers from the first moment on with the text that was kept, and asks the controller beside it. A context manager."""

    def __init__(
        self,
        lent: HandOver,
        host: str,
        directory: Path,
        problems: Problems,
        *,
        driver: Driver | None = None,
        make: Callable[[str], NodeText] | None = None,
    ) -> None:
        """Listen. Raises as `errors.cannot_listen`. make : of the text; None: as the driver's controller says."""
        self._host, self._directory, self._problems, self._driver = host, directory, problems, driver or usual_driver()
        self._make = make or partial(node_text, driver=self._driver)
        self._node = kept(directory, self._driver)
        self._asked = False  # whether the controller has answered since the start
        self._stopping = threading.Event()
        self._server = self._driver.node_server(NO_TEXT if self._node is None else self._node.text, bind=lent.bind, port=lent.port)
        self._thread = threading.Thread(target=self._run, name="hand-over text", daemon=True)
        log.info("hand-over: the program's node is answered on port %d", self._server.port)

    @property
    def port(self) -> int:
        """The port that was bound."""
        return self._server.port

    def look(self) -> None:
        """Make the text where none is kept, or where the controller's software is another one. Raises nothing: a problem says why."""
        try:
            if self._node is None or self._driver.identity(self._host).firmware != self._node.software:
                self._take(self._make(self._host))
            self._asked = True
            self._problems.clear(PROBLEM)
        except MonitorError as error:
            if self._node is None:  # with a text that is kept the node is answered all the same
                self._problems.report(PROBLEM, NODE_DOES_NOTHING(why=error.reason))

    def _take(self, node: NodeText) -> None:
        if self._node is not None and node.number != self._node.number:
            log.warning("hand-over: software %s needs another text: stop the program and play it again", node.software)
        self._node = node
        self._server.serve(node.text)
        keep(self._directory, node, self._driver)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self.look()
            except Exception as error:  # the thread must survive an error of this program; the log names it
                log.exception("hand-over: a fault")
                self._problems.report(PROBLEM, f"{type(error).__name__}: {error}")
            self._stopping.wait(LOOK_EVERY_S if self._asked else ASK_EVERY_S)

    def __enter__(self) -> "NodeServer":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._server.close()  # the thread may wait for a controller; it ends with the process


# --- what `joint-monitor check` finds --------------------------------------------------------------

NAME = "hand_over"
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


NO_ROUTE = Sentence("node_no_route", "no route leads to {host}: the program's node cannot reach this host")
LISTENS_ELSEWHERE = Sentence(
    "node_listens_elsewhere", "the controller reaches this host as {address}, the server listens on {bind} alone (replay.hand_over_listen)"
)
AT = "External Control at {address}, port {port}"
NOBODY_ANSWERS = Sentence(
    "node_nobody_answers",
    AT + ": nothing answers: while the daemon does not run, a program that is played stops at the node with a popup",
)
GETS_TEXT = Sentence("node_gets_text", AT + ": a node gets text {number}, {lines} lines")
GETS_NO_TEXT = Sentence(
    "node_gets_no_text", AT + ": the daemon does not know this controller yet: a node does nothing until the program is played again"
)
ANOTHER_SERVER = Sentence(
    "node_another_server",
    AT + ": another program answers; end it, or name another port (replay.hand_over_listen) here and in the node",
)
SCRIPT_BEGINS_WITH = Sentence("script_begins_with", "the file of the program's Script node must begin with {mark}{number} ({made})")
MADE_FOR, MADE_FOR_UNKNOWN = (
    Sentence("script_made_for", "made for software {software}"),
    Sentence("script_made_for_unknown", "made for a controller that says no software"),
)
SCRIPT_NOT_KNOWN = Sentence(
    "script_not_known", "which text the program's Script node needs is not known yet: joint-monitor script-node writes it"
)
PLAY_AGAIN = Sentence("node_play_again", "stop it and play it again")
COPY_AGAIN = Sentence("node_copy_again", "write the file again, copy it to the controller, and play the program again")
TEXT_NOT_SAID = Sentence("node_text_not_said", "{needs}; what the program has: the controller does not say it")
NOT_REACHED = Sentence("node_not_reached", "{needs}; what the program has: no node was reached yet")
HAS_IT = Sentence("node_has_text", "{needs}; the program that was played last has it, its nodes were reached {times} times")
HAS_ANOTHER = Sentence(
    "node_has_another_text",
    "{needs}; THE PROGRAM THAT WAS PLAYED LAST HAS ANOTHER TEXT: {remedy} (its nodes were reached {times} times)",
)


def _served(configuration: Configuration, lent: HandOver) -> ConditionResult:
    address = own_address(configuration.robot.host)
    if address is None:
        return ConditionResult(name=NAME, holds=False, reason=NO_ROUTE(host=configuration.robot.host))
    if ip_address(address).is_loopback and ip_address(lent.bind).is_loopback:
        address = lent.bind  # a simulated controller, on this host, reaches every such address
    if lent.bind not in {EVERYWHERE, address}:
        return ConditionResult(name=NAME, holds=False, reason=LISTENS_ELSEWHERE(address=address, bind=lent.bind))
    at = {"address": address, "port": lent.port}
    answer = configuration.driver.node_answer(address, lent.port)
    if answer is None:
        return ConditionResult(name=NAME, holds=True, reason=NOBODY_ANSWERS(**at), checked=False)
    number = number_of(answer)
    if number is not None:
        return _compared(configuration, number, GETS_TEXT(**at, number=number, lines=answer.count("\n")), PLAY_AGAIN())
    if answer == NO_TEXT:
        return ConditionResult(name=NAME, holds=True, reason=GETS_NO_TEXT(**at), checked=False)
    return ConditionResult(name=NAME, holds=False, reason=ANOTHER_SERVER(**at))


def _on_the_controller(configuration: Configuration) -> ConditionResult:
    node = kept(configuration.state_directory, configuration.driver)
    if node is None:
        return ConditionResult(name=NAME, holds=True, reason=SCRIPT_NOT_KNOWN(), checked=False)
    made = MADE_FOR(software=node.software) if node.software else MADE_FOR_UNKNOWN()
    return _compared(configuration, node.number, SCRIPT_BEGINS_WITH(mark=MARK, number=node.number, made=made), COPY_AGAIN())


def _compared(configuration: Configuration, number: str, needs: Reason, remedy: Reason) -> ConditionResult:
    """The text of today against what the node of the program that was played last says of its own.

    Another one does not speak against running the service: its arm is not taken, or taken as ever, and the program works.
    """
    says = configuration.driver.node_says(configuration.robot.host)
    if says is None or not says.reached:
        unknown = TEXT_NOT_SAID if says is None else NOT_REACHED
        return ConditionResult(name=NAME, holds=True, reason=unknown(needs=needs), checked=False)
    if says.version == version_of(number):
        return ConditionResult(name=NAME, holds=True, reason=HAS_IT(needs=needs, times=says.reached))
    return ConditionResult(name=NAME, holds=True, reason=HAS_ANOTHER(needs=needs, remedy=remedy, times=says.reached), checked=False)
