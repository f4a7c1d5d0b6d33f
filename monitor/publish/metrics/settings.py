"""Where metrics are served. The server itself is loaded only where it is wanted."""

from dataclasses import dataclass

from monitor.errors import BadInput


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricsSettings:
    """Where Prometheus may scrape."""

    listen: str = ""  # HOST:PORT, e.g. "127.0.0.1:9464"; empty: nowhere

    def __post_init__(self) -> None:
        """Raises BadInput where `listen` is no address."""
        if self.listen:
            self.address()

    def address(self) -> tuple[str, int]:
        """Host and port. Raises BadInput."""
        host, _, port = self.listen.rpartition(":")
        if not host or not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
            raise BadInput(f"metrics: listen = {self.listen!r}; expected HOST:PORT, e.g. 127.0.0.1:9464")
        return host, int(port)
