"""From a scene and a camera to the optical properties the renderer marches through.

Solar bands become monochromatic nodes: Gauss's rule for the measure ``R(lambda) (lambda / lambda_ref) E_sun(lambda)``,
so that Fraunhofer lines and jagged responses are integrated exactly and only the smooth transfer function is sampled
(exact for polynomials of degree 2 n - 1 in wavelength). Ozone's cross section has peaks of its own; the nodes take it
smoothed as :func:`horizonval.earth.quadrature.smoothed` says. Every node of a band carries the band's mean irradiance,
and the weights add up to the band's effective width [um]. Single scattered limb radiance with 4 nodes is then within
0.1 % for 100 to 200 nm wide bands, and 1 % for 400 to 900 nm (0.1 % with 8 nodes).

Thermal bands become the g points of :mod:`horizonval.earth.thermal_absorption`, weight 1, W m-2 sr-1.

Left out: aerosol and cloud; absorption of sunlight by O2, H2O and NO2 (the O2 A band at 760 nm takes a few per cent of
700 to 800 nm at the ground) and by ozone beyond 820 nm (4 % of the limb at 20 km at 820 nm, 2 % at 850); sunlight
reflected in thermal bands (0.02 of 30 W m-2 sr-1 in 8 to 14 um off a ground of emissivity 0.95).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from horizonval.earth import atmosphere_file, bands, ozone, planck, rayleigh, sunlight, thermal_absorption
from horizonval.earth.column import FloatArray, OpticalModel, SpectralNode
from horizonval.earth.profiles import Profile, names, profile
from horizonval.earth.quadrature import gauss_rule, smoothed
from horizonval.errors import UserError
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.scene import Atmosphere, SceneSpec
from horizonval.suggest import nearest

__all__ = ["NO_ATMOSPHERE", "FloatArray", "OpticalModel", "SpectralNode", "optical_model"]

NO_ATMOSPHERE = "none"
TOP_M = 100_000.0
STEP_M = 100.0
BARE_GROUND_K = 288.15
"""Temperature of the ground without an atmosphere to take it from: US76 sea level."""


def optical_model(
    scene: SceneSpec, camera: CameraSpec, sun_distance_au: float = 1.0, *, base_dir: Path | None = None
) -> OpticalModel:
    """Return the optical properties of a scene for every band of a camera.

    On a grid of 100 m from 0 to 100 km. Densities fall exponentially between levels; taken as linear over 100 m they
    are at most 3e-5 too high for a scale height of 7 km. An atmosphere file keeps its own nodes.

    ``us76`` has no absorption table of its own: its thermal bands take the absorption of ``us_standard`` with the
    temperatures of US76. The two profiles differ by at most 0.8 K up to 47 km and 2.3 K up to 100 km.

    Parameters
    ----------
    scene : SceneSpec
        Atmosphere and surface are used.
    camera : CameraSpec
        Its bands are used.
    sun_distance_au : float
        Distance of the Sun.
    base_dir : Path, optional
        Folder against which ``atmosphere.file`` is resolved; default the current one.

    Raises
    ------
    UserError
        Camera without bands; unknown profile; band outside the tables; atmosphere file refused or without a band of
        the camera's name.
    """
    if not camera.band:
        raise UserError(
            "the camera has no bands",
            where=f"{scene.camera.file}: band",
            expected="at least one [[band]] to render",
        )
    if scene.atmosphere.file is not None:
        return _from_file(scene, camera, sun_distance_au, base_dir)
    if scene.atmosphere.profile == NO_ATMOSPHERE:
        return _bare(scene, camera, sun_distance_au)
    known = [*names(), NO_ATMOSPHERE]
    if scene.atmosphere.profile not in known:
        raise UserError(
            f"unknown atmosphere profile {scene.atmosphere.profile!r}",
            where=f"{scene.scene.name}: atmosphere.profile",
            expected="one of " + ", ".join(nearest(scene.atmosphere.profile, known)),
        )
    state = profile(scene.atmosphere.profile).at(np.linspace(0.0, TOP_M, round(TOP_M / STEP_M) + 1))
    ground_k = scene.surface.temperature_k or float(state.temperature_k[0])
    nodes: list[SpectralNode] = []
    for i, band in enumerate(camera.band):
        where = f"{scene.camera.file}: band[{i}]"
        if band.kind == "solar":
            nodes += _solar_nodes(band, state, scene.atmosphere, sun_distance_au, where)
        else:
            nodes += _thermal_nodes(band, state, ground_k, sun_distance_au, where)
    refractivity = None
    if scene.atmosphere.refraction:
        refractivity = rayleigh.refractivity(state.number_density_air, [n.wavelength_um for n in nodes])
    return _model(scene, state.altitude_m, nodes, refractivity)


def _model(
    scene: SceneSpec, altitude_m: FloatArray, nodes: list[SpectralNode], refractivity: FloatArray | None = None
) -> OpticalModel:
    return OpticalModel(
        altitude_m=altitude_m,
        top_m=float(altitude_m[-1]),
        nodes=tuple(nodes),
        albedo=scene.surface.albedo,
        emissivity=scene.surface.emissivity,
        refractivity=refractivity,
    )


def _check_sunlight(band: Band, where: str) -> None:
    lo, hi = bands.limits_um(band)
    if lo < sunlight.MIN_UM or hi > sunlight.MAX_UM:
        raise UserError(
            f"band {band.name!r} spans {lo:g} to {hi:g} um",
            where=where,
            expected=f"a response within {sunlight.MIN_UM:g} to {sunlight.MAX_UM:g} um, the Sun's known spectrum",
        )


@dataclass(frozen=True)
class _SolarRule:
    """Gauss's rule of a solar band: nodes, their weights, and the measure it was made for."""

    wavelength_um: FloatArray
    weight_um: FloatArray
    mean_irradiance: float
    fine_um: FloatArray
    fine_energy: FloatArray

    def ozone(self) -> tuple[FloatArray, FloatArray]:
        """Return ozone's cross sections at 220 and 280 K that the nodes shall use, shape (n,); 0 beyond the table."""
        known = self.fine_um <= ozone.MAX_UM
        samples = np.zeros((2, len(self.fine_um)))
        samples[:, known] = ozone.cold_and_warm_m2(self.fine_um[known])
        cold, warm = (smoothed(self.fine_um, self.fine_energy, s, self.wavelength_um) for s in samples)
        return cold, warm


