"""The request that PolyScope makes at Play for each host of an External Control node."""

import asyncio

from monitor.simulate.program_tree import Host

REQUEST = b"request_program\n"
CONNECT_S = 5.0  # time-out of the connection
READ_S = 0.5  # time-out of the first byte
TEXT_MAX_BYTES = 1 << 20
SEGMENT_BYTES = 65536


async def requested(hosts: tuple[Host, ...]) -> dict[Host, str | None]:
    """The text that each host serves; None where it does not answer in time."""
    return {host: await _request(host) for host in hosts}


async def _request(host: Host) -> str | None:
    try:
        reader, writer = await asyncio.wait_for(asyncio.open_connection(*host), CONNECT_S)
    except (TimeoutError, OSError):
        return None
    try:
        writer.write(REQUEST)
        await writer.drain()
        return await _read(reader)
    except (TimeoutError, OSError):
        return None
    finally:
        writer.close()


async def _read(reader: asyncio.StreamReader) -> str | None:
    """What is there to read: a pause between two segments ends the text, as the manufacturer's reader has it."""
    text = await asyncio.wait_for(reader.read(SEGMENT_BYTES), READ_S)
    while text and len(text) < TEXT_MAX_BYTES:
        try:
            more = await asyncio.wait_for(reader.read(SEGMENT_BYTES), 0.05)
        except TimeoutError:
            break
        if not more:
            break
        text += more
    return text.decode("utf-8", "replace") or None
