"""Turns a flash image into the UF2 file that a board in BOOTSEL mode takes by drag and drop.

Usage: python tools/uf2.py IMAGE.bin OUT.uf2 [rp2040 | rp2350]

UF2: blocks of 512 bytes, each with 256 bytes of the image and the address they belong to.
"""

import struct
import sys
from collections.abc import Mapping
from pathlib import Path

FLASH_BASE = 0x10000000
RP2040_FAMILY = 0xE48BFF56
RP2350_FAMILY = 0xE48BFF59  # an image for its Arm cores in the secure state (RP2350 data sheet, 5.5.3)
FAMILIES = {"rp2040": RP2040_FAMILY, "rp2350": RP2350_FAMILY}
PAYLOAD = 256
_START = (0x0A324655, 0x9E5D5157)
_END = 0x0AB16F30
_FLAG_FAMILY = 0x2000
_HEADER = struct.Struct("<8I")


def to_uf2(parts: Mapping[int, bytes], family: int = RP2040_FAMILY) -> bytes:
    """Bytes by their address, a multiple of 256; the last block of each is filled up with zeros."""
    pieces = []
    for base, image in parts.items():
        if base % PAYLOAD:
            raise ValueError(f"a UF2 block starts at a multiple of {PAYLOAD}, not at {base:#x}")
        pieces += [(base + at, image[at : at + PAYLOAD].ljust(PAYLOAD, b"\0")) for at in range(0, len(image), PAYLOAD)]
    blocks = []
    for number, (address, part) in enumerate(pieces):
        header = _HEADER.pack(*_START, _FLAG_FAMILY, address, PAYLOAD, number, len(pieces), family)
        blocks.append((header + part).ljust(508, b"\0") + struct.pack("<I", _END))
    return b"".join(blocks)


def main(arguments: list[str]) -> int:
    image, out, chip = [*arguments, "rp2040"][:3] if len(arguments) in (2, 3) else ("", "", "")
    if chip not in FAMILIES:
        print(__doc__, file=sys.stderr)
        return 2
    Path(out).write_bytes(to_uf2({FLASH_BASE: Path(image).read_bytes()}, FAMILIES[chip]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