def _solar_rule(band: Band, n: int, sun_distance_au: float, where: str) -> _SolarRule:
    _check_sunlight(band, where)
    wavelength, weight = bands.sampled(band, sunlight.table_um(), order=4)
    weight = weight * wavelength / bands.reference_wavelength_um(band)
    irradiance = sunlight.irradiance(wavelength, sun_distance_au)
    nodes, energy = gauss_rule(wavelength, weight * irradiance, n)
    mean = float(energy.sum() / weight.sum())
    return _SolarRule(nodes, energy / mean, mean, wavelength, weight * irradiance)


def _solar_node(
    band: Band,
    index: int,
    wavelength_um: float,
    weight: float,
    irradiance: float,
    sun_distance_au: float,
    extinction: FloatArray,
    scattering: FloatArray,
) -> SpectralNode:
    return SpectralNode(
        name=f"{band.name}:{index}",
        band=band.name,
        weight=weight,
        wavelength_um=wavelength_um,
        extinction_per_m=extinction,
        molecular_per_m=scattering,
        molecular_cos2=rayleigh.COS2,
        particle_per_m=np.zeros_like(extinction),
        asymmetry=np.zeros_like(extinction),
        solar_irradiance=irradiance,
        source=np.zeros_like(extinction),
        surface_source=0.0,
        sun_radiance=irradiance / sunlight.disc_projected_solid_angle(sun_distance_au),
    )


def _solar_nodes(
    band: Band, state: Profile, atmosphere: Atmosphere, sun_distance_au: float, where: str
) -> list[SpectralNode]:
    lo, _ = bands.limits_um(band)
    if atmosphere.ozone and lo < ozone.MIN_UM:
        raise UserError(
            f"band {band.name!r} starts at {lo:g} um",
            where=where,
            expected=f"{ozone.MIN_UM:g} um or more, where ozone absorption is known",
        )
    rule = _solar_rule(band, band.nodes, sun_distance_au, where)
    cold, warm = rule.ozone() if atmosphere.ozone else (np.zeros(band.nodes), np.zeros(band.nodes))
    nodes = []
    for i, wavelength in enumerate(rule.wavelength_um):
        scattering = state.number_density_air * rayleigh.cross_section_m2(wavelength)
        absorption = state.number_density_o3 * ozone.at_temperature_m2(cold[i], warm[i], state.temperature_k)
        nodes.append(
            _solar_node(
                band,
                i,
                float(wavelength),
                float(rule.weight_um[i]),
                rule.mean_irradiance,
                sun_distance_au,
                scattering + absorption,
                scattering,
            )
        )
    return nodes


def _thermal_nodes(
    band: Band, state: Profile, ground_k: float, sun_distance_au: float, where: str
) -> list[SpectralNode]:
    climate = state.name
    if climate in thermal_absorption.climates():
        temperature = thermal_absorption.temperature_k(climate, state.altitude_m)
    else:
        climate, temperature = "us_standard", state.temperature_k
    nodes = []
    for point in thermal_absorption.g_points(climate, band, state.altitude_m, where=where):
        nu = point.bin_wavenumber_per_cm
        sun_per_um = sunlight.irradiance(1e4 / nu, sun_distance_au)
        sun_per_cm = sun_per_um * 1e4 / nu**2 / sunlight.disc_projected_solid_angle(sun_distance_au)
        nodes.append(
            SpectralNode(
                name=f"{band.name}:{point.name}",
                band=band.name,
                weight=1.0,
                wavelength_um=point.wavelength_um,
                extinction_per_m=point.absorption_per_m,
                molecular_per_m=np.zeros_like(state.altitude_m),
                molecular_cos2=0.0,
                particle_per_m=np.zeros_like(state.altitude_m),
                asymmetry=np.zeros_like(state.altitude_m),
                solar_irradiance=0.0,
                source=point.source(temperature),
                surface_source=float(point.source(ground_k)),
                sun_radiance=point.weigh(sun_per_cm),
            )
        )
    return nodes


