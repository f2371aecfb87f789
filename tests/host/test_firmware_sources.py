"""What must not be in the portable C: floats, the heap, recursion."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("common", "firmware/estimator", "firmware/app")
FORBIDDEN = re.compile(r"\b(float|double|malloc|calloc|realloc|free|alloca|setjmp|longjmp|goto)\b")
NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])+\'', re.DOTALL)
DEFINITION = re.compile(
    r"^(?:static |inline |const |unsigned |struct )*\w[\w ]*?[ *]+(\w+)\([^;{}]*\)\s*\{", re.MULTILINE
)
CALL = re.compile(r"(?<![>.\w])(\w+)\s*\(")  # not through a pointer: those lead into a port


def sources(room: str) -> Iterator[tuple[Path, str]]:
    for path in sorted((ROOT / room).rglob("*.[ch]")):
        yield path, NOISE.sub(" ", path.read_text())


@pytest.mark.parametrize("room", ROOMS)
def test_no_float_and_no_heap(room: str) -> None:
    texts = list(sources(room))
    found = [f"{path.relative_to(ROOT)}: {match[0]}" for path, text in texts for match in FORBIDDEN.finditer(text)]
    assert not found


def body_after(text: str, start: int) -> str:
    depth = 1
    for brace in re.finditer(r"[{}]", text[start:]):
        depth += 1 if brace[0] == "{" else -1
        if depth == 0:
            return text[start : start + brace.start()]
    return text[start:]


def test_no_recursion() -> None:
    calls: dict[tuple[str, str], set[str]] = {}  # (file, or "" where it is not static; name)
    for room in ROOMS:
        for path, text in sources(room):
            for match in DEFINITION.finditer(text):
                where = str(path) if match[0].startswith("static") else ""
                calls[where, match[1]] = set(CALL.findall(body_after(text, match.end())))
    names = {name for _, name in calls}
    assert {"tl_compensator_step", "advance", "tl_table_decode", "tl_crc32", "tl_clamp"} <= names

    def callees(caller: tuple[str, str]) -> set[tuple[str, str]]:
        return {key for key in calls if key[1] in calls[caller] and key[0] in (caller[0], "")}

    def reached(caller: tuple[str, str]) -> set[tuple[str, str]]:
        seen: set[tuple[str, str]] = set()
        todo = [caller]
        while todo:
            todo.extend(new := callees(todo.pop()) - seen)
            seen |= new
        return seen

    assert [name for name in calls if name in reached(name)] == []


def test_the_readme_s_example_compiles(tmp_path: Path) -> None:
    text = (ROOT / "firmware/estimator/README.md").read_text()
    code = re.search(r"```c\n(.*?)```", text, re.DOTALL)
    assert code is not None
    declarations, statements = code[1].split("\n\n", 1)
    source = tmp_path / "example.c"
    head = "void use(const uint8_t *blob, size_t size, uint8_t axis, int32_t position_q8, int32_t command_q16)"
    source.write_text(
        f'#include "tautline/tl_drive.h"\n#include <stdio.h>\n{declarations}\n{head};\n{head} {{\n{statements}\n}}\n'
    )
    folders = ["-I", ROOT / "common/include", "-I", ROOT / "firmware/estimator/include"]
    flags = ["-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wno-unused-variable", "-Werror", "-fsyntax-only"]
    built = subprocess.run(["cc", *flags, *folders, source], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr


def test_the_memory_that_headers_tell_of_is_what_it_takes(tmp_path: Path) -> None:
    headers = [path for room in ROOMS[:2] for path in sorted((ROOT / room / "include").glob("tautline/*.h"))]
    own = {"tl_onset": "tl_onset_detector_t"}
    sizes: dict[str, re.Match[str]] = {}
    for path in headers:
        if match := re.search(r"Memory: ([\d.]+) (bytes|kB)", path.read_text("utf-8")):
            sizes[own.get(path.stem, f"{path.stem}_t")] = match
    assert len(sizes) >= 9
    drive = sizes["tl_drive_t"]
    assert f"// {drive[1]} {drive[2]}," in (ROOT / "firmware/estimator/README.md").read_text("utf-8")
    source = tmp_path / "sizes.c"
    source.write_text(
        "#include <stdio.h>\n"
        + "".join(f'#include "tautline/{path.name}"\n' for path in headers)
        + "int main(void) {\n"
        + "".join(f'    printf("{name} %zu\\n", sizeof({name}));\n' for name in sizes)
        + "}\n"
    )
    folders = ["-I", ROOT / "common/include", "-I", ROOT / "firmware/estimator/include"]
    subprocess.run(["cc", "-std=c11", *folders, source, "-o", tmp_path / "sizes"], check=True)
    for line in subprocess.run([tmp_path / "sizes"], check=True, capture_output=True, text=True).stdout.splitlines():
        name, size = line.split()
        said = float(sizes[name][1]) * (1000 if sizes[name][2] == "kB" else 1)
        assert abs(int(size) - said) <= 0.03 * int(size), f"{name} takes {size} bytes, its header says {sizes[name][0]}"


def test_every_public_header_may_be_included_from_cpp() -> None:
    headers = [path for room in ROOMS[:2] for path in (ROOT / room / "include").rglob("*.h")]
    assert len(headers) > 10
    for path in headers:
        text = path.read_text()
        assert "tl_fast" in path.name or ('extern "C" {' in text and text.count("#ifdef __cplusplus") == 2), path


def test_every_list_of_codes_refuses_to_compile_with_one_twice() -> None:
    text = (ROOT / "common/include/tautline/tl_wire.h").read_text()
    lists = set(re.findall(r"^#define TL_WIRE_(\w+)\(C\)", text, re.MULTILINE))
    assert len(lists) > 8 and lists == set(re.findall(r"^TL_WIRE_IS_\((\w+),", text, re.MULTILINE))


HEADERS = sorted(path for room in ("common", "firmware/estimator") for path in (ROOT / room / "include").rglob("*.h"))
DECLARATION = re.compile(r"(?:\w+[ *]+)+(tl_\w+)\(")


def undocumented(header: str) -> list[str]:
    """Functions of a header without a /// comment. One stands for those that follow it without an empty line."""
    silent, told = [], False
    for line in header.splitlines():
        if not line.strip():
            told = False
        elif line.startswith("///"):
            told = True
        elif (match := DECLARATION.match(line)) and not told:
            silent.append(match[1])
    return silent


@pytest.mark.parametrize("path", HEADERS, ids=lambda path: path.name)
def test_every_function_of_a_header_is_told(path: Path) -> None:
    assert undocumented(path.read_text()) == []


def test_a_function_that_is_not_told_is_found() -> None:
    assert undocumented("/// Adds.\nint tl_add(int a);\nint tl_sub(int a);\n\nint tl_mul(int a);\n") == ["tl_mul"]
