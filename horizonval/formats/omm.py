"""Orbit mean-elements messages (CCSDS 502.0-B), KVN and XML: the elements of SGP4 with all their digits."""

from __future__ import annotations

from pathlib import Path

from sgp4 import omm
from sgp4.api import SGP4_ERRORS, Satrec

from horizonval.core.errors import UserError
from horizonval.formats.ccsds import check_earth, check_utc, is_xml, lines_of, needed, utc_of, xml_of

OMM_EXPECTED = "an orbit mean-elements message of SGP4, KVN or XML"
NEEDED = ("EPOCH", "MEAN_MOTION", "ECCENTRICITY", "INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY")
UNITS = {
    "MEAN_MOTION": "rev/day",
    "INCLINATION": "deg",
    "RA_OF_ASC_NODE": "deg",
    "ARG_OF_PERICENTER": "deg",
    "MEAN_ANOMALY": "deg",
}
"""Those of the standard, which a message may leave out."""
DEFAULTS = {
    "CLASSIFICATION_TYPE": "U",
    "OBJECT_ID": "0000-000A",
    "EPHEMERIS_TYPE": "0",
    "ELEMENT_SET_NO": "0",
    "REV_AT_EPOCH": "0",
    "NORAD_CAT_ID": "0",
    "BSTAR": "0",
    "MEAN_MOTION_DOT": "0",
    "MEAN_MOTION_DDOT": "0",
}
"""What a message may leave out, and SGP4 needs no value of."""


def satellite_of_omm(path: Path) -> Satrec:
    """Return the satellite in a message, for SGP4; a mistake is a :class:`UserError` with file and key."""
    where = str(path)
    fields = _fields(path)
    check_earth(fields, where)
    check_utc(fields, where)
    if (axes := needed(fields, "REF_FRAME", where, "TEME")).upper() != "TEME":
        raise UserError(f"found {axes!r}", where=f"{where}: REF_FRAME", expected="TEME")
    theory = needed(fields, "MEAN_ELEMENT_THEORY", where, "SGP4")
    if theory.upper() not in ("SGP4", "SGP", "SGP/SGP4"):
        raise UserError(f"found {theory!r}", where=f"{where}: MEAN_ELEMENT_THEORY", expected="SGP4")
    for key in NEEDED:
        needed(fields, key, where, "an element of SGP4")
    epoch = utc_of(fields["EPOCH"], f"{where}: EPOCH")
    fields = {**DEFAULTS, **fields, "EPOCH": epoch.strftime("%Y-%m-%dT%H:%M:%S.%f")}
    satellite = Satrec()
    try:
        omm.initialize(satellite, fields)
    except (ValueError, KeyError) as error:
        raise UserError(f"elements that are no numbers: {error}", where=where, expected=OMM_EXPECTED) from error
    if satellite.error:
        raise UserError(SGP4_ERRORS[satellite.error], where=where, expected="elements of a satellite")
    return satellite


def _fields(path: Path) -> dict[str, str]:
    with path.open("rb") as file:
        head = file.read(256).decode("utf-8", errors="replace")
    found: dict[str, str] = {}
    if is_xml(head):
        for element in xml_of(path, OMM_EXPECTED).iter():
            if len(element) == 0 and element.text and element.tag not in found:
                found[element.tag] = element.text.strip()
                _check_unit(path, element.tag, element.get("units", ""))
        return found
    for _, line in lines_of(path, OMM_EXPECTED):
        key, equals, value = line.partition("=")
        if equals:
            # Units stand behind the value, in brackets.
            number, _, unit = value.partition("[")
            found.setdefault(key.strip(), number.strip())
            _check_unit(path, key.strip(), unit.rstrip(" ]"))
    return found


def _check_unit(path: Path, key: str, unit: str) -> None:
    if unit and key in UNITS and unit.strip().lower() != UNITS[key]:
        raise UserError(f"in {unit.strip()!r}", where=f"{path}: {key}", expected=UNITS[key])
