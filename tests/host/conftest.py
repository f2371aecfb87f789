"""Opened families of cases do not change: what their sources do is tried by `./run test long`, that they are the same
by every run."""

import pytest

OPENED = {f"test_family_{name}.py" for name in ("two", "three", "four", "five", "six")}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.name in OPENED and item.name != "test_the_seal_holds":
            item.add_marker(pytest.mark.long)
