"""A frame: radiance per band, truth maps and the exact truth.

``renderer`` makes frames; ``sensor`` turns them into detector images; ``archive`` stores both; ``scoring`` reads the
truth. The truth is plain data that survives a trip through JSON bit by bit, so that an EXR file alone can be
re-scored.
"""

from __future__ import annotations

import math
from dataclasses import MISSING, asdict, dataclass, field, fields
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.geometry.camera import CameraModel, camera_from_spec
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.part import Outline
from horizonval.spec.camera import CameraSpec

FRAME_SCHEMA = 4
"""Schema of the truth's fields. 1: no Moon; 2: no infrared horizon; 3: no refracted horizon. Fields that an older truth
lacks take their defaults. It is part of a scene's identity, hence of its noise; the layout of files
has a separate number.
"""


class Hit(IntEnum):
    """What the ray through a pixel's centre meets first."""

    SPACE = 0
    SURFACE = 1
    ATMOSPHERE = 2
    SUN = 3
    MOON = 4
    CLOUD = 5
    PART = 6


MAP_UNITS = {
    "distance": "m",
    "tangent_height": "m",
    "solar_zenith": "deg",
    "hit": "0 space, 1 surface, 2 atmosphere, 3 sun, 4 moon, 5 cloud",
}
"""Truth maps every frame carries.

``distance``: to the surface or the cloud before it, +inf where the ray misses both. ``tangent_height``: lowest geodetic
height along the ray; for rays that hit the surface, minus the depth of the chord below it. ``solar_zenith``: at the
surface point, or at the tangent point. ``hit``: :class:`Hit`.

Frames with parts of the spacecraft in view also carry :data:`PART_MAP`.

Pixels beyond the image circle of a camera that has one see nothing: radiance 0, ``hit`` space, distance and tangent
height +inf, solar zenith 180.
"""

PART_MAP, PART_MAP_UNIT = "part", "1"
"""Covered share of every pixel by parts of the spacecraft, exact (:mod:`horizonval.geometry.part`). Where a
pixel's centre is behind a part, ``hit`` says so and ``distance`` is to the part; the other maps look through it.
"""


