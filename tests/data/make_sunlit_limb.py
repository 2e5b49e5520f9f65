"""Make horizonval/estimation/limb/model/data/sunlit_limb.npz: where a sunlit limb is steepest, by the place of the Sun.

    python tests/data/make_sunlit_limb.py

A line of rays across the limb is marched (all orders of scattering, US standard air, the filter of the shipped visible
cameras) for each of a grid of Sun's angles at the tangent point, blurred by Gaussians of several widths, and searched
for its steepest place. ``height_km`` is that of clear air over ground of albedo 0.3; ``other_km`` how much higher it is
over dark and bright ground, in the band's shortest and longest quarter, and in volcanic haze, all from 500 km.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from horizonval.core.arrays import FloatArray
from horizonval.earth.optical import optical_model
from horizonval.estimation.limb.model.sunlit import TABLE
from horizonval.renderer.plugin.backend import activate
from horizonval.spec.load import load_camera, load_suite

RADIUS_M = 6371008.8
ALTITUDE_KM = np.array([300.0, 700.0, 2000.0, 36000.0])
OTHERS_FROM_KM = 500.0
SIGMA_KM = np.geomspace(0.5, 512.0, 21)
ZENITH_DEG = np.array([0, 30, 50, 60, 70, 75, 80, 83, 85, 87, 88, 89, 90, 91, 92, 93, 94, 95, 96.0])
AZIMUTH_DEG = np.array([0, 30, 60, 90, 120, 150, 180.0])
TANGENT_KM = np.concatenate(
    [-np.geomspace(2.0, 4000.0, 32)[::-1], np.arange(0.0, 60.0, 1.5), np.arange(60.0, 150.1, 5)]
)
HAZE = "volcanic_moderate"
SEARCH_SIGMAS = 5.0
"""As far as the guard looks for the steepest place: six pixels, of 1.25 pixels of blur."""
TYPICAL_KM = 20.0
LEAST_REACH_KM = 35.0
NODES = 192


def profiles(model, altitude_km: float) -> tuple[FloatArray, list[FloatArray]]:
    """Return the band's radiance, shape (zenith, azimuth, tangent height), and that of its first and last node."""
    from horizonval.renderer.rays.radiance import radiance_along_rays
    from horizonval.renderer.scattering.quality import STANDARD

    distance = RADIUS_M + altitude_km * 1e3
    off = np.arcsin((RADIUS_M + TANGENT_KM * 1e3) / distance)
    rays = np.column_stack([np.sin(off), np.zeros_like(off), -np.cos(off)])
    rho = np.arcsin(RADIUS_M / distance)
    up = np.array([np.cos(rho), 0.0, np.sin(rho)])
    ahead, side = np.array([np.sin(rho), 0.0, -np.cos(rho)]), np.array([0.0, 1.0, 0.0])
    z, a = np.meshgrid(np.radians(ZENITH_DEG), np.radians(AZIMUTH_DEG), indexing="ij")
    level = np.cos(a)[..., None] * ahead + np.sin(a)[..., None] * side
    suns = (np.cos(z)[..., None] * up + np.sin(z)[..., None] * level).reshape(-1, 3)
    shape = (len(ZENITH_DEG), len(AZIMUTH_DEG), len(TANGENT_KM))
    out = radiance_along_rays(
        model,
        RADIUS_M,
        np.tile([0.0, 0.0, distance], (len(suns) * len(rays), 1)),
        np.tile(rays, (len(suns), 1)),
        np.repeat(suns, len(rays), axis=0),
        nodes=NODES,
        scattering=STANDARD,
    )
    bands = [node.weight * node.solar_irradiance * out[node.name].reshape(shape) for node in model.nodes]
    return np.sum(bands, axis=0), [bands[0], bands[-1]]


def steepest_km(radiance: FloatArray) -> FloatArray:
    """Return the height of the steepest place, shape (sigma, zenith, azimuth); NaN where there is none."""
    out = np.full((len(SIGMA_KM), *radiance.shape[:2]), np.nan)
    for i, sigma in enumerate(SIGMA_KM):
        step = sigma / 10.0
        reach = max(SEARCH_SIGMAS * sigma, LEAST_REACH_KM)
        height = np.arange(TYPICAL_KM - 2.0 * reach, TYPICAL_KM + 2.0 * reach, step)
        at = np.array([np.interp(height, TANGENT_KM, row, right=0.0) for row in radiance.reshape(-1, len(TANGENT_KM))])
        slope = -gaussian_filter1d(at, sigma / step, axis=1, order=1, mode="nearest")
        slope[:, np.abs(height - TYPICAL_KM) > reach] = -np.inf
        best = np.clip(np.argmax(slope, axis=1), 1, len(height) - 2)
        row = np.arange(len(at))
        before, middle, after = slope[row, best - 1], slope[row, best], slope[row, best + 1]
        inside = np.isfinite(before) & np.isfinite(after) & (middle > 0.0)
        with np.errstate(invalid="ignore"):
            found = height[best] + 0.5 * step * (before - after) / (before - 2.0 * middle + after)
        out[i] = np.where(inside, found, np.nan).reshape(radiance.shape[:2])
    return out


def main() -> None:
    activate()
    case = load_suite("terminator").cases[0]
    scene = case.scene
    camera = load_camera("vis-cmos-512-60deg")

    def model(albedo: float = 0.3, aerosol: str = "none"):
        surface = scene.surface.model_copy(update={"albedo": albedo})
        air = scene.atmosphere.model_copy(update={"aerosol": aerosol})
        return optical_model(scene.model_copy(update={"surface": surface, "atmosphere": air}), camera)

    clear = model()
    height = np.stack([steepest_km(profiles(clear, altitude)[0]) for altitude in ALTITUDE_KM])
    whole, (blue, red) = profiles(clear, OTHERS_FROM_KM)
    base = steepest_km(whole)
    dark, bright = (profiles(model(albedo), OTHERS_FROM_KM)[0] for albedo in (0.05, 0.8))
    haze = profiles(model(aerosol=HAZE), OTHERS_FROM_KM)[0]
    other = np.stack([steepest_km(one) - base for one in (dark, bright, blue, red, haze)])
    Path(TABLE).parent.mkdir(exist_ok=True)
    np.savez_compressed(
        TABLE,
        altitude_km=ALTITUDE_KM,
        sigma_km=SIGMA_KM,
        zenith_deg=ZENITH_DEG,
        azimuth_deg=AZIMUTH_DEG,
        height_km=height.astype(np.float32),
        other_km=other.astype(np.float32),
    )


if __name__ == "__main__":
    main()
