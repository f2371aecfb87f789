# The bindings (host/native/bind_*.cpp) carry their own signatures and docstrings; nothing is retyped here.
from typing import Any

def __getattr__(name: str) -> Any: ...
