"""Atmosphere files: the planet of the ``radiance`` command as one JSON object, read strictly.

::

    {"note": "anything",                              optional
     "planet_radius_km": 6371.0, "top_km": 100.0,
     "altitude_km": [0.0, ...], "temperature_K": [...],
     "refractivity": [...],                            optional: n - 1, needed for refraction
     "bands": [{"name": "550nm", "wavelength_nm": 550.0, "scattering_per_m": [...], "absorption_per_m": [...],
                "phase": "rayleigh" | "isotropic" | {"henyey_greenstein": g},
                "particle_scattering_per_m": [...], "asymmetry": g}],                     both optional
     "surface": {"albedo": 0.3, "temperature_K": 288.15, "emissivity": 1.0}}

Coefficients and temperature are linear in altitude between nodes; the first node is the ground. There is vacuum above
``top_km``, and between the last node and ``top_km`` (a coefficient that is not zero at the last node ends there in a
step).

A band may hold particles in addition to molecules: ``particle_scattering_per_m`` scatters by the phase function of
Henyey and Greenstein with ``asymmetry``, while ``phase`` applies to ``scattering_per_m`` and is then "rayleigh" or
"isotropic". ``extinction = scattering + particle_scattering + absorption``.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import MOST_MISTAKES, UserError, excerpt, several
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.earth.gases import rayleigh
from horizonval.earth.surface.ground_emission import uniform_ground

_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Fraction = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]

MAX_FILE_BYTES = 16 * 1024 * 1024
"""Largest atmosphere file that is read."""

MAX_TEMPERATURE_STEP_K = 0.1
"""Largest change of temperature between nodes of a thermal column; leaves 5e-7 of radiance at 15 um, 1e-4 at 1 um."""
VACUUM_STEP_M = 0.01
"""Thickness of the layer in which refracted air of a thermal band ends."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class HenyeyGreenstein(_Strict):
    """Phase function by its asymmetry."""

    henyey_greenstein: Annotated[float, Field(gt=-1, lt=1, allow_inf_nan=False)]


class AtmosphereBand(_Strict):
    """Coefficients at one wavelength."""

    name: Annotated[str, Field(min_length=1)]
    wavelength_nm: _Positive
    scattering_per_m: list[_NonNegative]
    absorption_per_m: list[_NonNegative]
    phase: Literal["rayleigh", "isotropic"] | HenyeyGreenstein
    particle_scattering_per_m: list[_NonNegative] | None = None
    asymmetry: Annotated[float, Field(gt=-1, lt=1, allow_inf_nan=False)] | None = None


class AtmosphereSurface(_Strict):
    """Lambert ground."""

    albedo: _Fraction
    temperature_K: _Positive  # noqa: N815 - the file's key
    emissivity: _Fraction


class AtmosphereFile(_Strict):
    """One atmosphere file; see the module text."""

    note: str = ""
    planet_radius_km: _Positive
    top_km: _Positive
    altitude_km: Annotated[list[_NonNegative], Field(min_length=2)]
    temperature_K: list[_Positive]  # noqa: N815 - the file's key
    refractivity: list[_NonNegative] | None = None
    bands: Annotated[list[AtmosphereBand], Field(min_length=1)]
    surface: AtmosphereSurface

    @model_validator(mode="after")
    def _consistent(self) -> AtmosphereFile:
        z = self.altitude_km
        if z[0] != 0:
            raise ValueError(f"altitude_km[0]: is {z[0]:g}; expected 0, the ground")
        for i, (below, above) in enumerate(pairwise(z)):
            if above <= below:
                raise ValueError(f"altitude_km[{i + 1}]: {above:g} follows {below:g}; expected rising altitudes")
        if self.top_km < z[-1]:
            raise ValueError(f"top_km: {self.top_km:g} lies below the last altitude; expected {z[-1]:g} or more")
        if len(self.temperature_K) != len(z):
            raise ValueError(_length("temperature_K", len(self.temperature_K), len(z)))
        if self.refractivity is not None and len(self.refractivity) != len(z):
            raise ValueError(_length("refractivity", len(self.refractivity), len(z)))
        for i, band in enumerate(self.bands):
            for key in ("scattering_per_m", "absorption_per_m", "particle_scattering_per_m"):
                values = getattr(band, key)
                if values is not None and len(values) != len(z):
                    raise ValueError(_length(f"bands[{i}].{key}", len(values), len(z)))
            _check_particles(band, f"bands[{i}]")
        names = [band.name for band in self.bands]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"bands[{i}].name: {name!r} is used twice; expected a name of its own")
        return self

    @property
    def planet_radius_m(self) -> float:
        """Radius of the planet [m]."""
        return self.planet_radius_km * 1e3


