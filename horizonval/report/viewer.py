"""What the frame viewer on a run's first page is given: every frame's digital numbers, exactly, and the exact truth.

The page is one file, so the numbers are inside it: differences along each line, modulo 2**16, low bytes first and high
bytes after them, deflated, in base64. The page's own code undoes this; nothing of it passes through a picture, so what
stands under the pointer is the number that is stored.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.earth.spectral.brightness import brightness_temperature_k
from horizonval.frame import DetectorImage
from horizonval.report.angle_unit import DEG
from horizonval.report.formatting import count, percent
from horizonval.report.load import CaseView, ReportRun
from horizonval.report.verdict import verdict_of
from horizonval.scoring.expected import Expected

BUDGET_PX = 12_000_000
"""Pixels whose numbers one page holds: about 20 MB of noisy 12-bit frames."""
_NODES = 129
"""Temperatures of a thermal frame's table."""


def packed(dn: NDArray[np.uint16]) -> str:
    """Return digital numbers, shape (H, W), as the text that the page's code unpacks."""
    difference = dn.astype(np.uint16)
    difference[:, 1:] -= dn[:, :-1]
    planes = np.concatenate([(difference & 0xFF).ravel(), (difference >> 8).ravel()]).astype(np.uint8)
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


def chosen(images: Sequence[DetectorImage | None], budget_px: int = BUDGET_PX) -> set[int]:
    """Return which images' numbers the page holds: all that fit, else as many as fit, evenly spread."""
    there = [i for i, image in enumerate(images) if image is not None]
    pixels = sum(image.dn.size for image in images if image is not None)
    if pixels <= budget_px:
        return set(there)
    n = len(there) * budget_px // pixels
    return {there[k * len(there) // n] for k in range(n)}


def heat_of(image: DetectorImage) -> dict[str, Any] | None:
    """Return how a thermal image's digital numbers become radiance and brightness temperature; ``None`` of others.

    ``zero`` and ``step`` [W m-2 sr-1] make radiances. ``temperature_k`` has the temperatures of radiances in equal
    ratios, from the first step's to full scale's. Between them the inverse of the temperature is linear in the
    logarithm of the radiance to better than 0.01 K.
    """
    step = image.observation.get("radiance_per_dn")
    band = next((one for one in image.truth.camera_spec.band if one.name == image.band), None)
    if step is None or band is None or band.kind != "thermal":
        return None
    zero = float(image.observation["radiance_at_zero"])
    ends = zero + step, zero + step * image.full_scale
    kelvin = brightness_temperature_k(band, np.geomspace(*ends, _NODES))
    return {"zero": zero, "step": step, "temperature_k": [round(float(value), 4) for value in kelvin]}


def frame_data(view: CaseView, expected: Expected | None, picture: Any, estimators: Sequence[str]) -> str:
    """Return what the viewer shows of a view beside its numbers and curves, as JSON."""
    image = view.image
    rows = {}
    for name in estimators:
        if (row := view.rows.get(name)) is None:
            continue
        mark = verdict_of(row, broken=view.broken)
        over = "" if row.error_over_bound is None else f"{row.error_over_bound:.3g}"
        rows[name] = {
            "kind": mark.key,
            "glyph": mark.glyph,
            "label": mark.label,
            "error": DEG.text(row.nadir_error_arcsec) if row.is_claim else "",
            "bound": "" if row.bound_arcsec is None else DEG.text(row.bound_arcsec),
            "over": over,
        }
    light = ""
    if image is not None:
        light = "day" if image.truth.sun_visible_fraction > 0.0 else "eclipse"
    return json.dumps(
        {
            "band": view.band,
            "heat": heat_of(image) if image is not None else None,
            "full": image.full_scale if image is not None else 0,
            "black": picture.black_dn if picture is not None else 0,
            "white": picture.white_dn if picture is not None else 1,
            "light": light,
            "sun": bool(expected is not None and expected.sun_in_frame),
            "rows": rows,
        },
        sort_keys=True,
    )


def sentence(run: ReportRun, groups: Sequence[Mapping[str, Any]]) -> str:
    """Return what works, how badly it is off and where it fails, over all judged estimators, in degrees."""
    rows = run.judged_rows
    due = [row for row in rows if row.is_due]
    if not due:
        return "No frame is due an answer."
    answered = sum(row.is_claim and not row.false_valid for row in due)
    errors = [row.nadir_error_arcsec for row in rows if row.is_claim and row.nadir_error_arcsec is not None]
    who = f" from {count(len(run.judged_estimators), 'estimator')} together" if len(run.judged_estimators) > 1 else ""
    text = f"Right in {percent(answered / len(due))} of {count(len(due), 'answer')} due{who}"
    if errors:
        median, most = np.percentile(errors, [50.0, 95.0])
        text += f": half of all claims within {DEG.text(float(median))} of the true nadir, 95 % within "
        text += f"{DEG.text(float(most))}, the worst {DEG.text(max(errors))}"
    places: dict[str, int] = {}
    for group in groups:
        if not group["given_pose"]:
            for key in ("crashed", "false", "silent"):
                for place, n, _ in group["headline"][key]:
                    places[place] = places.get(place, 0) + n
    if places:
        worst = sorted(places.items(), key=lambda item: (-item[1], item[0]))[:2]
        text += "; fails mostly " + " and ".join(f"{place} ({n})" for place, n in worst)
    return text + "."
