"""One RTDE connection without a socket: bytes in, bytes out, protocol version 2.

Before the reply to START this controller sends nothing but replies: ur-rtde reads one packet after each request and takes it for the reply.
"""

import logging
import math
import struct
from collections.abc import Callable, Mapping

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.registers import Recipe, recipe
from monitor.simulate.wire.packing import Variable, reader

log = logging.getLogger(__name__)

NAMES_MAX_BYTES = 2048  # documented limit of a list of names
INPUT_RECIPES_MAX = 255
HEAD = struct.Struct(">HB")  # length, type
DATA_HEAD = struct.Struct(">HBB")  # length, type, recipe


class ProtocolError(Exception):
    """The client does not speak RTDE; its connection must be closed."""


class RtdeSession:
    """The state of one connection. `started` tells whether the client has asked for data packets."""

    def __init__(self, controller: Controller, variables: Mapping[str, Variable], connection: int) -> None:
        """`variables` are all outputs by name; `connection` is a number of its own for each connection."""
        self._controller, self._variables, self._connection = controller, variables, connection
        self._buffer = b""
        self._output: Recipe | None = None
        self._packet: Callable[[], bytes] = bytes  # makes a data packet of the present values
        self._every = 1  # control periods from one packet to the next
        self._inputs: list[Recipe] = []
        self.started = False

    def feed(self, data: bytes) -> bytes:
        """Add bytes that arrived. Returns the replies to the packets that are now complete.

        Raises ProtocolError for an impossible header.
        """
        buffer, replies = self._buffer + data, b""
        while len(buffer) >= 3:
            size, kind = HEAD.unpack_from(buffer)
            if size < 3:
                raise ProtocolError(f"packet of {size} bytes; the header alone has 3")
            if len(buffer) < size:
                break
            payload, buffer = buffer[3:size], buffer[size:]
            if kind == 85:  # U, inputs: nearly all packets are
                self._write_input(payload)
            else:
                replies += self._answer(kind, payload)
        self._buffer = buffer
        return replies

    def output(self, tick: int, made: dict[tuple[str, ...], bytes]) -> bytes | None:
        """The data packet of a control period, or None if none is due. `made` keeps the packets of this period for other connections."""
        if not self.started or self._output is None or tick % self._every:
            return None
        packet = made.get(self._output.names)
        if packet is None:
            packet = made[self._output.names] = self._packet()
        return packet

    @property
    def has_inputs(self) -> bool:
        """Whether the client has claimed inputs."""
        return bool(self._inputs)

    def close(self) -> None:
        """End the connection: its inputs become free."""
        self._controller.registers.inputs.release(self._connection)

    def _answer(self, kind: int, payload: bytes) -> bytes:
        match kind:
            case 86:  # V
                accepted = len(payload) == 2 and payload == b"\x00\x02"
                return _packet(kind, bytes([accepted]))
            case 118:  # v
                return _packet(kind, struct.pack(">4I", *self._controller.identity.reported_version))
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
        types = [self._variables[name].type if self._controller.identity.publishes(name) else "NOT_FOUND" for name in names]
        known = bool(names) and "NOT_FOUND" not in types
        self._output = recipe(names, dict(zip(names, types, strict=True))) if known else None
        if self._output is not None:
            layout = struct.Struct(DATA_HEAD.format + self._output.layout.format[1:])
            read = reader(self._controller, [self._variables[name] for name in names], layout.size, 85, 1)
            self._packet = lambda: layout.pack(*read())
        rate_hz = self._controller.settings.arm.rate_hz
        wanted_hz = min(max(frequency_hz, 1.0), rate_hz) if math.isfinite(frequency_hz) else rate_hz
        self._every = int(rate_hz / wanted_hz + 1e-9)
        return bytes([1 if known else 0]) + ",".join(types).encode()

    def _add_input(self, payload: bytes) -> bytes:
        names = _names(payload)
        types = self._controller.registers.inputs.claim(names, self._connection)
        good = bool(names) and not {"NOT_FOUND", "IN_USE"} & set(types) and len(self._inputs) < INPUT_RECIPES_MAX
        if good:
            self._inputs.append(recipe(names, dict(zip(names, types, strict=True))))
        return bytes([len(self._inputs) if good else 0]) + ",".join(types).encode()

    def _write_input(self, payload: bytes) -> None:
        if not payload or not 1 <= payload[0] <= len(self._inputs):
            self._controller.registers.odd_inputs += 1  # when ur-rtde reconnects, it writes to a recipe before it asks for it
            return
        written = self._inputs[payload[0] - 1]
        values = payload[1:]
        if len(values) != written.layout.size:
            self._controller.registers.odd_inputs += 1  # ur-rtde checks no lengths: a short vector shifts the values behind it
            values = values[: written.layout.size].ljust(written.layout.size, b"\x00")
        self._controller.write_inputs(written, written.layout.unpack(values))


def text_message(text: str, source: str, level: int) -> bytes:
    """A text message (M) of the controller. Levels: 0 exception, 1 error, 2 warning, 3 information."""
    message, name = text.encode()[:255], source.encode()[:255]
    return _packet(77, bytes([len(message)]) + message + bytes([len(name)]) + name + bytes([level]))


def _packet(kind: int, payload: bytes) -> bytes:
    return struct.pack(">HB", len(payload) + 3, kind) + payload


def _names(payload: bytes) -> list[str]:
    if len(payload) > NAMES_MAX_BYTES:
        raise ProtocolError(f"list of names has {len(payload)} bytes; at most {NAMES_MAX_BYTES}")
    text = payload.decode("ascii", "replace")
    return [name.strip() for name in text.split(",") if name.strip()]  # ur-rtde ends its lists with a comma
