"""Results as values: two are equal where all that they hold is, they can be pickled, and they print in a line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

# format of all: of a short repr

_SHOWN = 3  # items of a sequence


class Value:
    """Equality, pickling and repr for frozen dataclasses made with eq=False and repr=False; cached properties are left
    out of all three."""

    def __eq__(self, other: object) -> bool:
        """Whether both are of one type and their fields hold the same (`same`)."""
        return type(self) is type(other) and _same_fields(self, other)

    __hash__ = None  # type: ignore[assignment]  # arrays have none

    def __getstate__(self) -> dict[str, Any]:
        """The state to pickle: the fields alone. What is cached beside them is made anew after unpickling."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def __repr__(self) -> str:
        """The fields in one line, each short (`_short_repr`)."""
        shown = (f"{field.name}={_short_repr(getattr(self, field.name))}" for field in fields(self) if field.repr)  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(shown)})"


def same(one: Any, other: Any) -> bool:
    """Whether two values hold the same: arrays and dataclasses element by element (NaN equals itself), mappings, tuples
    and lists by their items. A tuple may equal a list."""
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return _same_arrays(one, other)
    if is_dataclass(one):
        return type(one) is type(other) and _same_fields(one, other)
    if isinstance(one, Mapping):
        return (
            isinstance(other, Mapping)
            and one.keys() == other.keys()
            and all(same(value, other[key]) for key, value in one.items())
        )
    if isinstance(one, tuple | list):
        alike = isinstance(other, tuple | list) and len(one) == len(other)
        return alike and all(same(a, b) for a, b in zip(one, other, strict=True))
    return bool(one == other) or (one != one and other != other)


def _same_arrays(one: Any, other: Any) -> bool:
    """Whether both are arrays of one dtype and one shape with the same elements, NaN equal to itself."""
    if not (isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and one.dtype == other.dtype):
        return False
    if one.dtype == object:
        return one.shape == other.shape and all(map(same, one.flat, other.flat))
    return bool(np.array_equal(one, other, equal_nan=one.dtype.kind in "fc"))


def _same_fields(one: Any, other: Any) -> bool:
    """Whether two dataclasses of one type hold the same in the fields that count for equality."""
    return all(same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one) if field.compare)


def _short_repr(value: Any) -> str:
    """A short repr of a field: of arrays shape and range, of long collections the number of items, of other objects the
    type."""
    if isinstance(value, np.ndarray):
        shape = "x".join(map(str, value.shape))
        if value.dtype.kind not in "fiu" or not np.isfinite(value).any():
            return f"<{shape}>"
        return f"<{shape}: {np.nanmin(value):.4g} to {np.nanmax(value):.4g}>"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str | int) or value is None:
        return repr(value)
    if isinstance(value, tuple | list) and len(value) <= _SHOWN:
        return f"({', '.join(map(_short_repr, value))})"
    if isinstance(value, tuple | list | Mapping):
        return f"<{len(value)}>"
    return f"<{type(value).__name__}>"
