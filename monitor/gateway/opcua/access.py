"""Who may read. Nobody may write: requests that change anything are refused before anybody looks at them. I/O.

The library lets a client without encryption discover endpoints, and would let it sign in too. Here a session needs a channel with the
client's certificate, unless `allow_unsecured` says otherwise. A session belongs to the connection that made it: the library would give it
to another connection before the user is known.
"""

import logging
from pathlib import Path
from typing import Any

from asyncua import ua
from asyncua.crypto.permission_rules import USER_TYPES, PermissionRuleset, User, UserRole
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone
from asyncua.crypto.truststore import TrustStore
from asyncua.server.internal_server import InternalServer
from cryptography import x509

from monitor.errors import BadInput
from monitor.gateway.opcua.settings import OpcuaSettings
from monitor.plant.screen.people import User as Person
from monitor.plant.screen.people import read_users, user_of

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
            if self._seen == (about.st_mtime_ns, about.st_size):
                return
            self._users = read_users(self._file.read_text("utf-8"), str(self._file))
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput(f"opcua: users_file {self._file}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
        self._seen = (about.st_mtime_ns, about.st_size)


async def trust_store(settings: OpcuaSettings, folder: Path) -> TrustStore | None:
    """The certificates that clients must show; None: any. Raises BadInput."""
    if not settings.trusted_clients:
        return None
    place = folder / settings.trusted_clients
    if not place.is_dir():
        raise BadInput(f"opcua: trusted_clients {place}: is no folder")
    store = TrustStore([place], [])
    try:
        await store.load()
    except (OSError, ValueError) as error:
        raise BadInput(f"opcua: trusted_clients {place}: expected certificates there, *.der or *.pem: {error}") from None
    return store
