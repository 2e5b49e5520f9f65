"""Names that other functions take: what is shipped, and what is installed."""

from __future__ import annotations

from horizonval.estimation import registry
from horizonval.spec.files import shipped_names


def list_cameras() -> list[str]:
    """Return the names of the shipped cameras, for :meth:`horizonval.Camera.from_file`.

    Returns
    -------
    list of str

    Examples
    --------
    >>> import horizonval as hv
    >>> "vis-cmos-512-60deg" in hv.list_cameras()
    True
    """
    return shipped_names("camera")


def list_scenes() -> list[str]:
    """Return the names of the shipped scenes, for :meth:`horizonval.Scene.from_file` and :func:`horizonval.render`.

    Returns
    -------
    list of str

    Examples
    --------
    >>> import horizonval as hv
    >>> "limb-noon-vis" in hv.list_scenes()
    True
    """
    return shipped_names("scene")


def list_suites() -> list[str]:
    """Return the names of the shipped suites, for :func:`horizonval.run`.

    Returns
    -------
    list of str

    Examples
    --------
    >>> import horizonval as hv
    >>> "quick" in hv.list_suites()
    True
    """
    return shipped_names("suite")


def list_estimators() -> list[str]:
    """Return the names of all installed estimators, ours and those of other packages.

    Returns
    -------
    list of str

    Examples
    --------
    >>> import horizonval as hv
    >>> "guarded-altitude-free" in hv.list_estimators()
    True
    """
    return registry.names()
