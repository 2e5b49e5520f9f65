"""Fisher information of the limb in an image, as it is kept beside the image and added over heads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.frame import DetectorImage

KEY = "information"
"""Of an image's settings, under which its information stands. Images from before it was kept have none."""
SCHEMA = 2
POSE, SHAPE = 7, 5
UNKNOWNS = POSE + SHAPE
"""Turn (3), position (3), height of the limb, shape of the planet (5)."""


@dataclass(frozen=True, eq=False)
class LimbInformation:
    """Information of one image, or the sum of several.

    Attributes
    ----------
    by_noise, by_knowledge : ndarray, shape (12, 12)
        Of a turn of the body about its axes [1/rad^2], of the position in Earth-fixed axes, of the height of the limb
        and of the planet's shape along the shapes of :mod:`.limb_information` in Earth-fixed axes [1/m^2].
    limb_height_m : float
        Where the pixels that say most look past the Earth.
    """

    by_noise: FloatArray
    by_knowledge: FloatArray
    limb_height_m: float

    def __add__(self, other: LimbInformation) -> LimbInformation:
        """Return the information of two images of one pose."""
        weights = np.array([np.trace(one.by_noise[:3, :3]) for one in (self, other)])
        heights = np.array([self.limb_height_m, other.limb_height_m])
        mean = float(weights @ heights / weights.sum()) if weights.sum() > 0.0 else 0.0
        return LimbInformation(self.by_noise + other.by_noise, self.by_knowledge + other.by_knowledge, mean)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: upper triangles, row by row."""
        upper = np.triu_indices(UNKNOWNS)
        return {
            "schema": SCHEMA,
            "by_noise": _digits(self.by_noise[upper]),
            "by_knowledge": _digits(self.by_knowledge[upper]),
            "limb_height_m": round(self.limb_height_m, 1),
        }

    @classmethod
    def from_dict(cls, data: Any) -> LimbInformation | None:
        """Rebuild from :meth:`to_dict`; None where there is nothing, or what another version means by it."""
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            return None
        return cls(_symmetric(data["by_noise"]), _symmetric(data["by_knowledge"]), float(data["limb_height_m"]))


def carried(image: DetectorImage) -> LimbInformation | None:
    """Return the information that an image carries; None where it carries none."""
    return LimbInformation.from_dict(image.observation.get(KEY))


def _digits(values: FloatArray) -> list[float]:
    return [float(f"{value:.12g}") for value in values]


def _symmetric(upper: Sequence[float]) -> FloatArray:
    matrix = np.zeros((UNKNOWNS, UNKNOWNS))
    matrix[np.triu_indices(UNKNOWNS)] = upper
    return matrix + np.triu(matrix, 1).T
