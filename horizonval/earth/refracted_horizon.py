r"""Where refracting air shows the hard horizon: at the tangent of the apparent planet.

A ray that grazes the ground has the impact parameter ``n R`` (Bouguer's law), n the index of the air there, and leaves
the air as a straight line at that distance from the centre. Seen from outside the air, the outline is that of a planet
whose axes are longer by :math:`(n - 1) R`: 1.77 km in visible light over the US standard atmosphere.

One index serves all bands of a camera, the mean over their wavelengths (1 % of n - 1 at either end of the visible,
20 m); R is the planet's mean radius (10 m at most on the Earth's ellipsoid). The air is in layers: horizontal gradients
tilt the horizon by arcseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth import atmosphere_file
from horizonval.earth.atmosphere.air import NO_ATMOSPHERE, air_of
from horizonval.earth.atmosphere_file import AtmosphereFile
from horizonval.earth.gases import rayleigh
from horizonval.earth.spectral import bands
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.scene import SceneSpec


def air_refractivity(
    scene: SceneSpec, number_density_air: FloatArray, camera_bands: Sequence[Band]
) -> FloatArray | None:
    """Return n - 1 of air of some number density [1/m3] for a camera's bands; None where the scene bends no light."""
    if scene.atmosphere.refraction is False:
        return None
    return rayleigh.refractivity(number_density_air, [bands.reference_wavelength_um(band) for band in camera_bands])


def file_refractivity(scene: SceneSpec, file: AtmosphereFile, altitude_m: FloatArray, where: str) -> FloatArray | None:
    """Return n - 1 of an atmosphere file on other altitudes; None where light is not bent.

    Raises
    ------
    UserError
        The scene asks for refraction, and the file does not tell.
    """
    wanted = scene.atmosphere.refraction
    if wanted is False or (wanted is None and file.refractivity is None):
        return None
    return atmosphere_file.refractivity(file, altitude_m, where)


def horizon_rise_m(
    scene: SceneSpec, camera: CameraSpec, altitude_m: float, mean_radius_m: float, base_dir: Path | None = None
) -> float:
    """Return by how much the refracted horizon stands above the geometric one [m]; 0 where light is not bent.

    Inside the air, at index n(h), light arrives as from a planet larger by ``(n(0) - n(h)) R``.

    Parameters
    ----------
    scene, camera
        Resolved specifications.
    altitude_m : float
        Of the camera.
    mean_radius_m : float
        Of the planet.
    base_dir : Path, optional
        Folder against which files of the atmosphere are resolved; default the current one.

    Raises
    ------
    UserError
        As :func:`horizonval.earth.optical.optical_model` for the air.
    """
    atmosphere = scene.atmosphere
    if not camera.band or atmosphere.refraction is False:
        return 0.0
    if atmosphere.file is not None:
        path = (base_dir or Path()) / atmosphere.file
        file = atmosphere_file.read_atmosphere(path)
        level_m = atmosphere_file.altitudes_m(file, thermal=False)
        index = file_refractivity(scene, file, level_m, str(path))
    elif atmosphere.profile_file is None and atmosphere.profile == NO_ATMOSPHERE:
        return 0.0
    else:
        air = air_of(scene, base_dir)
        level_m, index = air.altitude_m, air_refractivity(scene, air.state.number_density_air, camera.band)
    return 0.0 if index is None else float(index[0] - np.interp(altitude_m, level_m, index)) * mean_radius_m
