"""A model's report and the comparison of models, as HTML pages that need no network and no other file."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import jinja2
import numpy as np
from matplotlib.figure import Figure

from tautline import __version__
from tautline.explain import topics
from tautline.folders import replaced_folder, write_file
from tautline.model import MODEL_FILE, Model
from tautline.recording import Recording
from tautline.reports import figures
from tautline.reports.evidence import FILE as EVIDENCE_FILE
from tautline.reports.evidence import STAGES, Evidence, Run, collect
from tautline.rig import MARKER
from tautline.trajectory import NEXT_FILE
from tautline.vision.snapshot import snapshot

FILE = "report.html"
CAMERA_FILE = "camera.jpg"  # in a model's folder: a frame of the camera, with the marker's path
_COARSE_IS_WRONG = frozenset({"coarse", "registration.static", "range", "predicts"})


@dataclass(frozen=True)
class Picture:
    """A picture on a page."""

    uri: str  # a data: URI, so that the page needs no other file
    title: str
    caption: str


@dataclass(frozen=True)
class Number:
    """A row of a page's table of numbers."""

    name: str
    value: str  # with its unit
    detail: str


def save_model(model: Model, recordings: Sequence[Recording], folder: Path) -> list[str]:
    """Writes a MODEL folder with its report, whole or not at all, in place of an earlier one, and returns the result in
    sentences. recordings: those that the model was calibrated from. Without any, or where none saw the tip within the
    motor's times, the report shows the tables alone. TautError where the recordings have neither marker nor angle, or
    `folder` holds something else."""
    with replaced_folder(folder, MODEL_FILE, stale=("follow-*.csv", EVIDENCE_FILE, CAMERA_FILE, NEXT_FILE)) as target:
        evidence = collect(model, recordings) if recordings else None
        if evidence is not None and len(evidence.t_s) == 0:
            evidence = None
        model.save(target)
        _save_camera_picture(recordings, target)
        if evidence is not None:
            evidence.save(target)
        write(model, target, evidence, folder.absolute().name)
    return sentences(model, evidence)


def _save_camera_picture(recordings: Sequence[Recording], folder: Path) -> None:
    """Writes camera.jpg into a model's folder: a frame of the first recording that has one, with the marker's path over
    it if the marker was seen. Writes nothing where no recording has a frame."""
    seen = next((shown for each in recordings if (shown := snapshot(each)) is not None), None)
    if seen is not None:
        cv2.imwrite(str(folder / CAMERA_FILE), seen, [cv2.IMWRITE_JPEG_QUALITY, 88])


def _camera_picture(folder: Path) -> Picture | None:
    """The file camera.jpg in a model's folder as a picture for its page; None where there is no such file."""
    path = folder / CAMERA_FILE
    if not path.is_file():
        return None
    uri = "data:image/jpeg;base64," + base64.b64encode(path.read_bytes()).decode()
    return Picture(
        uri, "What the camera saw", "What the camera saw. Blue: where the marker was, frame by frame; red: around it."
    )


def write(model: Model, folder: Path, evidence: Evidence | None, name: str = "") -> Path:
    """Writes report.html into a model's folder, which says what was measured, how good it is and what it gains, and
    returns its path. The runs of `taut follow` in the folder are shown too. evidence: None: the report shows the tables
    alone; name: the model's name in the title, "": that of the folder."""
    onsets = figures.onsets_of(model)
    used, unused = figures.split_onsets(onsets)
    runs = Run.load_all(folder)
    page: dict[str, Any] = {
        "title": f"What is lost between motor and tip: {name or folder.absolute().name}",
        "source": _source_line(model, evidence),
        "quality": model.quality.to_json(),
        "reasons": [
            {"code": r.code, "says": r.says, "remedy": r.remedy, "topic": topics().get(r.code)}
            for r in model.quality.reasons
        ],
        "camera": _camera_picture(folder),
        "result": sentences(model, evidence) + _run_sentences(runs),
        "numbers": _number_rows(model, used, unused, evidence),
        "notes": model.extra.get("notes", []),
        "motor_unit": model.rig.actuator.unit,
        "unit": evidence.unit if evidence else "",
        "hero": picture(
            figures.hero(model, onsets, evidence, figures.knots_of(model)),
            "Backlash width and characteristic",
            "Left: every measured width with 2 sigma (hollow: known to no better than half of it), the curve through "
            "them, its band; grey: not reached. "
            "Right: bending angle over motor position on the way up and down, and the central line f_remain.",
        ),
        "stages": _stage_rows(evidence) if model.quality.usable else [],
        "gain": None,
        "runs": None,
        "onset_count": len(onsets),
        "onsets": [_onset_row(onset) for onset in onsets],
        "unused": [k for k, onset in enumerate(onsets) if not onset["used"]],
        "closely": None,
        "track": None,
        "residuals": None,
        "cross_check": _cross_check_picture(model),
    }
    if evidence is not None:
        page |= _evidence_pictures(model, evidence, onsets)
    if runs:
        page["runs"] = picture(
            figures.followed_runs(runs),
            "A trajectory followed open loop",
            "Scored after the first full take-up in both directions.",
        )
    path = folder / FILE
    write_page("model.html", page, path)
    return path


