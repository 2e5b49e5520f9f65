"""The images of two runs of one scene: by digest first; only where that differs, by region."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.studies.regression.baseline.pack import FrozenFrame
from horizonval.studies.regression.regions import DISC, LIMB, bias, displacement_px

PERCENT = 100.0


def compare_images(
    table: str,
    now: Mapping[str, Any],
    base: Mapping[str, Any],
    radiance: NDArray[np.floating] | None,
    frozen: FrozenFrame | None,
) -> dict[str, Any]:
    """Return what a re-rendered scene and band is like beside the base's.

    Parameters
    ----------
    table : str
    now, base : mapping
        The bands' records: ``radiance_sha256``, ``images``, ``noise_dn``.
    radiance : ndarray, shape (H, W), or None
        Of now; needed where the digests differ.
    frozen : FrozenFrame or None
        Of the base, to 12 bits.

    Returns
    -------
    dict
        ``table``, ``same_radiance``, ``same_images`` (how many of ``n_images``), ``limb_radiance`` and
        ``disc_radiance`` [%], ``limb_displacement`` [px], ``noise`` [%]; None where a metric does not apply.
    """
    same = now["radiance_sha256"] == base["radiance_sha256"]
    found: dict[str, Any] = {
        "table": table,
        "same_radiance": same,
        "same_images": sum(a == b for a, b in zip(now["images"], base["images"], strict=False)),
        "n_images": len(now["images"]),
        "limb_radiance": 0.0,
        "disc_radiance": 0.0,
        "limb_displacement": 0.0,
        "noise": _noise(now["noise_dn"], base["noise_dn"]),
    }
    if frozen is None or (not same and radiance is None):
        return found | {"limb_radiance": None, "disc_radiance": None, "limb_displacement": None}
    old = frozen.radiance
    # Equal digests still say which regions there are: the metric applies, and is 0.
    new = old if same or radiance is None else np.asarray(radiance, dtype=np.float64)
    limb, disc = frozen.regions == LIMB, frozen.regions == DISC
    at_limb, on_disc, moved = bias(old, new, limb), bias(old, new, disc), displacement_px(old, new, limb)
    return found | {
        "limb_radiance": None if at_limb is None else PERCENT * at_limb,
        "disc_radiance": None if on_disc is None else PERCENT * on_disc,
        "limb_displacement": moved,
    }


def _noise(now: float | None, base: float | None) -> float | None:
    if now is None or base is None:
        return None
    if base == 0.0:
        return 0.0 if now == 0.0 else PERCENT
    return PERCENT * (now / base - 1.0)
