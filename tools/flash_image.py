"""What the flash of a new board holds, for the real board: the loader, and firmware in slot 0.

python tools/flash_image.py LOADER.bin IMAGE.bin SLOT_0 SLOT_1 OUT

writes OUT.bin, the flash from its beginning, and OUT.uf2, which makes slot 1 blank, too: a board that held newer
firmware there runs what was dropped on it. Offsets in flash, as 0x2000. The first sector of a slot is tl_boot.h's.
"""

from __future__ import annotations

import struct
import sys
import zlib
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tools.uf2 import FLASH_BASE, PAYLOAD, to_uf2

_PAGE, _SECTOR = 256, 4096  # format: bytes, of flash
_RECORD = struct.Struct("<4I")  # format: tl_boot.c's record, before its own CRC
_MAGIC, _MARK = 0x544F4F42, b"\x5a" * 16  # format: tl_boot.c's
_FIRST = 1  # the sequence number of a slot that was never updated


def slot(image: bytes) -> bytes:
    """A slot's first sector and its image, confirmed: there is none to fall back to."""
    record = _RECORD.pack(_MAGIC, _FIRST, len(image), zlib.crc32(image))
    pages = (record + struct.pack("<I", zlib.crc32(record)), _MARK)
    return b"".join(page.ljust(_PAGE, b"\xff") for page in pages).ljust(_SECTOR, b"\xff") + image


def main(arguments: list[str]) -> int:
    if len(arguments) != 5:
        print(__doc__, file=sys.stderr)
        return 2
    loader, image = (Path(name).read_bytes() for name in arguments[:2])
    first, second = (int(offset, 0) for offset in arguments[2:4])
    if len(loader) > first or first + _SECTOR + len(image) > second:
        print(f"flash_image: loader or image do not fit: {len(loader)}, {len(image)} bytes", file=sys.stderr)
        return 1
    flash = loader.ljust(first, b"\xff") + slot(image)
    Path(arguments[4] + ".bin").write_bytes(flash)
    Path(arguments[4] + ".uf2").write_bytes(to_uf2({FLASH_BASE: flash, FLASH_BASE + second: bytes(PAYLOAD)}))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
