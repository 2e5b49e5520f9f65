"""Optical properties of a scene in a camera's bands, as the renderer integrates them.

Solar bands become monochromatic nodes: Gauss's rule for the measure ``R(lambda) (lambda / lambda_ref) E_sun(lambda)``,
so that Fraunhofer lines and jagged responses are integrated exactly and only the smooth transfer function is sampled
(exact for polynomials of degree 2 n - 1 in wavelength). Nodes use a smoothed cross section of ozone
(:meth:`horizonval.earth.spectral.quadrature.Orthonormal.smoothed`). Every node of a band has the band's mean
irradiance, and the weights add up to the band's effective width [um]. The number of nodes is the band's, or the
smallest that meets ``render.band_error`` (:mod:`horizonval.earth.atmosphere.node_count`). Oxygen and water vapour add a
few nodes from 570 nm on (:mod:`horizonval.earth.gases.sunlight_absorption`).

A solar node has molecules with their depolarisation at its wavelength, ozone, nitrogen dioxide below 700 nm, and
particles with the asymmetry of the scatterers at each altitude. Thermal bands become
:class:`horizonval.earth.atmosphere.emission.EmittingBand` with a
:class:`horizonval.earth.surface.ground_emission.GroundEmission` behind.

Neglected: absorption of sunlight by ozone beyond 1000 nm (less than 0.3 % of the limb); sunlight reflected in thermal
bands (0.02 of 30 W m-2 sr-1 in 8 to 14 um off a ground of emissivity 0.95).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.earth import atmosphere_file
from horizonval.earth.atmosphere import aerosol
from horizonval.earth.atmosphere.air import AS_IT_IS, NO_ATMOSPHERE, TOP_M, Air, AirChange, air_of
from horizonval.earth.atmosphere.emission import EmittingBand, emitting_air, grey_band, no_air_band
from horizonval.earth.atmosphere.node_count import choose_rule
from horizonval.earth.atmosphere.solar_rule import Measure, SolarRule, gauss, rule_with_gases, solar_measure
from horizonval.earth.atmosphere.sunlit_gases import GasesInSight, SunlitGases, gases_in_sight
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.earth.gases import ozone, rayleigh
from horizonval.earth.limb_heights import air_refractivity, file_refractivity
from horizonval.earth.spectral import bands, sunlight
from horizonval.earth.surface.ground_emission import emitting_ground, lowest_air_k
from horizonval.earth.surface.ground_map import air_begins_m
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.scene import SceneSpec

__all__ = ["NO_ATMOSPHERE", "FloatArray", "OpticalModel", "SpectralNode", "node_counts", "optical_model"]

BARE_EARTH_NODES = 4
"""Nodes of a band over a ground with a spectrum but without air; they must follow vegetation's red edge."""
BARE_GROUND_K = 288.15
"""Temperature of the ground without an atmosphere: US76 at sea level."""


def node_counts(model: OpticalModel) -> dict[str, int]:
    """Return the number of spectral nodes or g points of every band of a model, in the camera's order."""
    solar = [node.band for node in model.nodes]
    thermal = {band.name: band.count for band in model.thermal}
    return {band: thermal[band] if band in thermal else solar.count(band) for band in model.bands}


def optical_model(
    scene: SceneSpec,
    camera: CameraSpec,
    sun_distance_au: float = 1.0,
    *,
    base_dir: Path | None = None,
    change: AirChange = AS_IT_IS,
) -> OpticalModel:
    """Return the optical properties of a scene for every band of a camera.

    The grid has 100 m steps from 0 to 100 km. Densities fall exponentially between levels; linear interpolation over
    100 m makes them at most 3e-5 too high for a scale height of 7 km. An atmosphere file keeps its own nodes.

    Where the air varies over the globe, solar nodes have the column below the satellite and the differences from it of
    the columns in sight (:mod:`horizonval.earth.atmosphere.sunlit_gases`).

    ``base_dir``: folder of ``atmosphere.file`` and ``profile_file``, default the current one; ``change``: how the air
    differs from the scene's, with the scene's spectral nodes and ground. Raises ``UserError``: camera without bands;
    unknown profile; band outside the tables; an invalid file; an atmosphere file without a band of the camera's name;
    ``render.band_error`` out of reach.
    """
    if not camera.band:
        raise UserError(
            "the camera has no bands",
            where=f"{scene.camera.file}: band",
            expected="at least one [[band]] to render",
        )
    if scene.atmosphere.file is not None:
        return _from_file(scene, camera, sun_distance_au, base_dir, change)
    if scene.atmosphere.profile_file is None and scene.atmosphere.profile == NO_ATMOSPHERE:
        return _bare(scene, camera, sun_distance_au)
    air = air_of(scene, base_dir)
    changed = air_of(scene, base_dir, change)
    emitting = emitting_air(air, scene, change, air_begins_m if scene.surface.kind == "earth" else None)
    ground_k: float | FloatArray = float(emitting.state.temperature_k[0, 0])
    if air.columns is not None and scene.atmosphere.profile_file is not None:
        ground_k = lowest_air_k(air.columns)
    sight = gases_in_sight(air, scene, change) if any(band.kind == "solar" for band in camera.band) else None
    nodes: list[SpectralNode] = []
    thermal: list[EmittingBand] = []
    for i, band in enumerate(camera.band):
        where = f"{scene.camera.file}: band[{i}]"
        if band.kind == "solar":
            nodes += _solar_nodes(band, air, changed, sight, scene, sun_distance_au, where, change)
        else:
            thermal.append(emitting.band(band, where))
    refractivity = air_refractivity(scene, change.state(air.state).number_density_air, camera.band)
    model = _model(scene, camera, air.altitude_m, nodes, thermal, ground_k, refractivity)
    raised = change.raised_m
    layers = tuple((v.base_m + raised, v.top_m + raised) for v in air.layers)
    gaps = tuple(v.gaps for v in air.layers)
    return replace(model, layers=layers, gaps=gaps, columns=None if sight is None else sight.places)


