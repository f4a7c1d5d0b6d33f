"""The server and its thread. I/O."""

import asyncio
import logging
import math
import socket
import threading
import time
from collections.abc import Coroutine, Sequence
from concurrent.futures import TimeoutError as LateError
from datetime import datetime
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits

from monitor import __version__
from monitor.errors import BadInput, MonitorError
from monitor.gateway.figures import ArmFigures
from monitor.gateway.opcua.access import ReadOnly, ReadOnlyServer, Users, discovery_only, trust_store
from monitor.gateway.opcua.address_space import AddressSpace
from monitor.gateway.opcua.certificate import Identity, ensure
from monitor.gateway.opcua.settings import OpcuaSettings

log = logging.getLogger(__name__)

NAME = "joint-monitor gateway"
START_S, PUT_S, STOP_S = 120.0, 120.0, 15.0
BATCH, AT_MOST_S = 10, 20.0  # arms at once, and the time after which the rest waits for the next call
BUFFER, LARGEST = 65_535, 16 * 1024 * 1024  # [bytes] of a chunk, of a message
SECURED = (
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
)


class ServerAway(MonitorError):
    """The server cannot listen, or does not answer its own program."""


class ConditionServer:
    """One running server; its event loop has a thread of its own."""

    def __init__(self, settings: OpcuaSettings, folder: Path, who: Identity) -> None:
        """Start it. Raises BadInput, ServerAway."""
        self._settings, self._folder, self._who = settings, folder, who
        logging.getLogger("asyncua").setLevel(logging.ERROR)  # it tells of each connection and each refusal
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="opcua server", daemon=True)
        self._thread.start()
        self._server: Server | None = None
        self._space: AddressSpace | None = None
        try:
            self._call(self._start(), START_S)
        except BaseException:
            self._end()
            raise

    def close(self) -> None:
        """End it: sessions are closed."""
        if self._server is not None:
            try:
                self._call(self._server.stop(), STOP_S)
            except (ServerAway, ua.UaError) as error:
                log.warning("opcua: the server ends late: %s", error)
            self._server = None
        self._end()

    def put(self, arms: Sequence[ArmFigures], now_unix_s: float) -> tuple[int, bool]:
        """Serve these arms, and no others. Returns how many values were written, and whether that is all: new arms take their time.

        What is left over is done by the next call.
        """
        self._call(self._take_out({(arm.site, arm.robot) for arm in arms}), PUT_S)
        written, until = 0, time.monotonic() + AT_MOST_S
        for begin in range(0, len(arms), BATCH):
            if time.monotonic() > until:
                return written, False
            written += int(self._call(self._put(arms[begin : begin + BATCH], now_unix_s), PUT_S))
        return written, True

    @property
    def clients(self) -> int:
        """Connections."""
        return 0 if self._server is None or self._server.bserver is None else len(self._server.bserver.clients)

    async def _take_out(self, wanted: set[tuple[str, str]]) -> None:
        assert self._space is not None
        for site, robot in self._space.arms - wanted:
            await self._space.take_out(site, robot)
            log.info("opcua: %s/%s is no arm of the plant any more", site, robot)

    async def _put(self, arms: Sequence[ArmFigures], now_unix_s: float) -> int:
        assert self._space is not None
        written = 0
        for arm in arms:
            written += await self._space.put(arm, now_unix_s, 3600.0 * self._settings.bad_after_h)
            await asyncio.sleep(0)  # clients are served between two arms
        return written

    async def _start(self) -> None:
        settings, who = self._settings, self._who
        _bind(settings)
        if ensure(who, settings):
            log.info("opcua: made a certificate for %s: %s", who.uri, who.certificate)
        users = Users(settings, self._folder, await trust_store(settings, self._folder))
        server = Server(iserver=ReadOnlyServer(users))
        await server.init()
        await server.set_application_uri(who.uri)
        server.product_uri, server.name, server.manufacturer_name = "urn:joint-monitor", NAME, "joint-monitor"
        server.application_type = ua.ApplicationType.Server
        await server.set_build_info(server.product_uri, server.manufacturer_name, NAME, __version__, "", datetime.fromtimestamp(0))  # noqa: DTZ006
        server.set_endpoint(settings.url(who.host))
        server.socket_address = settings.address()
        server.limits = TransportLimits(
            max_recv_buffer=BUFFER, max_send_buffer=BUFFER, max_chunk_count=math.ceil(LARGEST / BUFFER), max_message_size=LARGEST
        )
        try:
            await server.load_certificate(who.certificate)
            await server.load_private_key(who.key)
        except (OSError, ValueError) as error:
            raise BadInput(f"opcua: {who.certificate} or {who.key} cannot be used: {error}") from None
        policies = [*SECURED, *([ua.SecurityPolicyType.NoSecurity] if settings.allow_unsecured else [])]
        server.set_security_policy(policies, permission_ruleset=ReadOnly())
        tokens = [ua.UserNameIdentityToken] if settings.users_file else []
        server.set_identity_tokens([*tokens, *([ua.AnonymousIdentityToken] if settings.allow_anonymous else [])])
        if not settings.allow_unsecured:
            server._policies.append(discovery_only())
        self._space = AddressSpace(server)
        await self._space.prepare()
        try:
            await server.start()
        except OSError as error:
            raise ServerAway(f"{settings.listen}: cannot listen there: {error.strerror or error}") from None
        self._server = server
        log.info("opcua: listening at %s", settings.url(who.host))

    def _call(self, work: Coroutine[Any, Any, Any], timeout_s: float) -> Any:
        """Do something in the event loop, and wait for it."""
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result(timeout_s)
        except LateError:
            future.cancel()
            raise ServerAway(f"the server does not answer within {timeout_s:g} s") from None

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(STOP_S)
        if not self._thread.is_alive():
            self._loop.close()


def _bind(settings: OpcuaSettings) -> None:
    """Whether the address is free, before the server takes its seconds to start. Raises ServerAway."""
    host, port = settings.address()
    try:
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        raise ServerAway(f"{settings.listen}: cannot listen there: {error.strerror or error}") from None
