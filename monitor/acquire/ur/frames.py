"""Frames: how rows and messages travel through the pipe from a child process to its parent."""

import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from monitor.recording import Array

HEADER = struct.Struct("<BI")  # kind, length of the body in bytes
ROW, MESSAGE = 0, 1
LARGEST_BODY = 4096 - HEADER.size  # bytes; the kernel writes up to PIPE_BUF = 4096 bytes whole or not at all
LONGEST_TEXT = 1000  # characters of a message's text, so that every message fits into one frame


def row_frame(row: Array) -> bytes:
    """The frame of one row (WIDTH,), as float64 in little-endian order."""
    return _frame(ROW, np.ascontiguousarray(row, dtype="<f8").tobytes())


def message_frame(kind: str, content: dict[str, Any]) -> bytes:
    """The frame of one message: a JSON object with its kind. A text is cut after LONGEST_TEXT characters."""
    text = content.get("text")
    if isinstance(text, str):
        content = {**content, "text": text[:LONGEST_TEXT]}
    return _frame(MESSAGE, json.dumps({"kind": kind, **content}).encode())


def _frame(kind: int, body: bytes) -> bytes:
    if len(body) > LARGEST_BODY:
        raise ValueError(f"frame of {len(body)} bytes; at most {LARGEST_BODY}")
    return HEADER.pack(kind, len(body)) + body


class FrameReader:
    """Cuts a stream of bytes into frames; bytes of an incomplete frame wait for the rest."""

    def __init__(self) -> None:
        self._waiting = b""

    def frames(self, data: bytes) -> Iterator[Array | dict[str, Any]]:
        """Rows (WIDTH,) and messages that are complete with this data, oldest first."""
        data, at = self._waiting + data, 0
        complete = []
        while len(data) - at >= HEADER.size:
            kind, length = HEADER.unpack_from(data, at)
            body = data[at + HEADER.size : at + HEADER.size + length]
            if len(body) < length:
                break
            at += HEADER.size + length
            complete.append((kind, body))
        self._waiting = data[at:]
        for kind, body in complete:
            yield np.frombuffer(body, dtype="<f8").copy() if kind == ROW else json.loads(body)
