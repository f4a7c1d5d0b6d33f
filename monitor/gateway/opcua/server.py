"""The channel `opcua`: serves the arms as they were heard last, from a thread of its own. I/O.

Nobody may write: requests that change anything are refused before anybody looks at them.

The library lets a client without encryption discover endpoints, and would let it sign in too. Here a session needs a channel with the
client's certificate, unless `allow_unsecured` says otherwise. A session belongs to the connection that made it: the library would give it
to another connection before the user is known.
"""

import asyncio
import logging
import math
import threading
import time
from collections.abc import Coroutine, Sequence
from concurrent.futures import TimeoutError as LateError
from datetime import datetime
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.crypto.permission_rules import USER_TYPES, PermissionRuleset, User, UserRole
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone
from asyncua.crypto.truststore import TrustStore
from asyncua.server.internal_server import InternalServer
from cryptography import x509

from monitor import __version__
from monitor.errors import BadInput
from monitor.gateway.channel import Surroundings
from monitor.gateway.connection import NotReached
from monitor.gateway.opcua.address_space import AddressSpace
from monitor.gateway.opcua.settings import Identity, OpcuaSettings, ensure, expect_free, identity, trust_store, users_of
from monitor.gateway.values import Delivery, Transition
from monitor.plant.arm import ArmName, HeardArm
from monitor.plant.screen.people import User as Person
from monitor.plant.screen.people import user_of

log = logging.getLogger(__name__)

CHANGES = frozenset(
    {
        ua.ObjectIds.WriteRequest_Encoding_DefaultBinary,
        ua.ObjectIds.CallRequest_Encoding_DefaultBinary,
        ua.ObjectIds.TransferSubscriptionsRequest_Encoding_DefaultBinary,  # another client's subscriptions
    }
)
MOST_CONNECTIONS, MOST_SUBSCRIPTIONS = 100, 500


class ReadOnly(PermissionRuleset):  # type: ignore[misc] # the library has no types
    """What somebody who is signed in may ask for."""

    def __init__(self) -> None:
        self._allowed = {ua.NodeId(kind) for kind in USER_TYPES if kind not in CHANGES}

    def check_validity(self, user: Any, action_type: Any, body: Any) -> bool:  # noqa: ARG002 - the library's interface
        """Whether a request is served."""
        return user is not None and user.role == UserRole.User and action_type in self._allowed


class Nothing(PermissionRuleset):  # type: ignore[misc] # the library has no types
    """Of a channel without encryption: endpoints are told there, and nothing else."""

    def check_validity(self, user: Any, action_type: Any, body: Any) -> bool:  # noqa: ARG002 - the library's interface
        """Whether a request is served."""
        return False


def discovery_only() -> SecurityPolicyFactory:
    """The policy of channels without encryption, where these are not allowed."""
    return SecurityPolicyFactory(SecurityPolicyNone, ua.MessageSecurityMode.None_, permission_ruleset=Nothing())


class ReadOnlyServer(InternalServer):  # type: ignore[misc] # the library has no types
    """The library's server without what others could misuse."""

    def __init__(self, users: "Users") -> None:
        super().__init__(user_manager=users)
        self.allow_remote_admin = False
        self.max_connections, self.max_subscriptions = MOST_CONNECTIONS, MOST_SUBSCRIPTIONS
        self.max_monitored_item_queue_size = 100
        self.max_unacked_messages_per_subscription = 100

    def lookup_external_session(self, auth_token: Any) -> None:
        """A session is not taken over by another connection."""

    def register_server(self, server: Any, conf: Any = None) -> None:  # noqa: ARG002 - the library's interface
        """No other server is listed here. Raises BadServiceUnsupported."""
        raise ua.uaerrors.BadServiceUnsupported


