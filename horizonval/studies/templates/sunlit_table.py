"""The tables of sunlit bands: all states, four wavelengths, and what they come to."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress
from horizonval.earth.limb_relief import CLOUD_RELIEF_SOLAR
from horizonval.earth.spectral import bands
from horizonval.estimation.likelihood.height.alike import everywhere
from horizonval.estimation.likelihood.templates import LimbTemplates
from horizonval.spec.camera import Band
from horizonval.studies.templates import sunlit_states as states
from horizonval.studies.templates.kept import kept_arrays
from horizonval.studies.templates.modes import empirical_modes, scene_mode
from horizonval.studies.templates.rays import HEIGHT_M, SUN_AZIMUTH_DEG, SUN_ZENITH_DEG, edge_weights

PROFILES = "profiles"
VERSION = 1
FAINT = 1e-5
"""Share of a profile's largest value below which its own spectrum is of no account."""


@dataclass(frozen=True)
class SunlitKind:
    """A kind of states: how many modes it has, and how far along the limb they stay alike [rad]."""

    name: str
    states: tuple[states.SunlitState, ...]
    modes: int
    correlation_rad: float


def sunlit_kinds() -> tuple[SunlitKind, ...]:
    """Return the kinds of states.

    One haze serves a scene; air stays alike over 0.25 rad, as that of thermal bands; the ground over seas and
    continents.
    """
    return (
        SunlitKind("haze", states.haze_states(), 2, np.pi),
        SunlitKind("air", states.air_states(), 2, 0.25),
        SunlitKind("ground", states.ground_states(), 1, 0.5),
        SunlitKind("below", states.cloud_states(), 2, CLOUD_RELIEF_SOLAR.correlation_rad),
    )


def sunlit_table(some_bands: list[Band], work: Path, progress: Progress) -> list[LimbTemplates]:
    """Return the tables of sunlit bands; states that lie in the folder ``work`` already are read from there."""
    kinds = sunlit_kinds()
    base = _kept(states.BASE, work, progress)
    made = {kind.name: np.array([_kept(s, work, progress) for s in kind.states]) for kind in kinds}
    tables = []
    for band in some_bands:
        shares = states.band_shares(band)
        quick = np.tensordot(shares, base, axes=(0, 0))
        right = _kept(states.BASE, work, progress, band)
        known = quick > FAINT * quick.max(axis=-1, keepdims=True)
        factor = np.where(known, right / np.where(known, quick, 1.0), 1.0)
        of_kinds = {name: factor * np.tensordot(shares, v, axes=(0, 1)) for name, v in made.items()}
        tables.append(_assembled(band, factor * quick, kinds, of_kinds))
    return tables


def _kept(state: states.SunlitState, work: Path, progress: Progress, band: Band | None = None) -> FloatArray:
    """Return T at the four wavelengths, or the profiles of a band, from the folder or made now."""
    what = repr(state).partition(", share")[0] + ("" if band is None else band.model_dump_json())
    path = work / f"sunlit-{hashlib.sha256(what.encode()).hexdigest()[:16]}-v{VERSION}.npz"

    def make() -> dict[str, FloatArray]:
        progress.step("sunlit profiles", what)
        if band is None:
            return {PROFILES: states.sunlit_profiles(state, progress=progress)}
        return {PROFILES: states.band_profiles(state, band, progress)}

    return kept_arrays(path, make)[PROFILES]


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
            whole = scene_mode(departures, has, states.CLOUDS, around=False, shares=share, beside=0.0)
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
