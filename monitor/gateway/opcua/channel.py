"""The channel `opcua`: serves the arms as they were heard last. I/O."""

import logging
from collections.abc import Sequence

from monitor.errors import BadInput
from monitor.gateway.channel import Surroundings
from monitor.gateway.figures import ArmFigures, figures
from monitor.gateway.opcua.certificate import WITHOUT, identity
from monitor.gateway.opcua.settings import OpcuaSettings
from monitor.gateway.values import ArmState, Delivery, Transition
from monitor.plant.links import ArmName

try:
    from monitor.gateway.opcua.server import ConditionServer, ServerAway
except ModuleNotFoundError as missing:
    raise BadInput(WITHOUT) from missing

log = logging.getLogger(__name__)

PAUSE_S = 1.0


class OpcuaChannel:
    """A `Channel`. It owes nothing: whoever reads later reads what holds then."""

    name = "opcua"

    def __init__(self, settings: OpcuaSettings, surroundings: Surroundings) -> None:
        self._settings, self._arms = settings, surroundings.arms
        self._folder = surroundings.plant.folder
        self._who = identity(settings, self._folder, surroundings.plant.directory)
        self._server: ConditionServer | None = None
        self._known: dict[ArmName, tuple[ArmState, ArmFigures]] = {}
        self._left_out = 0

    def offer(self, transition: Transition) -> Sequence[Delivery]:  # noqa: ARG002 - of Channel
        """Nothing is owed."""
        return ()

    def status(self) -> str:
        """For `gateway status`."""
        if self._server is None:
            return "not listening"
        more = f"; {self._left_out} arms are left out: see opcua.most_arms and opcua.sites" if self._left_out else ""
        return f"{len(self._known)} arms at {self._settings.url(self._who.host)}, {self._server.clients} clients{more}"

    def step(self, now_unix_s: float) -> float:
        """Serve what has changed; the first step starts the server. Raises BadInput, ServerAway."""
        if self._server is None:
            self._server = ConditionServer(self._settings, self._folder, self._who)
        states = self._arms()
        if not states:  # the plant's database was not read yet
            return PAUSE_S
        wanted = sorted(name for name in states if not self._settings.sites or name.site in self._settings.sites)
        served, left_out = wanted[: self._settings.most_arms], len(wanted) - self._settings.most_arms
        if max(left_out, 0) != self._left_out:
            self._left_out = max(left_out, 0)
            if self._left_out:
                log.warning("opcua: %d of %d arms are left out: see most_arms and sites", self._left_out, len(wanted))
        known = {}
        for name in served:
            before = self._known.get(name)
            known[name] = before if before is not None and before[0] is states[name] else (states[name], figures(states[name]))
        self._known = known
        try:
            _, complete = self._server.put([each for _, each in known.values()], now_unix_s)
        except ServerAway:
            self.close()  # the next step starts another one
            raise
        return PAUSE_S if complete else 0.0

    def close(self) -> None:
        """End the server."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
