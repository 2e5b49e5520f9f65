"""Emission of thermal columns and bands along straight rays, integrated here on its own terms, against other codes."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from horizonval.earth import atmosphere_file
from horizonval.earth.atmosphere.profiles import us76
from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

DATA = Path(__file__).parents[1] / "data"
BANDS = {"14.0-16.3um": (14.0, 16.3), "8-14um": (8.0, 14.0)}


def column_radiance(
    z_m: Any, extinction: Any, source: Any, ground_source: float, impact_m: float, radius_m: float, steps: int = 4000
) -> float:
    """Return the emission along a ray with a given lowest height (negative: it meets the ground) through one column.

    Midpoints of ``steps`` equal pieces of the path, each isothermal and homogeneous; extinction and source linear
    between the heights given.
    """
    b = radius_m + impact_m
    end = math.sqrt((radius_m + z_m[-1]) ** 2 - b**2)
    start = math.sqrt(radius_m**2 - b**2) if impact_m < 0 else -end
    s = np.linspace(end, start, steps + 1)
    middle, step = (s[1:] + s[:-1]) / 2, abs(s[1] - s[0])
    z = np.sqrt(middle**2 + b**2) - radius_m
    depth = np.concatenate([[0.0], np.cumsum(np.interp(z, z_m, extinction) * step)])
    passed = np.exp(-depth)
    total = np.sum(np.interp(z, z_m, source) * -np.diff(passed))
    return float(total + (ground_source * passed[-1] if impact_m < 0 else 0.0))


def radiance(model: OpticalModel, impact_m: float, radius_m: float, steps: int = 4000) -> float:
    """Return the radiance of the first thermal band, uniform over latitudes, over a uniform ground."""
    band, ground = model.thermal[0], model.emission
    assert ground is not None
    behind = ground.emissivity * band.source(ground.land_k[0])
    columns = zip(*(column[:, 0] for column in band.columns()), behind, strict=True)
    return sum(column_radiance(band.altitude_m, *column, impact_m, radius_m, steps) for column in columns)


@pytest.fixture(scope="module")
def rows() -> list[dict[str, str]]:
    with (DATA / "thermal_limb.csv").open() as file:
        return list(csv.DictReader(file))


def model_of(climate: str, interval: str) -> OpticalModel:
    lo, hi = BANDS[interval]
    band: dict[str, Any] = {"name": "t", "kind": "thermal", "lo_um": lo, "hi_um": hi}
    camera = CameraSpec.model_validate({"camera": {"width": 1, "height": 1, "fov_deg": 1}, "band": [band]})
    scene: dict[str, Any] = {
        "camera": {"file": "t"},
        "platform": {"altitude_km": 500},
        "atmosphere": {"profile": climate, "aerosol": "none", "halocarbons": False},
    }
    return optical_model(SceneSpec.model_validate(scene), camera)


@pytest.mark.parametrize("climate", ["us_standard", "tropical"])
@pytest.mark.parametrize("interval", list(BANDS))
def test_correlated_k_on_the_limb(rows: list[dict[str, str]], climate: str, interval: str) -> None:
    model = model_of(climate, interval)
    chosen = [r for r in rows if r["atmosphere"] == climate and r["interval"] == interval]
    assert len(chosen) == 9
    for row in chosen:
        height = float(row["tangent_height_km"])
        found = radiance(model, height * 1e3, 6_371_230.0)
        # The same table in another integrator: five figures printed, 1e-3 for Planck at the middle of a bin and its
        # covered part there (here its integral), and both codes' steps.
        assert found == pytest.approx(float(row["radiance_420ppm_W_m2_sr"]), rel=2e-3), height
        # LOWTRAN7, another spectroscopy with 330 ppm of CO2: within 8 % up to 30 km, where both hold.
        if height <= 30:
            assert found == pytest.approx(float(row["lowtran7_330ppm_W_m2_sr"]), rel=0.08), height


# Tangent height (negative: impact parameter) and radiance at 15 um [W m-2 sr-1 um-1] of an absorber
# 1e-5 exp(-z / 7 km) per metre with the temperature of US76: mean of sasktran2 and an independent quadrature, which
# agree to 2e-5.
GREY = [
    (0.25, 3.7772905),
    (8.0, 1.8519847),
    (20.0, 0.54282367),
    (32.0, 0.15036524),
    (44.0, 0.04204973),
    (56.0, 0.006089890),
    (-2.0, 4.0497770),
]


def grey_file() -> dict[str, Any]:
    z = np.arange(0.0, 100.0001, 0.1)
    table = np.array([*us76(z[z <= 86] * 1e3).temperature_k, *np.full(np.sum(z > 86), 186.8673)])
    return {
        "planet_radius_km": 6371.0,
        "top_km": 100.0,
        "altitude_km": z.tolist(),
        "temperature_K": table.tolist(),
        "bands": [
            {
                "name": "grey",
                "wavelength_nm": 15000.0,
                "scattering_per_m": [0.0] * len(z),
                "absorption_per_m": (1e-5 * np.exp(-z / 7)).tolist(),
                "phase": "isotropic",
            }
        ],
        "surface": {"albedo": 0.0, "temperature_K": 288.15, "emissivity": 1.0},
    }


@pytest.mark.parametrize(("height_km", "expected"), GREY)
def test_grey_limb(height_km: float, expected: float) -> None:
    file = atmosphere_file.parse_atmosphere(grey_file(), "grey")
    model = atmosphere_file.file_model(file, thermal=True)
    found = radiance(model, height_km * 1e3, 6_371_000.0, steps=20_000)
    # Midpoint steps of 0.1 km; above 86 km the temperatures differ slightly, below 1e-4 of radiance at 56 km.
    assert found == pytest.approx(expected, rel=1e-4)
