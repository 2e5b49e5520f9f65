"""Mean elements of SGP4 with all their digits: CCSDS messages (502.0-B-2 and -3), and catalogues as JSON or CSV.

KVN and XML say everything. JSON and CSV, as CelesTrak and Space-Track publish them, leave out what holds for all of
their elements: the Earth, TEME, UTC and SGP4. Catalogue numbers may have any length, since SGP4 does not need them.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sgp4 import omm
from sgp4.api import SGP4_ERRORS, Satrec

from horizonval.core import files
from horizonval.core.errors import UserError
from horizonval.formats.csv_table import MAX_FILE_BYTES, csv_rows
from horizonval.formats.ndm import (
    HARMLESS,
    HEAD_BYTES,
    READ,
    VERSIONS,
    Fields,
    check_keys,
    form_of_elements,
    is_user_defined,
    listed,
    messages_of,
    one_element_set,
)
from horizonval.geometry.clock import instant_of, utc_at

EXPECTED = "mean elements of SGP4: an OMM in KVN or XML, JSON or CSV"
DEFAULTS = {"CENTER_NAME": "EARTH", "REF_FRAME": "TEME", "TIME_SYSTEM": "UTC", "MEAN_ELEMENT_THEORY": "SGP4"}
"""Values that JSON and CSV leave out."""
CATALOGUE = frozenset(
    {"CCSDS_OMM_VERS", "SEMIMAJOR_AXIS", "PERIOD", "APOAPSIS", "PERIAPSIS", "OBJECT_TYPE", "RCS_SIZE", "COUNTRY_CODE"}
    | {"LAUNCH_DATE", "SITE", "DECAY_DATE", "DECAYED", "FILE", "GP_ID", "TLE_LINE0", "TLE_LINE1", "TLE_LINE2"}
    | {"RMS", "DATA_SOURCE"}
)
"""Further keys of Space-Track and CelesTrak in JSON and CSV; none of them changes the orbit."""
THEORIES = ("SGP4", "SGP/SGP4", "SGP")
EPHEMERIS_TYPES = (0.0, 2.0, 3.0)
"""Types of SGP4 and of its deep-space part; 4 is SGP4-XP, another theory with other elements."""
GM_KM3_S2, LARGEST_GM_MISFIT = 398600.8, 1e-4
"""Gravity parameter inside SGP4 (WGS-72), and the relative difference up to which another one is the Earth's."""


def satellite_of_omm(path: Path, satellite: str | None = None) -> tuple[Satrec, str]:
    """Return the satellite in a file, for SGP4, and a warning about what was assumed, or nothing.

    ``satellite`` chooses one by name, number or designator.

    Raises
    ------
    UserError
        With file and key: several satellites or several sets of elements of one, a theory other than SGP4, another
        centre or frame, elements that are missing or out of range.
    """
    fields = one_element_set(_element_sets(path), satellite, str(path), lambda one: one.text("EPOCH", "no epoch"))
    return _satellite(fields)


