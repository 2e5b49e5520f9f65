"""What shines on parts of the spacecraft: the map of the Earth, and the Sun."""

from __future__ import annotations

import numpy as np

import horizonval as hv
from horizonval.renderer import parts


def test_the_map_of_the_earth_holds_what_the_camera_sees() -> None:
    """Straight down and straight up, and the limb where it is: rows of the map from zenith to nadir."""
    import mitsuba as mi

    from horizonval.renderer.frame import viewpoint_of

    camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 9, "height": 9, "fov_deg": 5.0})
    scene = hv.Scene(camera, altitude_km=500.0, atmosphere={"profile": "none"}, sun={"zenith_deg": 20.0})
    viewpoint = viewpoint_of(scene.spec, camera.spec)
    nadir = viewpoint.frame(scene.spec).radiance["vis"][4, 4]
    film = mi.load_dict({"type": "hdrfilm", "width": 8, "height": 8})
    integrator = viewpoint._mi_scene.integrator()
    light = parts.sky_light(integrator, viewpoint._described.sensor.r_itrs, film)
    earth = light.earth["vis"]
    assert earth.shape == (parts.ROWS, parts.COLUMNS)
    np.testing.assert_allclose(earth[-1], nadir, rtol=0.01)
    assert (earth[0] < 1e-9 * nadir).all()
    # the horizon 22 deg below level: a row is 2.8 deg
    lit = np.flatnonzero(earth.max(axis=1) > 1e-3 * nadir)[0]
    assert abs(180.0 * lit / (parts.ROWS - 1) - 112.0) < 3.0
    sun = light.sun["vis"]
    # no air before the Sun
    whole = sum(n.weight * n.solar_irradiance for n in viewpoint._described.model.nodes)
    np.testing.assert_allclose(sun.irradiance, whole, rtol=1e-6)
