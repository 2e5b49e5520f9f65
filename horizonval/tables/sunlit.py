"""Tables of sunlit bands: states of air, haze, cloud and ground, and their profiles by the Sun's angles.

On a sphere of the Earth's mean radius, lines of sight along x are lowest above the pole z; with the Sun's zenith angle
Z and its azimuth A from the line of sight there, both at the lowest point of every line, it stands in the direction ::

    cos Z z + sin Z (cos A x + sin A y)

The base is US standard air with the mean haze over a ground of albedo 0.3. Beside it stand

- *air*: the six AFGL climates and every 24th of the real states: ozone, and the density by height;
- *haze*: optical depths below 10 km of a quarter of the mean to four times it, a stratosphere one to two years after an
  eruption and one right after it;
- *ground*: sea, land, desert and ice;
- *below*: none, opaque cloud of four heights and two brightnesses, which the line meets and which lies all around, or
  cirrus.

Shares are in the tables below; they were chosen. An opaque cloud is a ground that is raised, with all its
surroundings. All orders of scattering, with the moments that serve haze: of thin cloud to a few per cent.

Four wavelengths are marched, the nodes of Gauss's rule for the sunlight in :data:`WHOLE`; what the air and ground make
of sunlight, ``T = L / E_sun``, is smooth between them, and a band is ::

    L_band = integral of R lambda E_sun T / integral of R lambda,    T(lambda) = sum_i T_i l_i(1 / lambda)

with Lagrange's polynomials ``l_i`` (:func:`band_shares`). Ozone's bands make that 1 to 5 % wrong at 10 to 30 km. So
the base is marched in the band's own nodes too, and every state takes the ratio of the two
(:func:`band_profiles`): the base is then right, and another state's departure from it to the same 1 to 5 % of itself.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress
from horizonval.earth.atmosphere.aerosol import MEAN_DEPTH_BELOW_10_KM
from horizonval.earth.column import OpticalModel
from horizonval.earth.limb_heights import CLOUD_RELIEF_SOLAR
from horizonval.earth.optical import optical_model
from horizonval.earth.spectral import bands, sunlight
from horizonval.earth.weather import real_states
from horizonval.estimation.fit.heights import everywhere
from horizonval.estimation.fit.templates import LimbTemplates
from horizonval.spec.camera import Band, CameraGeometry, CameraSpec
from horizonval.spec.earth import Atmosphere, CloudLayer, Surface
from horizonval.spec.pose import CameraUse, Platform
from horizonval.spec.scene import SceneName, SceneSpec
from horizonval.tables.modes import (
    HEIGHT_M,
    SUN_AZIMUTH_DEG,
    SUN_ZENITH_DEG,
    edge_weights,
    empirical_modes,
    kept_arrays,
    scene_mode,
)

RADIUS_M = 6371008.8
FROM_M = 3e6
"""How far before their lowest points lines begin: above all air for each that matters."""
NODES = 192
WHOLE = Band(
    name="whole", kind="solar", wavelength_um=[0.405, 0.415, 0.745, 0.755], response=[0.0, 1.0, 1.0, 0.0], nodes=4
)
CLIMATES = (
    *("tropical", "midlatitude_summer", "midlatitude_winter"),
    *("subarctic_summer", "subarctic_winter", "us_standard"),
)
CLOUDS = 0.75
"""Share of scenes that have clouds; in them every limb has one of those of :func:`cloud_states`."""
EVERY = 24
"""Of the real states; the others are left for tests."""


@dataclass(frozen=True)
class SunlitState:
    """One state; ``share``: its probability among those of its kind.

    ``top_m``: height of the opaque ground, that of clouds if it is above 0; ``albedo``: the ground's. ``cirrus``:
    optical depth and top [km].
    """

    profile: str = "us_standard"
    aerosol: Literal["background", "volcanic_moderate", "volcanic_high"] = "background"
    depth: float = MEAN_DEPTH_BELOW_10_KM
    albedo: float = 0.3
    top_m: float = 0.0
    cirrus: tuple[float, float] | None = None
    share: float = 1.0


BASE = SunlitState()


def air_states() -> tuple[SunlitState, ...]:
    """Return the states of air."""
    real = [f"{real_states.PREFIX}{name}" for name in real_states.names()[::EVERY]]
    return tuple(SunlitState(profile=name) for name in (*CLIMATES, *real))


def haze_states() -> tuple[SunlitState, ...]:
    """Return the states of haze."""
    mean = MEAN_DEPTH_BELOW_10_KM
    amounts = ((0.25, 0.05), (0.5, 0.2), (1.0, 0.32), (2.0, 0.2), (4.0, 0.05))
    usual = [SunlitState(depth=mean * times, share=share) for times, share in amounts]
    moderate = SunlitState(aerosol="volcanic_moderate", share=0.12)
    return (*usual, moderate, SunlitState(aerosol="volcanic_high", share=0.06))


def ground_states() -> tuple[SunlitState, ...]:
    """Return the states of the ground, without clouds."""
    return (
        SunlitState(albedo=0.07, share=0.14),
        SunlitState(albedo=0.2, share=0.12),
        SunlitState(albedo=0.35, share=0.12),
        SunlitState(albedo=0.6, share=0.06),
    )


def cloud_states() -> tuple[SunlitState, ...]:
    """Return the states of clouds; the first has none."""
    tops = ((2e3, 0.14), (5e3, 0.17), (8e3, 0.18), (12e3, 0.14))
    clouds = [SunlitState(top_m=top, albedo=a, share=0.5 * share) for top, share in tops for a in (0.4, 0.7)]
    thin = ((0.2, 10.0, 0.04), (0.2, 14.0, 0.05), (0.02, 16.5, 0.03))
    none = replace(BASE, share=1.0 - CLOUDS)
    return (none, *clouds, *(SunlitState(cirrus=(tau, top), share=share) for tau, top, share in thin))


def sunlit_model(state: SunlitState, band: Band = WHOLE, air: Mapping[str, Any] | None = None) -> OpticalModel:
    """Return the optical properties of a state in a band; ``air``: keys of an atmosphere in place of its profile."""
    layers: tuple[CloudLayer, ...] = ()
    if state.cirrus is not None:
        depth, top_km = state.cirrus
        kind: Literal["cirrus", "subvisible_cirrus"] = "cirrus" if depth > 0.05 else "subvisible_cirrus"
        layers = (CloudLayer(kind=kind, optical_depth=depth, top_km=top_km, base_km=top_km - 2.0),)
    scene = SceneSpec(
        scene=SceneName(name="limb-templates"),
        camera=CameraUse(file="limb-templates"),
        platform=Platform(epoch_utc=datetime(2026, 3, 20, tzinfo=UTC), altitude_km=500.0),
        atmosphere=Atmosphere(
            **({"profile": state.profile} if air is None else air),
            aerosol=state.aerosol,
            aerosol_optical_depth_550nm=state.depth,
        ),
        surface=Surface(albedo=state.albedo),
        layer=layers,
    )
    camera = CameraSpec(camera=CameraGeometry(width=1, height=1, fov_deg=1.0), band=[band])
    return raised(optical_model(scene, camera), state.top_m)


def raised(model: OpticalModel, top_m: float) -> OpticalModel:
    """Return what is above a height, over a ground there."""
    if top_m <= 0.0:
        return model
    z = model.altitude_m
    # on the same number of even steps, that all models share the kernels of one grid
    new = np.linspace(0.0, float(z[-1]) - top_m, len(z))

    def column(values: FloatArray) -> FloatArray:
        return np.interp(new + top_m, z, values)

    nodes = tuple(
        replace(
            node,
            extinction_per_m=column(node.extinction_per_m),
            molecular_per_m=column(node.molecular_per_m),
            particle_per_m=column(node.particle_per_m),
            asymmetry=column(node.asymmetry),
        )
        for node in model.nodes
    )
    index = None if model.refractivity is None else column(model.refractivity)
    return replace(model, altitude_m=new, top_m=float(new[-1]), nodes=nodes, refractivity=index)


def sunlit_profiles(
    state: SunlitState,
    band: Band = WHOLE,
    progress: Progress | None = None,
    air: Mapping[str, Any] | None = None,
    sun_deg: tuple[FloatArray, FloatArray] = (SUN_ZENITH_DEG, SUN_AZIMUTH_DEG),
) -> FloatArray:
    """Return T at the nodes of a band over the Sun's zenith angles and azimuths [1/sr], shape (nodes, A, B, H)."""
    from horizonval.renderer.backend import activate
    from horizonval.renderer.kernel.batching import IMAGE_TABLE
    from horizonval.renderer.rays import radiance_along_rays
    from horizonval.renderer.scattering.shells import STANDARD

    activate()
    model = sunlit_model(state, band, air)
    zenith, azimuth = np.meshgrid(*map(np.radians, sun_deg), indexing="ij")
    sun = np.stack(
        [np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)], axis=-1
    ).reshape(-1, 3)
    lowest = np.stack([np.full_like(HEIGHT_M, -FROM_M), 0.0 * HEIGHT_M, RADIUS_M + HEIGHT_M], axis=-1)
    shape = (*zenith.shape, len(HEIGHT_M))
    count = math.prod(shape)
    found = radiance_along_rays(
        model,
        RADIUS_M + state.top_m,
        np.tile(lowest, (len(sun), 1)),
        np.tile([1.0, 0.0, 0.0], (count, 1)),
        np.repeat(sun, len(HEIGHT_M), axis=0),
        nodes=NODES,
        scattering=STANDARD,
        progress=progress,
        table=IMAGE_TABLE,
    )
    return np.array([(found[node.name] / node.solar_irradiance).reshape(shape) for node in model.nodes])


