"""The march up to stations along rays against marches that end there; steps of tables against the usual ones."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.renderer.backend import activate

activate()
import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

from horizonval.earth.optical import optical_model  # noqa: E402
from horizonval.renderer.kernel.batching import IMAGE_TABLE, make_batches  # noqa: E402
from horizonval.renderer.kernel.march import SunlitStations, march_air, march_to_stations  # noqa: E402
from horizonval.renderer.planet import Planet, way_through  # noqa: E402
from horizonval.renderer.tables import vectors  # noqa: E402
from horizonval.renderer.types import constant, constant_vector  # noqa: E402
from horizonval.spec.camera import CameraSpec  # noqa: E402
from horizonval.spec.scene import SceneSpec  # noqa: E402

PLANET = Planet(6_378_137.0, 6_356_752.0)
BAND = {"name": "green", "kind": "solar", "lo_um": 0.52, "hi_um": 0.58, "nodes": 2}


@pytest.fixture(scope="module")
def lit_air():
    # clean air: with haze a grazing ray keeps 5e-4 of its light, and 2e-4 of that hang on where the steps lie
    air = {"aerosol": "none"}
    scene = SceneSpec.model_validate(
        {"camera": {"file": "test"}, "platform": {"altitude_km": 500.0}, "atmosphere": air}
    )
    camera = CameraSpec.model_validate({"camera": {"width": 8, "height": 8, "fov_deg": 20.0}, "band": [BAND]})
    model = optical_model(scene, camera)
    [(_, batch)] = list(make_batches(model, PLANET, IMAGE_TABLE))
    return model.top_m, batch


def _rays(down: float) -> tuple:
    """Return the camera and directions that dip below its horizontal by ``down`` rad and a little more."""
    dip = down + np.array([0.0, 0.002, 0.01])
    d = np.stack([-np.sin(dip), np.cos(dip), 0.0 * dip], axis=1)
    return vectors(np.array([[PLANET.a_m + 500e3, 0.0, 0.0]])), vectors(d)


def _numbers(*ends: float) -> tuple:
    """Return the numbers of the stations at the ends of pieces."""
    return tuple(constant(n) for n in (0.0, *ends))


@pytest.mark.parametrize(
    ("down", "to_ground", "sun_itrs"),
    [(0.9, True, (0.6, 0.8, 0.0)), (0.385, True, (-0.2, -0.98, 0.0)), (0.367, False, (-0.2, -0.98, 0.0))],
)
def test_stations_tell_what_marches_find_that_end_there(
    lit_air, down: float, to_ground: bool, sun_itrs: tuple[float, float, float]
) -> None:
    top_m, batch = lit_air
    o, d = _rays(down)
    sun = constant_vector(sun_itrs)
    first, last = way_through(PLANET, o, d, 18e3, to_ground)
    stations = SunlitStations((first, last), _numbers(4.0), _numbers(192.0), count=5, steps=192, before=192)
    radiance, _, depth, _ = march_to_stations(PLANET, top_m, batch, o, d, sun, to_ground, stations)
    # of the pieces between stations
    radiance, depth = (np.array(v[0]).reshape(5, 3) for v in (radiance, depth))
    transmittance = np.exp(-np.cumsum(depth, axis=0))
    radiance = np.cumsum(radiance * np.exp(depth) * transmittance, axis=0)
    for k in range(5):
        end = first + (last - first) * (k / 4.0)
        cloud = dr.full(mi.Bool, True, 3), end
        air = march_air(PLANET, top_m, batch, o, d, sun, mi.Bool(to_ground), 2048, cloud)
        assert radiance[k] == pytest.approx(np.array(air.radiance[0]), rel=1e-4)
        assert transmittance[k] == pytest.approx(np.array(air.transmittance[0]), rel=1e-4)


def test_steps_leave_no_jumps_where_the_shadow_begins(lit_air) -> None:
    """Rays along the limb into the Earth's shadow: the piece before it grows gently from ray to ray."""
    top_m, batch = lit_air
    azimuth = np.linspace(1.2, 1.5, 400)
    d = np.stack([np.full_like(azimuth, -0.375), np.cos(azimuth), np.sin(azimuth)], axis=1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = vectors(np.array([[PLANET.a_m + 500e3, 0.0, 0.0]]))
    sun = constant_vector((-0.1, -0.995, 0.0))
    found, exact = (
        np.array(march_air(PLANET, top_m, batch, o, vectors(d), sun, mi.Bool(False), nodes).radiance[0])
        for nodes in (128, 2048)
    )
    shines = exact > 1e-6 * exact.max()
    assert shines.sum() > 50
    ratio = found[shines] / exact[shines]
    assert np.median(np.abs(ratio - 1.0)) < 5e-3
    assert np.abs(np.diff(ratio, 2)).max() < 1e-3
