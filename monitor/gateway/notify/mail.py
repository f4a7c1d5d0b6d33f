"""Messages by mail: SMTP with TLS and a password. I/O.

SMTP cannot be told to take a message once: a connection that is lost between the server's taking it and its saying so has it sent again.
The message then has the same Message-ID, by which mail servers and readers recognise it.
"""

import hashlib
import io
import smtplib
import socket
import ssl
import time
from collections.abc import Collection
from datetime import UTC, datetime
from email.message import EmailMessage
from email.policy import SMTP
from email.utils import format_datetime, parseaddr
from pathlib import Path
from typing import Any

from monitor.gateway.notify.people import Refused, Unreachable
from monitor.gateway.notify.settings import NotifySettings, RecipientSettings
from monitor.gateway.notify.texts import Message
from monitor.gateway.reach import believed

TIMEOUT_S = 20.0  # of one look for more
WHOLE_S = 60.0  # of signing in, and of one message: a server that answers a letter at a time holds nobody up for longer
GOODBYE_S = 5.0
REFUSED_WAIT_S = 1800.0  # until an address that the server refuses is tried again
GREYLISTED_WAIT_S = 300.0  # until an address that it refuses for the moment is
PASSWORD_WAIT_S = 1800.0  # until a password that it refuses is tried again: after several attempts servers lock an account


class NoSignIn(smtplib.SMTPException):
    """The server takes no password here, or in no way that we know."""


class _Answers(io.RawIOBase):
    """What a server says, until a time of the monotonic clock."""

    def __init__(self, connection: socket.socket, session: "_InTime") -> None:
        self._connection, self._session = connection, session

    def readable(self) -> bool:
        """Yes."""
        return True

    def readinto(self, buffer: Any) -> int:
        """What has come. Raises TimeoutError."""
        left_s = self._session.until - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError
        self._connection.settimeout(min(left_s, TIMEOUT_S))
        try:
            return self._connection.recv_into(buffer)
        finally:
            self._connection.settimeout(TIMEOUT_S)


class _InTime(smtplib.SMTP):
    """A session whose answers must be there in time as a whole; smtplib only knows a time for each part of them."""

    def __init__(self, host: str, port: int, **options: Any) -> None:
        self.until = time.monotonic() + WHOLE_S
        super().__init__(host, port, timeout=TIMEOUT_S, **options)

    def getreply(self) -> tuple[int, bytes]:
        """The next answer. Raises TimeoutError, smtplib.SMTPServerDisconnected."""
        if self.file is None and self.sock is not None:
            self.file = io.BufferedReader(_Answers(self.sock, self))
        try:
            return super().getreply()
        except smtplib.SMTPServerDisconnected as error:
            if isinstance(error.__context__, TimeoutError):  # smtplib would call it a connection that was closed
                raise TimeoutError from None
            raise


class _InTimeOverTls(_InTime, smtplib.SMTP_SSL):
    """The same, with TLS from the beginning."""


class MailWay:
    """A `Way`. One connection carries the messages of a step."""

    name = "mail"

    def __init__(self, settings: NotifySettings, folder: Path) -> None:
        """`folder` : from which relative names of files start. Raises BadInput where ca_file is no certificate."""
        self._settings = settings
        self._context = believed(settings.ca_file, folder, "notify")
        self._server: _InTime | None = None
        self._locked_until, self._locked_why = 0.0, ""

    def addresses(self, recipient: RecipientSettings) -> Collection[str]:
        """The mail addresses."""
        return recipient.mail

    def ready(self) -> None:
        """Connect and sign in. Raises Unreachable."""
        self._connected()

    def send(self, message: Message) -> Any:
        """Hand it to the mail server. Raises Refused, Unreachable."""
        server = self._connected()
        mail = mail_of(message, self._settings.sender)
        server.until = time.monotonic() + WHOLE_S
        try:
            server.send_message(mail, parseaddr(self._settings.sender)[1], [message.recipient])
        except smtplib.SMTPRecipientsRefused as error:
            code, said = error.recipients[message.recipient]
            wait_s = REFUSED_WAIT_S if code >= 500 else GREYLISTED_WAIT_S
            raise Refused(f"{message.recipient}: refused by the mail server: {code} {_said(said)}", wait_s) from None
        except (smtplib.SMTPSenderRefused, smtplib.SMTPDataError) as error:
            self.rest()
            raise Refused(f"{message.recipient}: refused by the mail server: {error.smtp_code} {_said(error.smtp_error)}") from None
        except smtplib.SMTPNotSupportedError:
            raise Refused(f"{message.recipient}: the mail server takes no address with such letters (SMTPUTF8)", REFUSED_WAIT_S) from None
        except (smtplib.SMTPException, OSError, ValueError) as error:
            # the session was open: it may be this message that the server does not survive, and the others shall get through
            self.rest()
            raise Refused(f"{message.recipient}: mail server {self._settings.smtp}: {reason(error)}") from None
        return {"message_id": str(mail["Message-ID"])}

    def rest(self) -> None:
        """Close the connection."""
        server, self._server = self._server, None
        if server is not None:
            server.until = time.monotonic() + GOODBYE_S
            try:
                server.quit()
            except (smtplib.SMTPException, OSError):
                server.close()

    def _connected(self) -> _InTime:
        if self._server is None:
            if time.monotonic() < self._locked_until:
                raise Unreachable(self._locked_why, self._locked_until - time.monotonic())
            try:
                self._server = connected(self._settings, self._context)
            except smtplib.SMTPAuthenticationError as error:
                self._locked_until = time.monotonic() + PASSWORD_WAIT_S
                self._locked_why = f"mail server {self._settings.smtp}: {reason(error)}"
                raise Unreachable(self._locked_why, PASSWORD_WAIT_S) from None
            except (smtplib.SMTPException, OSError, ValueError) as error:
                raise Unreachable(f"mail server {self._settings.smtp}: {reason(error)}") from None
        return self._server