def band_shares(band: Band) -> FloatArray:
    """Return what T at each of the nodes counts for in the mean radiance of a band [W m-2 um-1], shape (nodes,)."""
    nodes = np.array([node.wavelength_um for node in sunlit_model(BASE).nodes])
    wavelength, weight = bands.sampled(band)
    photons = weight * wavelength
    basis = np.array(
        [np.prod([(1.0 / wavelength - 1.0 / o) / (1.0 / n - 1.0 / o) for o in nodes if o != n], axis=0) for n in nodes]
    )
    return np.asarray(basis @ (photons * sunlight.irradiance(wavelength)) / photons.sum())


def band_profiles(
    state: SunlitState,
    band: Band,
    progress: Progress | None = None,
    air: Mapping[str, Any] | None = None,
    sun_deg: tuple[FloatArray, FloatArray] = (SUN_ZENITH_DEG, SUN_AZIMUTH_DEG),
) -> FloatArray:
    """Return a band's profiles in its own nodes [W m-2 sr-1 um-1], shape (A, B, H)."""
    model = sunlit_model(state, band, air)
    weight = np.array([node.weight * node.solar_irradiance for node in model.nodes])
    total = np.tensordot(weight, sunlit_profiles(state, band, progress, air, sun_deg), axes=(0, 0))
    return np.asarray(total / sum(node.weight for node in model.nodes))


