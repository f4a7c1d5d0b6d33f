"""The server that gives a program's node its text, for as long as the daemon lives. I/O."""

import logging
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from monitor.acquire.driver import Driver
from monitor.acquire.settings import HandOver
from monitor.acquire.ur.driver import UNIVERSAL_ROBOTS
from monitor.acquire.ur.node_server import HandOverServer
from monitor.errors import MonitorError
from monitor.service.hand_over.node_text import NodeText, keep, kept, node_text
from monitor.service.problems import Problems

log = logging.getLogger(__name__)

PROBLEM = "hand_over"
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
        driver: Driver = UNIVERSAL_ROBOTS,
        make: Callable[[str], NodeText] | None = None,
    ) -> None:
        """Listen. Raises BadInput where the port is in use. make : of the text; None: as the driver's controller says."""
        self._host, self._directory, self._problems, self._driver = host, directory, problems, driver
        self._make = make or partial(node_text, driver=driver)
        self._node = kept(directory)
        self._asked = False  # whether the controller has answered since the start
        self._stopping = threading.Event()
        self._server = HandOverServer(NO_TEXT if self._node is None else self._node.text, bind=lent.bind, port=lent.port)
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
                self._problems.report(PROBLEM, f"a program that is played now gets a node that does nothing: {error}")

    def _take(self, node: NodeText) -> None:
        if self._node is not None and node.number != self._node.number:
            log.warning("hand-over: software %s needs another text: stop the program and play it again", node.software)
        self._node = node
        self._server.serve(node.text)
        keep(self._directory, node)

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
