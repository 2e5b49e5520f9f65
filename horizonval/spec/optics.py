"""The ``[optics]`` table of camera files: what the lens does to the light."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from horizonval.spec.base import Model
from horizonval.spec.numbers import NonNegative, Positive


class Optics(Model):
    """The lens. ``psf_sigma_px`` is the Gaussian point spread, pixel integration not included."""

    f_number: Positive = 2.8
    transmission: Annotated[float, Field(gt=0, le=1)] = 1.0
    psf_sigma_px: NonNegative = 0.0
