"""The outline of clouds above the limb, against rays through 16 x 16 points of every pixel."""

from __future__ import annotations

from typing import Any

import emission_models
import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.renderer.backend import activate
from horizonval.renderer.kernel.cells import group_cells
from horizonval.renderer.kernel.frame_geometry import FrameGeometry

SOLAR = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
FINE = 16


def _view(camera: dict[str, Any], clouds: dict[str, Any], subsamples: int, refraction: bool = False) -> FrameGeometry:
    activate()
    from horizonval.renderer.description import describe
    from horizonval.renderer.plugins import mitsuba_scene

    render = {"subsamples": subsamples, "orders": "single"}
    air = {"profile": "us_standard", "aerosol": "none"} if refraction else {"profile": "none"}
    scene = emission_models.scene(
        camera={"file": "test", "mount_roll_deg": 68.0},
        platform={"altitude_km": 500.0, "latitude_deg": 5.0, "longitude_deg": -140.0},
        sun={"zenith_deg": 40.0},
        clouds=clouds,
        atmosphere={**air, "refraction": refraction},
        render=render,
    )
    described = describe(scene, emission_models.camera(SOLAR, **camera))
    loaded = mitsuba_scene(described.limb, described.sensor)
    view: FrameGeometry = loaded.integrator().apparent_view(loaded.sensors()[0])
    return view


def _shares(view: FrameGeometry, *, outlines: bool) -> FloatArray:
    """The share of every pixel under Earth and clouds, by the shares of the rays that end on either."""
    import drjit as dr
    import mitsuba as mi

    from horizonval.renderer.kernel.clouds import first_cloud

    assert view.ground is not None
    assert view.ground.clouds is not None
    cells = group_cells(view, outlines=outlines)
    total = dr.zeros(mi.Float64, cells.count)
    dr.scatter_add(total, cells.ground.share, cells.ground.slot)
    dr.eval(total)
    hit, _ = first_cloud(view.ground.clouds, view.planet, view.origin, cells.limb.direction, False, view.bending)
    dr.scatter_add(total, dr.select(hit, cells.limb.share, 0.0), cells.limb.slot)
    return np.array(cells.image(total)).reshape(view.height, view.width)


def _sampled(view: FrameGeometry) -> FloatArray:
    """The same by one ray through each of 16 x 16 points."""
    import drjit as dr
    import mitsuba as mi

    from horizonval.renderer.kernel.clouds import first_cloud

    assert view.ground is not None
    assert view.ground.clouds is not None
    rows, columns = view.height * FINE, view.width * FINE
    number = dr.arange(mi.UInt32, rows * columns)
    u = (mi.Float64(number % columns) + 0.5) / FINE - 0.5
    v = (mi.Float64(number // columns) + 0.5) / FINE - 0.5
    d = view.rays.direction(u, v)
    dr.eval(d)
    _, _, meets = view.planet.chord(view.origin, d)
    hit, _ = first_cloud(view.ground.clouds, view.planet, view.origin, d, False, view.bending)
    covered = np.array(mi.Float64(hit | meets)).reshape(view.height, FINE, view.width, FINE)
    return np.asarray(covered.mean(axis=(1, 3)))


NEAR = {"width": 160, "height": 24, "fov_deg": 12.0}
COARSE = {"width": 96, "height": 24, "fov_deg": 60.0}
EARTH, UNIFORM = {"seed": 5}, {"cover": 0.5, "seed": 5, "top_km": 16.0, "mean_top_km": 8.0}


@pytest.mark.parametrize(
    ("camera", "subsamples", "clouds"), [(NEAR, 1, EARTH), (NEAR, 2, UNIFORM), (COARSE, 1, UNIFORM), (COARSE, 2, EARTH)]
)
def test_the_outline_is_that_of_many_rays(camera: dict[str, Any], subsamples: int, clouds: dict[str, Any]) -> None:
    """0.05 px rms of the outline's height in columns of pixels, less than half the error of one ray a cell."""
    view = _view(camera, clouds, subsamples)
    exact = _sampled(view).sum(axis=0)
    assert exact.std() > 0.05
    error = _shares(view, outlines=True).sum(axis=0) - exact
    rough = _shares(view, outlines=False).sum(axis=0) - exact
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.sqrt(np.mean(rough**2)) > 2.0 * np.sqrt(np.mean(error**2))


@pytest.mark.parametrize(("camera", "subsamples"), [(NEAR, 1), (COARSE, 1)])
def test_the_refracted_outline_is_that_of_many_rays(camera: dict[str, Any], subsamples: int) -> None:
    view = _view(camera, EARTH, subsamples, refraction=True)
    assert view.bending is not None
    exact = _sampled(view).sum(axis=0)
    error = _shares(view, outlines=True).sum(axis=0) - exact
    assert np.sqrt(np.mean(error**2)) < 0.05


def test_no_share_is_lost() -> None:
    """The rays of every cell fill it: 1e-9, rounding."""
    import drjit as dr
    import mitsuba as mi

    view = _view(NEAR, EARTH, 2)
    cells = group_cells(view)
    assert cells.second is not None
    assert dr.width(cells.second) > 100
    total = dr.zeros(mi.Float64, cells.count)
    for rays in (cells.ground, cells.limb):
        dr.scatter_add(total, rays.share, rays.slot)
        dr.eval(total)
    if dr.width(cells.space):
        dr.scatter_add(total, mi.Float64(1.0), cells.space)
    assert np.array(cells.image(total)) == pytest.approx(1.0, abs=1e-9)