def _satellite(fields: Fields) -> tuple[Satrec, str]:
    fields.check_earth()
    fields.one_of("REF_FRAME", ("TEME",))
    theory = fields.one_of("MEAN_ELEMENT_THEORY", THEORIES)
    if (kind := fields.number("EPHEMERIS_TYPE", default=0.0)) not in EPHEMERIS_TYPES:
        raise UserError(
            f"found {kind:g}", where=fields.at("EPHEMERIS_TYPE"), expected="0, 2 or 3, of SGP4", fix="4 is SGP4-XP"
        )
    for key in ("REF_FRAME_EPOCH", "SEMI_MAJOR_AXIS"):
        if fields.text(key):
            raise UserError(
                "is not a key of SGP4's elements", where=fields.at(key), expected="MEAN_MOTION, and TEME of date"
            )
    for key in ("BTERM", "AGOM"):
        if fields.number(key, default=0.0):
            raise UserError("is a term of SGP4-XP", where=fields.at(key), expected="BSTAR, of SGP4")
    if abs(fields.number("GM", default=GM_KM3_S2) / GM_KM3_S2 - 1.0) > LARGEST_GM_MISFIT:
        raise UserError(
            f"found {fields.text('GM')}", where=fields.at("GM"), expected=f"the Earth's, {GM_KM3_S2} km**3/s**2"
        )
    instant = instant_of(fields.needed("EPOCH", "the time of the elements"), fields.at("EPOCH"), fields.time_system())
    try:
        epoch = utc_at(instant)
    except UserError as error:
        raise error.at(fields.at("EPOCH")) from error
    values = {
        key: _within(fields, key, low, high)
        for key, low, high in (
            ("MEAN_MOTION", 0.01, 20.0),
            ("ECCENTRICITY", 0.0, 1.0),
            ("INCLINATION", 0.0, 180.0),
            ("RA_OF_ASC_NODE", -360.0, 360.0),
            ("ARG_OF_PERICENTER", -360.0, 360.0),
            ("MEAN_ANOMALY", -360.0, 360.0),
        )
    }
    for key in ("BSTAR", "MEAN_MOTION_DOT", "MEAN_MOTION_DDOT"):
        values[key] = fields.number(key, default=0.0)
    doubts = []
    if not fields.text("BSTAR"):
        doubts.append(f"{fields.at('BSTAR')} is missing: no drag")
    if theory == "SGP":
        doubts.append(f"{fields.at('MEAN_ELEMENT_THEORY')}: elements of SGP are flown by SGP4")
    found = Satrec()
    names = {"CLASSIFICATION_TYPE": "U", "OBJECT_ID": "", "EPHEMERIS_TYPE": "0", "ELEMENT_SET_NO": "0"}
    number = fields.text("NORAD_CAT_ID")
    number = number if re.fullmatch("[0-9]{1,5}", number) else "0"
    numbers = {"REV_AT_EPOCH": "0", "NORAD_CAT_ID": number, "EPOCH": epoch.strftime("%Y-%m-%dT%H:%M:%S.%f")}
    omm.initialize(found, {**names, **numbers, **values})
    if found.error:
        raise UserError(SGP4_ERRORS[found.error], where=fields.where, expected="elements of a satellite")
    return found, "; ".join(doubts)


def _within(fields: Fields, key: str, low: float, high: float) -> float:
    expected = f"a number from {low:g} to {high:g}"
    value = fields.number(key, expected)
    if not low <= value <= high:
        raise UserError(f"found {fields.text(key)}", where=fields.at(key), expected=expected)
    return value


def _element_sets(path: Path) -> list[Fields]:
    """Return all element sets of a file, each with its keys."""
    form = form_of_elements(files.read_bytes(path, largest=MAX_FILE_BYTES, expected=EXPECTED, first=HEAD_BYTES))
    if form == "json":
        found = _of_json(path)
    elif form == "csv":
        found = _of_csv(path)
    else:
        return [segment.fields for message in messages_of(path, "omm", EXPECTED) for segment in message.segments]
    if not found:
        raise UserError("no element set", where=str(path), expected=EXPECTED)
    for fields in found:
        if not {"EPOCH", "MEAN_MOTION"} & fields.values.keys():
            raise UserError(
                f"keys {listed(fields.values)}",
                where=fields.where,
                expected="mean elements, with EPOCH and MEAN_MOTION",
                fix="two-line elements go into a file of their own, as lines",
            )
        check_keys(fields, READ["omm"] | HARMLESS | CATALOGUE, "mean elements")
        if fields.text("CCSDS_OMM_VERS"):
            fields.one_of("CCSDS_OMM_VERS", VERSIONS["omm"])
        for key, value in DEFAULTS.items():
            if not fields.text(key):
                fields.values.pop(key, None)
                fields.add(key, value, fields.where)
    return found


def _of_json(path: Path) -> list[Fields]:
    # Numbers remain text, with all their digits.
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=EXPECTED)
    every: Any = files.parse_json(text, path, pairs=_Pairs, number=str)
    found = []
    for number, one in enumerate([every] if isinstance(every, _Pairs) else every, 1):
        where = f"{path}: element set {number}"
        if not isinstance(one, _Pairs):
            raise UserError("is no object of JSON", where=where, expected="keys and values of mean elements")
        found.append(_fields(where, [(key, value) for key, value in one]))
    return found


class _Pairs(list[tuple[str, Any]]):
    """Keys and values of a JSON object, repeated keys included."""


def _of_csv(path: Path) -> list[Fields]:
    header, rows = csv_rows(path, EXPECTED)
    if len(header) == 1:
        raise UserError("columns without commas between them", where=str(path), expected="comma-separated text")
    return [_fields(f"{path}: line {line}", list(zip(header, row, strict=True))) for line, row in rows]


def _fields(where: str, pairs: list[tuple[str, Any]]) -> Fields:
    fields = Fields(where)
    for key, value in pairs:
        name = key.strip().upper()
        if (name or value) and not is_user_defined(name):
            if value is not None and not isinstance(value, str):
                raise UserError("is no single value", where=f"{where}: {key}", expected="a number or a text")
            fields.add(name, (value or "").strip(), where)
    return fields
