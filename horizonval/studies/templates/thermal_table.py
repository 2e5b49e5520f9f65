"""The table of a thermal band: all states of all places, month by month, and what they come to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress
from horizonval.earth.gases import afgl
from horizonval.earth.limb_relief import CLOUD_RELIEF_THERMAL
from horizonval.earth.spectral import bands
from horizonval.estimation.likelihood.height.alike import everywhere
from horizonval.estimation.likelihood.templates import LimbTemplates
from horizonval.spec.camera import Band
from horizonval.studies.templates import thermal_states as states
from horizonval.studies.templates.kept import kept_arrays
from horizonval.studies.templates.modes import BESIDE, empirical_modes, scene_mode
from horizonval.studies.templates.rays import HEIGHT_M, LATITUDE_DEG, MONTHS, edge_weights

AIR_MODES, COVER_MODES = 5, 2
COVER_KINDS = ("scene", "veil") + ("below",) * COVER_MODES
LEAST_ALIKE, MOST_ALIKE = 0.05, 0.99
"""Correlations of places apart that some 70 states can tell from none, and from all."""
KEPT = ("calm", "air", "aside", "below")
VERSION = 3
"""Of the states: raised where they change, so that months made before are made again."""


def thermal_month(some_bands: list[Band], month: float, progress: Progress) -> dict[str, FloatArray]:
    """Return the profiles of every band in one month.

    ``calm`` (A, H) of the climate, ``air`` (A, N, H), ``aside`` (A, N - 1, H) and ``below`` (A, M, H) of the states, by
    band name and these.
    """
    levels = afgl.levels_m()
    found: dict[str, list[FloatArray]] = {f"{band.name} {what}": [] for band in some_bands for what in KEPT}

    def add(latitude: float, what: str, models: list[states.OpticalModel]) -> None:
        rows = [states.thermal_profiles(model, latitude, some_bands) for model in models]
        for band, profiles in zip(some_bands, zip(*rows, strict=True), strict=True):
            found[f"{band.name} {what}"].append(np.array(profiles))

    for latitude in map(float, LATITUDE_DEG):
        progress.step(f"month {month:g}", f"latitude {latitude:g}")
        calm = states.calm_air(latitude, month, levels)
        airs = [states.air_of_state(latitude, month, k, levels) for k in range(states.WEATHERS + 1)]
        asides = [states.air_of_state(latitude, month, k, levels, aside=True) for k in range(states.WEATHERS)]
        covers = [states.cover_of(latitude, month, k) for k in range(states.COVERS)]
        add(latitude, "calm", [states.thermal_model(calm, some_bands, latitude, month)])
        add(latitude, "air", [states.thermal_model(air, some_bands, latitude, month) for air in airs])
        add(latitude, "aside", [states.thermal_model(air, some_bands, latitude, month) for air in asides])
        add(latitude, "below", [states.thermal_model(calm, some_bands, latitude, month, cover) for cover in covers])
    return {key: np.array(values) for key, values in found.items()}


def thermal_table(
    some_bands: list[Band], work: Path, progress: Progress, months: FloatArray = MONTHS
) -> list[LimbTemplates]:
    """Return the tables of thermal bands; months that lie in the folder ``work`` already are read from there."""
    parts = []
    names = "-".join(band.name for band in some_bands)
    for month in months:
        path = work / f"thermal-{names}-{month:g}-v{VERSION}.npz"
        parts.append(kept_arrays(path, partial(thermal_month, some_bands, float(month), progress)))
    return [_assembled(band, parts, months) for band in some_bands]


@dataclass(frozen=True)
class CoverModes:
    """``mean`` and ``left_variance`` (A, B, H), ``modes`` (A, B, K, H) and ``correlation_rad`` (K,)."""

    mean: FloatArray
    modes: FloatArray
    left_variance: FloatArray
    correlation_rad: FloatArray


def cover_modes(departures: FloatArray, months: FloatArray, *, around: bool) -> CoverModes:
    """Return what the states of what lies below come to: modes of scenes with clouds, with thin ones, and the rest.

    Parameters
    ----------
    departures : ndarray, shape (A, B, COVERS, H)
        From the same air without clouds.
    months : ndarray, shape (B,)
    around : bool
        Whether they are the whole year.
    """
    cloudy = np.array([[states.is_cloudy(float(m), k) for k in range(states.COVERS)] for m in months], dtype=float)
    whole = scene_mode(departures, cloudy[None], states.CLOUDS, around=around)
    left = departures - whole.of_state
    thin = np.array(
        [[[states.has_cirrus(lat, float(m), k) for k in range(states.COVERS)] for m in months] for lat in LATITUDE_DEG],
        dtype=float,
    )
    often = np.array([[states.cirrus_chance(lat, float(m)) for m in months] for lat in LATITUDE_DEG])
    veil = scene_mode(left, thin, often[..., None], around=around)
    rest = empirical_modes(left - veil.of_state, edge_weights(HEIGHT_M), COVER_MODES, around=around)
    return CoverModes(
        rest.mean + whole.mean + veil.mean,
        np.concatenate([whole.mode[:, :, None], veil.mode[:, :, None], rest.modes], axis=2),
        rest.left_variance,
        np.array([np.pi, np.pi, *[CLOUD_RELIEF_THERMAL.correlation_rad] * COVER_MODES]),
    )


def _assembled(band: Band, parts: list[dict[str, FloatArray]], months: FloatArray) -> LimbTemplates:
    calm, air, aside, below = (np.stack([part[f"{band.name} {what}"] for part in parts], axis=1) for what in KEPT)
    # the climate of all states, the last of the air, counts once for each place of the parallel
    of_air = empirical_modes(
        np.concatenate([air, aside, air[:, :, -1:]], axis=2) - calm, edge_weights(HEIGHT_M), AIR_MODES, around=True
    )
    of_cover = cover_modes(below - calm, months, around=True)
    return LimbTemplates(
        band_kind="thermal",
        band_um=bands.limits_um(band),
        height_m=HEIGHT_M,
        axes=(np.radians(LATITUDE_DEG), months),
        mean=calm[:, :, 0] + of_air.mean + of_cover.mean,
        modes=np.concatenate([of_air.modes, of_cover.modes], axis=2),
        mode_kinds=("air",) * AIR_MODES + COVER_KINDS,
        correlation_rad=np.concatenate(
            [lengths_of_air(of_air.coefficients), everywhere(of_cover.correlation_rad, len(LATITUDE_DEG))], axis=1
        ),
        left_sigma=np.sqrt(of_air.left_variance + of_cover.left_variance),
        made_by=f"tests/data/make_limb_templates.py, states {VERSION}: {states.WEATHERS + 1} of air and "
        f"{states.COVERS} of what is below at every place",
    )


def lengths_of_air(coefficients: FloatArray) -> FloatArray:
    """Return the lengths [rad] of modes along the meridian and along the parallel, shape (A, K, 2).

    From the correlation r of places apart by the chord d, ``l = d / sqrt(2 ln 1/r)``, all months together: with the
    latitudes on both sides along the meridian, and as many along the parallel. At the poles, where there is no
    parallel, both are that of the meridian.

    Parameters
    ----------
    coefficients : ndarray, shape (A, B, 2 WEATHERS + 2, K)
        Of states at one longitude, the climate of all, the same states aside, the climate again.
    """
    at, aside = (coefficients[:, :, k : k + states.WEATHERS] for k in (0, states.WEATHERS + 1))
    latitude = np.radians(LATITUDE_DEG)
    steps = np.zeros((len(latitude), len(latitude) - 1))
    steps[1:] += np.eye(len(latitude) - 1)
    steps[:-1] += np.eye(len(latitude) - 1)
    apart = np.full(len(latitude) - 1, 2.0 * np.sin(0.5 * (latitude[1] - latitude[0])))
    meridian = _lengths(at[1:], at[:-1], steps, apart)
    beside = np.eye(len(latitude)) + BESIDE * (np.eye(len(latitude), k=1) + np.eye(len(latitude), k=-1))
    beside[:, [0, -1]] = 0.0
    turn = states.aside_rad(latitude)
    parallel = _lengths(at, aside, beside, 2.0 * np.cos(latitude) * np.sin(0.5 * turn))
    parallel[[0, -1]] = meridian[[0, -1]]
    return np.stack([meridian, parallel], axis=-1)


def _lengths(a: FloatArray, b: FloatArray, together: FloatArray, apart: FloatArray) -> FloatArray:
    """Return lengths (A, K) of coefficients (P, B, N, K) and those ``apart`` (P,); ``together`` (A, P) adds pairs."""
    both, one, other = (together @ np.sum(x * y, axis=(1, 2)) for x, y in ((a, b), (a, a), (b, b)))
    r = np.clip(both / np.sqrt(one * other), LEAST_ALIKE, MOST_ALIKE)
    square = (together @ apart**2) / np.maximum(together.sum(axis=1), 1e-300)
    return np.asarray(np.sqrt(square[:, None] / (-2.0 * np.log(r))))
