"""How far notifications get: the mail server up to each recipient, webhooks up to TLS, apprise up to its address. Nothing is sent. I/O."""

import smtplib
import ssl
from collections.abc import Iterator, Sequence
from email.utils import parseaddr
from importlib.util import find_spec
from urllib.parse import urlsplit

from monitor.errors import BadInput
from monitor.gateway.channel import Finding
from monitor.gateway.notify.mail import NoSignIn, connected, reason
from monitor.gateway.notify.settings import NotifySettings
from monitor.gateway.reach import believed, reach, tls
from monitor.plant.settings import PlantConfiguration

OPEN_TO_ALL = "none, as configured: everybody on the way can read the messages"


def check(settings: NotifySettings, plant: PlantConfiguration) -> Sequence[Finding]:
    """A finding for each step of each way."""
    try:
        context = believed(settings.ca_file, plant.folder, "notify")
    except BadInput as error:
        return [Finding("notify", "settings", False, str(error))]
    return [*_mail(settings, context), *_webhooks(settings, context), *_apprise(settings)]


def _mail(settings: NotifySettings, context: ssl.SSLContext) -> Iterator[Finding]:
    people = list(dict.fromkeys(address for each in settings.to for address in each.mail))
    if not people:
        return
    found = list(reach("mail", *settings.server()))
    yield from found
    if not found[-1].ok:
        return
    try:
        server = connected(settings, context)
    except (smtplib.SMTPAuthenticationError, NoSignIn) as error:
        yield Finding("mail", "tls", True, OPEN_TO_ALL if settings.tls == "none" else "the certificate is believed")
        what = f"{reason(error)}: look at user and password" if isinstance(error, smtplib.SMTPAuthenticationError) else reason(error)
        yield Finding("mail", "authentication", False, what)
        return
    except (smtplib.SMTPException, OSError, ValueError) as error:
        yield Finding("mail", "tls" if isinstance(error, ssl.SSLError | smtplib.SMTPNotSupportedError) else "smtp", False, reason(error))
        return
    with server:
        if settings.tls == "none":
            yield Finding("mail", "tls", True, OPEN_TO_ALL)
        else:
            yield Finding("mail", "tls", True, f"{getattr(server.sock, 'version', lambda: '')()}; the certificate is believed")
        yield Finding("mail", "authentication", True, f"signed in as {settings.user}" if settings.user else "the server asks for none")
        yield from _recipients(settings, server, people)


def _recipients(settings: NotifySettings, server: smtplib.SMTP, people: Sequence[str]) -> Iterator[Finding]:
    """Whether the server takes mail from us to each of them; no mail is sent."""
    sender = parseaddr(settings.sender)[1]
    try:
        code, said = server.mail(sender)
        if code != 250:
            text = f"{sender} may not send: {code} {said.decode(errors='replace')}: expected a sender whom the server takes"
            yield Finding("mail", "authorisation", False, text)
            return
        for address in people:
            code, said = server.rcpt(address)
            taken = code in {250, 251}
            answer = "taken" if taken else f"refused: {code} {said.decode(errors='replace')}"
            yield Finding("mail", "authorisation", taken, f"{address}: {answer}")
        server.rset()
    except (smtplib.SMTPException, OSError) as error:
        yield Finding("mail", "authorisation", False, reason(error))


def _webhooks(settings: NotifySettings, context: ssl.SSLContext) -> Iterator[Finding]:
    for each in settings.to:
        if not each.webhook:
            continue
        if find_spec("httpx") is None:
            yield Finding("webhook", "settings", False, "the package httpx is absent: pip install 'joint-monitor[gateway]'")
            return
        where = urlsplit(each.webhook)
        port = where.port or (443 if where.scheme == "https" else 80)
        found = [one._replace(text=f"{each.name}: {one.text}") for one in reach("webhook", where.hostname or "", port)]
        yield from found
        if found[-1].ok and where.scheme == "https":
            one = tls("webhook", where.hostname or "", port, context)
            yield one._replace(text=f"{each.name}: {one.text}")
        if found[-1].ok:
            text = f"{each.name}: whether it takes our signature shows with the first message: nothing is posted here"
            yield Finding("webhook", "authorisation", True, text)


def _apprise(settings: NotifySettings) -> Iterator[Finding]:
    if not any(each.apprise for each in settings.to):
        return
    if find_spec("apprise") is None:
        yield Finding("apprise", "settings", False, "the package apprise is absent: pip install 'joint-monitor[gateway]'")
        return
    from monitor.gateway.notify.by_apprise import AppriseWay

    try:
        AppriseWay(settings)
    except BadInput as error:
        yield Finding("apprise", "settings", False, str(error))
        return
    names = ", ".join(each.name for each in settings.to if each.apprise)
    yield Finding(
        "apprise", "settings", True, f"{names}: addresses that apprise knows; the services themselves are asked by the first message"
    )
