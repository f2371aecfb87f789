"""The folder of an MJCF export, and what each part of it leaves against `taut predict`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tautline.effects import BY_ID, of_this_version
from tautline.elements import SINGLE, Elements, warp_of
from tautline.folders import replaced_folder, write_file
from tautline.io.exporting.export import Exported
from tautline.io.exporting.mjcf import measure, transmission
from tautline.io.exporting.mjcf.chain import Chain, fit, fit_sum
from tautline.io.exporting.mjcf.nominal import OWN, Nominal, read_nominal
from tautline.io.exporting.mjcf.scene import CENTRE, LAGGING, LEAD, MOTOR, TIP, Law, Scene
from tautline.model import Effect, Model, allowed_width, monotone
from tautline.plain import plain
from tautline.prediction import predict
from tautline.recording import Motor
from tautline.undone import onset_elements

if TYPE_CHECKING:
    from tautline.io.exporting.export import Mount

Array = npt.NDArray[np.float64]

FORMAT = "mjcf-export/1"
REPORT, SCENE, WITH_CALLBACK = "export.json", "scene.xml", "scene_callback.xml"
CODE, ABOUT, TABLES, WARP = "transmission.py", "transmission.json", "tables.csv", "warp.csv"
_ONSET, _LAG = "transmission.smooth_onset", "transmission.lag"
_BY_CALLBACK = frozenset(
    (_ONSET, _LAG, "transmission.creep", "configuration.contact", "actuator.encoder_periodic")
)  # transmission.py has their equations
_SEEN = frozenset(("kinematics", "registration", "camera", "acquisition"))  # stages: these change how the tip is seen
# Of the range of B and of f_remain: polynomials that are so near (0.5 um, 0.02 deg) get no further ones.
_ENOUGH, _ENOUGH_LAW = 1e-3, 2e-4  # tolerance


def write(model: Model, out: Path, mount: Mount, progress: Callable[[float, str], None]) -> Exported:
    """Writes the folder `out` of an MJCF export, whole or not at all: both scenes, the callback with its tables, and
    export.json. mount: the user's MJCF and what in it. Takes 5 to 30 s, as the scenes are simulated to say what they
    leave; progress: gets the share done, 0 to 1, and a word. TautError where MJCF and model do not go together."""
    tip_rad = np.radians(model.c_deg)
    nominal = read_nominal(mount, model.rig.actuator.unit, model.rig.actuator.range, tip_rad)
    progress(0.05, "polynomials")
    law = law_of(model)
    with replaced_folder(out, REPORT, stale=(WARP,)) as folder:
        rest = callback_files(model, nominal)
        # What a scene leads to is named from where it lies: here while it is measured, in the end from `out`.
        for name, text in {**scenes(nominal, law, folder), **rest}.items():
            write_file(folder / name, text)
        report = _measure_errors(model, nominal, law, folder, progress)
        texts = {**scenes(nominal, law, out), **rest}
        for name, text in texts.items():
            write_file(folder / name, text)
        write_file(folder / REPORT, json.dumps(plain(report), indent=1, allow_nan=False) + "\n")
    lost = tuple(_losses_in_words(report))
    return Exported(tuple(out / name for name in (REPORT, *texts)), lost, {"report": report})


def law_of(model: Model) -> Law:
    """Fits a model's B/2 and f_remain with polynomials over q less the middle of the motor's range, and takes over lag
    and delay: what the scene in XML alone needs. Takes 1 to 6 s."""
    low, high = model.rig.actuator.range
    middle = 0.5 * (low + high)
    x, angle, half = model.q - middle, np.radians(model.c_deg), 0.5 * model.width
    lag = _callback_parameters(model).get("lag", 0.0)
    return Law(
        middle=middle,
        span=high - low,
        steepest=float(np.abs(np.diff(angle) / np.diff(x)).max()),
        half=_raised_to_zero(fit(x, half, _ENOUGH * max(float(half.max()), 1e-12)), x),
        angle=fit_sum(x, angle, _ENOUGH_LAW * float(np.ptp(angle))),
        lag_s=lag,
        delay_s=model.delay_s,
    )


def _raised_to_zero(half: Chain, x: Array) -> Chain:
    """The chain of B/2, its last constant raised so that it is nowhere below 0 on x (n,): there the play's walls would
    cross each other."""
    short = -min(0.0, float(half(x).min()))
    last = half.links[-1].copy()
    last[0] += short
    return replace(half, links=(*half.links[:-1], last))


def _callback_parameters(model: Model) -> dict[str, float]:
    """The parameters, by name, of the model's effects that transmission.py, the export's callback, simulates by their
    own equations. A gradual onset is not one of them: elements stand for it (`callback_files`)."""
    return {
        name: float(value)
        for effect in of_this_version(model)
        if effect.id in _BY_CALLBACK and effect.id != _ONSET
        for name, value in effect.parameters.items()
    }


def scenes(nominal: Nominal, law: Law, out: Path) -> dict[str, str]:
    """The texts of both MJCFs, by file name: the one with the transmission in XML alone, and the one that the callback
    leads. out: the folder that they will be in, from which they name their meshes."""
    alone, led = Scene(nominal, law), Scene(nominal, law)
    for scene in (alone, led):
        scene.add_motor()
    alone.add_play()
    alone.add_law()
    led.add_led_joint()
    return {SCENE: alone.text(out), WITH_CALLBACK: led.text(out)}


def callback_files(model: Model, nominal: Nominal) -> dict[str, str]:
    """The texts of the files that lead the joint of scene_callback.xml, by file name: transmission.py and what it
    reads. That is transmission.json, the tables of B, f_remain and B's sigma over q and, where several elements stand
    side by side, their warp. It knows neither friction nor a gradual onset: elements stand for both."""
    onset = next((effect.parameters for effect in model.effects if effect.id == _ONSET), None)
    elements = onset_elements(model.elements, onset) if onset else model.elements
    play = replace(model, elements=elements, friction=None).play
    unit = model.rig.actuator.unit
    columns = np.column_stack([model.q, model.width, model.c_deg, model.width_sigma])
    texts = {
        CODE: (resources.files(transmission.__package__) / CODE).read_text(encoding="utf-8"),
        ABOUT: json.dumps(plain(_about(model, nominal, elements, play.narrow)), indent=1) + "\n",
        TABLES: _csv(f"q_{unit},width_{unit},c_deg,sigma_{unit}", columns),
    }
    if not elements.single:
        warp = warp_of(model.q, model.width, play.narrow)
        texts[WARP] = _csv(f"q_{unit},x", np.column_stack([warp.q, warp.x]))
    return texts


def _about(model: Model, nominal: Nominal, elements: Elements, narrow: float) -> dict[str, Any]:
    """The document of transmission.json: what transmission.py needs beside the tables. narrow: the width B, unit of q,
    below which the single play stands for the elements."""
    stands_in = not elements.single and bool((model.width < narrow).any())
    return {
        "format": FORMAT,
        "unit": model.rig.actuator.unit,
        "scale": nominal.scale,
        "actuator": nominal.mount.actuator,
        "tip": [list(each) for each in nominal.tip],
        "lead": LEAD,  # the joint that the callback leads
        "moves": [MOTOR, CENTRE, LAGGING],  # joints that rest where the motor is
        "own": OWN,  # how the names of the equalities that the export added begin
        "leads": f"{TIP}_equal",  # of them the one that holds the tip
        "elements": elements.to_json(),
        "narrow": narrow if stands_in else 0.0,
        "parameters": _callback_parameters(model),
        "delay_s": model.delay_s,
    }


def _csv(header: str, rows: Array) -> str:
    """The text of a CSV: the header line, then rows (n, columns)."""
    return "\n".join([header, *(",".join(f"{value:.12g}" for value in row) for row in rows.tolist())]) + "\n"


# -- what it leaves -----------------------------------------------------------------------------------------------


def _measure_errors(
    model: Model, nominal: Nominal, law: Law, folder: Path, progress: Callable[[float, str], None]
) -> dict[str, Any]:
    """Simulates the two scenes in `folder` and compares them with the model's own prediction. Returns the document of
    export.json: the errors of both scenes, and for each part of the model what it is exported as, or why it is not."""
    motor = measure.motion(model, nominal.timestep)
    predicted_deg = predict(model, motor, motor.t_s).c_deg
    q = float(motor.q[0])
    about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    control: list[transmission.Control] = []

    def start_led(scene: Any, data: Any) -> None:
        """Starts the callback, which brings the scene to rest."""
        control.append(transmission.Control(scene, folder))
        control[0].start(data, q)

    def start_alone(scene: Any, data: Any) -> None:
        """Brings the scene without callback to rest."""
        transmission.rest(scene, data, q, about)

    progress(0.4, "simulating the XML alone")
    alone = measure.simulate(folder / SCENE, nominal, motor, start_alone, None)
    progress(0.6, "simulating the callback")
    led = measure.simulate(folder / WITH_CALLBACK, nominal, motor, start_led, lambda m, d: control[0](m, d))
    progress(0.8, "what each part leaves")
    errors = {
        "xml": measure.error(model, motor, alone, predicted_deg),
        "callback": measure.error(model, motor, led, predicted_deg),
    }
    exported, refused = parts(model, law, motor, predicted_deg)
    chains = [chain.links for chain in law.angle.chains]
    return {
        "format": FORMAT,
        "unit": "px" if model.rig.has_camera else "deg",
        "motion": f"a smooth wander over the range for {measure.MOTION_S:g} s, steps of {nominal.timestep:g} s",
        "error": {name: {"rms": rms, "largest": most} for name, (rms, most) in errors.items()},
        "exported": exported,
        "refused": refused,
        "steps_of_polynomials": {"backlash": len(law.half.links), "f_remain": sum(map(len, chains))},
        "tip": [name for name, _ in nominal.tip],
    }


def parts(
    model: Model, law: Law, motor: Motor, predicted_deg: Array
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Two lists for export.json: the parts of a model that are exported, with file and form, and those that are not,
    with the reason. `error` of an entry is the rms by which the prediction is off through that part alone, px or deg,
    None where it cannot be said. predicted_deg: the whole model's angles (n,) at the motor's times."""
    x = model.q - law.middle
    width = replace(model, width=allowed_width(model.q, 2.0 * law.half(x)))
    bent = replace(model, c_deg=monotone(np.degrees(law.angle(x))))

    def leaves(other: Model) -> float:
        """Rms by which the other model's prediction differs from the whole model's, px or deg."""
        return measure.error(model, motor, predict(other, motor, motor.t_s).c_deg, predicted_deg)[0]

    exported: list[dict[str, Any]] = [
        {"what": "transmission.backlash", "in": "callback", "as": "table", "error": 0.0},
        {
            "what": "transmission.backlash",
            "in": "xml",
            "as": "a slack joint between two tendons",
            "error": leaves(width),
        },
        {"what": "configuration.remaining", "in": "callback", "as": "table", "error": 0.0},
        {"what": "configuration.remaining", "in": "xml", "as": "equalities of fourth order", "error": leaves(bent)},
    ]
    refused: list[dict[str, Any]] = []
    if not model.elements.single:
        instead = 0.0 if model.friction is None else leaves(replace(model, friction=None))
        exported.append({"what": "elements", "in": "callback", "as": "plays side by side", "error": instead})
        one = leaves(replace(model, elements=SINGLE, friction=None))
        refused.append({"what": "elements", "in": "xml", "why": "one play stands for several", "error": one})
    effects = [effect for effect in of_this_version(model) if BY_ID[effect.id].holds is None]  # others: in the tables
    for effect in effects:
        if BY_ID[effect.id].stage not in _SEEN:
            for entry in _parts_of_effect(model, effect, leaves):
                (exported if "as" in entry else refused).append(entry)
    for effect in effects:
        if BY_ID[effect.id].stage in _SEEN:
            refused.append({"what": effect.id, "in": "both", "why": "it changes how the tip is seen", "error": None})
    return exported, refused