def _grey_thermal_node(
    band: Band,
    temperature: FloatArray,
    ground_k: float,
    absorption: FloatArray,
    sun_distance_au: float,
    where: str,
) -> SpectralNode:
    """Return the one node of a thermal band with the same absorption throughout; source integrated over the band."""
    _check_sunlight(band, where)
    wavelength, weight = bands.sampled(band)
    source = planck.radiance_per_um(wavelength, temperature[:, None]) @ weight
    sun = float(sunlight.irradiance(wavelength, sun_distance_au) @ weight)
    return SpectralNode(
        name=band.name,
        band=band.name,
        weight=1.0,
        wavelength_um=bands.reference_wavelength_um(band),
        extinction_per_m=absorption,
        molecular_per_m=np.zeros_like(absorption),
        molecular_cos2=0.0,
        particle_per_m=np.zeros_like(absorption),
        asymmetry=np.zeros_like(absorption),
        solar_irradiance=0.0,
        source=source,
        surface_source=float(planck.radiance_per_um(wavelength, ground_k) @ weight),
        sun_radiance=sun / sunlight.disc_projected_solid_angle(sun_distance_au),
    )


def _bare(scene: SceneSpec, camera: CameraSpec, sun_distance_au: float) -> OpticalModel:
    """Return the ground alone: nothing depends on wavelength, so that one node per band is exact."""
    z = np.array([0.0, TOP_M])
    zero = np.zeros_like(z)
    ground_k = scene.surface.temperature_k or BARE_GROUND_K
    nodes = []
    for i, band in enumerate(camera.band):
        where = f"{scene.camera.file}: band[{i}]"
        if band.kind == "solar":
            rule = _solar_rule(band, 1, sun_distance_au, where)
            nodes.append(
                _solar_node(
                    band,
                    0,
                    float(rule.wavelength_um[0]),
                    float(rule.weight_um[0]),
                    rule.mean_irradiance,
                    sun_distance_au,
                    zero,
                    zero,
                )
            )
        else:
            cold = np.full_like(z, ground_k)
            nodes.append(_grey_thermal_node(band, cold, ground_k, zero, sun_distance_au, where))
    return _model(scene, z, nodes)


def _from_file(scene: SceneSpec, camera: CameraSpec, sun_distance_au: float, base_dir: Path | None) -> OpticalModel:
    """Return a scene whose atmosphere comes from a file: one node per camera band, grey inside the band.

    Coefficients, temperatures and phase function come from the file; albedo, emissivity and (where given) the ground's
    temperature from the scene, the response and the Sun's spectrum from the camera band. The file's radius does not
    move the scene's Earth.
    """
    assert scene.atmosphere.file is not None
    path = (base_dir or Path()) / scene.atmosphere.file
    file = atmosphere_file.read_atmosphere(path)
    known = {band.name: band for band in file.bands}
    z = atmosphere_file.altitudes_m(file, thermal=any(band.kind == "thermal" for band in camera.band))
    temperature = atmosphere_file.column(file, file.temperature_K, z)
    ground_k = scene.surface.temperature_k or file.surface.temperature_K
    nodes = []
    for i, band in enumerate(camera.band):
        where = f"{scene.camera.file}: band[{i}]"
        if band.name not in known:
            raise UserError(
                f"no band {band.name!r}, which the camera {scene.camera.file!r} has",
                where=f"{path}: bands",
                expected="a band for each of the camera's, by name; the file has "
                + ", ".join(nearest(band.name, known)),
            )
        entry = known[band.name]
        absorption = atmosphere_file.column(file, entry.absorption_per_m, z)
        if band.kind == "thermal":
            nodes.append(_grey_thermal_node(band, temperature, ground_k, absorption, sun_distance_au, where))
            continue
        scatterers = atmosphere_file.scatterers(file, entry, z)
        scattering = scatterers["molecular_per_m"] + scatterers["particle_per_m"]
        rule = _solar_rule(band, 1, sun_distance_au, where)
        node = _solar_node(
            band,
            0,
            entry.wavelength_nm * 1e-3,
            float(rule.weight_um[0]),
            rule.mean_irradiance,
            sun_distance_au,
            scattering + absorption,
            scattering,
        )
        nodes.append(replace(node, **scatterers))
    refractivity = atmosphere_file.refractivity(file, z, str(path)) if scene.atmosphere.refraction else None
    return _model(scene, z, nodes, refractivity)
