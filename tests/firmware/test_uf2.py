"""The UF2 converter against the format's own rules, read back block by block."""

import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.uf2 import RP2040_FAMILY, main, to_uf2


@given(st.binary(min_size=1, max_size=2000), st.integers(0, 8000))
def test_read_back(image: bytes, page: int) -> None:
    base = 0x10000000 + 256 * page
    uf2 = to_uf2({base: image})
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
        to_uf2({0x10000001: b"x"})


def test_each_chip_has_its_family(tmp_path: Path) -> None:
    image, out = tmp_path / "image.bin", tmp_path / "image.uf2"
    image.write_bytes(bytes(300))
    families = {}
    for chip in ("rp2040", "rp2350"):
        assert main([str(image), str(out), chip]) == 0
        families[chip] = {out.read_bytes()[at + 28 : at + 32] for at in (0, 512)}
    # Data sheets of RP2040 and RP2350: images for the first, for the Arm cores of the second in the secure state.
    assert families == {"rp2040": {bytes.fromhex("56ff8be4")}, "rp2350": {bytes.fromhex("59ff8be4")}}
    assert main([str(image), str(out), "rp2041"]) == 2
    assert main([str(image)]) == 2
