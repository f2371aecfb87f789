"""The commands that README.md holds, so that they can be run as they are written there.

A block's second word says where its commands can be run: ```sh anywhere with `taut` on the PATH and a wheel's desktop
board, ```sh install beside a wheel, ```sh clone in a clone of the repository, ```sh robot with a board and a camera.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

Where = Literal["anywhere", "install", "clone", "robot", "python"]
_FENCE = re.compile(r"^```(\w+)(?: +(\w+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    where: Where
    text: str

    @property
    def commands(self) -> list[str]:
        """Its lines, without empty ones."""
        return [line for line in self.text.splitlines() if line.strip()]


def blocks(readme: str) -> list[Block]:
    """In the order of the page; blocks that are not sh or python are pictures of something else."""
    fenced = []
    for language, where, text in _FENCE.findall(readme):
        if language == "sh":
            fenced.append(Block(where or "anywhere", text))
        elif language == "python":
            fenced.append(Block("python", text))
    return fenced


def unfenced(readme: str) -> list[str]:
    """Commands inside sentences: `./run ...`, `taut ...` and others in backticks."""
    text = _FENCE.sub("", readme)
    return [
        command
        for command in re.findall(r"`([^`\n]+)`", text)
        if re.match(r"(\./run|taut|sudo|pipx|python) ?", command)
    ]
