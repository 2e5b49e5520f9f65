"""Places along a circular orbit over an Earth that stands still.

With the argument of latitude u, the inclination i and the longitude of the ascending node::

    sin latitude = sin i sin u,    longitude = node + atan2(cos i sin u, cos u),    tan heading = cot i / cos u

The spherical triangle of node, equator and place. Neglected: the Earth's turn meanwhile, and the difference of
geocentric and geodetic latitude (0.19 deg at most), which only shifts where along the orbit a frame is taken.
"""

from __future__ import annotations

import math


def place_on_orbit(argument_rad: float, inclination_rad: float, node_rad: float) -> dict[str, float]:
    """Return latitude, longitude and heading (from north, through east) as keys of a scene's platform table [deg]."""
    u, i = argument_rad, inclination_rad
    longitude = node_rad + math.atan2(math.sin(u) * math.cos(i), math.cos(u))
    return {
        "latitude_deg": math.degrees(math.asin(math.sin(i) * math.sin(u))),
        "longitude_deg": math.degrees(math.remainder(longitude, math.tau)),
        "heading_deg": math.degrees(math.atan2(math.cos(i), math.sin(i) * math.cos(u))),
    }
