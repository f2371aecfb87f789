"""Messages as physical values: what goes in comes out, on the grid of its fixed-point format, through any garbage."""

import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tautline.device import wire

LIMIT = 2**31 - 1


@given(
    q=st.floats(-8e6, 8e6),
    speed=st.floats(0, 8e6),
    junk=st.lists(st.binary(max_size=40), min_size=3, max_size=3),
    cut=st.integers(1, 64),
)
def test_a_message_survives_its_way(q: float, speed: float, junk: list[bytes], cut: int) -> None:
    sent = [wire.encode("move", 1 + i, axis=i, q=q, speed_s=speed) for i in range(2)]
    stream = (
        junk[0] + sent[0] + junk[1] + sent[1] + junk[2] + bytes(600)
    )  # what looks like a frame's head may wait for its end
    decoder = wire.Decoder()
    found = [m for i in range(0, len(stream), cut) for m in decoder.feed(stream[i : i + cut])]
    assert [m.sequence for m in found if m.name == "move"] == [1, 2]
    for message in found:
        assert abs(message.q - q) <= 0.5 / 256 and abs(message.speed_s - speed) <= 0.5 / 256


def test_a_text_that_is_none_is_read_as_far_as_it_goes() -> None:
    frame = bytearray(wire.encode("identity", 3, serial="AB"))
    frame[frame.index(b"AB")] = 0xFF
    frame[-4:] = zlib.crc32(frame[:-4]).to_bytes(4, "little")
    (message,) = wire.Decoder().feed(bytes(frame))
    assert message.serial == "\N{REPLACEMENT CHARACTER}B"


def test_arrays_defaults_and_saturation() -> None:
    frame = wire.encode("motion_start", 3, axis=1, speed_s=[10.0, 0.5, 0.0, 0.0], low=-1e12, high=1e12)
    (message,) = wire.Decoder().feed(frame)
    assert message.low == -(2**31) / 256 and message.high == LIMIT / 256
    assert np.array_equal(message.speed_s, [10.0, 0.5, 0.0, 0.0])
    assert message.cycles == 0
    with pytest.raises(TypeError, match="no field nonsense"):
        wire.encode("ping", 1, nonsense=1)
    with pytest.raises(KeyError):
        wire.encode("nonsense", 1)


def test_codes_have_names_and_texts() -> None:
    assert wire.text("MODES", wire.code("MODES", "OFF")) == "motor off"
    assert "unknown" in wire.text("FAULTS", 250)
    assert wire.flags(wire.code("FLAGS", "ENABLED") | wire.code("FLAGS", "AT_REST")) == ["enabled", "at_rest"]
    assert "CRC" in wire.table_reason(5)
