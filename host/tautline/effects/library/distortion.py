"""Another lens than the rig's: OpenCV's coefficients of distortion, without unit."""

from collections.abc import Mapping
from dataclasses import replace

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model
from tautline.rig import Camera

_NAMES = ("k1", "k2", "p1", "p2", "k3")


def distorted(camera: Camera, values: Mapping[str, float]) -> Camera:
    """The camera with the effect's coefficients k1, k2, p1, p2, k3 (0 where `values` has none) added to its own."""
    k1, k2, p1, p2, k3 = (own + values.get(name, 0.0) for own, name in zip(camera.distortion, _NAMES, strict=True))
    return replace(camera, distortion=(k1, k2, p1, p2, k3))


def _with_distortion(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with the effect's distortion added to its rig's camera, which must exist. session_s is not used."""
    rig = model.rig
    assert rig.camera
    return replace(model, rig=replace(rig, camera=distorted(rig.camera, values)))


EFFECTS = (
    Kind(
        "camera.distortion",
        (
            *(Parameter(name, "", 0.05) for name in ("k1", "k2")),
            *(Parameter(name, "", 0.01) for name in ("p1", "p2")),
            Parameter("k3", "", 0.05),
        ),
        says="the lens distorts otherwise than the rig says",
        tell="The gap grows towards the picture's corners, whatever the motor does.",
        mend="Calibrate the camera again, with the whole picture covered.",
        needs="camera",
        holds=_with_distortion,
        leaves="lens",
    ),
)
