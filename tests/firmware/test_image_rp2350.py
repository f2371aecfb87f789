"""The RP2350's image: its boot ROM starts it, nothing in it is float, its own memset and memcpy are right."""

from __future__ import annotations

import ctypes
import re
import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.budget import code, float_instructions
from tools.uf2 import RP2350_FAMILY, to_uf2

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "rp2350"
FLASH, RAM = 0x10000000, 0x20000000


@pytest.fixture(scope="module")
def image() -> bytes:
    if not (BUILD / "tautline.bin").is_file():
        pytest.skip("the image is not built: run './run firmware --chip rp2350'")
    return (BUILD / "tautline.bin").read_bytes()


def test_its_boot_rom_finds_an_executable_for_its_arm_cores(image: bytes) -> None:
    """RP2350 data sheet, 5.9: a loop of blocks begins in the first 4 kB, one of which says what the image is."""
    starts = [at for at in range(0, 4096, 4) if image[at : at + 4] == struct.pack("<I", 0xFFFFDED3)]
    assert starts
    at, seen, kinds = starts[0], [], []
    while at not in seen:
        seen.append(at)
        assert image[at : at + 4] == struct.pack("<I", 0xFFFFDED3)
        item = at + 4
        while image[item] != 0xFF:  # the last item
            size = image[item + 1]
            if image[item] == 0x42:  # the image's type
                kinds.append(struct.unpack_from("<H", image, item + 2)[0])
            item += 4 * size
        loop, end = struct.unpack_from("<iI", image, item + 4)
        assert end == 0xAB123579
        at += loop
    assert at == starts[0]
    assert kinds == [1 | 2 << 4 | 0 << 8 | 1 << 12]  # executable, secure, Arm, RP2350


def test_it_starts_with_a_vector_table(image: bytes) -> None:
    stack, reset = struct.unpack_from("<II", image)
    assert stack == 0x20082000  # the end of scratch bank Y
    assert reset & 1 and FLASH < reset < FLASH + len(image)


@pytest.mark.usefixtures("image")
def test_nothing_in_it_uses_the_floating_point_unit(tmp_path: Path) -> None:
    assert float_instructions(BUILD / "tautline.elf") == []
    (tmp_path / "f.c").write_text("float f(float x) { return 3.0f * x; }\n", "utf-8")
    flags = ["-mcpu=cortex-m33", "-mfloat-abi=softfp", "-O2", "-c"]
    subprocess.run(["arm-none-eabi-gcc", *flags, "-o", "f.o", "f.c"], check=True, cwd=tmp_path)
    assert float_instructions(tmp_path / "f.o") == ["f"]  # it would be seen


@pytest.mark.usefixtures("image")
def test_what_the_control_path_calls_of_the_c_library_is_in_ram() -> None:
    address, _ = code(BUILD / "tautline.elf")
    assert address["memset"] >= RAM and address["memcpy"] >= RAM


def test_the_uf2_is_for_this_chip(image: bytes) -> None:
    assert (BUILD / "tautline.uf2").read_bytes() == to_uf2({0x10000000: image}, RP2350_FAMILY)


@pytest.fixture(scope="module")
def memory(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The port's memset and memcpy, for this machine, under names that nothing else has."""
    folder = tmp_path_factory.mktemp("memory")
    text = (ROOT / "firmware/port/rp2040/memory.c").read_text("utf-8").replace('#include "pico.h"\n', "")
    text = re.sub(r"\b(memset|memcpy)\(", r"our_\1(", text)
    (folder / "memory.c").write_text("#define __not_in_flash(group)\n" + text, "utf-8")
    command = ["gcc", "-O2", "-shared", "-fPIC", "-fsanitize=undefined", "-fno-sanitize-recover", "-o", "memory.so"]
    subprocess.run([*command, "memory.c"], check=True, cwd=folder)
    return ctypes.CDLL(str(folder / "memory.so"))


@given(
    st.binary(min_size=96, max_size=96), st.integers(0, 8), st.integers(0, 8), st.integers(0, 80), st.integers(0, 511)
)
def test_its_memset_and_memcpy(memory: ctypes.CDLL, data: bytes, to: int, of: int, size: int, value: int) -> None:
    source, out = ctypes.create_string_buffer(data, 96), ctypes.create_string_buffer(data, 96)
    memory.our_memcpy.restype = memory.our_memset.restype = ctypes.c_void_p
    for call, rest, expected in (
        (memory.our_memset, (ctypes.c_int(value),), bytes([value & 255]) * size),
        (memory.our_memcpy, (ctypes.byref(source, of),), data[of : of + size]),
    ):
        ctypes.memmove(out, data, 96)
        returned = call(ctypes.byref(out, to), *rest, ctypes.c_size_t(size))
        assert returned == ctypes.addressof(out) + to
        assert out.raw == data[:to] + expected + data[to + size :]