def _evidence_pictures(model: Model, evidence: Evidence, onsets: Sequence[figures.Onset]) -> dict[str, Picture]:
    """The pictures of a model's page that show its recordings, by their names in the template. onsets: the model's
    (figures.onsets_of)."""
    unit = model.rig.actuator.unit
    pictures = {
        "gain": picture(
            figures.stage_errors(evidence),
            "Distance between prediction and measurement",
            "f_coarse knows neither backlash nor the real law; B alone gets the moments of motion right.",
        ),
        "track": picture(
            figures.recorded_motion(evidence, onsets, unit),
            f"Motor and {'marker' if model.sensor == MARKER else 'angle'} over time",
            "Dots: where the tip began to move.",
        ),
        "residuals": picture(
            figures.residuals(evidence, unit),
            "Residuals of the whole model",
            "White and small: nothing is left unmodelled. A pattern over q or time: taut diagnose says what it is.",
        ),
    }
    closely = figures.onsets_closely(model, evidence, onsets)
    if closely is not None:
        pictures["closely"] = picture(
            closely,
            "Some onsets closely",
            f"Dots: {_row_noun(evidence)}. Grey: the motor turns, the tip rests. Red: the hinge; the backlash ends "
            "where it bends.",
        )
    return pictures


def _cross_check_picture(model: Model) -> Picture | None:
    """The picture that compares the model's B with B by the distance of the passes up and down; None for a model
    without that second measurement (`pass_width` in model.json)."""
    passes = model.extra.get("pass_width")
    if passes is None:
        return None
    by_marker = model.sensor == MARKER
    return picture(
        figures.cross_check(model, np.array(passes, dtype=float)),
        "B from the onsets and from the two passes",
        f"The distance of the two passes at equal {'image position' if by_marker else 'angle'} measures B again. "
        f"Where they part, the onset is smooth{', or the registration changes with direction.' if by_marker else '.'}",
    )


def write_comparison(models: Mapping[str, Model], path: Path) -> None:
    """Writes the page at `path` on how B and f_remain of each model, by name, differ from those of the first model (the
    paper's Fig. 2). TautError where the models' units differ."""
    rows = comparison(models)
    names = list(models)
    unit = models[names[0]].rig.actuator.unit
    fine, per_unit = figures.fine_unit(unit)
    page = {
        "title": "How backlash and f_remain changed",
        "result": _comparison_sentences(rows, unit),
        "picture": picture(
            figures.compared(models),
            "B and f_remain of all models",
            f"Above: the curves, with 2 sigma. Below: each less {names[0]}'s, with 2 sigma of the difference; where a "
            "band does not hold 0, the change is larger than the uncertainty.",
        ),
        "columns": [
            f"B mean ({unit})",
            f"B least to most ({unit})",
            f"change of B ({fine})",
            f"largest change ({fine})",
            "in sigma (rms)",
            "offset of f_remain (deg)",
            "rest of its change (deg rms)",
            "delay (ms)",
        ],
        "rows": [
            [
                row["model"],
                _digits(row["width_mean"]),
                f"{_digits(row['width_min'])} to {_digits(row['width_max'])}",
                _digits(per_unit * row["width_change_mean"], 2, sign=True),
                _digits(per_unit * row["width_change_max"], 2, sign=True),
                _digits(row["width_change_sigmas"], 2),
                _digits(row["remaining_change_mean_deg"], 2, sign=True),
                _digits(row["remaining_rest_rms_deg"], 2),
                f"{1e3 * row['delay_s']:.1f}",
            ]
            for row in rows
        ],
    }
    write_page("compare.html", page, path)


