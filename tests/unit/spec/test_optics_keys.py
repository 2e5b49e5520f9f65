"""The lens's keys: what contradicts itself is refused with the key and the values."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from horizonval.spec.camera import CameraSpec
from horizonval.spec.optics import Optics

SCATTER = {"b0": 0.1, "l_rad": 0.01, "s": -2.0}
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"vignetting_deg": [0, 10], "vignetting": [1.0]}, "vignetting_deg has 2 values, vignetting has 1"),
    ({"vignetting_deg": [0, 10, 10], "vignetting": [1.0, 0.9, 0.8]}, "vignetting_deg must rise, got 10.0 before 10.0"),
    ({"vignetting_deg": [0, 10], "vignetting": [1.0, 1.1]}, "vignetting.1"),
    ({"psf_field_deg": [0], "psf_field_sigma_px": []}, "psf_field_deg has 1 values, psf_field_sigma_px has 0"),
    ({"psf_field_deg": [0], "psf_field_sigma_px": [1.0], "psf_sigma_px": 0.7}, "in place of psf_sigma_px = 0.7"),
    ({"psf_field_deg": [0], "psf_field_sigma_px": [-1.0]}, "psf_field_sigma_px.0"),
    ({"pupil": "round"}, "pupil"),
    ({"scatter": {**SCATTER, "b0": 500.0}}, "b0 = 500.0 with l_rad = 0.01 and s = -2.0 scatters 1.447"),
    ({"scatter": {**SCATTER, "b0": None, "tis": 1.2}}, "tis = 1.2 must be below 1"),
    ({"scatter": {**SCATTER, "tis": 0.1}}, "exactly one of b0 and tis, got b0 = 0.1 and tis = 0.1"),
    ({"scatter": {"l_rad": 0.01, "s": -2.0}}, "exactly one of b0 and tis"),
    ({"scatter": {**SCATTER, "s": 0.5}}, "scatter.s"),
    ({"stray": {"angle_deg": [30, 40], "pst": [1e-3]}}, "angle_deg has 2 values, pst has 1"),
    ({"stray": {"angle_deg": [40, 30], "pst": [1e-3, 1e-4]}}, "angle_deg must rise, got 40.0 before 30.0"),
    ({"stray": {"angle_deg": [30], "pst": [1.5]}}, "pst = 1.5 at angle_deg = 30.0 must not be above 1"),
    ({"stray": {"angle_deg": [30, 80], "pst": [1e-3, 1e-4], "cutoff_deg": 60}}, "80.0, beyond cutoff_deg = 60.0"),
    ({"ghost": [{"ratio": 0.1, "scale": 0.0}]}, "scale = 0.0"),
    ({"ghost": [{"ratio": 0.6}, {"ratio": 0.5}]}, "add up to 1.1"),
    ({"ghost": [{"ratio": -0.1}]}, "ghost.0.ratio"),
]


@pytest.mark.parametrize(("keys", "message"), REFUSED)
def test_refused(keys, message):
    with pytest.raises(ValidationError) as caught:
        Optics.model_validate(keys)
    error = caught.value.errors()[0]
    text = ".".join(str(part) for part in error["loc"]) + ": " + error["msg"]
    assert message in text


def test_aperture_against_f_number_and_focal_length(camera_tables):
    """40 pixels of 5.5 um over 60 deg are a focal length of 0.1905 mm."""
    camera_tables["optics"]["aperture_mm"] = 0.1905 / 4
    CameraSpec.model_validate(camera_tables)
    camera_tables["optics"]["aperture_mm"] = 0.1
    with pytest.raises(ValidationError, match=r"aperture_mm = 0.1 .* f/1.905, but optics.f_number = 4"):
        CameraSpec.model_validate(camera_tables)


def test_keys_survive_the_archive(camera_tables):
    camera_tables["optics"] |= {
        "diffraction": True,
        "scatter": SCATTER,
        "stray": {"angle_deg": [30, 40], "pst": [1e-3, 1e-4]},
        "ghost": [{"ratio": 0.1}],
    }
    spec = CameraSpec.model_validate(camera_tables)
    assert CameraSpec.model_validate(spec.model_dump(mode="json")) == spec
    assert "defocus_um" not in spec.model_dump()["optics"]