def _model(
    scene: SceneSpec,
    camera: CameraSpec,
    altitude_m: FloatArray,
    nodes: list[SpectralNode],
    thermal: list[EmittingBand],
    lowest_air_k: float | FloatArray,
    refractivity: FloatArray | None = None,
) -> OpticalModel:
    return OpticalModel(
        altitude_m=altitude_m,
        top_m=float(altitude_m[-1]),
        nodes=tuple(nodes),
        albedo=scene.surface.albedo,
        refractivity=refractivity,
        thermal=tuple(thermal),
        emission=emitting_ground(scene, lowest_air_k) if thermal else None,
        band_order=tuple(band.name for band in camera.band),
    )


def _solar_node(
    band: Band,
    index: int,
    rule: SolarRule,
    sun_distance_au: float,
    extinction: FloatArray,
    scattering: FloatArray,
) -> SpectralNode:
    """Return a node of a rule with plain Rayleigh scattering and no particles."""
    irradiance = rule.mean_irradiance / sun_distance_au**2
    return SpectralNode(
        name=f"{band.name}:{index}",
        band=band.name,
        weight=float(rule.weight_um[index]),
        wavelength_um=float(rule.wavelength_um[index]),
        extinction_per_m=extinction,
        molecular_per_m=scattering,
        molecular_cos2=rayleigh.COS2,
        particle_per_m=np.zeros_like(extinction),
        asymmetry=np.zeros_like(extinction),
        solar_irradiance=irradiance,
        sun_radiance=irradiance / sunlight.disc_projected_solid_angle(sun_distance_au),
        energy_ratio=float(rule.energy_ratio[index]),
    )


def _solar_nodes(
    band: Band,
    air: Air,
    changed: Air,
    sight: GasesInSight | None,
    scene: SceneSpec,
    sun_distance_au: float,
    where: str,
    change: AirChange,
) -> list[SpectralNode]:
    """Return the nodes that the scene's air needs, with the properties of ``changed`` air."""
    lo, hi = bands.limits_um(band)
    if air.with_ozone and lo < ozone.MIN_UM:
        raise UserError(
            f"band {band.name!r} starts at {lo:g} um",
            where=where,
            expected=f"{ozone.MIN_UM:g} um or more, where ozone absorption is known",
            fix="or set atmosphere.ozone = false",
        )
    if air.aerosol.kinds and (lo < aerosol.MIN_UM or hi > aerosol.MAX_UM):
        raise UserError(
            f"band {band.name!r} spans {lo:g} to {hi:g} um",
            where=where,
            expected=f"a response within {aerosol.MIN_UM:g} to {aerosol.MAX_UM:g} um, where aerosol is known",
            fix='or set atmosphere.aerosol = "none"',
        )
    measure = solar_measure(band, where)

    def clear_rule(of: Measure) -> SolarRule:
        if band.nodes is None:
            return choose_rule(of, air, scene.surface.albedo, scene.render.band_error, where)
        return gauss(of, band.nodes, with_ozone=air.with_ozone)

    with_gases = scene.atmosphere.gases_in_sunlight
    rule = rule_with_gases(measure, clear_rule, with_ozone=air.with_ozone) if with_gases else clear_rule(measure)
    gases = SunlitGases.of(changed.state, change.raised_m, with_gases=with_gases)
    nodes = []
    for i, wavelength in enumerate(rule.wavelength_um):
        molecular, absorption = gases.molecular_per_m(wavelength), gases.absorption_per_m(rule, i)
        particles, scattered, asymmetry = changed.aerosol.at(float(wavelength))
        node = _solar_node(band, i, rule, sun_distance_au, molecular + absorption + particles, molecular)
        nodes.append(
            replace(
                node,
                molecular_cos2=float(rayleigh.cos2(wavelength)),
                particle_per_m=scattered,
                asymmetry=asymmetry,
                **_around(sight, rule, i),
                **_layers(changed, float(wavelength), change.raised_m),
            )
        )
    return nodes