def comparison(models: Mapping[str, Model]) -> list[dict[str, Any]]:
    """A row for each model, by name, with its changes against the first model; the columns are those of
    `_comparison_row`."""
    first = next(iter(models.values()))
    return [_comparison_row(name, model, first) for name, model in models.items()]


def _comparison_row(name: str, model: Model, first: Model) -> dict[str, Any]:
    """The row of one model in `comparison`: its changes against the model `first` at 201 even places over the q that
    both have measured. Where there is no such q the range is None and all other numbers but the delay are NaN. Widths
    are in the unit of q; `width_change_sigmas` is the rms of the change over the sigma of the difference. f_remain's
    change, deg, is split into its mean and the rms about that mean, as a shift of the motor's zero alone changes the
    mean too."""
    low, high = max(first.measured[0], model.measured[0]), min(first.measured[1], model.measured[1])
    q = np.linspace(low, high, 201) if high > low else np.empty(0)
    width, base = (np.interp(q, m.q, m.width) for m in (model, first))
    sigma = np.hypot(*(np.interp(q, m.q, m.width_sigma) for m in (model, first)))
    change = width - base
    angle_deg = model.remaining(q) - first.remaining(q)
    some = len(q) > 0
    worst = int(np.argmax(np.abs(change))) if some else 0
    return {
        "model": name,
        "q_from": low if some else None,
        "q_to": high if some else None,
        "width_mean": width.mean() if some else np.nan,
        "width_min": width.min() if some else np.nan,
        "width_max": width.max() if some else np.nan,
        "width_change_mean": change.mean() if some else np.nan,
        "width_change_rms": np.sqrt(np.mean(change**2)) if some else np.nan,
        "width_change_max": change[worst] if some else np.nan,
        "width_change_max_at": q[worst] if some else np.nan,
        "width_change_sigmas": np.sqrt(np.mean((change / np.maximum(sigma, 1e-12)) ** 2)) if some else np.nan,
        "remaining_change_mean_deg": angle_deg.mean() if some else np.nan,
        "remaining_rest_rms_deg": angle_deg.std() if some else np.nan,
        "delay_s": model.delay_s,
    }


def write_page(template: str, page: Mapping[str, Any], path: Path, beside: Path | None = None) -> None:
    """Renders a page from a jinja2 template and writes it to `path`. template: file name in the package's templates,
    or else in the folder `beside`; page: the template's variables, to which `footer` (version and time) is added."""
    write_file(path, _render(template, page, beside))


def _render(template: str, page: Mapping[str, Any], beside: Path | None = None) -> str:
    """The page's HTML, with all variables escaped; an undefined variable is an error. Arguments as in `write_page`."""
    loaders: list[jinja2.BaseLoader] = [jinja2.PackageLoader("tautline.reports")]
    if beside is not None:
        loaders.append(jinja2.FileSystemLoader(beside))
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(loaders), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    footer = f"tautline {__version__}, {datetime.now().astimezone():%Y-%m-%d %H:%M %z}"
    return environment.get_template(template).render(footer=footer, **page)


def picture(made: Figure, title: str, caption: str) -> Picture:
    """Makes a page's picture of the figure `made`, as SVG within the page."""
    return Picture(figures.data_uri(made), title, caption)


def _digits(value: float, digits: int = 3, sign: bool = False) -> str:
    """A value as text with this many significant digits, but at most 6 decimals and no exponent; "not measured" for
    None, NaN and infinities. sign: with a + before a positive value."""
    if value is None or not np.isfinite(value):
        return "not measured"
    if round(value, 6) == 0:
        return "0"
    places = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{value:{'+' if sign else ''}.{min(places, 6)}f}"


def _with_unit(value: float, unit: str, digits: int = 3) -> str:
    """A number as `_digits` writes it and its unit, joined by a space at which no line is broken."""
    return f"{_digits(value, digits)}\u00a0{unit}"