PROFILES = "profiles"
VERSION = 1
FAINT = 1e-5
"""Share of a profile's largest value below which the spectrum of the base is not corrected."""


@dataclass(frozen=True)
class SunlitKind:
    """A kind of states: its number of modes, and its correlation length along the limb [rad]."""

    name: str
    states: tuple[SunlitState, ...]
    modes: int
    correlation_rad: float


def sunlit_kinds() -> tuple[SunlitKind, ...]:
    """Return the kinds of states: one haze per scene, air correlated over 0.25 rad, ground over seas and continents."""
    return (
        SunlitKind("haze", haze_states(), 2, np.pi),
        SunlitKind("air", air_states(), 2, 0.25),
        SunlitKind("ground", ground_states(), 1, 0.5),
        SunlitKind("below", cloud_states(), 2, CLOUD_RELIEF_SOLAR.correlation_rad),
    )


def sunlit_table(some_bands: list[Band], work: Path, progress: Progress) -> list[LimbTemplates]:
    """Return the tables of sunlit bands; states that lie in the folder ``work`` already are read from there."""
    kinds = sunlit_kinds()
    base = _kept(BASE, work, progress)
    made = {kind.name: np.array([_kept(s, work, progress) for s in kind.states]) for kind in kinds}
    tables = []
    for band in some_bands:
        shares = band_shares(band)
        quick = np.tensordot(shares, base, axes=(0, 0))
        right = _kept(BASE, work, progress, band)
        known = quick > FAINT * quick.max(axis=-1, keepdims=True)
        factor = np.where(known, right / np.where(known, quick, 1.0), 1.0)
        of_kinds = {name: factor * np.tensordot(shares, v, axes=(0, 1)) for name, v in made.items()}
        tables.append(_assembled(band, factor * quick, kinds, of_kinds))
    return tables


