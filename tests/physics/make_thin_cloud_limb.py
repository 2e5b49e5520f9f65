"""Make ``limb_thin_cloud_montecarlo.csv``: a limb with thin cirrus by Monte Carlo, 40 minutes of processor time.

US standard air with ozone at one wavelength, ice of one kind from 9 to 11 km with sharp edges, a ground of albedo 0.3.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import replace

import monte_carlo
import numpy as np
from reference_rays import DATA, limb_ray, vector

from horizonval.earth.clouds import layers
from horizonval.earth.clouds.layers import layers_of
from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

TABLE = DATA / "limb_thin_cloud_montecarlo.csv"
BASE_KM, TOP_KM = 9.0, 11.0
SUNS = ((20.0, 90.0), (60.0, 30.0), (60.0, 150.0), (85.0, 60.0), (90.0, 120.0))
HEIGHTS_KM = (3.0, 9.3, 10.2, 13.0)
PATHS, MOST_PATHS, ERROR = 8000, 200_000, 4e-3


def model_of(optical_depth: float) -> OpticalModel:
    """Return our model, of unit irradiance."""
    layer = {"kind": "cirrus", "optical_depth": optical_depth, "base_km": BASE_KM, "top_km": TOP_KM}
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test"},
            "platform": {"altitude_km": 500},
            "atmosphere": {"aerosol": "none", "refraction": False, "gases_in_sunlight": False},
            "layer": [layer] if optical_depth else [],
        }
    )
    green = {"name": "green", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
    camera = CameraSpec.model_validate(
        {"camera": {"name": "test", "width": 8, "height": 8, "fov_deg": 5.0}, "band": [green]}
    )
    model = optical_model(scene, camera)
    model = replace(model, nodes=(replace(model.nodes[0], solar_irradiance=1.0),))
    assert not optical_depth or layers_of(scene)[0].particle == "ice 30"
    return model


def air_of(optical_depth: float) -> monte_carlo.Air:
    """Return the same air for the Monte Carlo, the layer's edges a metre wide."""
    node, z = model_of(0.0).nodes[0], model_of(0.0).altitude_m / 1e3
    edges = [BASE_KM - 1e-3, BASE_KM + 1e-3, TOP_KM - 1e-3, TOP_KM + 1e-3]
    heights = np.unique(np.concatenate([z, edges]))
    extinction, scattering, g = (float(v) for v in layers.sunlit("ice 30", node.wavelength_um))
    inside = ((heights > BASE_KM) & (heights < TOP_KM)) * optical_depth / (TOP_KM - BASE_KM)
    gas = np.interp(heights, z, node.extinction_per_m - node.molecular_per_m)
    return monte_carlo.make_air(
        heights,
        1e3 * np.interp(heights, z, node.molecular_per_m),
        1e3 * gas + inside * (extinction - scattering),
        [(inside * scattering, g)],
        cos2=node.molecular_cos2,
        ground=monte_carlo.uniform(0.3),
    )


def main(optical_depths: list[float]) -> None:
    with TABLE.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        ray_keys = ["optical_depth", "sun_zenith_deg", "azimuth_deg", "height_km"]
        table.writerow([*ray_keys, "radiance_per_sr", "standard_error", "single_per_sr"])
        for depth in optical_depths:
            air = air_of(depth)
            rays = [(sun, azimuth, height) for sun, azimuth in SUNS for height in HEIGHTS_KM]
            for i, ray in enumerate(rays):
                row = limb_ray(*ray)
                vectors = (vector(row, name) for name in ("obs", "dir", "sun"))
                seed = monte_carlo.seed_of(depth, i, "y")
                answer = monte_carlo.radiance(air, *vectors, PATHS, seed, se=ERROR, max_paths=MOST_PATHS)
                numbers = f"{answer.total:.6g}", f"{answer.multiple_se:.2g}", f"{answer.single_exact:.6g}"
                table.writerow([depth, *ray, *numbers])


if __name__ == "__main__":
    main([float(v) for v in sys.argv[1:]])
