"""The request that PolyScope makes at Play for each host of an External Control node.

PolyScope 3 and 5 read while something is ready, PolyScope X until nothing has come for 0.1 s; both take what they have by then.
"""

import asyncio
from typing import NamedTuple

from monitor.simulate.polyscope import X
from monitor.simulate.program_tree import Host

REQUEST = b"request_program\n"


class Patience(NamedTuple):
    """How long one generation waits [s]."""

    connect_s: float
    first_s: float  # for the first byte
    pause_s: float  # between two segments


OLDER, OF_X = Patience(5.0, 0.5, 0.05), Patience(0.1, 5.0, 0.1)
TEXT_MAX_BYTES = 1 << 20
SEGMENT_BYTES = 65536


async def requested(hosts: tuple[Host, ...], *, generation: int) -> dict[Host, str | None]:
    """The text that each host serves; None where it does not answer in time. `generation` is the major version of PolyScope."""
    patience = OF_X if generation >= X else OLDER
    return {host: await _request(host, patience) for host in hosts}


async def _request(host: Host, patience: Patience) -> str | None:
    try:
        reader, writer = await asyncio.wait_for(asyncio.open_connection(*host), patience.connect_s)
    except (TimeoutError, OSError):
        return None
    try:
        writer.write(REQUEST)
        await writer.drain()
        return await _read(reader, patience)
    except (TimeoutError, OSError):
        return None
    finally:
        writer.close()


async def _read(reader: asyncio.StreamReader, patience: Patience) -> str | None:
    """What is there to read: a pause between two segments ends the text, as the manufacturer's reader has it."""
    text = await asyncio.wait_for(reader.read(SEGMENT_BYTES), patience.first_s)
    while text and len(text) < TEXT_MAX_BYTES:
        try:
            more = await asyncio.wait_for(reader.read(SEGMENT_BYTES), patience.pause_s)
        except TimeoutError:
            break
        if not more:
            break
        text += more
    return text.decode("utf-8", "replace") or None
