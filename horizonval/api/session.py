"""Frames in real time: one position and instant, any sequence of attitudes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack

import numpy as np
from numpy.typing import NDArray

from horizonval.api.camera import Camera
from horizonval.api.frame import Frame
from horizonval.api.image import Image, observe
from horizonval.api.scene import Scene, SceneKeywords, plain, scene_of
from horizonval.core.errors import UserError
from horizonval.geometry.pose import turned
from horizonval.jobs.progress import shown
from horizonval.spec.detector import Cmos
from horizonval.spec.pose import ANGLES

if TYPE_CHECKING:
    from horizonval.core.progress import Progress
    from horizonval.frame import RadianceFrame
    from horizonval.renderer.viewpoint import Viewpoint

Attitude: TypeAlias = "Sequence[float] | NDArray[np.float64] | Mapping[str, Any]"
"""Yaw, pitch and roll [deg]; a quaternion; or keys of a pose that turn the camera."""

ATTITUDE = "Session: attitude"
"""Name in error messages."""


class Session:
    """A camera at one position and instant that returns frames and detector images for any attitude in real time.

    The first frame computes what depends on position, instant and air; later frames only turn the camera. After the
    first frame and image a session neither reads from nor writes to the disk, with one exception: Dr.Jit compiles and
    caches the kernel of something that comes into view for the first time, such as the Sun's disc. Every frame has its
    exact truth and the same bytes as :func:`horizonval.render` returns for ``frame.scene``.

    Parameters
    ----------
    camera : Camera, str, Path or mapping
        As of :class:`horizonval.Scene`.
    progress : bool or Progress
        Whether standard error shows the long steps of the first frame, or the object that receives them.
    **keywords
        Those of :class:`horizonval.Scene`; their attitude and mounting are the defaults of all frames.

    Attributes
    ----------
    scene : Scene
        The position, instant and air, with the default attitude.

    Raises
    ------
    UserError
        As :class:`horizonval.Scene`.

    Examples
    --------
    >>> import horizonval as hv
    >>> camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 32, "height": 32})
    >>> session = hv.Session(camera, altitude_km=550, mount_roll_deg=65, render={"orders": "single"})
    >>> session.image((3.0, 0.0, -1.5), seed=1)
    <Image scene: 32 x 32 px, band vis, seed 1, 0.0 % saturated>
    >>> session.frame([0.0, 0.0, 0.0, 1.0]).truth.yaw_rad
    0.0
    >>> session.frame({"yaw_deg": 10.0}).scene.spec.attitude.yaw_deg
    10.0
    >>> hv.Session.of("limb-noon-vis").scene.spec.atmosphere.profile
    'tropical'
    """

    def __init__(
        self,
        camera: Camera | str | Path | Mapping[str, Any] | None = None,
        *,
        progress: bool | Progress = False,
        **keywords: Unpack[SceneKeywords],
    ) -> None:
        self._set(Scene(camera, **keywords), progress)

    def _set(self, scene: Scene, progress: bool | Progress) -> None:
        self.scene, self._progress = scene, progress
        self._viewpoint: Viewpoint | None = None

    @classmethod
    def of(cls, scene: Scene | str | Path, *, progress: bool | Progress = False) -> Session:
        """Return a session of a scene, its file, or a shipped name; raises as :meth:`horizonval.Scene.from_file`."""
        session = cls.__new__(cls)
        session._set(scene_of(scene), progress)
        return session

    @property
    def camera(self) -> Camera:
        """The camera of the session."""
        return self.scene.camera

    def frame(self, attitude: Attitude | None = None, *, maps: bool = True) -> Frame:
        """Return the frame of an attitude: radiance per band, truth maps, and the exact truth.

        Raises ``UserError``: an invalid attitude; the first frame also as :func:`horizonval.render`.

        Parameters
        ----------
        attitude : sequence or mapping, optional
            Of the body against lvlh: three angles ``yaw, pitch, roll`` [deg]; or a quaternion ``q_body_from_lvlh``,
            scalar last, of length 1; or a mapping with keywords of :class:`horizonval.Scene` that turn the camera:
            attitude, rate and mounting. Missing values come from ``scene``.
        maps : bool
            False leaves out the truth maps, which a detector does not need: quicker.
        """
        return Frame.of(self._rendered(attitude, maps=maps))

    def image(
        self,
        attitude: Attitude | None = None,
        seed: int = 0,
        *,
        band: str | None = None,
        exposure_s: float | None = None,
        noise: bool = True,
    ) -> Image:
        """Return the detector image of an attitude; quicker than a frame and ``observe``, as it needs no maps.

        ``attitude``: as of :meth:`frame`. ``exposure_s``: replaces the exposure of the camera's detector. ``seed``,
        ``band``, ``noise``: as of :func:`horizonval.observe`. Raises ``UserError``: as :meth:`frame`, and for a camera
        without a detector, a band that it lacks, an invalid exposure, or a rate that no image shows.
        """
        camera = exposed(self.camera, exposure_s, "Session: exposure_s")
        return observe(self._rendered(attitude, maps=False), seed=seed, band=band, camera=camera, noise=noise)

    def move(self, **keywords: Any) -> None:
        """Change position, instant or air; the next frame computes what depends on them.

        The keywords are those of :class:`horizonval.Scene`; all others stay. After an error the session is unchanged.

        Examples
        --------
        >>> import horizonval as hv
        >>> session = hv.Session("vis-cmos-512-60deg", altitude_km=550)
        >>> session.move(latitude_deg=20, epoch_utc="2026-03-20T12:01Z")
        >>> session.scene.spec.platform.latitude_deg
        20.0
        """
        self._set(self.scene.changed(**keywords), self._progress)

    def __repr__(self) -> str:
        return f"<Session {repr(self.scene).removeprefix('<Scene ')}"

    def _rendered(self, attitude: Attitude | None, *, maps: bool) -> RadianceFrame:
        spec = self.scene.spec
        if attitude is not None:
            keys = attitude if isinstance(attitude, Mapping) else _keys_of_numbers(attitude, ATTITUDE)
            spec = turned(spec, {str(key): plain(value) for key, value in keys.items()}, ATTITUDE)
        if self._viewpoint is None:
            from horizonval.renderer.frame import viewpoint_of

            with shown(self._progress) as listener:
                self._viewpoint = viewpoint_of(self.scene.spec, self.camera.spec, listener)
        return self._viewpoint.frame(spec, maps=maps)


def exposed(camera: Camera, exposure_s: float | None, where: str) -> Camera:
    """Return a camera with another exposure, if one is given; ``UserError``, at ``where``: it has no shutter."""
    if exposure_s is None:
        return camera
    if not isinstance(camera.spec.detector, Cmos):
        raise UserError("set", where=where, expected="none: this camera's detector has no shutter")
    return camera.changed(detector={"exposure_s": exposure_s})


def _keys_of_numbers(attitude: Sequence[float] | NDArray[np.float64], where: str) -> dict[str, Any]:
    """Return three angles or a quaternion as keys of a pose."""
    try:
        values = np.asarray(attitude, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    match values.shape:
        case (3,) if np.isfinite(values).all():
            return dict(zip(ANGLES, values.tolist(), strict=True))
        case (4,) if np.isfinite(values).all():
            return {"q_body_from_lvlh": values.tolist()}
    expected = "3 angles [deg], a quaternion of 4 numbers, or keys of a pose"
    raise UserError(f"found {attitude!r}", where=where, expected=expected)
