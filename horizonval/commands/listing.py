"""Names a user can give: cameras, suites, estimators, atmospheres."""

from __future__ import annotations

from collections.abc import Callable

from horizonval.spec.files import shipped_names


def _cameras() -> list[str]:
    return shipped_names("camera")


def _suites() -> list[str]:
    return shipped_names("suite")


def _studies() -> list[str]:
    return shipped_names("study")


def _estimators() -> list[str]:
    from horizonval.estimation import registry

    return registry.names()


def _atmospheres() -> list[str]:
    from horizonval.earth.atmosphere import climate, profiles

    return [*profiles.names(), climate.BY_LATITUDE_MONTH, "none"]


def _scenes() -> list[str]:
    return shipped_names("scene")


LISTS: dict[str, Callable[[], list[str]]] = {
    "cameras": _cameras,
    "suites": _suites,
    "studies": _studies,
    "estimators": _estimators,
    "atmospheres": _atmospheres,
    "scenes": _scenes,
}
"""What ``horizonval list`` knows, each as a function that returns the names."""
