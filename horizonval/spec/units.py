"""Units of the keys that hold numbers: what a key's name says, or what is stated beside it."""

from __future__ import annotations

from typing import Any

from pydantic import Field

DIMENSIONLESS = "1"

SUFFIXES = {
    "deg": "deg",
    "deg_s": "deg/s",
    "rad": "rad",
    "km": "km",
    "m": "m",
    "mm": "mm",
    "um": "um",
    "m_s": "m/s",
    "s": "s",
    "h": "h",
    "hz": "Hz",
    "k": "K",
    "c": "deg C",
    "k_per_min": "K/min",
    "percent": "%",
    "ppm": "ppm",
    "px": "px",
    "e": "electrons",
    "e_per_s": "electrons/s",
    "e_per_um": "electrons/um",
    "e_per_dn": "electrons/DN",
    "dn": "DN",
    "per_cm2_s": "1/(cm2 s)",
    "cm_rthz_per_w": "cm Hz^(1/2)/W",
    "mb": "MiB",
}
"""Unit by the end of a key's name, after an underscore."""


def unit(name: str) -> Any:
    """Return what states a number's unit in ``Annotated``, where the key's name does not say it; ``"1"`` for none."""
    return Field(json_schema_extra={"unit": name})


def unit_of_name(key: str) -> str | None:
    """Return the unit that a key's name ends with, the longest where several fit; None if it says none."""
    found = [suffix for suffix in SUFFIXES if key.endswith("_" + suffix)]
    return SUFFIXES[max(found, key=len)] if found else None
