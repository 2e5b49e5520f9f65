"""Names a user can give, each with a line that says what it is: cameras, suites, estimators, atmospheres."""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

from horizonval.spec.files import Kind, head_comment, shipped_names, shipped_path

ATMOSPHERES = {
    "tropical": "15 deg north, annual mean (AFGL 1986).",
    "midlatitude_summer": "45 deg north in July (AFGL 1986).",
    "midlatitude_winter": "45 deg north in January (AFGL 1986).",
    "subarctic_summer": "60 deg north in July (AFGL 1986).",
    "subarctic_winter": "60 deg north in January (AFGL 1986).",
    "us_standard": "US standard climate (AFGL 1986); the default.",
    "us76": "US Standard Atmosphere 1976 with the gases of AFGL 1986.",
    "by_latitude_month": "Zonal mean climate: every latitude's own air, in the month of the epoch.",
    "weather": "The air of one day, drawn from a seed: it varies with latitude, longitude and height.",
    "none": "No air.",
}


def _shipped(kind: Kind) -> dict[str, str]:
    return {name: first_sentence(head_comment(shipped_path(kind, name))) for name in shipped_names(kind)}


def _cameras() -> dict[str, str]:
    return _shipped("camera")


def _suites() -> dict[str, str]:
    return _shipped("suite")


def _studies() -> dict[str, str]:
    return _shipped("study")


def _scenes() -> dict[str, str]:
    return _shipped("scene")


def _estimators() -> dict[str, str]:
    from horizonval.estimation import registry

    # Of other packages nothing is imported here.
    return {
        name: f"Of another package, in {registry.module_of(name)}."
        if registry.is_foreign(name)
        else f"{registry.get(name).title.removesuffix('.')}."
        for name in registry.names()
    }


def _atmospheres() -> dict[str, str]:
    from horizonval.earth.atmosphere import climate, columns, profiles
    from horizonval.earth.weather import real_states

    known = (*profiles.names(), climate.BY_LATITUDE_MONTH, columns.WEATHER, "none")
    states = {f"{real_states.PREFIX}{name}": real_states.description(name) for name in real_states.names()}
    return {name: ATMOSPHERES[name] for name in known} | states


def _detectors() -> dict[str, str]:
    from horizonval.spec.detector import Cmos, LinearArray, Microbolometer, Thermopile

    return {
        get_args(model.model_fields["kind"].annotation)[0]: first_sentence(" ".join((model.__doc__ or "").split()))
        for model in (Cmos, Microbolometer, Thermopile, LinearArray)
    }


def first_sentence(text: str) -> str:
    """Return what a text begins with, as one sentence."""
    sentence = text.split(". ")[0].rstrip(" .:;")
    return f"{sentence}." if sentence else ""


LISTS: dict[str, Callable[[], dict[str, str]]] = {
    "cameras": _cameras,
    "suites": _suites,
    "studies": _studies,
    "estimators": _estimators,
    "atmospheres": _atmospheres,
    "scenes": _scenes,
    "detectors": _detectors,
}
"""What ``horizonval list`` knows, each as a function that returns names and what they stand for."""
