"""Packages out of bytes that come in pieces: RTDE and the primary port both send a length, a type, and what belongs to it."""

import struct
from collections.abc import Iterator

LONGEST = 65_536  # bytes; a state on the primary port has about 1500


def take_packages(waiting: bytearray, head: struct.Struct) -> Iterator[tuple[int, bytes]]:
    """Type and payload of every package that is complete; each is taken off `waiting`. head : length with this head, type.

    Raises OSError at a length that no package has.
    """
    while len(waiting) >= head.size:
        length, kind = head.unpack_from(waiting)
        if not head.size <= length <= LONGEST:
            raise OSError("a package without a head")
        if len(waiting) < length:
            return
        payload = bytes(waiting[head.size : length])
        del waiting[:length]
        yield kind, payload
