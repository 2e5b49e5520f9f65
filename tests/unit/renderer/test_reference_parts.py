"""Parts of the cross-check and of the export, each against a closed form or a second implementation."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.geometry.camera import camera_from_spec, unproject
from horizonval.geometry.ellipsoid import WGS84, geodetic_height, itrs_from_geodetic
from horizonval.renderer.reference import reference
from horizonval.spec.camera import CameraSpec


def _positions() -> np.ndarray:
    latitude, height = np.meshgrid(np.radians(np.linspace(-90, 90, 37)), np.linspace(0.0, 1e5, 11))
    return itrs_from_geodetic(latitude.ravel(), np.full(latitude.size, 0.7), height.ravel())


def test_heights_equal_geometry(mi: Any) -> None:
    """1e-6 m for exact shells, 0.6 m for the grid, poles and equator included."""
    from horizonval.renderer.planet import Planet
    from horizonval.renderer.reference.reference_scene import Placement, _radius_and_height, geodetic

    r = _positions()
    planet = Planet(WGS84.a_m, WGS84.b_m)
    expected = geodetic_height(r, WGS84)
    exact = np.array(geodetic(planet, mi.Vector3d(*(np.ascontiguousarray(c) for c in r.T)))[0])
    assert np.abs(exact - expected).max() < 1e-6
    place = Placement.below(planet, np.array([7e6, 0.0, 0.0]), np.eye(3), (1.0, 0.0, 0.0))
    assert np.abs(_radius_and_height(place, r)[1] - expected).max() < 0.6


def test_the_scenes_origin_is_on_the_ground_below_the_camera(mi: Any) -> None:
    from horizonval.renderer.planet import Planet
    from horizonval.renderer.reference.reference_scene import Placement

    for r in _positions()[-37:]:
        place = Placement.below(Planet(WGS84.a_m, WGS84.b_m), r * 1.1, np.eye(3), (1.0, 0.0, 0.0))
        assert abs(float(geodetic_height(place.origin_m, WGS84))) < 1e-6
        assert np.cross(place.origin_m, r) == pytest.approx(0.0, abs=1.0)


def test_a_coarser_detector_keeps_the_lens() -> None:
    """The outer corners of the image and the focal length in millimetres stay where they are."""
    pixel = {"kind": "cmos", "pixel_pitch_um": 5.5, "exposure_s": 1e-3, "quantum_efficiency": 0.6}
    detector = pixel | {"full_well_e": 1e4, "read_noise_e": 10, "bits": 10}
    geometry = {"width": 640, "height": 480, "fx": 500.0, "fy": 510.0, "cx": 300.0, "distortion": [-0.1]}
    camera = CameraSpec.model_validate({"camera": geometry, "optics": {"psf_sigma_px": 0.8}, "detector": detector})
    small = reference.resized(camera, 64, 48, "")
    corners = [
        unproject(camera_from_spec(c.camera), np.array([[-0.5, -0.5], [c.camera.width - 0.5, c.camera.height - 0.5]]))
        for c in (camera, small)
    ]
    assert corners[0] == pytest.approx(corners[1], abs=1e-12)
    assert small.detector is not None
    assert small.detector.pixel_pitch_um * small.camera.fx == pytest.approx(5.5 * 500.0)
    assert small.optics.psf_sigma_px == pytest.approx(0.08)
    with pytest.raises(UserError, match="64x48"):
        reference.resized(camera, 64, 64, "")


@pytest.mark.parametrize(("spp", "pixels"), [(2, 1), (7, 100), (64, 512**2), (4096, 512**2), (3, 10**8)])
def test_passes_are_bounded_and_give_no_less_than_asked(spp: int, pixels: int) -> None:
    passes, each = reference._passes(spp, pixels)
    assert passes >= 2
    assert spp <= passes * each < spp + passes
    assert each == 1 or each * pixels <= reference.LANES


def test_xml_keeps_every_digit_and_sign(mi: Any) -> None:
    from horizonval.renderer.reference.reference import scene_xml

    text = '{"a": "<&>", "b": 0.1}'
    data = {
        "type": "scene",
        "integrator": {"type": "horizon_limb", "model": text, "nodes": 3, "raw": True, "x": 0.1 + 0.2},
        "sun": {"type": "directional", "direction": [1 / 3, -1e-17, 0.0]},
    }
    root = ElementTree.fromstring(scene_xml(data, "a -- b"))
    values = {e.get("name"): (e.tag, e.get("value")) for e in root.iter() if e.get("value")}
    assert values["model"] == ("string", text)
    assert values["raw"] == ("boolean", "true")
    assert values["nodes"] == ("integer", "3")
    assert float(values["x"][1]) == 0.1 + 0.2
    assert [float(v) for v in values["direction"][1].split(",")] == [1 / 3, -1e-17, 0.0]
    with pytest.raises(TypeError, match="has no XML"):
        scene_xml({"type": "scene", "integrator": {"type": "volpath", "bad": None}}, "")
