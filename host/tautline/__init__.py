"""tautline: measure and undo what a tendon-driven instrument loses between motor and tip.

    import tautline as tl

    recording = tl.load("monday", "rig.toml")
    calibration = tl.calibrate(recording)
    print(calibration.model.quality.verdict, calibration.model.width)
    tl.report(calibration, "model", recording)
    blob = tl.encode(calibration.model)

Its functions and the types of what they take and give. Where they are made is in the package's rooms (DESIGN.md).
What they note beside their results goes to the logger "tautline".
"""

import logging
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tautline.api import calibrate as calibrate
    from tautline.api import compensate as compensate
    from tautline.api import diagnose as diagnose
    from tautline.api import diagnose_simulator as diagnose_simulator
    from tautline.api import encode as encode
    from tautline.api import export as export
    from tautline.api import import_recording as import_recording
    from tautline.api import load as load
    from tautline.api import plot as plot
    from tautline.api import predict as predict
    from tautline.api import propose_import as propose_import
    from tautline.api import report as report
    from tautline.api import track as track
    from tautline.calibration.result import Calibration as Calibration
    from tautline.compensation import Compensator as Compensator
    from tautline.compensation import SetPoints as SetPoints
    from tautline.core.session import Session as Session
    from tautline.diagnosis.diagnose import Diagnosis as Diagnosis
    from tautline.diagnosis.findings import Finding as Finding
    from tautline.diagnosis.findings import Gap as Gap
    from tautline.elements import Elements as Elements
    from tautline.errors import TautError as TautError
    from tautline.errors import UnusableError as UnusableError
    from tautline.friction import Friction as Friction
    from tautline.io.exporting import Exported as Exported
    from tautline.io.importing import Imported as Imported
    from tautline.io.importing import Proposal as Proposal
    from tautline.model import Model as Model
    from tautline.prediction import Prediction as Prediction
    from tautline.quality import Quality as Quality
    from tautline.quality import Reason as Reason
    from tautline.quality import Verdict as Verdict
    from tautline.recording import Angle as Angle
    from tautline.recording import Marker as Marker
    from tautline.recording import Motor as Motor
    from tautline.recording import Recording as Recording
    from tautline.rig import Rig as Rig
    from tautline.tracking import Tracked as Tracked
    from tautline.tracking import Tracker as Tracker

logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until a program asks: the commands have words

DISTRIBUTION = "tautline-robotics"  # its name on the package index
__version__ = version(DISTRIBUTION)

_PUBLIC = {
    "Angle": "recording",
    "Calibration": "calibration.result",
    "Compensator": "compensation",
    "Diagnosis": "diagnosis.diagnose",
    "Elements": "elements",
    "Finding": "diagnosis.findings",
    "Friction": "friction",
    "Gap": "diagnosis.findings",
    "Imported": "io.importing",
    "Exported": "io.exporting",
    "Marker": "recording",
    "Model": "model",
    "Motor": "recording",
    "Prediction": "prediction",
    "Proposal": "io.importing",
    "Quality": "quality",
    "Reason": "quality",
    "Recording": "recording",
    "Rig": "rig",
    "Session": "core.session",
    "SetPoints": "compensation",
    "TautError": "errors",
    "Tracked": "tracking",
    "Tracker": "tracking",
    "UnusableError": "errors",
    "Verdict": "quality",
    "calibrate": "api",
    "compensate": "api",
    "diagnose": "api",
    "diagnose_simulator": "api",
    "encode": "api",
    "import_recording": "api",
    "export": "api",
    "load": "api",
    "plot": "api",
    "predict": "api",
    "propose_import": "api",
    "report": "api",
    "track": "api",
}
__all__ = ["__version__", *_PUBLIC]


def __getattr__(name: str) -> Any:
    """Returns a public name of the package and imports its module only when the name is first asked for, so that `taut
    --help` loads none of them. AttributeError for any other name."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'tautline' has no attribute {name!r}")
    return getattr(import_module(f"tautline.{_PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    """The public names, including those whose modules have not been imported yet."""
    return sorted(__all__)
