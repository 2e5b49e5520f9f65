"""Two rendered heads through the detector and the method, over a sphere whose vertical is known."""

from __future__ import annotations

from horizonval.systems.b.pair.applicability import OVERHEAD
from horizonval.systems.b.pair.frames import attitude, pair, scene, view


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