def _check_particles(band: AtmosphereBand, where: str) -> None:
    """Refuse an incomplete description of particles, and two kinds of particles in one band."""
    if (band.particle_scattering_per_m is None) != (band.asymmetry is None):
        there, lacks = "particle_scattering_per_m", "asymmetry"
        if band.asymmetry is not None:
            there, lacks = lacks, there
        raise ValueError(f"{where}.{lacks}: missing; expected this key beside {there}")
    if band.particle_scattering_per_m is not None and isinstance(band.phase, HenyeyGreenstein):
        raise ValueError(
            f"{where}.phase: is Henyey-Greenstein's beside particles of their own; "
            'expected "rayleigh" or "isotropic" beside particle_scattering_per_m'
        )


def _length(key: str, found: int, expected: int) -> str:
    return f"{key}: has {found} values; expected {expected}, one per altitude_km"


def _path(loc: tuple[int | str, ...]) -> str:
    """Return a pydantic location as the user wrote it: ``bands[0].scattering_per_m[3]``."""
    text = ""
    for part in loc:
        if isinstance(part, int):
            text += f"[{part}]"
        elif part not in ("HenyeyGreenstein", "literal['rayleigh','isotropic']"):
            text += f".{excerpt(part)}" if text else excerpt(part)
    return text


def _user_error(error: ValidationError, file: str) -> UserError:
    problems = error.errors(include_url=False)
    mistakes: dict[str, UserError] = {}
    for problem in problems[:MOST_MISTAKES]:
        mistake = _mistake(problem, file)
        # pydantic reports a wrong phase function once per alternative.
        mistakes.setdefault(mistake.where, mistake)
    return several(list(mistakes.values()), max(0, len(problems) - MOST_MISTAKES))


def _mistake(problem: Any, file: str) -> UserError:
    if problem["type"] == "value_error":
        key, _, text = str(problem["ctx"]["error"]).partition(": ")
        what, _, expected = text.partition("; expected ")
        return UserError(what, where=f"{file}: {key}", expected=expected)
    key = _path(problem["loc"])
    if ".phase" in key:
        expected = '"rayleigh", "isotropic" or {"henyey_greenstein": g} with -1 < g < 1'
        return UserError(
            f"not a phase function: {json.dumps(problem['input'])}"[:120],
            where=f"{file}: {key.split('.phase')[0]}.phase",
            expected=expected,
        )
    kind = problem["type"]
    if kind == "missing":
        return UserError("missing", where=f"{file}: {key}", expected="this key")
    if kind == "extra_forbidden":
        return UserError("unknown key", where=f"{file}: {key}", expected="no other keys than the format's")
    found = json.dumps(problem["input"])
    found = found if len(found) <= 40 else found[:40] + "..."
    rule = problem["msg"].removeprefix("Input should be ").removeprefix("a valid ").removeprefix("List should have ")
    rule = rule.partition(" after validation")[0]
    return UserError(f"is {found}", where=f"{file}: {key}", expected=rule)


def parse_atmosphere(data: object, file: str) -> AtmosphereFile:
    """Return the checked content of an atmosphere file; raises ``UserError`` with the first wrong keys."""
    if not isinstance(data, dict) or not AtmosphereFile.model_fields.keys() & data:
        raise UserError("not an atmosphere file", where=file, expected="a JSON object of the format's keys")
    try:
        return AtmosphereFile.model_validate(data)
    except ValidationError as error:
        raise _user_error(error, file) from None


def read_atmosphere(path: Path | str) -> AtmosphereFile:
    """Read and check an atmosphere file; raises ``UserError`` if it is missing, not JSON, or invalid."""
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected="an atmosphere file (JSON)")
    return parse_atmosphere(files.parse_json(text, path), str(path))


def altitudes_m(file: AtmosphereFile, *, thermal: bool) -> FloatArray:
    """Return the grid on which the file's columns are exact: its nodes, for thermal columns with more between.

    Coefficients and temperature are linear between the file's nodes, but Planck's function of the temperature is not.
    Intervals are therefore divided evenly until the temperature changes by at most 0.1 K from node to node.
    """
    z = np.array(file.altitude_km) * 1e3
    if not thermal:
        return z
    steps = np.abs(np.diff(file.temperature_K)) / MAX_TEMPERATURE_STEP_K
    # Rounding: a step of 0.1 K plus one bit needs no second node.
    parts = np.maximum(1, np.ceil(steps - 1e-9)).astype(int)
    pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(z[:-1], z[1:], parts, strict=True)]
    return np.concatenate([*pieces, z[-1:]])


