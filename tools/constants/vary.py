"""The package with other numbers: its modules are compiled with each constant times its factor."""

from __future__ import annotations

import ast
import math
import sys
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from types import CodeType, ModuleType

from tools.constants.find import PACKAGE

Factors = Mapping[str, float]  # by Constant.key


def other(value: float, factor: float) -> float:
    """A whole number stays one; of a share above a half what it lacks to one is varied, so that it stays a share."""
    if isinstance(value, int):
        return round(value * factor)
    if 0.5 < abs(value) < 1.0:
        return math.copysign(1.0 - (1.0 - abs(value)) * factor, value)
    return value * factor


class _Other(ast.NodeTransformer):
    def __init__(self, file: str, factors: Factors) -> None:
        self.file, self.factors = file, factors

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        factor = self.factors.get(f"{self.file}:{node.lineno}:{node.col_offset}")
        if factor is None or not isinstance(node.value, int | float):
            return node
        return ast.copy_location(ast.Constant(other(node.value, factor)), node)


class _Loader(SourceFileLoader):
    def __init__(self, fullname: str, path: str, factors: Factors) -> None:
        super().__init__(fullname, path)
        self.factors = factors

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path))
        return compile(_Other(path.removeprefix(f"{PACKAGE}/"), self.factors).visit(tree), path, "exec")


class _Finder(MetaPathFinder):
    def __init__(self, factors: Factors) -> None:
        self.factors = factors

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        package, *rest = fullname.split(".")
        if package != PACKAGE.name:
            return None
        place = PACKAGE.joinpath(*rest)
        if (place / "__init__.py").is_file():
            file = str(place / "__init__.py")
            loader = _Loader(fullname, file, self.factors)
            return spec_from_file_location(fullname, file, loader=loader, submodule_search_locations=[str(place)])
        file = f"{place}.py"
        if not place.with_suffix(".py").is_file():
            return None  # the native module
        return spec_from_file_location(fullname, file, loader=_Loader(fullname, file, self.factors))


def install(factors: Factors) -> None:
    """Before anything of the package is imported."""
    if any(name.split(".")[0] == PACKAGE.name for name in sys.modules):
        raise RuntimeError("the package is imported already: its numbers cannot be changed any more")
    sys.meta_path.insert(0, _Finder(factors))
