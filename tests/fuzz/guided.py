"""Atheris over readers.py: libFuzzer, guided by what of the package's lines an input reaches.

    python tests/fuzz/guided.py TARGET [libFuzzer's options] [a FILE, or FOLDERS of inputs]

An input is the choices that are made, byte by byte, so tools/trust.py runs these as it runs the harnesses in C. What
breaks is left as a file, and read again by its name.
"""

from __future__ import annotations

import importlib.machinery
import os
import random
import sys
import tempfile
import zlib
from pathlib import Path

import atheris

ROOT = Path(__file__).resolve().parents[2]
# An editable installation has a finder of its own, whose modules Atheris cannot count in: they are found as any.
sys.path[:0] = [str(ROOT / "host"), str(ROOT / "tests" / "fuzz")]
sys.meta_path.insert(0, importlib.machinery.PathFinder)
with atheris.instrument_imports(include=["tautline"]):
    import readers


class Choices(random.Random):
    """Numbers from an input's bytes, and from what they sum up to when they are used up."""

    def __init__(self, data: bytes) -> None:
        super().__init__(zlib.crc32(data))
        self._data, self._at = data, 0

    def getrandbits(self, bits: int, /) -> int:
        size = -(-bits // 8)
        if self._at + size > len(self._data):
            return super().getrandbits(bits)
        self._at += size
        return int.from_bytes(self._data[self._at - size : self._at], "little") >> (8 * size - bits)

    def random(self) -> float:
        return self.getrandbits(16) / 65536.0


def main() -> None:
    name, *options = sys.argv[1:] or [""]
    if name not in readers.TARGETS:
        sys.exit(f"TARGET: one of {', '.join(readers.TARGETS)}")
    os.environ["XDG_RUNTIME_DIR"] = tempfile.gettempdir()  # who holds a board is noted there

    def once(data: bytes) -> None:
        try:
            readers.once(name, Choices(data))
        except Exception as error:
            print(f"broken: {error!r}", file=sys.stderr)
            raise

    atheris.Setup([sys.argv[0], *options], once)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
