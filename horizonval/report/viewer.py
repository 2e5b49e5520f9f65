"""What the frame viewer on a run's first page is given: every frame's digital numbers, exactly, and the exact truth.

The page is one file, so the numbers are inside it: differences along each line, modulo 2**16, low bytes first and high
bytes after them, deflated, in base64. The page's own code undoes this; nothing of it passes through a picture, so what
stands under the pointer is the number that is stored.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.earth.spectral.bands import width_um
from horizonval.earth.spectral.planck import brightness_temperature_k
from horizonval.frame import DetectorImage, FrameTruth
from horizonval.report.angle_unit import DEG
from horizonval.report.figures import overlay
from horizonval.report.load import CaseView
from horizonval.report.sightline import sightline_of
from horizonval.report.verdict import verdict_of
from horizonval.scoring.expected import Expected
from horizonval.sensor.expected_image import black_level_dn, radiance_per_dn

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
    """Return how an image's digital numbers become radiance and brightness temperature; ``None`` without calibration.

    ``zero`` and ``step`` [W m-2 sr-1] make radiances, over ``width_um`` those per wavelength: of a photon counting
    detector as its data sheet has it on the axis, above the black level, with noise and dark current in it.
    ``temperature_k``, of thermal bands, has the temperatures of radiances in equal
    ratios, from the first step's to full scale's. Between them the inverse of the temperature is linear in the
    logarithm of the radiance to better than 0.01 K.
    """
    step = radiance_per_dn(image)
    band = next((one for one in image.truth.camera_spec.band if one.name == image.band), None)
    if step is None or band is None:
        return None
    width = width_um(band)
    if band.kind != "thermal":
        return {"zero": -step * black_level_dn(image), "step": step, "width_um": width, "temperature_k": None}
    zero = image.observation.get("radiance_at_zero")
    if zero is None:
        # A frozen image carries the step of its detector alone.
        return None
    ends = zero + step, zero + step * image.full_scale
    kelvin = brightness_temperature_k(band, np.geomspace(*ends, _NODES))
    return {
        "zero": zero,
        "step": step,
        "width_um": width,
        "temperature_k": [round(float(value), 4) for value in kelvin],
    }


def rows_of(view: CaseView, estimators: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return what the viewer tells of each estimator on a view."""
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
    return rows


def light_of(view: CaseView) -> dict[str, Any]:
    """Return day or eclipse, whether the Sun is in the frame and how far it is from the axis: the exact truth's."""
    truth = view.image.truth if view.image is not None else None
    row = next((one for one in view.rows.values() if one.sun_visible_fraction is not None), None)
    fraction = truth.sun_visible_fraction if truth is not None else row.sun_visible_fraction if row else None
    angle = math.degrees(truth.sun_boresight_rad) if truth is not None else row.sun_boresight_deg if row else None
    return {
        "light": "" if fraction is None else "day" if fraction > 0.0 else "eclipse",
        "sun_deg": None if angle is None else round(angle, 2),
        "sun": bool(row is not None and row.sun_in_frame),
    }


def frame_data(view: CaseView, expected: Expected | None, picture: Any, estimators: Sequence[str]) -> dict[str, Any]:
    """Return what the viewer shows of a view beside its numbers and curves."""
    image = view.image
    light = light_of(view)
    if expected is not None:
        light["sun"] = expected.sun_in_frame
    return {
        "band": view.band,
        "heat": heat_of(image) if image is not None else None,
        "full": image.full_scale if image is not None else 0,
        "black": picture.black_dn if picture is not None else 0,
        "white": picture.white_dn if picture is not None else 1,
        "rows": rows_of(view, estimators),
        "sight": sightline_of(image.truth) if image is not None else None,
        **light,
    }


def layers_of(view: CaseView, truth: FrameTruth, estimators: Sequence[str]) -> list[dict[str, str]]:
    """Return limb points and fitted limb of each estimator as path data."""
    camera = truth.camera_model
    layers = []
    for name in estimators:
        detail = view.details.get(name) or {}
        fit = detail.get("fit") or {}
        limb = ""
        if fit.get("nadir_cam") is not None and fit.get("angular_radius_rad") is not None:
            limb = overlay.limb_path(camera, fit["nadir_cam"], fit["angular_radius_rad"])
        layers.append({"points": overlay.points_path(detail.get("points") or []), "limb": limb})
    return layers
