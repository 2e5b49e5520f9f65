"""The plane of a view table: rays found again at their places, and borders where rays touch raised ellipsoids."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.renderer.backend import activate

TOP_M = 1e5
EDGES_M = (13_878.0, 15_038.0, 21_000.0)
CAMERAS = ([4.0e6, 3.0e6, 5.2e6], [6.9e6, 1.0e5, 2.0e5], [0.0, 0.0, 7.5e6], [3.0e7, 2.0e7, -1.5e7])


@pytest.fixture(scope="module", autouse=True)
def _backend():
    activate()


def _plane(origin, to_ground=False, edges_m=EDGES_M):
    from horizonval.renderer.kernel.frame_geometry import RayCoordinates
    from horizonval.renderer.planet import Planet
    from horizonval.renderer.view_table.sunlit_air import RayPlane

    planet = Planet(6_378_137.0, 6_356_752.3)
    return RayPlane.of(RayCoordinates.of(planet, np.array(origin), TOP_M), to_ground, edges_m, TOP_M)


@pytest.mark.parametrize("to_ground", [True, False])
@pytest.mark.parametrize("origin", [*CAMERAS, [6.4e6, 0.0, 0.0]])
def test_rays_are_found_again_at_their_places(origin, to_ground):
    from horizonval.renderer.tables import vectors

    plane = _plane(origin, to_ground)
    rng = np.random.default_rng(3)
    x, azimuth = rng.random(2000), rng.uniform(-np.pi, np.pi, 2000)
    found, turned = plane.place(vectors(np.array([origin])), vectors(plane.directions(x, azimuth)))
    # heights of 1e-7 m, the rounding of distances as long as this, over a limb of 1e5 m, in the worst camera
    np.testing.assert_allclose(np.array(found), x, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(np.array(turned), azimuth, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("origin", CAMERAS)
def test_rays_on_a_border_touch_the_ellipsoid_raised_by_its_height(origin):
    from horizonval.renderer.tables import vectors
    from horizonval.renderer.view_table.patch_table import ROW_PATCHES

    plane = _plane(origin)
    assert plane.heights_m == (*EDGES_M, TOP_M)
    assert sum(plane.patches) == ROW_PATCHES
    azimuth = np.linspace(0.0, 2.0 * np.pi, 50)
    for border, height in zip(np.cumsum(plane.patches), plane.heights_m, strict=True):
        d = vectors(plane.directions(np.full_like(azimuth, border / ROW_PATCHES), azimuth))
        miss = plane.coordinates.planet.miss_distance(vectors(np.array([origin])), d, height)
        # 1e-14 of 6.4e6 m and of the camera's distance: below a micrometre
        np.testing.assert_allclose(np.array(miss), 1.0, rtol=0.0, atol=5e-14)


def test_the_lowest_edges_give_way_where_there_are_more_than_patches():
    edges = [1000.0 * k for k in range(1, 12)]
    plane = _plane(CAMERAS[0], edges_m=edges)
    assert plane.heights_m == (*edges[-7:], TOP_M)
    assert set(plane.patches) == {1}