def _parts_of_effect(model: Model, effect: Effect, leaves: Callable[[Model], float]) -> list[dict[str, Any]]:
    """The entries of `parts` on an effect of the mechanism: with the key "as" where it is exported, with "why" where it
    is not. leaves(other): the rms error, px or deg, of another model's prediction."""
    if BY_ID[effect.id].needs in ("load", "joint", "freedom"):
        why = "it follows what the scene has no input for"  # the motion on which errors are measured has none either
        return [{"what": effect.id, "in": "both", "why": why, "error": None}]
    without = leaves(replace(model, effects=tuple(each for each in model.effects if each is not effect)))
    callback: dict[str, Any] = {"what": effect.id, "in": "callback"}
    if effect.id in _BY_CALLBACK:
        callback |= {"as": "its equations", "error": _error_in_callback(model, effect, leaves)}
    else:
        callback |= {"why": "it has no equation there", "error": without}
    xml: dict[str, Any] = {"what": effect.id, "in": "xml"}
    if effect.id == _LAG:
        first_order = Effect(effect.id, {**effect.parameters, "lag_second": 0.0})
        others = tuple(first_order if each is effect else each for each in model.effects)
        xml |= {"as": "a spring and a damper", "error": leaves(replace(model, effects=others))}
    else:
        xml |= {"why": "MuJoCo has nothing like it", "error": without}
    return [callback, xml]


def _error_in_callback(model: Model, effect: Effect, leaves: Callable[[Model], float]) -> float:
    """The rms, px or deg, by which the prediction is off because the callback simulates an effect in another form: a
    gradual onset as elements. 0 for all other effects, whose own equations it has. leaves(other): that rms for another
    model's prediction."""
    if effect.id != _ONSET:
        return 0.0
    elements = onset_elements(model.elements, effect.parameters)
    effects = tuple(e for e in model.effects if e is not effect)
    return leaves(replace(model, elements=elements, friction=None, effects=effects))


def _losses_in_words(report: dict[str, Any]) -> list[str]:
    """What the export loses, a line each, from its report (export.json)."""
    unit, errors = report["unit"], report["error"]
    lost = [
        f"{what} leaves {errors[name]['rms']:.3g} {unit} rms, {errors[name]['largest']:.3g} at most, of taut predict"
        for name, what in (("xml", f"{SCENE} alone"), ("callback", f"{WITH_CALLBACK} with {CODE}"))
    ]
    for part in report["refused"]:
        size = "" if part["error"] is None else f": {part['error']:.3g} {unit} rms"
        lost.append(f"{part['what']} is not in {part['in']}, {part['why']}{size}")
    return lost
