"""Sun, Moon and the light of the night in a scene file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from horizonval.spec.base import Model
from horizonval.spec.numbers import Angle


class SunOverride(Model):
    """Place the Sun by hand, seen from the point below the satellite; without this table the epoch decides."""

    zenith_deg: Annotated[float, Field(ge=0, le=180)]
    """Angle of the Sun from the zenith of the point below the satellite; above 90 it is below the horizon there."""
    azimuth_deg: Angle = 0.0
    """Azimuth of the Sun at that point, from north towards east."""


class Moon(Model):
    """The Moon. Its place comes from the epoch, or from `zenith_deg` and `azimuth_deg`, as the Sun's in `[sun]`.

    Where the Sun is placed by hand there is no Moon unless it is placed by hand too: that of the epoch would not fit.
    """

    enabled: bool = True
    """Whether there is a Moon."""
    zenith_deg: Annotated[float, Field(ge=0, le=180)] | None = None
    """Angle of the Moon from the zenith of the point below the satellite; places it by hand."""
    azimuth_deg: Angle = 0.0
    """Azimuth of the Moon at that point, from north towards east; goes with `zenith_deg`."""


class Night(Model):
    """What shines where the Sun does not.

    Left out of frames in which the Sun is nowhere lower than 9 deg below the horizon, and moonlight also where the Moon
    is a thin crescent (within some 20 deg of the Sun). Thermal bands have none of it, and no Moon.
    """

    airglow: bool = True
    """Light that the upper air emits; needs air."""
    sky_background: bool = True
    """The sky behind everything."""
    moonlight: bool = True
    """Moonlight on ground and air."""