def _source_line(model: Model, evidence: Evidence | None) -> str:
    """The page's line on what it is made from: with evidence the recordings' names and the number of frames or
    readings; and the motor's range."""
    made = f"from {', '.join(evidence.names)}; " if evidence else ""
    low, high = model.rig.actuator.range
    length = f"{len(evidence.t_s)} {_row_noun(evidence)}; " if evidence else ""
    return f"{made}{length}motor range {low:g} to {high:g} {model.rig.actuator.unit}"


def _row_noun(evidence: Evidence) -> str:
    """The word for the evidence's rows: "frames" of a camera, or "readings" of an angle sensor."""
    return "frames" if evidence.unit == "px" else "readings"


def sentences(model: Model, evidence: Evidence | None) -> list[str]:
    """A calibration's result for a person, in sentences: the range of B, how well it is known, and, with evidence and a
    usable model, how well the model predicts the recordings and how far off backlash alone would put the tip."""
    unit, inside = model.rig.actuator.unit, model.is_measured
    lines = []
    if inside.any():
        width, sigma = model.width[inside], model.width_sigma[inside]
        least, most = _digits(width.min()), _digits(width.max())
        reach = least if least == most else f"{least} to {most}"
        lines.append(
            f"After every change of direction the motor turns {reach} {unit} before "
            f"the tip moves, known to ± {_digits(2 * float(np.median(sigma)), 2)} {unit}."
            if model.quality.usable
            else f"Nothing here holds: B came out as {reach} {unit}, and the verdict says why that cannot be trusted."
        )
    else:
        lines.append("No width could be measured: no reversal reached the end of the backlash.")
    if evidence is None or not model.quality.usable:
        return lines
    coarse, with_width, whole = evidence.rms()  # of STAGES
    if not np.isfinite(whole):
        return [*lines, "The tip was never driven through a full backlash both ways, so nothing can be scored."]
    said = (
        f"With these tables the tip is where the model says within {_digits(whole, 2)} {evidence.unit}; "
        f"f_coarse alone is off by {_digits(coarse, 2)} {evidence.unit}"
    )
    if any(reason.code in _COARSE_IS_WRONG for reason in model.quality.reasons):
        return [*lines, f"{said}, but something in the rig is wrong, which the verdict names: that is no gain."]
    lost_deg, lost = _backlash_share(model, evidence)
    return [
        *lines,
        f"{said}, with B by {_digits(with_width, 2)} {evidence.unit}.",
        f"Backlash alone, with all else right, puts the tip {_digits(lost_deg, 2)} deg off (rms), "
        f"{_digits(lost, 2)} {unit} of the motor.",
    ]


def _backlash_share(model: Model, evidence: Evidence) -> tuple[float, float]:
    """How far backlash alone puts the tip off if it is not compensated, over the settled rows: the rms of the
    difference between f_remain(q) and the seen angle c, deg; and the same in the unit of q, between q and f_remain's
    inverse at c."""
    q, c_deg = evidence.q[evidence.settled], evidence.c_deg[evidence.settled]
    off = np.column_stack([model.remaining(q) - c_deg, q - model.remaining_inverse(c_deg)])
    deg, motor = np.sqrt(np.nanmean(off**2, axis=0))
    return float(deg), float(motor)


def _ratio(worse: float, better: float) -> str:
    """The ratio worse / better as text with two significant digits."""
    return _digits(worse / max(better, 1e-12), 2)


