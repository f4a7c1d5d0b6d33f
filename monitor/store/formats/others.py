"""Files that other programs pack, or write in formats that are not read: unpacked within bounds, or refused with what converts them."""

import bz2
import gzip
import io
import lzma
import zlib
from collections.abc import Iterable
from typing import Any

from monitor.errors import BadInput

PACKED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"(\xb5/\xfd")  # gzip, bzip2, xz, zstd
# of the bytes of a file: recordings of real arms unpack to 15 times, and what is more is no recording, or a bomb
MOST_UNPACKED = 32.0
PIECE_BYTES = 1_000_000  # that are unpacked at once to see how many there are
LEAST_BYTES = 8e6  # that are unpacked however small the file is

# how a file begins → what it is, and the command that converts it
_TO_CSV = "python -c \"import pandas; pandas.read_{kind}({name!r}).to_csv('recording.csv', index=False)\""
OTHERS = {
    b"\x89HDF": ("HDF5, or MATLAB 7.3", "in MATLAB: save('recording.mat', '-v7'); else of one table: " + _TO_CSV.replace("{kind}", "hdf")),
    b"MATLAB 7.3": ("MATLAB 7.3", "in MATLAB: save('recording.mat', '-v7')"),
    b"ARROW1": ("Arrow or Feather", _TO_CSV.replace("{kind}", "feather")),
    b"\x80": ("a pickle", _TO_CSV.replace("{kind}", "pickle")),
    b"PK": ("a zip, or a spreadsheet", "a zip: unzip {name!r}; a spreadsheet: " + _TO_CSV.replace("{kind}", "excel")),
    b"\xd0\xcf\x11\xe0": ("a spreadsheet", _TO_CSV.replace("{kind}", "excel")),
}


def unpacked(content: bytes, where: str) -> bytes:
    """The content, or what is packed in it by gzip, bzip2, xz or zstd. Raises BadInput where it is damaged or unpacks to too much."""
    if not content.startswith(PACKED):
        return content
    most = int(_most(len(content)))
    try:
        inner = _opened(content).read(most + 1)
    except (OSError, EOFError, lzma.LZMAError, zlib.error, ValueError) as wrong:
        raise BadInput(f"{where}: is packed and damaged: {wrong}; expected the whole file") from None
    refuse_unpacked(len(inner), len(content), where)
    return bytes(inner)


def _opened(content: bytes) -> Any:
    """The stream of what is packed."""
    gz, bz, xz, _ = PACKED
    if content.startswith(gz):
        return gzip.open(io.BytesIO(content))
    if content.startswith(bz):
        return bz2.open(io.BytesIO(content))
    if content.startswith(xz):
        return lzma.open(io.BytesIO(content))
    import pyarrow as pa

    return pa.input_stream(pa.BufferReader(content), compression="zstd")


def refuse_much(packed: Iterable[tuple[str, bytes]], size: int, where: str) -> None:
    """Raises BadInput where the parts of a file of `size` bytes hold more than a recording can, or are damaged.

    packed : of each part zstd or lz4, and what is packed so. It is unpacked piece by piece, and none is kept.
    """
    import pyarrow as pa

    unpacked_size = 0
    for kind, content in packed:
        stream = pa.input_stream(pa.BufferReader(content), compression=kind)
        while piece := len(stream.read(PIECE_BYTES)):
            unpacked_size += piece
            refuse_unpacked(unpacked_size, size, where)


def refuse_unpacked(size: float, packed: float, where: str) -> None:
    """Raises BadInput where a file of `packed` bytes holds more than a recording of its size can."""
    if size > _most(packed):
        raise BadInput(
            f"{where}: unpacks to more than {MOST_UNPACKED:g} times its {packed / 1e6:.2g} MB; expected a recording of an arm that moves: "
            f"write it as plain CSV if it is one"
        )


def _most(packed: float) -> float:
    return max(MOST_UNPACKED * packed, LEAST_BYTES)


def refuse_others(content: bytes, where: str) -> None:
    """Raises BadInput for a format that is not read, with the command that converts it."""
    for begin, (what, command) in OTHERS.items():
        if content.startswith(begin):
            raise BadInput(f"{where}: is {what}, which is not read; convert it: {command.format(name=where)}")
