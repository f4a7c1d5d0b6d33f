"""The gateway of one arm within its daemon: [notify] of the arm's own file, and the gateway's channels over the arm's own history. I/O.

A small database beside the history copies the history's logs by cursor, as a plant does, and keeps what is owed. So nothing is lost or
told twice over a crash, and a crash of what tells people never touches the history.
"""

import logging
import threading
import time
from pathlib import Path
from typing import Any

import orjson

from monitor.config.load import load
from monitor.config.schema import Configuration
from monitor.errors import BadInput, MonitorError
from monitor.gateway.connection import Finding
from monitor.gateway.run import Gateway
from monitor.gateway.settings import CHANNELS, GatewayConfiguration, GatewaySettings, check_all, secrets_of
from monitor.plant.arm import SAVE_MONITOR_S
from monitor.plant.ingest import keep_last_values
from monitor.plant.pull import pull
from monitor.plant.settings import PlantConfiguration, PlantSettings
from monitor.plant.status import DOCUMENTS
from monitor.publish.documents import as_json
from monitor.reason import Sentence
from monitor.service.run import Running

log = logging.getLogger(__name__)

NAME = "notify"  # of the section, the problem, the thread, and the folder beside the history
LOOK_S = 2.0  # between two looks at the history
END_S = 5.0  # for a look to end
WAITS = Sentence("notify_waits", "what is owed to people waits, and is tried again: {why}")


def own_configuration(configuration: Configuration) -> GatewayConfiguration:
    """What the gateway of one arm works with: people alone, and a silence that nobody else hears of is none."""
    folder = configuration.state_directory / NAME
    return GatewayConfiguration(
        path=configuration.path,
        plant=PlantConfiguration(path=configuration.path, plant=PlantSettings(directory=str(folder))),
        gateway=GatewaySettings(silent_hours=0.0, plant_silent_minutes=0.0),
        sections={**{kind.section: kind.settings() for kind in CHANNELS}, NAME: configuration.notify},
        secrets=secrets_of([configuration.notify]),
    )


def load_own(path: Path) -> GatewayConfiguration:
    """The same from an arm's file, with its secrets. Raises BadConfiguration."""
    return own_configuration(load(path, reads_files=True))


def check_own(path: Path) -> list[Finding]:
    """How far each channel of an arm's file gets; no message is sent."""
    try:
        return check_all(load_own(path))
    except BadInput as error:  # a credential of the service's that whoever calls this may not read, for example
        return [Finding(NAME, "settings", False, str(error))]


class OwnGateway:
    """It runs while the daemon does. A context manager: `OwnGateway(running)` is handed to the daemon's `serve`."""

    def __init__(self, running: Running) -> None:
        """Raises BadConfiguration where a channel cannot be made of its settings."""
        configuration = running.daemon.state.configuration
        self._arm, self._prefix = (configuration.robot.site, configuration.robot.id), configuration.key_prefix
        self._bus, self._problems = running.daemon.bus, running.problems
        self._gateway = Gateway(own_configuration(configuration))
        self._kept: tuple[float, Any] = (-SAVE_MONITOR_S, None)  # when the last values were kept, and the health among them
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=NAME, daemon=True)

    def __enter__(self) -> "OwnGateway":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join(END_S)
        self._gateway.__exit__()

    def ask(self, key: str) -> bytes:
        """The answer of this very daemon to a query, as a plant gets it over the bus. Raises BadInput with the text of a refusal."""
        name, _, parameters = key.removeprefix(f"{self._prefix}/").partition("?")
        return orjson.dumps(self._bus.ask(name, dict(part.partition("=")[::2] for part in parameters.split(";"))))

    def look(self) -> str | None:
        """Copy what is new, and owe what follows from it. Returns what is in the way; None where nothing is. Raises MonitorError."""
        if self._gateway.trouble is None:
            self._copy()
        self._gateway.step()
        if self._gateway.trouble is not None:
            return self._gateway.trouble
        self._gateway.start()
        troubles = [f"{each.channel.name}: {each.trouble}" for each in self._gateway.workers if each.trouble]
        return "; ".join([*troubles, *(f"no answer of {late}" for late in self._gateway.heartbeats.late())]) or None

    def _copy(self) -> None:
        known = pull(self._gateway.database, self, self._prefix, *self._arm, time.time)
        said = self._bus.last_values()
        at, health = self._kept
        if said.get("health") is health and time.monotonic() - at < SAVE_MONITOR_S:
            return
        now, kept = time.time(), [key for key in DOCUMENTS if key in said]
        keep_last_values(self._gateway.database, {(known.arm, key): (now, as_json(said[key])) for key in kept})
        self._kept = time.monotonic(), said.get("health")

    def _run(self) -> None:
        while not self._stopping.wait(LOOK_S):
            try:
                why = self.look()
            except MonitorError as error:
                why = str(error)
            except Exception as error:  # the thread must survive an error of this program; the log names it
                log.exception("%s: a look ended", NAME)
                why = f"{type(error).__name__}: a mistake of this program; the journal has more"
            self._problems.update(NAME, None if why is None else WAITS(why=why))