def column(file: AtmosphereFile, values: list[float], altitude_m: FloatArray) -> FloatArray:
    """Return one of the file's columns on other altitudes."""
    return np.interp(altitude_m, np.array(file.altitude_km) * 1e3, np.array(values, dtype=np.float64))


def scatterers(file: AtmosphereFile, band: AtmosphereBand, altitude_m: FloatArray) -> dict[str, Any]:
    """Return the fields of :class:`SpectralNode` about scattering for a band of the file, on other altitudes."""
    scattering = column(file, band.scattering_per_m, altitude_m)
    zero = np.zeros_like(scattering)
    if isinstance(band.phase, HenyeyGreenstein):
        return {
            "molecular_per_m": zero,
            "molecular_cos2": 0.0,
            "particle_per_m": scattering,
            "asymmetry": np.full_like(zero, band.phase.henyey_greenstein),
        }
    particles = band.particle_scattering_per_m
    return {
        "molecular_per_m": scattering,
        "molecular_cos2": rayleigh.COS2 if band.phase == "rayleigh" else 0.0,
        "particle_per_m": zero if particles is None else column(file, particles, altitude_m),
        "asymmetry": zero if band.asymmetry is None else np.full_like(zero, band.asymmetry),
    }


def refractivity(file: AtmosphereFile, altitude_m: FloatArray, where: str) -> FloatArray:
    """Return n - 1 on other altitudes; raises ``UserError`` if the file has no refractivity."""
    if file.refractivity is None:
        raise UserError(
            "missing", where=f"{where}: refractivity", expected="n - 1 at every altitude, to refract light with"
        )
    return column(file, file.refractivity, altitude_m)


def file_model(file: AtmosphereFile, *, thermal: bool, refracted: str = "") -> OpticalModel:
    """Return the optical properties of an atmosphere file.

    Parameters
    ----------
    thermal : bool
        False: scattered sunlight of irradiance 1, one node of weight 1 per band, radiances in 1/sr. The Sun is a point,
        so its disc has no radiance. True: emission at the band's wavelength, one emitting band of one g point per band,
        radiances in W m-2 sr-1 um-1. Extinction is then absorption alone: removing scattered light without its source
        would be the larger error.
    refracted : str
        Name of the file, for the error message. If given, light is refracted by the file's ``refractivity``.
    """
    z = altitudes_m(file, thermal=thermal)
    if thermal and refracted:
        # The air ends in a step. Refraction moves the height of the vacuum's first node together with that of the last.
        z = np.append(z, z[-1] + VACUUM_STEP_M)
    surface = file.surface
    return OpticalModel(
        altitude_m=z,
        top_m=float(z[-1]),
        nodes=() if thermal else tuple(_solar_node(file, band, z) for band in file.bands),
        albedo=surface.albedo,
        refractivity=refractivity(file, z, refracted) if refracted else None,
        thermal=tuple(_grey_band(file, band, z) for band in file.bands) if thermal else (),
        emission=uniform_ground(surface.temperature_K, surface.emissivity) if thermal else None,
    )


def _solar_node(file: AtmosphereFile, band: AtmosphereBand, altitude_m: FloatArray) -> SpectralNode:
    scattering = scatterers(file, band, altitude_m)
    absorption = column(file, band.absorption_per_m, altitude_m)
    return SpectralNode(
        name=band.name,
        band=band.name,
        weight=1.0,
        wavelength_um=band.wavelength_nm * 1e-3,
        extinction_per_m=absorption + scattering["molecular_per_m"] + scattering["particle_per_m"],
        **scattering,
        solar_irradiance=1.0,
        sun_radiance=0.0,
    )


def _grey_band(file: AtmosphereFile, band: AtmosphereBand, altitude_m: FloatArray) -> EmittingBand:
    """Return a band that emits at one wavelength, per micrometre; zero absorption becomes 1e-300 per metre."""
    inside = altitude_m <= file.altitude_km[-1] * 1e3
    absorption = np.where(inside, column(file, band.absorption_per_m, altitude_m), 0.0)
    wavelength_um = band.wavelength_nm * 1e-3
    return EmittingBand(
        name=band.name,
        wavelength_um=np.array([wavelength_um]),
        altitude_m=altitude_m,
        sin_latitude=np.zeros(1),
        level_m=altitude_m,
        ln_extinction=np.log(np.maximum(absorption, 1e-300))[None, None, :],
        temperature_k=column(file, file.temperature_K, altitude_m)[None, :],
        source_wavenumber_per_cm=np.array([1e4 / wavelength_um]),
        source_weight_per_cm=np.array([[1e4 / wavelength_um**2]]),
        sun_radiance=np.zeros(1),
    )
