"""Two rendered heads through the detector and the method, over a sphere whose vertical is known."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.renderer.frame import render_frame
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.systems.b.pair.applicability import OVERHEAD
from horizonval.systems.b.pair.frames import attitude, glare_optics, pair, scene, view, without_sunlight


def test_a_rendered_pair_finds_the_vertical_of_a_bare_sphere() -> None:
    item = {
        "camera": pair(160),
        "scene": scene("pair", attitude=attitude(8.0, -11.0), sun=OVERHEAD),
        "seed": 0,
        "searched": True,
    }
    found = view(item)
    assert found["status"] == "valid"
    # a pixel is 0.85 deg at the middle; its rounding, 0.25 deg, over chords of 1.5 and two to eight pixels
    assert found["error_deg"]["SIGHT"] < 0.25
    assert abs(found["tilt_error_deg"]) <= found["error_deg"]["SIGHT"] + 1e-9
    assert found["error_deg"]["CONE"] < 0.1
    # the plane's chord leaves the vertical by degrees as soon as the cameras turn about their boresights
    assert found["error_deg"]["PLANE"] > 1.0
    # the horizon crosses both frames from side to side, or to the lower edge
    assert min(found["in_view_px"].values()) > 100.0


def test_without_the_suns_own_light_its_image_goes_and_the_limb_stays() -> None:
    """The Sun 10 deg over the limb: behind a lens that scatters, only what came from its disc changes."""
    camera = CameraSpec.model_validate(pair(128, tables={"optics": glare_optics(0.05, 1e-3, 10.0)}))
    tables = {
        "platform": {"altitude_km": 500.0, "heading_deg": 90.0},
        "sun": {"zenith_deg": 102.0, "azimuth_deg": 80.0},
    }
    use = {"file": "pair", "head": "forward"}
    frame = render_frame(SceneSpec.model_validate({**scene("sun", air=True, **tables), "camera": use}), camera)
    dark = without_sunlight(frame)
    lit_light, dark_light = frame.radiance["vis"], dark.radiance["vis"]
    changed = lit_light != dark_light
    # the disc is 0.53 deg wide, a pixel 0.85 to 1.1 deg; nothing further from it than three pixels changes
    assert 1 <= changed.sum() <= 20
    row, column = np.unravel_index(int(np.argmax(lit_light)), lit_light.shape)
    assert np.abs(np.argwhere(changed) - (row, column)).max() <= 3
    # the sky 10 deg over the limb is a million times darker than the ground, the disc ten thousand times brighter
    assert lit_light.max() > 1e3 * dark_light.max()
    assert dark_light[changed].max() < 1e-3 * dark_light.max()
    lit_dn, dark_dn = (observe(one, camera, seed=0).dn.astype(float) for one in (frame, dark))
    assert (lit_dn - dark_dn).mean() > 3.0
    assert without_sunlight(dark).radiance["vis"] == pytest.approx(dark_light)
