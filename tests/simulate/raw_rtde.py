"""RTDE as bytes over a socket, for tests that must not depend on the opinion of a client library."""

import socket
import struct


class RawRtde:
    """One RTDE connection."""

    def __init__(self, host: str, timeout_s: float = 5.0) -> None:
        self.wire = socket.create_connection((host, 30004), timeout=timeout_s)
        self._waiting = b""

    def __enter__(self) -> "RawRtde":
        return self

    def __exit__(self, *_: object) -> None:
        self.wire.close()

    def send(self, kind: bytes, payload: bytes = b"") -> None:
        self.wire.sendall(struct.pack(">H", len(payload) + 3) + kind + payload)

    def packet(self) -> tuple[bytes, bytes]:
        """Type and payload of the next packet. Raises ConnectionResetError or EOFError when the connection has ended."""
        while len(self._waiting) < 3 or len(self._waiting) < struct.unpack_from(">H", self._waiting)[0]:
            data = self.wire.recv(65536)
            if not data:
                raise EOFError
            self._waiting += data
        size = struct.unpack_from(">H", self._waiting)[0]
        packet, self._waiting = self._waiting[:size], self._waiting[size:]
        return packet[2:3], packet[3:]

    def ask(self, kind: bytes, payload: bytes = b"") -> bytes:
        self.send(kind, payload)
        return self.packet()[1]

    def stream(self, names: str, frequency_hz: float = 500.0) -> str:
        """Subscribe to outputs and start the data packets. Returns the types of the outputs."""
        types = self.ask(b"O", struct.pack(">d", frequency_hz) + names.encode())[1:].decode()
        assert self.ask(b"S") == b"\x01"
        return types

    def timestamps(self, count: int) -> list[float]:
        """The timestamps of the next packets. The first variable must be `timestamp`."""
        return [struct.unpack_from(">d", self.packet()[1], 1)[0] for _ in range(count)]