class Users:
    """Decides at sign-in. The file of users is read each time it has changed."""

    def __init__(self, settings: OpcuaSettings, folder: Path, trusted: TrustStore | None) -> None:
        """Raises BadInput where the file of users cannot be read."""
        self._settings, self._trusted = settings, trusted
        self._file = folder / settings.users_file if settings.users_file else None
        self._users: dict[str, Person] = {}
        self._seen: tuple[int, int] | None = None
        self._read()

    def get_user(self, _server: Any, username: str | None = None, password: str | None = None, certificate: bytes | None = None) -> Any:
        """Somebody who may read; None: nobody. Called by the library for each session."""
        if not certificate and not self._settings.allow_unsecured:
            log.warning("opcua: a client without encryption is refused")
            return None
        if self._trusted is not None and not (certificate and self._trusted.validate(x509.load_der_x509_certificate(certificate))):
            log.warning("opcua: a client is refused whose certificate is not in trusted_clients")
            return None
        if username is None:
            return User(UserRole.User, "anonymous") if self._settings.allow_anonymous else None
        try:
            self._read()
        except BadInput as error:
            log.error("trouble=users: %s; nobody is let in by a token", error, extra={"trouble": "users"})
            self._users, self._seen = {}, None
        found = user_of(password or "", self._users)
        if found is None or found.name != username:
            log.warning("opcua: %r is refused: no such user with this token", username[:100])
            return None
        return User(UserRole.User, found.name)

    def _read(self) -> None:
        if self._file is None:
            return
        try:
            about = self._file.stat()
        except OSError as error:
            raise BadInput(f"opcua: users_file {self._file}: cannot be read: {error.strerror}") from None
        if self._seen == (about.st_mtime_ns, about.st_size):
            return
        self._users = users_of(self._file)
        self._seen = (about.st_mtime_ns, about.st_size)


# --- The server and its thread

NAME = "joint-monitor gateway"
START_S, PUT_S, STOP_S = 120.0, 120.0, 15.0
BATCH, AT_MOST_S = 10, 20.0  # arms at once, and the time after which the rest waits for the next call
BUFFER, LARGEST = 65_535, 16 * 1024 * 1024  # [bytes] of a chunk, of a message
SECURED = (
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
)


class ConditionServer:
    """One running server; its event loop has a thread of its own."""

    def __init__(self, settings: OpcuaSettings, folder: Path, who: Identity) -> None:
        """Start it. Raises BadInput, NotReached."""
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
            except (NotReached, ua.UaError) as error:
                log.warning("opcua: the server ends late: %s", error)
            self._server = None
        self._end()

    def put(self, arms: Sequence[HeardArm], now_unix_s: float) -> tuple[int, bool]:
        """Serve these arms, and no others. Returns how many values were written, and whether that is all: new arms take their time.

        What is left over is done by the next call.
        """
        self._call(self._take_out({arm.name for arm in arms}), PUT_S)
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

    async def _take_out(self, wanted: set[ArmName]) -> None:
        assert self._space is not None
        for name in self._space.arms - wanted:
            await self._space.take_out(name)
            log.info("opcua: %s is no arm of the plant any more", name)

    async def _put(self, arms: Sequence[HeardArm], now_unix_s: float) -> int:
        assert self._space is not None
        written = 0
        for arm in arms:
            written += await self._space.put(arm, now_unix_s, 3600.0 * self._settings.bad_after_h)
            await asyncio.sleep(0)  # clients are served between two arms
        return written

    async def _start(self) -> None:
        settings, who = self._settings, self._who
        expect_free(settings)
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
            raise NotReached("address", f"{settings.listen}: cannot listen there: {error.strerror or error}") from None
        self._server = server
        log.info("opcua: listening at %s", settings.url(who.host))

    def _call(self, work: Coroutine[Any, Any, Any], timeout_s: float) -> Any:
        """Do something in the event loop, and wait for it."""
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result(timeout_s)
        except LateError:
            future.cancel()
            raise NotReached("server", f"the server does not answer within {timeout_s:g} s") from None

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(STOP_S)
        if not self._thread.is_alive():
            self._loop.close()


PAUSE_S = 1.0


class OpcuaChannel:
    """A `Channel`. It owes nothing: whoever reads later reads what holds then."""

    name = "opcua"

    def __init__(self, settings: OpcuaSettings, surroundings: Surroundings) -> None:
        self._settings, self._arms = settings, surroundings.arms
        self._folder = surroundings.plant.folder
        self._who = identity(settings, self._folder, surroundings.plant.directory)
        self._server: ConditionServer | None = None
        self._served = self._left_out = 0

    def offer(self, transition: Transition) -> Sequence[Delivery]:  # noqa: ARG002 - of Channel
        """Nothing is owed."""
        return ()

    def status(self) -> str:
        """For `gateway status`."""
        if self._server is None:
            return "not listening"
        more = f"; {self._left_out} arms are left out: see opcua.most_arms and opcua.sites" if self._left_out else ""
        return f"{self._served} arms at {self._settings.url(self._who.host)}, {self._server.clients} clients{more}"

    def step(self, now_unix_s: float) -> float:
        """Serve what has changed; the first step starts the server. Raises BadInput, NotReached."""
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
        self._served = len(served)
        try:
            _, complete = self._server.put([states[name] for name in served], now_unix_s)
        except NotReached:
            self.close()  # the next step starts another one
            raise
        return PAUSE_S if complete else 0.0

    def close(self) -> None:
        """End the server."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