@dataclass(frozen=True)
class FrameTruth:
    """Exact truth of one frame: float64, closed form, made without the renderer.

    Vectors are tuples of Python floats so that equality and JSON are exact. ``*_cam`` in camera axes, ``*_itrs`` in
    Earth-fixed axes, quaternions scalar last and mapping components from the second frame to the first. Directions to
    Sun, Moon and nadir are unit vectors; yaw, pitch and roll are those of the body against lvlh (zyx).

    Attributes
    ----------
    scene, camera : dict
        The resolved specifications (plain data), enough to observe and estimate again.
    scene_id : str
        Hex digest identifying them.
    epoch_utc : str
        ISO 8601.
    r_itrs : tuple of 3 floats
        Camera position [m].
    altitude_m : float
        Geodetic height of the camera.
    sun_visible_fraction : float
        Share of the Sun's disc seen past the Earth from the camera: 1 lit, 0 umbra.
    angular_radius_rad : float
        Asin(R / distance) for a sphere; for the ellipsoid the mean over the horizon of its angle to the geocentric
        nadir.
    moon_itrs, moon_cam : tuple of 3 floats or None
        From the camera towards the Moon's centre; None, and the numbers below 0, where the scene has no Moon.
    moon_visible_fraction : float
        Share of the Moon's disc, lit or not, seen past the Earth from the camera.
    moon_phase_angle_rad : float
        Angle at the Moon between Sun and camera: 0 full, pi new.
    infrared_horizon : dict
        By thermal band, where its radiance drops all round the clear-sky horizon
        (:func:`horizonval.truth.frame_truth.with_infrared_horizon`). Empty without thermal bands, without air, and for
        cameras inside it.
    horizon_rise_m : float
        Height of the refracted horizon, the tangent of the apparent ellipsoid, above the geometric one, the tangent of
        the ellipsoid (:mod:`horizonval.earth.limb_heights`). 0 where light is not bent.
    refracted_angular_radius_rad : float
        As ``angular_radius_rad``, of the refracted horizon; 0 in truths older than this field.
    parts : dict
        What parts of the spacecraft hide: ``outline`` (:class:`horizonval.geometry.part.Outline`); ``names``;
        ``hidden_limb``, the share of the horizon in the image behind them, by azimuth about the nadir, None without
        horizon in the image; ``hidden_sun``, the share of the Sun's disc behind them, in the image or not. Empty
        without parts, and then not written.
    """

    scene: dict[str, Any]
    camera: dict[str, Any]
    scene_id: str
    epoch_utc: str
    ellipsoid_a_m: float
    ellipsoid_b_m: float
    r_itrs: tuple[float, float, float]
    altitude_m: float
    q_cam_from_itrs: tuple[float, float, float, float]
    q_cam_from_body: tuple[float, float, float, float]
    q_body_from_lvlh: tuple[float, float, float, float]
    yaw_rad: float
    pitch_rad: float
    roll_rad: float
    sun_itrs: tuple[float, float, float]
    sun_cam: tuple[float, float, float]
    sun_angular_radius_rad: float
    sun_visible_fraction: float
    nadir_geocentric_cam: tuple[float, float, float]
    nadir_geodetic_cam: tuple[float, float, float]
    angular_radius_rad: float
    schema: int = FRAME_SCHEMA
    moon_itrs: tuple[float, float, float] | None = None
    moon_cam: tuple[float, float, float] | None = None
    moon_angular_radius_rad: float = 0.0
    moon_visible_fraction: float = 0.0
    moon_phase_angle_rad: float = 0.0
    infrared_horizon: dict[str, Any] = field(default_factory=dict)
    horizon_rise_m: float = 0.0
    refracted_angular_radius_rad: float = 0.0
    parts: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def part_outline(self) -> Outline | None:
        """What parts of the spacecraft cover; None without parts."""
        return Outline.from_dict(self.parts["outline"]) if self.parts else None

    @cached_property
    def camera_spec(self) -> CameraSpec:
        """The camera that took the frame, validated once."""
        return CameraSpec.model_validate(self.camera)

    @cached_property
    def camera_model(self) -> CameraModel:
        """Its intrinsics."""
        return camera_from_spec(self.camera_spec.camera)

    @cached_property
    def ellipsoid(self) -> Ellipsoid:
        """The planet's shape."""
        return Ellipsoid(self.ellipsoid_a_m, self.ellipsoid_b_m)

    @property
    def apparent_ellipsoid(self) -> Ellipsoid:
        """Whose outline is the refracted horizon, for cameras above the air; the planet's shape without refraction."""
        return self.ellipsoid.raised(self.horizon_rise_m)

    @property
    def camera_file(self) -> str:
        """File, or shipped name, that the scene names for its camera; empty where it names none."""
        return str(self.scene.get("camera", {}).get("file", ""))

    @property
    def camera_name(self) -> str:
        """The camera's own name, else its file's."""
        return self.camera_spec.camera.name or self.camera_file.rsplit("/", 1)[-1].removesuffix(".toml")

    @property
    def head(self) -> str | None:
        """Name of the head that took the frame, ``None`` for a camera without heads."""
        head: str | None = self.scene.get("camera", {}).get("head")
        return head

    @property
    def scene_name(self) -> str:
        """Name of the scene; empty where it has none."""
        return str(self.scene.get("scene", {}).get("name", ""))

    @property
    def sun_boresight_rad(self) -> float:
        """Angle from the optical axis to the Sun's centre, behind the Earth or not."""
        return math.acos(max(-1.0, min(1.0, self.sun_cam[2])))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data (JSON keeps every bit: ``repr`` of a float64 round-trips)."""
        data = asdict(self)
        if not data["parts"]:
            del data["parts"]
        return data

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> FrameTruth:
        """Rebuild from :meth:`to_dict`; raises ``KeyError`` naming a missing key, ``TypeError`` for a foreign one.

        Fields that came after the truth's own schema take their defaults; ``schema`` stays what it was.
        """
        names = {f.name: f for f in fields(cls)}
        if "schema" not in data:
            raise KeyError("schema")
        old = data["schema"] != FRAME_SCHEMA
        for name, f in names.items():
            if (
                name not in data
                and name != "parts"
                and not (old and (f.default is not MISSING or f.default_factory is not MISSING))
            ):
                raise KeyError(name)
        if unknown := sorted(set(data) - set(names)):
            raise TypeError(f"unknown keys {unknown}")
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in data.items()}
        return cls(**values)


@dataclass(frozen=True)
class RadianceFrame:
    """What the renderer makes.

    Attributes
    ----------
    radiance : dict of ndarray, shape (H, W), float32
        Per band, W m-2 sr-1, weighted with the band's response (peak 1). Of a solar band the response is a quantum
        efficiency, and photons of every wavelength count as energy at the band's reference wavelength: what electrons
        are proportional to (:mod:`horizonval.earth.spectral.bands`).
    maps : dict of ndarray, shape (H, W), float32
        See :data:`MAP_UNITS`.
    truth : FrameTruth
    render : dict
        How it was made (version, subsamples, nodes, spectral nodes per band, back-end): provenance, not identity.
    energy_radiance : dict of ndarray, shape (H, W), float32
        Per band, W m-2 sr-1: the plain integral over wavelength of spectral radiance times response. Of a thermal band
        the same array as its radiance. Bands of solar frames from before this was kept are not in it.
    behind : dict of ndarray, shape (H, W), float32
        Per band, the radiance without parts of the spacecraft, which a turning camera needs: they turn with it. Empty
        for frames without parts.
    """

    radiance: dict[str, NDArray[np.float32]]
    maps: dict[str, NDArray[np.float32]]
    truth: FrameTruth
    render: dict[str, Any] = field(default_factory=dict)
    energy_radiance: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    behind: dict[str, NDArray[np.float32]] = field(default_factory=dict)


@dataclass(frozen=True)
class DetectorImage:
    """What a detector makes of one band of a frame.

    ``dn`` (H, W), uint16; ``full_scale``: largest digital number; ``observation``: seed and detector settings, which
    with the frame give the same bytes again.
    """

    dn: NDArray[np.uint16]
    band: str
    truth: FrameTruth
    full_scale: int
    observation: dict[str, Any] = field(default_factory=dict)
