"""Tables of the limb in one known air, the same everywhere, instead of a climate's ensemble.

Thermal: that column is marched at every latitude of the table, over the ground of the place and month, with the
same states of cloud, haze and ground as in the shipped tables, so that only their modes remain.

Sunlit: profiles of the air ``P`` and of the shipped tables' base ``P_0``, clear, are marched in the band's nodes,
under more Suns than the shipped tables have, and the whole shipped table is multiplied with ``P / P_0``, without its
modes of air: this assumes that haze, ground and cloud change radiance by the same ratio in any air.

``clear``: the mean is that of the air with the mean haze; the remaining modes are haze and ground in sunlight, and in
thermal bands a ground at the climate's mean along the circle of latitude, with the standard deviation over places and
hours of that circle, and 5 K (rms) from day to day as in the shipped ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress
from horizonval.earth.atmosphere import climate
from horizonval.earth.atmosphere.air import air_of
from horizonval.earth.atmosphere.emission import emitting_air
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.spectral import bands
from horizonval.earth.surface.ground_emission import climate_ground, emitting_places, ground_k
from horizonval.estimation.fit.heights import everywhere
from horizonval.estimation.fit.templates import LimbTemplates
from horizonval.spec.camera import Band
from horizonval.spec.earth import Atmosphere
from horizonval.spec.pose import CameraUse, Platform
from horizonval.spec.prior import is_climate_file
from horizonval.spec.scene import SceneName, SceneSpec
from horizonval.tables import sunlit, thermal
from horizonval.tables.modes import HEIGHT_M, KNOWN_AZIMUTH_DEG, KNOWN_ZENITH_DEG, LATITUDE_DEG
from horizonval.tables.sunlit import FAINT
from horizonval.tables.thermal import COVER_KINDS, cover_modes

LONGITUDES = 360
"""Of the places round a circle of latitude, at every hour that the Sun makes there."""
GROUND_CORRELATION_RAD = 0.5
"""Seas and continents, as in the sunlit tables."""
CLOUDY_KINDS = ("air", "scene", "below")
"""Modes of sunlit tables that known air without clouds has not."""


@dataclass(frozen=True)
class UniformAir:
    """An air: keys of a scene's table ``[atmosphere]``, and whether there are no clouds."""

    keys: Mapping[str, Any]
    clear: bool = False

    @classmethod
    def named(cls, name: str, clear: bool = False) -> UniformAir:
        """Return the air of a name (`horizonval list atmospheres`) or of a profile file.

        ``UserError``: no such air, an invalid file, or an air that varies over the Earth.
        """
        asked = cls({"profile_file" if is_climate_file(name) else "profile": name}, clear)
        scene = asked._scene()
        try:
            varies = air_of(scene).columns is not None or climate.varies(scene)
        except UserError as e:
            raise e.inside("--air") from None
        if varies:
            raise UserError(f"{name!r} varies over the Earth", where="--air", expected="one column of air")
        return asked

    def gases(self) -> GasState:
        """Return the column of gases, without halocarbons."""
        scene = self._scene()
        return emitting_air(air_of(scene), scene).state

    def _scene(self) -> SceneSpec:
        return SceneSpec(
            scene=SceneName(name="known-air"),
            camera=CameraUse(file="known-air"),
            platform=Platform(epoch_utc=datetime(2026, 3, 20, tzinfo=UTC), altitude_km=500.0),
            atmosphere=Atmosphere(**self.keys, halocarbons=False),
        )


