"""Commands that come back through the gateway: an alert is acknowledged by a ticket or a button. The arm itself carries them out. I/O.

They go to the arm's own commands, as the plant's screen sends them; a role is asked for, and every act and refusal is a line of the audit.
"""

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from monitor.errors import BadInput, StoreError
from monitor.plant.arm import ArmName
from monitor.plant.database import Database
from monitor.plant.ingest import add_audit
from monitor.plant.links import Inbox, Link, command_arm
from monitor.plant.screen.people import NEEDED, Role
from monitor.plant.status import refuse_doubled

log = logging.getLogger(__name__)

WAIT_S = 5.0  # for a router, by the first act


class Commands:
    """Sends commands to arms. The first one opens the ways to them. Several threads may use it."""

    def __init__(self, database: Database, connect: Sequence[str], zenoh_file: str, now: Callable[[], float]) -> None:
        self._database, self._connect, self._zenoh_file, self._now = database, connect, zenoh_file, now
        self._opening = threading.Lock()
        self._links: list[Link] = []

    def close(self) -> None:
        """Close the ways."""
        with self._opening:
            for link in self._links:
                link.close()
            self._links = []

    def send(self, arm: ArmName, command: str, document: Mapping[str, Any], *, who: str, role: Role | None, via: str) -> dict[str, Any]:
        """Send a command in somebody's name. Returns the arm's answer. Raises BadInput where it is refused, or nobody answers.

        who : for the audit and the alert. role : that of whoever asks; None: he has none. via : by which channel it came.
        """
        about = ", ".join(f"{key} {document[key]}" for key in ("joint", "condition", "hours", "why") if document.get(key) not in (None, ""))
        try:
            needed = NEEDED.get(command)
            if needed is None:
                raise BadInput("this is done at the arm itself")
            if role is None or role < needed:
                raise BadInput(f"{who} may {role.name if role else 'nothing'}; this needs the role {needed.name}")
            refuse_doubled(self._database, arm.site, arm.robot)
            answer = command_arm(self._way(arm), arm, f"cmd/{command}", {**document, "by": who})
        except BadInput as error:
            self.audit(who, command, str(arm), f"by {via}: {about}: refused: {error}")
            raise
        self.audit(who, command, str(arm), f"by {via}: {about}" if about else f"by {via}")
        return answer

    def audit(self, who: str, act: str, robot: str | None, text: str) -> None:
        """One line of the audit; it also stands in the journal, where the database may be away."""
        log.info("audit who=%r act=%s robot=%s: %s", who, act, robot, text)
        try:
            with self._database.write() as connection:
                add_audit(connection, self._now(), who, act, robot, text[:2000])
        except StoreError as error:
            log.error("trouble=audit: the line above is not in the database: %s", error, extra={"trouble": "audit"})

    def _way(self, arm: ArmName) -> Link | None:
        """A router behind which the arm's monitor is."""
        with self._opening:
            if not self._links:
                self._links = [Link(endpoint, Inbox(), self._zenoh_file, follows=False) for endpoint in self._connect]
            links = list(self._links)
        until = time.monotonic() + WAIT_S
        while True:
            for link in links:
                if link.reached() and link.sees(arm):
                    return link
            if time.monotonic() >= until or all(link.reached() for link in links):
                return None
            time.sleep(0.05)
