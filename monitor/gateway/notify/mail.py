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
from collections.abc import Callable, Collection, Sequence
from datetime import UTC, datetime
from email.message import EmailMessage
from email.policy import SMTP
from email.utils import format_datetime, parseaddr
from typing import Any

from monitor.config.notify import NotifySettings, RecipientSettings
from monitor.gateway.connection import Finding, NotReached, Refused, Steps, attempted, believed, dial, say_tls, untrusted
from monitor.gateway.connection import reason as socket_reason
from monitor.gateway.notify.messages import Message
from monitor.plant.settings import PlantConfiguration

TIMEOUT_S = 20.0  # of one look for more
WHOLE_S = 60.0  # of signing in, and of one message: a server that answers a letter at a time holds nobody up for longer
GOODBYE_S = 5.0
REFUSED_WAIT_S = 1800.0  # until an address that the server refuses is tried again
GREYLISTED_WAIT_S = 300.0  # until an address that it refuses for the moment is
OPEN_TO_ALL = "none, as configured: everybody on the way can read the messages"
PASSWORD_WAIT_S = 1800.0  # until a password that it refuses is tried again: after several attempts servers lock an account


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

    def __init__(self, host: str, port: int, steps: Steps, context: ssl.SSLContext | None) -> None:
        """`context` : of TLS from the beginning."""
        self.until = time.monotonic() + WHOLE_S
        self._steps, self._tls = steps, context
        super().__init__(host, port, timeout=TIMEOUT_S)

    def _get_socket(self, host: str, port: int, timeout: float) -> socket.socket:
        return dial(host, port, self._steps, self._tls, timeout)

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


class MailWay:
    """A `Way`. One connection carries the messages of a step."""

    name = "mail"

    def __init__(self, settings: NotifySettings, plant: PlantConfiguration, now: Callable[[], float]) -> None:  # noqa: ARG002 - as the others
        """Raises BadInput where ca_file is no certificate."""
        self._settings = settings
        self._context = believed(settings.ca_file, plant.folder, "notify")
        self._server: _InTime | None = None
        self._locked_until = 0.0
        self._locked: NotReached | None = None

    def addresses(self, recipient: RecipientSettings) -> Collection[str]:
        """The mail addresses."""
        return recipient.mail

    def ready(self) -> None:
        """Connect and sign in. Raises NotReached."""
        self._connected()

    def send(self, message: Message) -> Any:
        """Hand it to the mail server. Raises Refused, NotReached."""
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

    def check(self) -> Sequence[Finding]:
        """How far mail gets: up to each recipient. No mail is sent."""

        def walk(steps: Steps) -> None:
            with connected(self._settings, self._context, steps) as server:
                _try_recipients(self._settings, server, steps)

        return attempted(self.name, walk)

    def _connected(self) -> _InTime:
        if self._server is None:
            left_s = self._locked_until - time.monotonic()
            if self._locked is not None and left_s > 0.0:
                raise NotReached(self._locked.step, str(self._locked), left_s)
            try:
                self._server = connected(self._settings, self._context, Steps())
            except NotReached as error:
                if error.wait_s:
                    self._locked, self._locked_until = error, time.monotonic() + error.wait_s
                raise
        return self._server


def connected(settings: NotifySettings, context: ssl.SSLContext, steps: Steps) -> _InTime:
    """A session that is signed in. Raises NotReached."""
    host, port = settings.server()
    here, other = f"mail server {settings.smtp}", "another port, or another setting of tls (starttls, tls, none)"
    step, server = "smtp", None
    try:
        server = _InTime(host, port, steps, context if settings.tls == "tls" else None)
        step = "tls"
        if settings.tls == "starttls":
            server.starttls(context=context)
            assert isinstance(server.sock, ssl.SSLSocket)
            say_tls(steps, server.sock)
        elif settings.tls == "none":
            steps.say("tls", OPEN_TO_ALL)
        step = "authentication"
        server.ehlo_or_helo_if_needed()
        if settings.user:
            server.login(settings.user, settings.password)
        steps.say("authentication", f"signed in as {settings.user}" if settings.user else "the server asks for none")
        return server
    except BaseException as error:
        if server is not None:
            server.close()
        if isinstance(error, NotReached):
            raise NotReached(error.step, f"{here}: {error}") from None
        if isinstance(error, smtplib.SMTPAuthenticationError):
            raise NotReached(step, f"{here}: {reason(error)}: look at user and password", PASSWORD_WAIT_S) from None
        if isinstance(error, smtplib.SMTPNotSupportedError) and step == "authentication":
            raise NotReached(step, f"{here}: the server takes no password on this port, or none without TLS: {other}") from None
        if type(error) is smtplib.SMTPException and step == "authentication":  # its subclasses say something else
            raise NotReached(step, f"{here}: the server takes passwords only in ways that are not known here: {other}") from None
        if isinstance(error, smtplib.SMTPNotSupportedError):
            raise NotReached(step, f"{here}: {error}: {other}") from None
        if isinstance(error, smtplib.SMTPException | OSError | ValueError):
            raise NotReached(step, f"{here}: {reason(error)}") from None
        raise


def _try_recipients(settings: NotifySettings, server: smtplib.SMTP, steps: Steps) -> None:
    """Whether the server takes mail from us to each of them; no mail is sent. Raises NotReached."""
    sender = parseaddr(settings.sender)[1]
    try:
        code, said = server.mail(sender)
        if code != 250:
            raise NotReached("authorisation", f"{sender} may not send: {code} {_said(said)}: expected a sender whom the server takes")
        for address in dict.fromkeys(address for each in settings.to for address in each.mail):
            code, said = server.rcpt(address)
            taken = code in {250, 251}
            steps.say("authorisation", f"{address}: {'taken' if taken else f'refused: {code} {_said(said)}'}", ok=taken)
        server.rset()
    except (smtplib.SMTPException, OSError) as error:
        raise NotReached("authorisation", reason(error)) from None


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
    """Why a session ended, in a sentence."""
    if isinstance(error, smtplib.SMTPAuthenticationError):
        return f"user or password are refused: {error.smtp_code} {_said(error.smtp_error)}"
    if isinstance(error, smtplib.SMTPResponseException):
        return f"{error.smtp_code} {_said(error.smtp_error)}"
    return untrusted(error) if isinstance(error, ssl.SSLCertVerificationError) else socket_reason(error)


def _said(text: bytes | str) -> str:
    return (text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)).replace("\r", "").replace("\n", " ")[:200]
