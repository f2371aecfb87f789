"""The UF2 converter against the format's own rules, read back block by block."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.uf2 import RP2040_FAMILY, to_uf2


@given(st.binary(min_size=1, max_size=2000), st.integers(0, 8000))
def test_read_back(image: bytes, page: int) -> None:
    base = 0x10000000 + 256 * page
    uf2 = to_uf2(image, base)
    assert len(uf2) == 512 * -(-len(image) // 256)
    memory = bytearray()
    for number in range(len(uf2) // 512):
        block = uf2[512 * number : 512 * (number + 1)]
        first, second, flags, address, size, index, count, family = struct.unpack_from("<8I", block)
        assert (first, second, struct.unpack_from("<I", block, 508)[0]) == (0x0A324655, 0x9E5D5157, 0x0AB16F30)
        assert (flags, family, size) == (0x2000, RP2040_FAMILY, 256)
        assert (address, index, count) == (base + 256 * number, number, len(uf2) // 512)
        memory += block[32 : 32 + size]
    assert memory[: len(image)] == image
    assert not any(memory[len(image) :])


def test_base_between_blocks_is_refused() -> None:
    with pytest.raises(ValueError, match="multiple"):
        to_uf2(b"x", 0x10000001)
