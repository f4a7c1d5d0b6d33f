"""Rows and messages through the pipe: what comes out is what went in, however the bytes are cut."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.acquire.child import LONGEST_TEXT, FrameReader, message_frame, row_frame
from monitor.acquire.ur.rtde import WIDTH
from monitor.reason import ANYTHING

ROW = np.arange(WIDTH) / 7.0
STREAM = row_frame(ROW) + message_frame("play", {"duration_s": 3.0}) + row_frame(-ROW)


@given(cuts=st.lists(st.integers(0, len(STREAM)), max_size=8))
def test_frames_are_the_same_after_any_split_of_their_bytes(cuts):
    """An incomplete frame waits for the rest of its bytes."""
    reader, found = FrameReader(), []
    ends = [*sorted(cuts), len(STREAM)]
    for begin, end in zip([0, *ends], ends, strict=False):
        found += list(reader.frames(STREAM[begin:end]))
    assert len(found) == 3
    assert np.array_equal(found[0], ROW)
    assert found[1] == {"kind": "play", "duration_s": 3.0}
    assert np.array_equal(found[2], -ROW)


def test_a_long_text_is_cut_and_a_frame_that_is_too_long_is_refused():
    """A frame must fit into one write of a pipe."""
    (message,) = FrameReader().frames(message_frame("failed", {"cause": "internal", "reason": ANYTHING(text="x" * 5000).document()}))
    assert message["reason"]["text"] == "x" * LONGEST_TEXT
    with pytest.raises(ValueError, match="at most"):
        message_frame("state", {"row": [0.123456789] * 500})
