"""Profiles from a user's file, of one place or many: temperature, air and its gases over altitude, read strictly.

CSV with one line of column names, or a JSON object of lists with the same names; other columns are refused.

======================== ===========================================================================================
``altitude_km``          rising from 0 (the ground) to 60 or more; at least 10 levels, at most 10 km between two of them
``temperature_K``        100 to 400
``pressure_Pa``          or ``pressure_hPa``, or ``number_density_per_m3``: exactly one of them; above 0
``ozone_per_m3``         or ``ozone_ppmv`` (parts per million of the air's molecules): exactly one; 0 or more
``water_vapour_ppmv``    and ``carbon_dioxide_ppmv``, ``nitrous_oxide_ppmv``, ``methane_ppmv``: any of them or none; 0
                         or more, of the air's molecules
``latitude_deg``         -90 to 90, geodetic: place of the line, for profiles of many places
``longitude_deg``        -180 to 360, together with latitudes; without it a profile holds all around its latitude
======================== ===========================================================================================

Lines of equal latitude and longitude are one profile. Each has separate levels, and every rule applies to each.
:mod:`horizonval.earth.atmosphere.placed_profiles` interpolates between places.

Between levels temperature is linear, and so are the logarithms of pressure and of the mixing ratios (a mixing ratio
itself next to a zero). Above the last level temperature and mixing ratios stay constant, and the pressure falls as
between the last two levels. Pressure and density need not be hydrostatic.

Gases without a column, and nitric acid, come at equal pressure from the AFGL climate that is nearest in temperature
(:func:`horizonval.earth.gases.afgl.nearest_climate`); carbon dioxide is then the scene's. Missing water vapour costs
most: it dominates the lowest 10 km of the limb in the windows.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt, nearest
from horizonval.earth.atmosphere.profiles import AtmosphereProfile
from horizonval.earth.gases import afgl

MAX_FILE_BYTES = 16 * 1024 * 1024
MAX_PLACES = 1000
MIN_LEVELS = 10
MIN_TOP_KM = 60.0
MAX_STEP_KM = 10.0
TEMPERATURE_K = (100.0, 400.0)
GROUND_PRESSURE_PA = (30_000.0, 120_000.0)
"""Catches pressures in the wrong unit; every place on Earth lies well inside."""

_BOLTZMANN = 1.380649e-23
_AIR = ("pressure_Pa", "pressure_hPa", "number_density_per_m3")
_OZONE = ("ozone_per_m3", "ozone_ppmv")
_OTHER_GASES = {
    "water_vapour_ppmv": "h2o",
    "carbon_dioxide_ppmv": "co2",
    "nitrous_oxide_ppmv": "n2o",
    "methane_ppmv": "ch4",
}
_PLACE = {"latitude_deg": (-90.0, 90.0), "longitude_deg": (-180.0, 360.0)}
_KEYS = ("altitude_km", "temperature_K", *_AIR, *_OZONE, *_OTHER_GASES, *_PLACE)
_TOP_M = 120_000.0
_STEP_M = 1000.0
_LEAST = 1e-30
"""Mixing ratio that replaces zero where a logarithm is needed."""


@dataclass(frozen=True)
class PlacedProfile:
    """A profile and its place: latitude and longitude [deg], None where the file has none."""

    latitude_deg: float | None
    longitude_deg: float | None
    profile: AtmosphereProfile


@dataclass(frozen=True)
class _Table:
    """Columns of a file with the line (CSV) or list position (JSON, from 1) of each value, and their place."""

    file: str
    columns: dict[str, list[float]]
    number: Sequence[int]
    is_csv: bool
    of_place: str = ""

    def where(self, key: str, i: int) -> str:
        """Return file, key and line or level of a value."""
        if self.is_csv:
            return f"{self.file}: line {self.number[i]}, column {key}"
        return f"{self.file}: {key}, level {self.number[i]}"

    def part(self, rows: Sequence[int], of_place: str) -> _Table:
        """Return the table of some of the rows."""
        columns = {key: [values[i] for i in rows] for key, values in self.columns.items()}
        return _Table(self.file, columns, [self.number[i] for i in rows], self.is_csv, of_place)


def read_profiles(path: Path | str, co2_ppm: float = afgl.CO2_PPM) -> tuple[PlacedProfile, ...]:
    """Return the profiles of a file on levels from 0 to 120 km, in the order of their places.

    ``co2_ppm``: carbon dioxide of the lower atmosphere where the file has no column of it. Raises ``UserError``, with
    file, key, line and allowed range: a mistake, or a file with carbon dioxide where the scene sets another amount.
    """
    path = Path(path)
    table = _read(path)
    if co2_ppm != afgl.CO2_PPM and "carbon_dioxide_ppmv" in table.columns:
        raise UserError(
            f"the file has carbon dioxide of its own, and the scene asks for {co2_ppm:g} ppm",
            where=f"{path}: carbon_dioxide_ppmv",
            expected="either the column or atmosphere.co2_ppm",
            fix="leave one of them out",
        )
    return tuple(_placed(part, path.stem, co2_ppm) for part in _places(table))


def has_places(path: Path | str) -> bool:
    """Return whether a file has a column of latitudes; False where it cannot be read."""
    try:
        return "latitude_deg" in _read(Path(path)).columns
    except UserError:
        return False


def _read(path: Path) -> _Table:
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected="a profile (CSV or JSON)")
    return _read_json(text, str(path)) if path.suffix.lower() == ".json" else _read_csv(text, str(path))


def _placed(table: _Table, name: str, co2_ppm: float) -> PlacedProfile:
    _check(table)
    latitude, longitude = (table.columns[key][0] if key in table.columns else None for key in _PLACE)
    return PlacedProfile(latitude, longitude, _profile(table, name, co2_ppm))


def _places(table: _Table) -> list[_Table]:
    """Return the table of every place."""
    keys = [key for key in _PLACE if key in table.columns]
    if not keys or not table.number:
        return [table]
    for key in keys:
        low, high = _PLACE[key]
        for i, value in enumerate(table.columns[key]):
            if not low <= value <= high:
                raise UserError(f"is {value:g}", where=table.where(key, i), expected=_range(key))
    rows: dict[tuple[float, ...], list[int]] = {}
    for i, place in enumerate(zip(*(table.columns[key] for key in keys), strict=True)):
        rows.setdefault(place, []).append(i)
    if len(rows) > MAX_PLACES:
        raise UserError(
            f"profiles of {len(rows)} places", where=f"{table.file}: {keys[0]}", expected=f"at most {MAX_PLACES}"
        )
    seen: dict[tuple[float, ...], tuple[float, ...]] = {}
    for place, own in rows.items():
        # -180 and 180 are one meridian, and a pole has one place
        turn = 0.0 if abs(place[0]) == 90.0 else place[-1] % 360.0
        other = seen.setdefault((place[0], turn) if len(keys) == 2 else place, place)
        if other is not place:
            raise UserError(
                f"is {place[-1]:g}: the same place as longitude {other[-1]:g}",
                where=table.where(keys[-1], own[0]),
                expected="every place once",
            )
    found = []
    for place, own in rows.items():
        named = ", ".join(f"{key.removesuffix('_deg')} {value:g}" for key, value in zip(keys, place, strict=True))
        found.append(table.part(own, f", {named}"))
    return found


def _read_csv(text: str, file: str) -> _Table:
    try:
        reader = csv.reader(text.splitlines(), strict=True)
        rows = [(reader.line_num, row) for row in reader if row and not row[0].lstrip().startswith("#")]
    except csv.Error as error:
        raise UserError(f"not a CSV file: {error}", where=file, expected="comma-separated text") from None
    if not rows:
        raise UserError("the file is empty", where=file, expected="a line of column names")
    header = [name.strip() for name in rows[0][1]]
    _check_keys(header, f"{file}: line {rows[0][0]}")
    columns: dict[str, list[float]] = {name: [] for name in header}
    for number, row in rows[1:]:
        if len(row) != len(header):
            raise UserError(
                f"{len(row)} fields", where=f"{file}: line {number}", expected=f"{len(header)}, as there are names"
            )
        for name, field in zip(header, row, strict=True):
            try:
                columns[name].append(float(field))
            except ValueError:
                raise UserError(
                    f'found "{excerpt(field)}"', where=f"{file}: line {number}, column {name}", expected=_range(name)
                ) from None
    return _Table(file, columns, [number for number, _ in rows[1:]], is_csv=True)


def _read_json(text: str, file: str) -> _Table:
    data = files.parse_json(text, file)
    if not isinstance(data, Mapping):
        raise UserError("not a profile", where=file, expected="an object of lists: " + ", ".join(_KEYS))
    _check_keys(list(data), file)
    columns = {}
    for key, values in data.items():
        if not isinstance(values, list):
            raise UserError("is no list", where=f"{file}: {key}", expected="a list of numbers, one per altitude_km")
        for i, value in enumerate(values):
            if isinstance(value, bool) or not isinstance(value, int | float):
                found = json.dumps(value)[:40]
                raise UserError(f"is {found}", where=f"{file}: {key}, level {i + 1}", expected=_range(key))
        columns[key] = [_float(value) for value in values]
    levels = len(columns["altitude_km"])
    for key, values in columns.items():
        if len(values) != levels:
            raise UserError(
                f"has {len(values)} values", where=f"{file}: {key}", expected=f"{levels}, one per altitude_km"
            )
    return _Table(file, columns, range(1, levels + 1), is_csv=False)


def _float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _check_keys(keys: Sequence[str], where: str) -> None:
    # A file without a single key of ours is something else, which a message must not show.
    if not set(keys) & set(_KEYS):
        raise UserError("not a profile", where=where, expected="the keys " + ", ".join(_KEYS))
    for key in keys:
        if key not in _KEYS:
            raise UserError(
                f"unknown key {excerpt(key)!r}", where=where, expected="one of " + ", ".join(nearest(key, _KEYS))
            )
        if list(keys).count(key) > 1:
            raise UserError(f"{key} is there more than once", where=where, expected="every key once")
    if "longitude_deg" in keys and "latitude_deg" not in keys:
        raise UserError("missing: latitude_deg", where=where, expected="latitude_deg beside longitude_deg")
    for alternatives in (("altitude_km",), ("temperature_K",), _AIR, _OZONE):
        found = [key for key in alternatives if key in keys]
        if len(found) != 1:
            what = " and ".join(found) + " are given" if found else "missing: " + " or ".join(alternatives)
            raise UserError(what, where=where, expected="exactly one of " + ", ".join(alternatives))


def _range(key: str) -> str:
    if key == "temperature_K":
        return f"{TEMPERATURE_K[0]:g} to {TEMPERATURE_K[1]:g} K"
    if key in _PLACE:
        return f"{_PLACE[key][0]:g} to {_PLACE[key][1]:g} degrees"
    if key == "altitude_km":
        return "rising altitudes from 0 on"
    return "a finite number of 0 or more" if key in (*_OZONE, *_OTHER_GASES) else "a finite number above 0"


def _check(table: _Table) -> None:
    def refused(what: str, key: str, i: int, expected: str) -> UserError:
        return UserError(what, where=table.where(key, i), expected=expected)

    for key, values in table.columns.items():
        for i, value in enumerate(values):
            good = math.isfinite(value)
            if key == "temperature_K":
                good = good and TEMPERATURE_K[0] <= value <= TEMPERATURE_K[1]
            elif key in (*_OZONE, *_OTHER_GASES):
                good = good and value >= 0
            elif key in _AIR:
                good = good and value > 0
            if not good:
                raise refused(f"is {value:g}", key, i, _range(key))
    z = table.columns["altitude_km"]
    if len(z) < MIN_LEVELS:
        raise UserError(
            f"{len(z)} levels",
            where=f"{table.file}: altitude_km{table.of_place}",
            expected=f"at least {MIN_LEVELS} levels",
        )
    if z[0] != 0:
        raise refused(f"is {z[0]:g}", "altitude_km", 0, "0, the ground")
    for i, (below, above) in enumerate(pairwise(z), start=1):
        if not below < above <= below + MAX_STEP_KM:
            expected = f"rising altitudes, at most {MAX_STEP_KM:g} km from one to the next"
            raise refused(f"{above:g} follows {below:g}", "altitude_km", i, expected)
    if z[-1] < MIN_TOP_KM:
        raise refused(f"ends at {z[-1]:g} km", "altitude_km", len(z) - 1, f"levels up to {MIN_TOP_KM:g} km or more")
    pressure = _pressure(table)
    key = next(key for key in _AIR if key in table.columns)
    if not GROUND_PRESSURE_PA[0] <= pressure[0] <= GROUND_PRESSURE_PA[1]:
        low, high = (_in_units_of(key, p, table.columns["temperature_K"][0]) for p in GROUND_PRESSURE_PA)
        raise refused(f"is {table.columns[key][0]:g} at the ground", key, 0, f"{low:g} to {high:g} there")
    rising = np.flatnonzero(np.diff(pressure) >= 0)
    if rising.size:
        i = int(rising[0]) + 1
        what = f"is {table.columns[key][i]:g}, and the pressure does not fall from the level below"
        raise refused(what, key, i, "a pressure that falls with altitude")


def _in_units_of(key: str, pressure_pa: float, temperature_k: float) -> float:
    if key == "number_density_per_m3":
        return pressure_pa / (_BOLTZMANN * temperature_k)
    return pressure_pa / 100 if key == "pressure_hPa" else pressure_pa


def _pressure(table: _Table) -> FloatArray:
    columns = {key: np.array(values) for key, values in table.columns.items()}
    if "number_density_per_m3" in columns:
        return columns["number_density_per_m3"] * _BOLTZMANN * columns["temperature_K"]
    return columns["pressure_Pa"] if "pressure_Pa" in columns else columns["pressure_hPa"] * 100


def _profile(table: _Table, name: str, co2_ppm: float) -> AtmosphereProfile:
    """Return the profile on its own levels and, above the last, on levels by 1 km to 120 km."""
    z = np.array(table.columns["altitude_km"]) * 1e3
    temperature = np.array(table.columns["temperature_K"])
    pressure = _pressure(table)
    shares = {gas: np.array(table.columns[key]) * 1e-6 for key, gas in _OTHER_GASES.items() if key in table.columns}
    if "ozone_ppmv" in table.columns:
        shares["o3"] = np.array(table.columns["ozone_ppmv"]) * 1e-6
    else:
        shares["o3"] = np.array(table.columns["ozone_per_m3"]) * _BOLTZMANN * temperature / pressure
    # Profiles hold no zeros, for their interpolation is logarithmic: the shares are kept apart from it by a fine grid.
    empty = any((share == 0).any() for share in shares.values())
    fine = np.unique(np.concatenate([z, np.arange(0.0, z[-1], 100.0)])) if empty else z
    above = np.arange(z[-1] + _STEP_M, _TOP_M + _STEP_M, _STEP_M)
    slope = (math.log(pressure[-1]) - math.log(pressure[-2])) / (z[-1] - z[-2])
    ln_pressure = np.interp(fine, z, np.log(pressure))
    altitude = np.concatenate([fine, above])
    pressure = np.exp(np.concatenate([ln_pressure, ln_pressure[-1] + slope * (above - z[-1])]))
    temperature = np.interp(altitude, z, temperature)
    lent = afgl.gases_at_pressure(afgl.nearest_climate(pressure, temperature), pressure, co2_ppm)
    lent.update({gas: _share(altitude, z, share) for gas, share in shares.items()})
    air = pressure / (_BOLTZMANN * temperature)
    return AtmosphereProfile.of(
        name=name,
        altitude_m=altitude,
        pressure_pa=pressure,
        temperature_k=temperature,
        number_density_air=air,
        gases={gas: air * share for gas, share in lent.items()},
    )


def _share(altitude_m: FloatArray, z: FloatArray, share: FloatArray) -> FloatArray:
    """Return a gas's share between and above levels z: linear in the logarithm, or itself next to a zero."""
    both = np.interp(altitude_m, z, np.log(np.maximum(share, _LEAST)))
    whole = np.interp(altitude_m, z, (share > 0).astype(float)) == 1
    return np.where(whole, np.exp(both), np.maximum(np.interp(altitude_m, z, share), _LEAST))