def _number_rows(model: Model, used: Sequence[Any], unused: Sequence[Any], evidence: Evidence | None) -> list[Number]:
    """The rows of the page's table of numbers: least and greatest B and the measured range (if any B was measured), the
    number of reversals, the delay, and with evidence of a usable model the rms of the prediction's error. used, unused:
    the model's onsets."""
    unit, inside = model.rig.actuator.unit, model.is_measured
    numbers = []
    if inside.any():
        width, at = model.width[inside], model.q[inside]
        numbers += [
            Number("widest backlash", _with_unit(width.max(), unit), f"at {_digits(at[width.argmax()], 2)} {unit}"),
            Number("narrowest", _with_unit(width.min(), unit), f"at {_digits(at[width.argmin()], 2)} {unit}"),
            Number(
                "measured",
                f"{_digits(model.measured[0], 3)} to {_with_unit(model.measured[1], unit)}",
                "motor position",
            ),
        ]
    numbers.append(Number("reversals used", str(len(used)), f"of {len(used) + len(unused)}"))
    if model.sensor == MARKER or model.delay_s:
        sigma = model.uncertainty.delay_sigma_s
        spread = f"± {_digits(2e3 * sigma, 1)} ms" if sigma else "nominal"  # 2 sigma
        what = "image" if model.sensor == MARKER else "sensor"
        numbers.append(Number(f"delay of the {what}", f"{1e3 * model.delay_s:.1f}\u00a0ms", spread))
    if evidence is not None and np.isfinite(evidence.rms()[2]) and model.quality.usable:
        numbers.append(Number("prediction", _with_unit(evidence.rms()[2], evidence.unit, 2), "rms per coordinate"))
    return numbers


def _stage_rows(evidence: Evidence | None) -> list[list[str]]:
    """The page's table of STAGES, over the settled rows. A row has the stage's name, the rms error per coordinate, the
    distance from what was seen (mean ± standard deviation, then the largest), and how many times smaller the rms is
    than that of f_coarse. [] without evidence or settled rows."""
    if evidence is None or not evidence.settled.any():
        return []
    rms = evidence.rms()
    rows = []
    for name, error, value in zip(STAGES, evidence.error, rms, strict=True):
        distance = np.linalg.norm(error[evidence.settled], axis=1)
        rows.append(
            [
                name,
                _digits(value),
                f"{_digits(float(np.nanmean(distance)))} ± {_digits(float(np.nanstd(distance)), 2)}",
                _digits(float(np.nanmax(distance))),
                _ratio(rms[0], value),
            ]
        )
    return rows


def _onset_row(onset: figures.Onset) -> list[str]:
    """An onset as a row of the page's table: time, direction, q at the turn and at the onset, width, 2 sigma, and "yes"
    if it was used, else why not."""

    def text(value: float, places: int) -> str:
        """The value with this many decimals; "" for NaN."""
        return "" if np.isnan(value) else f"{value:.{places}f}"

    return [
        text(onset["t_s"], 3),
        "rises" if onset["direction"] > 0 else "falls",
        text(onset["q1"], 4),
        text(onset["q2"], 4),
        text(onset["width"], 4),
        text(2 * onset["sigma"], 4),
        "yes" if onset["used"] else onset["reason"] or "no",
    ]


def _run_sentences(runs: Mapping[str, Run]) -> list[str]:
    """A list of one sentence that compares the run of `taut follow` without compensation ("off") with the fully
    compensated one ("full"); [] unless both were made and can be scored. runs: by compensation."""
    off, full = runs.get("off"), runs.get("full")
    if off is None or full is None or not np.isfinite(off.rms_deg + full.rms_deg):
        return []
    return [
        f"Followed open loop, the tip was off by {_digits(off.rms_deg, 2)} deg without compensation and by "
        f"{_digits(full.rms_deg, 2)} deg with it: {_ratio(off.rms_deg, full.rms_deg)} times less."
    ]


def _comparison_sentences(rows: Sequence[Mapping[str, Any]], unit: str) -> list[str]:
    """A sentence for each model but the first on how it differs from the first. rows: of `comparison`, which are the
    models in turn; unit: of q."""
    said = []
    fine, per_unit = figures.fine_unit(unit)
    for row in rows[1:]:
        if not np.isfinite(row["width_mean"]):
            said.append(f"{row['model']} has measured no q that {rows[0]['model']} has.")
            continue
        certain = "more than its uncertainty" if row["width_change_sigmas"] > 2 else "within the uncertainty"
        mean, most = (_digits(per_unit * row[f"width_change_{each}"], 2, sign=True) for each in ("mean", "max"))
        said.append(
            f"{row['model']}: B changed by {mean} {fine} on average and {most} {fine} at most, {certain}; "
            f"f_remain by {_digits(row['remaining_change_mean_deg'], 2, sign=True)} deg throughout, and by "
            f"{_digits(row['remaining_rest_rms_deg'], 2)} deg rms about that."
        )
    return said
