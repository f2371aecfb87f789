"""tautline: measure and undo what a tendon-driven instrument loses between motor and tip.

The public types of results and errors; what makes them is in the package's rooms (DESIGN.md).
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tautline.calibration.calibrate import Calibration as Calibration
    from tautline.elements import Elements as Elements
    from tautline.errors import TautError as TautError
    from tautline.errors import UnusableError as UnusableError
    from tautline.model import Model as Model
    from tautline.quality import Quality as Quality
    from tautline.quality import Reason as Reason
    from tautline.quality import Verdict as Verdict
    from tautline.recording import Recording as Recording
    from tautline.rig import Rig as Rig

__version__ = version("tautline")

_PUBLIC = {
    "Calibration": "calibration.calibrate",
    "Elements": "elements",
    "Model": "model",
    "Quality": "quality",
    "Reason": "quality",
    "Recording": "recording",
    "Rig": "rig",
    "TautError": "errors",
    "UnusableError": "errors",
    "Verdict": "quality",
}
__all__ = ["__version__", *_PUBLIC]


def __getattr__(name: str) -> Any:
    """Each type comes with its module when it is first asked for: `taut --help` needs none of them."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'tautline' has no attribute {name!r}")
    return getattr(import_module(f"tautline.{_PUBLIC[name]}"), name)