def thermal_in(air: UniformAir, band: Band, months: FloatArray, progress: Progress) -> LimbTemplates:
    """Return the table of a thermal band; ``months`` (B,) of the ground, rising."""
    gases = air.gases()
    calm = np.zeros((len(LATITUDE_DEG), len(months), len(HEIGHT_M)))
    covered = np.zeros((*calm.shape[:2], 1 if air.clear else thermal.COVERS, len(HEIGHT_M)))
    for i, j in np.ndindex(*calm.shape[:2]):
        latitude, month = float(LATITUDE_DEG[i]), float(months[j])
        progress.step("known air", f"latitude {latitude:g}, month {month:g}")
        clear, warm = _clear_covers(latitude, month) if air.clear else (thermal.CLEAR, None)
        calm[i, j] = _profile(gases, band, latitude, month, clear)
        for k in range(covered.shape[2]):
            cover = thermal.cover_of(latitude, month, k) if warm is None else warm
            covered[i, j, k] = _profile(gases, band, latitude, month, cover)
    departures = covered - calm[:, :, None]
    table = LimbTemplates(
        band_kind="thermal",
        band_um=bands.limits_um(band),
        height_m=HEIGHT_M,
        axes=(np.radians(LATITUDE_DEG), months),
        mean=calm,
        modes=departures[:, :, :1],
        mode_kinds=("ground",),
        correlation_rad=everywhere([GROUND_CORRELATION_RAD], len(LATITUDE_DEG)),
        left_sigma=np.zeros_like(calm),
        made_by=f"horizonval templates --air, {dict(air.keys)}",
    )
    if air.clear:
        return table
    found = cover_modes(departures, months, around=False)
    return replace(
        table,
        mean=calm + found.mean,
        modes=found.modes,
        mode_kinds=COVER_KINDS,
        correlation_rad=everywhere(found.correlation_rad, len(LATITUDE_DEG)),
        left_sigma=np.sqrt(found.left_variance),
    )


def ground_around_k(latitude_deg: float, month: float) -> tuple[float, float]:
    """Return the mean temperature of a month's ground round a circle of latitude, and its standard deviation [K]."""
    ground = climate_ground(month)
    longitude = np.linspace(0.0, 2.0 * np.pi, LONGITUDES, endpoint=False)
    latitude = np.full(LONGITUDES, np.radians(latitude_deg))
    mean, square = 0.0, 0.0
    for noon in (0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi):
        at = emitting_places(ground, latitude, longitude, noon)
        for kind, share in at.shares.items():
            kelvin = ground_k(ground, kind, at)
            mean += 0.25 * float(np.mean(share * kelvin))
            square += 0.25 * float(np.mean(share * kelvin**2))
    return mean, float(np.sqrt(max(square - mean**2, 0.0)))


def _clear_covers(latitude_deg: float, month: float) -> tuple[thermal.Cover, thermal.Cover]:
    """Return a clear sky over the mean ground of a place, and over one that is warmer by a standard deviation."""
    mean_k, spread_k = ground_around_k(latitude_deg, month)
    mean = replace(
        thermal.CLEAR,
        ground_warmer_k=mean_k - thermal.ground_k(latitude_deg, month, thermal.CLEAR),
    )
    sigma_k = float(np.hypot(spread_k, thermal.GROUND_SIGMA_K))
    return mean, replace(mean, ground_warmer_k=mean.ground_warmer_k + sigma_k)


def _profile(gases: GasState, band: Band, latitude_deg: float, month: float, cover: thermal.Cover) -> FloatArray:
    model = thermal.thermal_model(gases, [band], latitude_deg, month, cover)
    return thermal.thermal_profiles(model, latitude_deg, [band])[0]


def sunlit_in(air: UniformAir, band: Band, whole: LimbTemplates, progress: Progress) -> LimbTemplates:
    """Return the table of a sunlit band, from the shipped one of the bands most like it."""
    sun_deg = (KNOWN_ZENITH_DEG, KNOWN_AZIMUTH_DEG)
    axes = (np.radians(sun_deg[0]), np.radians(sun_deg[1]))
    profile = sunlit.band_profiles(sunlit.BASE, band, progress, air.keys, sun_deg)
    base = sunlit.band_profiles(sunlit.BASE, band, progress, sun_deg=sun_deg)
    known = base > FAINT * base.max(axis=-1, keepdims=True)
    ratio = np.where(known, profile / np.where(known, base, 1.0), 1.0)
    left_out = CLOUDY_KINDS if air.clear else ("air",)
    kept = np.array([kind not in left_out for kind in whole.mode_kinds])
    zenith, azimuth = np.meshgrid(*axes, indexing="ij")
    mean, modes, left_sigma = (
        values.reshape(*zenith.shape, *values.shape[1:]) for values in whole.at(zenith.ravel(), azimuth.ravel())
    )
    return replace(
        whole,
        band_um=bands.limits_um(band),
        axes=axes,
        mean=profile if air.clear else mean * ratio,
        modes=modes[:, :, kept] * ratio[:, :, None],
        mode_kinds=tuple(kind for kind, stays in zip(whole.mode_kinds, kept, strict=True) if stays),
        correlation_rad=whole.lengths_at(axes[0])[:, kept],
        left_sigma=np.zeros_like(profile) if air.clear else left_sigma * ratio,
        made_by=f"horizonval templates --air, {dict(air.keys)}",
    )
