"""One RTDE connection as bytes in, bytes out: protocol version 2, without a socket.

Nothing is ever sent unasked before the reply to START: ur-rtde reads one packet per request and takes it for the answer.
"""

import logging
import math
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING

from monitor.simulate.controller.registers import Recipe, recipe
from monitor.simulate.wire.packing import reader

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller

log = logging.getLogger(__name__)

NAMES_MAX_BYTES = 2048  # of a list of names, as documented
INPUT_RECIPES_MAX = 255
HEAD = struct.Struct(">HB")  # length, type
DATA_HEAD = struct.Struct(">HBB")  # length, type, recipe


class ProtocolError(Exception):
    """The peer does not speak RTDE: close the connection."""


class RtdeSession:
    """State of one connection."""

    def __init__(self, controller: "Controller", connection: int) -> None:
        self._controller, self._connection = controller, connection
        self._buffer = b""
        self._output: Recipe | None = None
        self._packet: Callable[[], bytes] = bytes  # of the present values: head, recipe 1, values
        self._every = 1  # ticks per packet
        self._inputs: list[Recipe] = []
        self.started = False

    def feed(self, data: bytes) -> bytes:
        """Replies to whatever complete packets have arrived.

        Raises ProtocolError where a header cannot be one.
        """
        buffer, replies = self._buffer + data, b""
        while len(buffer) >= 3:
            size, kind = HEAD.unpack_from(buffer)
            if size < 3:
                raise ProtocolError(f"packet of {size} bytes; the header alone has 3")
            if len(buffer) < size:
                break
            payload, buffer = buffer[3:size], buffer[size:]
            if kind == 85:  # U, nearly always
                self._write_input(payload)
            else:
                replies += self._answer(kind, payload)
        self._buffer = buffer
        return replies

    def output(self, tick: int, made: dict[tuple[str, ...], bytes]) -> bytes | None:
        """The data packet due in this tick, if any; `made` holds what other connections have had made of this very tick."""
        if not self.started or self._output is None or tick % self._every:
            return None
        packet = made.get(self._output.names)
        if packet is None:
            packet = made[self._output.names] = self._packet()
        return packet

    def close(self) -> None:
        """The connection ended: its inputs are free again."""
        self._controller.inputs.release(self._connection)

    def _answer(self, kind: int, payload: bytes) -> bytes:
        match kind:
            case 86:  # V
                accepted = len(payload) == 2 and payload == b"\x00\x02"
                return _packet(kind, bytes([accepted]))
            case 118:  # v
                return _packet(kind, struct.pack(">4I", *self._controller.reported_version))
            case 79:  # O
                return _packet(kind, self._set_output(payload))
            case 73:  # I
                return _packet(kind, self._add_input(payload))
            case 83:  # S
                self.started = self._output is not None or bool(self._inputs)
                return _packet(kind, bytes([self.started]))
            case 80:  # P
                self.started = False
                return _packet(kind, b"\x01")
            case 77:  # M
                log.info("rtde client says: %s", payload[1:].decode("utf-8", "replace")[:200])
            case _:
                log.warning("rtde packet of unknown type %d ignored", kind)
        return b""

    def _set_output(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            raise ProtocolError("output recipe without a frequency")
        (frequency_hz,) = struct.unpack_from(">d", payload)
        names = _names(payload[8:])
        c = self._controller
        variables = {name: variable for name, variable in c.variables.items() if c.knows(name) and name not in c.missing}
        types = [variables[name].kind if name in variables else "NOT_FOUND" for name in names]
        known = bool(names) and "NOT_FOUND" not in types
        self._output = recipe(names, {name: variables[name].kind for name in names}) if known else None
        if self._output is not None:
            layout = struct.Struct(DATA_HEAD.format + self._output.layout.format[1:])
            read = reader(self._controller, [variables[name] for name in names], layout.size, 85, 1)
            self._packet = lambda: layout.pack(*read())
        rate_hz = self._controller.settings.arm.rate_hz
        wanted_hz = min(max(frequency_hz, 1.0), rate_hz) if math.isfinite(frequency_hz) else rate_hz
        self._every = int(rate_hz / wanted_hz + 1e-9)
        return bytes([1 if known else 0]) + ",".join(types).encode()

    def _add_input(self, payload: bytes) -> bytes:
        names = _names(payload)
        types = self._controller.inputs.claim(names, self._connection)
        good = bool(names) and not {"NOT_FOUND", "IN_USE"} & set(types) and len(self._inputs) < INPUT_RECIPES_MAX
        if good:
            self._inputs.append(recipe(names, dict(zip(names, types, strict=True))))
        return bytes([len(self._inputs) if good else 0]) + ",".join(types).encode()

    def _write_input(self, payload: bytes) -> None:
        if not payload or not 1 <= payload[0] <= len(self._inputs):
            self._controller.odd_inputs += 1  # ur-rtde's reconnect really does send a recipe before it asks for it
            return
        written = self._inputs[payload[0] - 1]
        values = payload[1:]
        if len(values) != written.layout.size:
            self._controller.odd_inputs += 1  # the client checks no lengths: a short vector shifts the rest
            values = values[: written.layout.size].ljust(written.layout.size, b"\x00")
        self._controller.write_inputs(written, written.layout.unpack(values))


def text_message(text: str, source: str, level: int) -> bytes:
    """M as the controller sends it; level 0 exception, 1 error, 2 warning, 3 info."""
    message, name = text.encode()[:255], source.encode()[:255]
    return _packet(77, bytes([len(message)]) + message + bytes([len(name)]) + name + bytes([level]))


def _packet(kind: int, payload: bytes) -> bytes:
    return struct.pack(">HB", len(payload) + 3, kind) + payload


def _names(payload: bytes) -> list[str]:
    if len(payload) > NAMES_MAX_BYTES:
        raise ProtocolError(f"list of names has {len(payload)} bytes; at most {NAMES_MAX_BYTES}")
    text = payload.decode("ascii", "replace")
    return [name.strip() for name in text.split(",") if name.strip()]  # ur-rtde ends its lists with a comma
