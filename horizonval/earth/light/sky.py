"""Additions to the Sun's irradiance in a scene's sky: its limb darkening, the Moon, and the night."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from horizonval.earth.column import OpticalModel
from horizonval.earth.light import limb_darkening, moonlight
from horizonval.earth.light.airglow import with_night
from horizonval.spec.camera import Band

NIGHT_ZENITH_RAD = math.radians(99.0)
"""Solar zenith angle beyond which night sources count.

With the Sun 9 deg below the horizon twilight illuminates the ground with some 0.1 lx (between 3.4 lx at 6 deg and 0.008
lx at 12 deg: Kaufmann, *IES Lighting Handbook*; Seidelmann, *Explanatory Supplement*, 1992, section 9.3), half of a
full Moon; with a higher Sun, night sources add less than twilight's variation from day to day."""


@dataclass(frozen=True)
class Moonlight:
    """The Moon as seen from the Earth's centre: phase angle [rad] and distances [au]; ``sun_au``: Sun to Earth."""

    phase_rad: float
    sun_moon_au: float
    moon_au: float
    sun_au: float


def night_in_view(sun_zenith_rad: float, horizon_rad: float) -> bool:
    """Return whether somewhere in view the Sun is lower than :data:`NIGHT_ZENITH_RAD`.

    ``sun_zenith_rad``: of the Sun at the sub-satellite point. ``horizon_rad``: angle at the Earth's centre from that
    point to the horizon.
    """
    return sun_zenith_rad + horizon_rad > NIGHT_ZENITH_RAD


def with_sky(
    model: OpticalModel,
    camera_bands: list[Band],
    *,
    sun_distance_au: float,
    moon: Moonlight | None,
    airglow: bool,
    background: bool,
) -> OpticalModel:
    """Return the model with limb darkening and moonlight in its solar nodes, and optionally the night.

    Thermal bands have a uniform Sun (the disc's edge is within 10 % of its centre at 10 um, and the Sun saturates any
    horizon sensor), and no Moon.
    """
    nodes = []
    for node in model.nodes:
        if node.solar_irradiance > 0.0:
            ratio = 0.0
            if moon is not None:
                ratio = float(
                    moonlight.irradiance_ratio(
                        node.wavelength_um, moon.phase_rad, moon.sun_moon_au, moon.moon_au, moon.sun_au
                    )
                )
            node = replace(
                node,
                limb_darkening=limb_darkening.coefficients(node.wavelength_um),
                moon_irradiance=node.solar_irradiance * ratio,
            )
        nodes.append(node)
    model = replace(model, nodes=tuple(nodes))
    if not (airglow or background):
        return model
    return with_night(model, camera_bands, sun_distance_au, airglow=airglow, sky=background)
