"""The effects by which a calibrated model can be extended, and the simulation with them.

Every effect is a nested extension of the chain actuator -> transmission -> configuration -> kinematics -> registration
-> camera -> acquisition: a few named parameters, and with its amplitudes at zero it is absent. One descriptor (kind.py)
has all that is known of it; adding one is a module of library/, and a file of host/native/effects/ where it moves the
tip by laws of its own.
"""

from tautline.effects.kind import (
    COLUMN,
    FREEDOMS,
    SIMULATOR,
    STAGES,
    Event,
    Kind,
    Parameter,
    Transform,
    of_simulator,
    simulator_id,
)
from tautline.effects.library import BY_ID, EVENTS, LIBRARY, OWNER, SCATTERS, kind_of
from tautline.effects.simulation import (
    IN_TABLES,
    NATIVE,
    PROJECTION,
    ImagePath,
    Path,
    bends_alone,
    follow,
    image,
    image_with_slopes,
    of_model,
    of_this_version,
    see,
    simulate,
    tabled,
)

__all__ = [
    "BY_ID",
    "COLUMN",
    "EVENTS",
    "FREEDOMS",
    "IN_TABLES",
    "LIBRARY",
    "NATIVE",
    "OWNER",
    "PROJECTION",
    "SCATTERS",
    "SIMULATOR",
    "STAGES",
    "Event",
    "ImagePath",
    "Kind",
    "Parameter",
    "Path",
    "Transform",
    "bends_alone",
    "follow",
    "image",
    "image_with_slopes",
    "kind_of",
    "of_model",
    "of_simulator",
    "of_this_version",
    "see",
    "simulate",
    "simulator_id",
    "tabled",
]