def _kept(state: SunlitState, work: Path, progress: Progress, band: Band | None = None) -> FloatArray:
    """Return T at the four wavelengths, or the profiles of a band, from the folder or made now."""
    what = repr(state).partition(", share")[0] + ("" if band is None else band.model_dump_json())
    path = work / f"sunlit-{hashlib.sha256(what.encode()).hexdigest()[:16]}-v{VERSION}.npz"

    def make() -> dict[str, FloatArray]:
        progress.step("sunlit profiles", what)
        if band is None:
            return {PROFILES: sunlit_profiles(state, progress=progress)}
        return {PROFILES: band_profiles(state, band, progress)}

    return kept_arrays(path, [PROFILES], make)[PROFILES]


def _assembled(
    band: Band, base: FloatArray, kinds: tuple[SunlitKind, ...], made: dict[str, FloatArray]
) -> LimbTemplates:
    weights = edge_weights(HEIGHT_M)
    mean, left = base.copy(), np.zeros_like(base)
    modes: list[FloatArray] = []
    names: list[str] = []
    alike: list[float] = []
    for kind in kinds:
        share = np.array([state.share for state in kind.states])
        departures = np.moveaxis(made[kind.name] - base, 0, 2)
        share = share / share.sum()
        if kind.name == "below":
            has = np.array([[[state != kind.states[0] for state in kind.states]]], dtype=float)
            whole = scene_mode(departures, has, CLOUDS, around=False, shares=share, beside=0.0)
            mean, departures = mean + whole.mean, departures - whole.of_state
            modes.append(whole.mode[:, :, None])
            names.append("scene")
            alike.append(np.pi)
        found = empirical_modes(departures, weights, kind.modes, around=False, shares=share, beside=0.0)
        mean += found.mean
        left += found.left_variance
        modes.append(found.modes)
        names += [kind.name] * kind.modes
        alike += [kind.correlation_rad] * kind.modes
    return LimbTemplates(
        band_kind="solar",
        band_um=bands.limits_um(band),
        height_m=HEIGHT_M,
        axes=(np.radians(SUN_ZENITH_DEG), np.radians(SUN_AZIMUTH_DEG)),
        mean=mean,
        modes=np.concatenate(modes, axis=2),
        mode_kinds=tuple(names),
        correlation_rad=everywhere(alike, len(SUN_ZENITH_DEG)),
        left_sigma=np.sqrt(left),
        made_by=f"tests/data/make_limb_templates.py, states {VERSION}: "
        + ", ".join(f"{len(kind.states)} of {kind.name}" for kind in kinds),
    )