def _around(sight: GasesInSight | None, rule: SolarRule, index: int) -> dict[str, Any]:
    """Return the fields of a node about the columns around its own."""
    if sight is None:
        return {}
    extinction, molecular = sight.more_per_m(rule, index)
    return {"more_extinction_per_m": extinction, "more_molecular_per_m": molecular}


def _layers(air: Air, wavelength_um: float, raised_m: float) -> dict[str, Any]:
    """Return the fields of a node about layers of thin cloud."""
    if not air.layers:
        return {}
    optics = [aerosol.optics(layer.particle, wavelength_um) for layer in air.layers]
    columns = [
        float(v.extinction) * layer.column(air.altitude_m, raised_m)
        for v, layer in zip(optics, air.layers, strict=True)
    ]
    return {
        "layer_per_m": np.array(columns),
        "layer_albedo": tuple(float(v.scattering / v.extinction) for v in optics),
        "layer_asymmetry": tuple(float(v.asymmetry) for v in optics),
    }


def _bare(scene: SceneSpec, camera: CameraSpec, sun_distance_au: float) -> OpticalModel:
    """Return the ground alone: one node per band is exact unless the ground has a spectrum."""
    z = np.array([0.0, TOP_M])
    zero = np.zeros_like(z)
    ground_k = scene.surface.temperature_k or BARE_GROUND_K
    nodes: list[SpectralNode] = []
    thermal: list[EmittingBand] = []
    for i, band in enumerate(camera.band):
        where = f"{scene.camera.file}: band[{i}]"
        if band.kind == "solar":
            count = 1 if scene.surface.kind != "earth" else band.nodes or BARE_EARTH_NODES
            rule = gauss(solar_measure(band, where), count)
            nodes += [_solar_node(band, k, rule, sun_distance_au, zero, zero) for k in range(count)]
        else:
            pieces = 1 if scene.surface.kind != "earth" else BARE_EARTH_NODES
            thermal.append(no_air_band(band, ground_k, where, pieces))
    return _model(scene, camera, z, nodes, thermal, ground_k)


def _from_file(
    scene: SceneSpec, camera: CameraSpec, sun_distance_au: float, base_dir: Path | None, change: AirChange
) -> OpticalModel:
    """Return a scene whose atmosphere comes from a file: one node per camera band, grey inside the band.

    Coefficients, temperatures and phase function come from the file; albedo, emissivity and (where given) the ground's
    temperature from the scene; response and solar spectrum from the camera band. The file's radius does not change the
    scene's Earth.
    """
    assert scene.atmosphere.file is not None
    path = (base_dir or Path()) / scene.atmosphere.file
    file = atmosphere_file.read_atmosphere(path)
    known = {band.name: band for band in file.bands}
    z = atmosphere_file.altitudes_m(file, thermal=any(band.kind == "thermal" for band in camera.band))
    lower = np.maximum(z - change.raised_m, 0.0)
    temperature = atmosphere_file.column(file, file.temperature_K, lower)
    denser = np.exp(change.ln_density(z, temperature))
    ground_k = file.surface.temperature_K
    nodes: list[SpectralNode] = []
    thermal: list[EmittingBand] = []
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
        absorption = denser * atmosphere_file.column(file, entry.absorption_per_m, lower)
        if band.kind == "thermal":
            thermal.append(grey_band(band, z, temperature + change.warmer_k, absorption, where))
            continue
        scatterers = atmosphere_file.scatterers(file, entry, lower)
        scatterers["molecular_per_m"] = denser * scatterers["molecular_per_m"]
        scatterers["particle_per_m"] = (1.0 + change.dustier) * scatterers["particle_per_m"]
        scattering = scatterers["molecular_per_m"] + scatterers["particle_per_m"]
        rule = gauss(solar_measure(band, where), 1)
        node = _solar_node(band, 0, rule, sun_distance_au, scattering + absorption, scattering)
        node = replace(node, wavelength_um=entry.wavelength_nm * 1e-3)
        nodes.append(replace(node, **scatterers))
    refractivity = file_refractivity(scene, file, z, str(path))
    if refractivity is not None:
        refractivity = denser * refractivity
    return _model(scene, camera, z, nodes, thermal, ground_k, refractivity)
