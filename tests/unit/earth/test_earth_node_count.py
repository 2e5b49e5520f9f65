from typing import Any

import numpy as np
import pytest
from earth_forms import model_of, scene, solar

from horizonval.core.errors import UserError
from horizonval.earth.atmosphere import air, node_count, solar_rule
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.earth.optical import node_counts, optical_model
from horizonval.spec.camera import Band
from horizonval.spec.files import shipped_names
from horizonval.spec.load import load_camera

RADIUS_M = 6_371_000.0


def limb(node: SpectralNode, z_m: np.ndarray, tangent_m: float, sun_zenith_deg: float, toward_sun: bool) -> float:
    """Return single scattered limb radiance with the Sun in the plane of sight, by plain sums along the ray.

    Independent of the module under test in its geometry (other azimuth, so other angles of scattering and a slanting
    Sun), its steps and its columns.
    """
    s = np.linspace(-1, 1, 161) ** 3 * np.sqrt((RADIUS_M + 100e3) ** 2 - (RADIUS_M + tangent_m) ** 2)
    middle, step = (s[1:] + s[:-1]) / 2, np.diff(s)
    x, y = middle, np.full_like(middle, RADIUS_M + tangent_m)  # sight along x
    sun = np.array([np.sin(np.radians(sun_zenith_deg)) * (1 if toward_sun else -1), np.cos(np.radians(sun_zenith_deg))])
    height = np.hypot(x, y) - RADIUS_M
    k, molecules, particles, g = (
        np.interp(height, z_m, column)
        for column in (node.extinction_per_m, node.molecular_per_m, node.particle_per_m, node.asymmetry)
    )
    t = np.linspace(0, 1, 201)[:, None] ** 2 * 2.5e6
    up = np.hypot(x + t * sun[0], y + t * sun[1]) - RADIUS_M
    along = np.where(up > 100e3, 0.0, np.interp(up, z_m, node.extinction_per_m)) + np.where(up < 0, 1.0, 0.0)
    to_sun = np.trapezoid(along, t, axis=0)
    cosine = sun[0]
    c = node.molecular_cos2
    source = molecules * (1 - c / 3 + c * cosine**2) + particles * (1 - g**2) / (1 + g**2 - 2 * g * cosine) ** 1.5
    before = np.cumsum(k * step) - k * step
    emitted = source / (4 * np.pi) * np.exp(-to_sun - before) * -np.expm1(-k * step) / k
    return float(np.sum(emitted))


def band_radiance(model: OpticalModel, *ray: Any) -> float:
    return sum(n.weight * n.solar_irradiance * limb(n, model.altitude_m, *ray) for n in model.nodes)


@pytest.mark.parametrize("error", [0.01, 0.003])
@pytest.mark.parametrize(
    ("lo_um", "hi_um", "atmosphere"),
    [
        (0.45, 0.75, {}),
        (0.40, 0.90, {"profile": "subarctic_winter", "aerosol": "none"}),
        (0.54, 0.56, {"profile": "tropical", "aerosol": "volcanic_high"}),
        (0.70, 1.05, {}),
    ],
)
def test_rays_that_the_choice_did_not_see(lo_um: float, hi_um: float, atmosphere: dict[str, Any], error: float) -> None:
    tables = {"atmosphere": atmosphere}
    chosen = model_of(solar(lo_um, hi_um), **tables, render={"band_error": error})
    fine = model_of(solar(lo_um, hi_um, nodes=32), **tables)
    assert len(chosen.nodes) < 16
    for tangent_m, zenith, toward in ((2e3, 20.0, True), (11e3, 60.0, False), (17e3, 85.0, True), (38e3, 75.0, False)):
        found, expected = (band_radiance(m, tangent_m, zenith, toward) for m in (chosen, fine))
        assert found == pytest.approx(expected, rel=1.5 * error), (tangent_m, zenith, toward)


def test_fewest_nodes() -> None:
    measure = solar_rule.solar_measure(Band.model_validate(solar(0.45, 0.75)), "")
    counts = [
        len(node_count.choose_rule(measure, air.air_of(scene()), 0.3, error, "").wavelength_um)
        for error in (0.1, 0.03, 0.01, 0.003, 0.001)
    ]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1] <= 8


def test_what_the_band_asks_for_is_honoured() -> None:
    assert node_counts(model_of(solar(0.5495, 0.5505))) == {"b": 1}
    assert node_counts(model_of(solar(0.45, 0.75, nodes=9))) == {"b": 9}
    assert node_counts(model_of(solar(0.45, 0.75), atmosphere={"profile": "none"})) == {"b": 1}


@pytest.mark.parametrize("name", [name for name in shipped_names("camera") if name.startswith(("vis-", "rgb-"))])
def test_shipped_cameras_have_four(name: str) -> None:
    """One launch of the renderer's kernel holds four nodes; a fifth would double its time. A colour needs fewer."""
    shipped = load_camera(name)
    for profile in ("us_standard", "tropical", "midlatitude_winter", "subarctic_winter"):
        counts = node_counts(optical_model(scene(atmosphere={"profile": profile}), shipped))
        assert counts == {"vis": 4} if name.startswith("vis-") else max(counts.values()) <= 4


def test_bands_at_the_ends_of_the_tables() -> None:
    with pytest.raises(UserError, match=r"cam\.toml: band\[0\]: 64 spectral nodes .* a larger render\.band_error"):
        model_of(solar(0.28, 2.0), render={"band_error": 1e-4})
    model = model_of(solar(0.26, 0.27), atmosphere={"ozone": False, "aerosol": "background"})
    assert all(n.particle_per_m.any() for n in model.nodes)