def connected(settings: NotifySettings, context: ssl.SSLContext) -> _InTime:
    """A session that is signed in. Raises smtplib.SMTPException, OSError, ValueError."""
    host, port = settings.server()
    server = _InTimeOverTls(host, port, context=context) if settings.tls == "tls" else _InTime(host, port)
    try:
        if settings.tls == "starttls":
            server.starttls(context=context)
        server.ehlo_or_helo_if_needed()
        if settings.user:
            _sign_in(server, settings.user, settings.password)
    except BaseException:
        server.close()
        raise
    return server


def _sign_in(server: smtplib.SMTP, user: str, password: str) -> None:
    try:
        server.login(user, password)
    except smtplib.SMTPNotSupportedError:
        raise NoSignIn("the server takes no password on this port, or none without TLS") from None
    except smtplib.SMTPException as error:
        if type(error) is smtplib.SMTPException:  # its subclasses say something else
            raise NoSignIn("the server takes passwords only in ways that are not known here") from None
        raise


def mail_of(message: Message, sender: str) -> EmailMessage:
    """The message as RFC 5322 has it."""
    mail = EmailMessage(policy=SMTP)
    domain = parseaddr(sender)[1].rpartition("@")[2]
    mail["From"] = sender
    mail["To"] = message.recipient
    mail["Subject"] = message.subject
    mail["Date"] = format_datetime(datetime.fromtimestamp(message.made_at_unix_s, UTC))
    mail["Message-ID"] = f"<{message.name}@{domain}>"
    mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: no automatic answers
    threads = dict.fromkeys(str(each["alert_id"]) for each in message.transitions)
    if len(threads) == 1:  # a reader shows all messages about one alert together
        thread = hashlib.sha256(next(iter(threads)).encode()).hexdigest()[:24]
        mail["References"] = f"<alert.{thread}@{domain}>"
    mail.set_content(message.text)
    for name, subtype, content in message.attachments:
        mail.add_attachment(content, subtype=subtype, filename=name)
    return mail


def reason(error: Exception) -> str:
    """Why, in a sentence."""
    if isinstance(error, smtplib.SMTPAuthenticationError):
        return f"user or password are refused: {error.smtp_code} {_said(error.smtp_error)}"
    if isinstance(error, NoSignIn):
        return f"{error}: another port, another setting of tls (starttls, tls, none), or neither user nor password"
    if isinstance(error, smtplib.SMTPNotSupportedError):
        return f"{error}: another port, or another setting of tls (starttls, tls, none)"
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not believed ({error.verify_message}); give the authority's certificate as ca_file"
    if isinstance(error, smtplib.SMTPResponseException):
        return f"{error.smtp_code} {_said(error.smtp_error)}"
    if isinstance(error, TimeoutError):
        return "does not answer in time"
    return str(getattr(error, "strerror", None) or error or type(error).__name__)


def _said(text: bytes | str) -> str:
    return (text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)).replace("\r", "").replace("\n", " ")[:200]
