"""A real SMTP server in this process: TLS, passwords, refusals, and outages on request. What it takes is kept as it came."""

import asyncio
import email
import email.policy
import ssl

import trustme
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import SMTP, AuthResult

USER, PASSWORD = "gateway", "pass-word-of-the-gateway"


class MailServer:
    """A context manager; `settings` are lines for [notify]."""

    def __init__(self, folder, *, tls=False, address="127.0.0.1"):
        self.taken = []  # (recipients, message as email reads it)
        self.refused = set()  # addresses
        self.poison = None  # a text at which the server hangs up
        self.drips = set()  # addresses: the answer to a message for them has no end
        self.logins = 0
        self.drops = 0  # connections that are cut after the message was taken, before the answer
        self.context = None
        self.ca_file = folder / "ca.pem"
        if tls:
            authority = trustme.CA()
            authority.cert_pem.write_to_path(self.ca_file)
            self.context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            authority.issue_cert("127.0.0.1", "localhost").configure_cert(self.context)
        self.address, self.port = address, 0

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.stop()

    def start(self):
        """Listen, on the port of before where there was one."""
        options = {"require_starttls": True, "tls_context": self.context, "auth_required": True} if self.context else {}
        self._controller = _Controller(self, hostname=self.address, port=self.port, authenticator=self._sign_in, **options)
        self._controller.start()
        self.port = self._controller.server.sockets[0].getsockname()[1]

    def stop(self):
        self._controller.stop(no_assert=True)

    def _sign_in(self, server, session, envelope, mechanism, data):
        self.logins += 1
        return AuthResult(success=(data.login, data.password) == (USER.encode(), PASSWORD.encode()), handled=False)

    async def handle_RCPT(self, server, session, envelope, address, options):
        if address in self.refused:
            return "550 5.1.1 nobody of this name"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, server, session, envelope):
        if self.poison and self.poison.encode() in envelope.content:
            server.transport.abort()
            return "250 never said"
        while self.drips & set(envelope.rcpt_tos) and not server.transport.is_closing():
            server.transport.write(b"2")
            await asyncio.sleep(0.02)
        self.taken.append((envelope.rcpt_tos, email.message_from_bytes(envelope.content, policy=email.policy.default)))
        if self.drops:
            self.drops -= 1
            server.transport.abort()
        return "250 taken"

    def subjects(self, to=None):
        return [message["Subject"] for recipients, message in self.taken if to is None or to in recipients]


class _Controller(Controller):
    """With the port that the kernel chose: aiosmtpd itself would connect to port 0 to see whether it runs."""

    def __init__(self, handler, **options):
        super().__init__(handler, **options)

    def _trigger_server(self):
        self.port = self.server.sockets[0].getsockname()[1]
        super()._trigger_server()

    def factory(self):
        return SMTP(self.handler, **self.SMTP_kwargs)
