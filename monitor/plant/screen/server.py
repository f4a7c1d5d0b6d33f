"""The screen's HTTP server, in a thread of the plant. I/O."""

import time
from pathlib import Path

from monitor.errors import StoreError
from monitor.plant.database import Database
from monitor.plant.ingest import add_audit
from monitor.plant.screen.access import PlantAccess
from monitor.plant.screen.app import Screen
from monitor.plant.screen.arm_page import Ways
from monitor.plant.screen.people import printable
from monitor.plant.screen.settings import ScreenSettings
from monitor.views.web.server import WebServer, log

LONGEST_TEXT = 2000  # of a line of the audit; a reason that a person types has some hundred letters


class ScreenServer(WebServer):
    """A context manager; it serves until the context ends. `url` is the screen's address."""

    def __init__(self, settings: ScreenSettings, folder: Path, database: Database, ways: Ways) -> None:
        """Begin to serve. folder : from which relative names of files start.

        Raises BusError where the address is taken, BadInput where the file of users cannot be read.
        """
        host, port = settings.address()
        super().__init__(settings.listen, host, port, "screen")
        try:
            access = PlantAccess(settings, folder, self.port, lambda *line: _note(database, *line))
        except BaseException:
            self.__exit__()
            raise
        if settings.believes_this_machine:
            log.warning("screen: proxies holds an address of this machine, and there is no proxy_secret: each process here can be anybody")
        self.screen = Screen(database, ways, access, settings.language)
        self.serve(self.screen.starlette, self.screen.closing, "" if settings.knows_people else " (everybody of this machine)")


def _note(database: Database, who: str, act: str, robot: str | None, text: str) -> None:
    """One line of the audit; it also stands in the journal, where the database may be away."""
    text = text[:LONGEST_TEXT]
    log.info("audit who=%r act=%s robot=%s: %s", who, act, robot, printable(text))
    try:
        with database.write() as connection:
            add_audit(connection, time.time(), who, act, robot, text)
    except StoreError as error:
        log.error("trouble=audit: the line above is not in the database: %s", error, extra={"trouble": "audit"})
