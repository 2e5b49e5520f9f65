"""What a frame is differentiated by, in which unit, and how the camera moves for it.

========================= =============== ============================================================================
name                      unit            what changes
========================= =============== ============================================================================
``rotation_x`` ``_y _z``  1/rad           the camera turns about its own axis (x right, y down, z along the boresight),
                                          right-handed, and stays where it is
``east north up``         1/m             the camera moves along the geodetic directions of where it is and keeps its
                                          attitude in Earth-fixed axes; so do Sun and Moon, ground and air
``limb_height``           1/m             the whole air is raised over the ground
``gain``                  1               all radiance grows by the same factor: the radiance itself
``temperature``           1/K             the air is warmer at all heights, pressure in hydrostatic balance
``density``               1               all gases grow denser by the same factor
``aerosol``               1               all particles grow more by the same factor
========================= =============== ============================================================================

All of them times the radiance's W m-2 sr-1. What changes of the air exactly:
:mod:`horizonval.earth.atmosphere.air_change`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.air_change import AirChange
from horizonval.geometry.ellipsoid import Ellipsoid, surface_normal
from horizonval.renderer.plugin.settings import CameraSettings

ROTATIONS = ("rotation_x", "rotation_y", "rotation_z")
SHIFTS = ("east", "north", "up")
POSE = (*ROTATIONS, *SHIFTS)
GAIN = "gain"
AIR_STEPS = {"limb_height": 10.0, "temperature": 0.5, "density": 0.003, "aerosol": 0.01}
"""Steps of central differences: m, K, relative, relative."""
PARAMETERS = (*POSE, "limb_height", GAIN, "temperature", "density", "aerosol")
UNITS = (
    dict.fromkeys(ROTATIONS, "W m-2 sr-1 rad-1")
    | dict.fromkeys((*SHIFTS, "limb_height"), "W m-2 sr-1 m-1")
    | {GAIN: "W m-2 sr-1", "temperature": "W m-2 sr-1 K-1", "density": "W m-2 sr-1", "aerosol": "W m-2 sr-1"}
)


def level_axes(r_itrs: FloatArray, ellipsoid: Ellipsoid) -> FloatArray:
    """Return the unit vectors east, north and up at a position, shape (3, 3), one a row; geodetic.

    At a pole, north goes on along the meridian of ``atan2(y, x)``.
    """
    up = surface_normal(r_itrs, ellipsoid)
    longitude = np.arctan2(r_itrs[1], r_itrs[0])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    return np.stack([east, np.cross(up, east), up])


def displaced(camera: CameraSettings, ellipsoid: Ellipsoid, parameter: str, step: float) -> CameraSettings:
    """Return a camera turned or moved by a step [rad or m] of one of :data:`POSE`."""
    if parameter in ROTATIONS:
        turn = Rotation.from_rotvec(step * np.eye(3)[ROTATIONS.index(parameter)]).as_matrix()
        return replace(camera, itrs_from_cam=camera.itrs_from_cam @ turn)
    axes = level_axes(camera.r_itrs, ellipsoid)
    return replace(camera, r_itrs=camera.r_itrs + step * axes[SHIFTS.index(parameter)])


def changed_air(parameter: str, step: float) -> AirChange:
    """Return the change of air of one of :data:`AIR_STEPS`."""
    key = {"limb_height": "raised_m", "temperature": "warmer_k", "density": "denser", "aerosol": "dustier"}[parameter]
    return AirChange(**{key: step})
