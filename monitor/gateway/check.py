"""How far each channel gets: name, TCP, TLS, authentication, authorisation; each a line with what to do. No message is sent. I/O."""

import time
from pathlib import Path

from monitor.errors import BadInput
from monitor.gateway.channel import Finding
from monitor.gateway.channels import CHANNELS
from monitor.gateway.settings import GatewayConfiguration, load_gateway


def check_file(path: Path) -> tuple[Path, list[Finding]] | None:
    """The file of a gateway, and how far it gets. None where it has no channel."""
    try:
        configuration = load_gateway(path)
        return (path, check_all(configuration)) if configuration.enabled else None
    except BadInput as error:  # a credential of the service's that whoever calls this may not read, for example
        return path, [Finding("gateway", "settings", False, str(error))]


def check_all(configuration: GatewayConfiguration, *, send: bool = False) -> list[Finding]:
    """The findings of all configured channels, without any secret in them. send : send everybody a test message, too."""
    found = [
        finding
        for kind in CHANNELS
        if kind.enabled(configuration.sections[kind.section])
        for finding in kind.check(configuration.sections[kind.section], configuration.plant)
    ]
    if send:
        from monitor.gateway.notify.ways import send_test

        found += send_test(configuration.sections["notify"], configuration.plant, configuration.gateway.language, time.time)
    return [finding._replace(text=configuration.scrub(finding.text)) for finding in found]
