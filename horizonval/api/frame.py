"""Rendered frames, and the rendering of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from horizonval.api.camera import Camera
from horizonval.api.derivatives import FrameDerivatives, derivatives_of
from horizonval.api.image import Image, observe
from horizonval.api.scene import Scene, scene_of
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.frame import RadianceFrame
from horizonval.jobs.progress import shown

if TYPE_CHECKING:
    import xarray

    from horizonval.core.progress import Progress
    from horizonval.formats.rays import RayFile


class Frame(RadianceFrame):
    """A rendered frame: radiance per band, truth maps, and the exact truth; a notebook shows it as a picture.

    Made by :func:`horizonval.render` or :func:`horizonval.open_frame`.

    Attributes
    ----------
    radiance : dict of ndarray, shape (H, W), float32
        Per band [W m-2 sr-1], weighted with the band's response (peak 1). The response of a solar band is a quantum
        efficiency, and every photon counts as energy at the band's reference wavelength, so that radiance is
        proportional to a detector's electrons. For radiometry use ``energy_radiance``.
    energy_radiance : dict of ndarray, shape (H, W), float32
        Per band [W m-2 sr-1]: the integral over wavelength of spectral radiance times response. Equal to ``radiance``
        in thermal bands. Files of older versions hold none of solar bands.
    maps : dict of ndarray, shape (H, W), float32
        ``distance`` [m], ``tangent_height`` [m], ``solar_zenith`` [deg], ``hit``.
    truth : FrameTruth
        Pose, Sun, nadir: float64, closed form, computed without the renderer.
    render : dict
        Settings and version of the rendering.

    Examples
    --------
    >>> import horizonval as hv
    >>> frame = hv.open_frame("frame.exr")
    >>> frame
    <Frame small: 64 x 64 px, band vis>
    >>> frame.observe(seed=1)
    <Image small: 64 x 64 px, band vis, seed 1, 0.0 % saturated>
    """

    @classmethod
    def of(cls, frame: RadianceFrame) -> Frame:
        """Return a rendered frame as a :class:`Frame`."""
        return cls(frame.radiance, frame.maps, frame.truth, frame.render, frame.energy_radiance, frame.behind)

    @property
    def camera(self) -> Camera:
        """The camera that the frame was rendered for."""
        return Camera(self.truth.camera_spec)

    @property
    def scene(self) -> Scene:
        """The scene that was rendered."""
        return Scene.from_dict(self.truth.scene, self.camera)

    def to_xarray(self) -> xarray.Dataset:
        """Return radiance and truth maps with their coordinates; needs the extra ``xarray``."""
        from horizonval.store.export import dataset_of

        return dataset_of(self)

    def observe(
        self,
        seed: int = 0,
        *,
        band: str | None = None,
        camera: Camera | str | Path | dict[str, Any] | None = None,
        noise: bool = True,
    ) -> Image:
        """Return the image that a detector makes of the frame; see :func:`horizonval.observe`."""
        return observe(self, seed=seed, band=band, camera=camera, noise=noise)

    def derivatives(
        self, *, parameters: Sequence[str] | None = None, progress: bool | Progress = True
    ) -> FrameDerivatives:
        """Return how the radiance of every pixel changes with attitude, position, gain and the air.

        Each parameter takes two frames. Frames of the pose share the tables of the air; every parameter of the air
        needs new ones. The scene is that of the frame's truth, so a frame from a file serves as well. Raises
        ``UserError``: an unknown parameter; as :func:`horizonval.render`.

        Parameters
        ----------
        parameters : sequence of str, optional
            Some of ``rotation_x``, ``rotation_y``, ``rotation_z``, ``east``, ``north``, ``up``, ``limb_height``,
            ``gain``, ``temperature``, ``density``, ``aerosol``; all by default.
        progress : bool or Progress
            As for :func:`horizonval.render`.
        """
        return derivatives_of(self.scene, parameters, progress)

    def save(self, path: str | Path) -> Path:
        """Write the frame as an OpenEXR file with its truth in the header; :func:`horizonval.open_frame` reads it.

        Raises ``UserError``: the file cannot be written.
        """
        from horizonval.store.exr import write_frame

        write_frame(path, self)
        return Path(path)

    def picture(self) -> NDArray[np.uint8]:
        """Return the frame as a picture, shape (H, W, 3), sRGB.

        Sunlight is relative to a white ground and compressed. Frames with thermal bands alone show brightness
        temperatures with their scale.
        """
        from horizonval.report.pictures import frame_picture

        return frame_picture(self)

    def _repr_html_(self) -> str:
        from horizonval.report.pictures import png_uri

        title = repr(self).strip("<>")
        return f'<img src="{png_uri(self.picture())}" alt="{title}" title="{title}">'

    def __repr__(self) -> str:
        height, width = next(iter(self.radiance.values())).shape
        bands = f"band{'s' if len(self.radiance) > 1 else ''} {', '.join(self.radiance)}"
        return f"<Frame {self.truth.scene_name}: {width} x {height} px, {bands}>"


def render(scene: Scene | str | Path, *, progress: bool | Progress = True) -> Frame:
    """Render a scene: the radiance that reaches every pixel in every band, and the exact truth.

    Deterministic: the same scene gives the same bytes.

    Parameters
    ----------
    scene : Scene, str or Path
        A scene, its file, or a shipped name.
    progress : bool or Progress
        Whether long steps are shown on standard error, or the object that receives them.

    Raises
    ------
    UserError
        The scene cannot be rendered, or no back-end works.

    Examples
    --------
    >>> import horizonval as hv
    >>> camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 32, "height": 32})
    >>> scene = hv.Scene(camera=camera, altitude_km=550, mount_roll_deg=65, render={"orders": "single"})
    >>> frame = hv.render(scene)
    >>> frame.radiance["vis"].shape
    (32, 32)
    """
    from horizonval.renderer.frame import render_frame
    from horizonval.sensor.motion import check_scene_turn

    resolved = scene_of(scene)
    check_scene_turn(resolved.spec, resolved.camera.spec)
    with shown(progress) as listener:
        return Frame.of(render_frame(resolved.spec, resolved.camera.spec, listener))


def render_reference(
    scene: Scene | str | Path,
    *,
    samples: int | None = None,
    size: tuple[int, int] | None = None,
    progress: bool | Progress = True,
) -> Frame:
    """Render a scene by Monte Carlo in stock Mitsuba, the cross-check of :func:`render`.

    Solar bands have scattering by molecules, ozone and particles over a uniform Lambert ground; thermal bands have air
    and thin cloud that emit over the scene's ground, with an integrator of this package. Neglected: refraction, the
    Sun's disc and glare, clouds, parts, and in sunlight the surface map. The map ``standard_error_<band>`` has the
    noise; in thermal bands ``render["deterministic_frame_differs"]`` is the difference to :func:`render` in standard
    errors.

    Parameters
    ----------
    scene : Scene, str or Path
    samples : int, optional
        Per pixel and spectral node (thermal bands: per pixel and band), at least 2.
    size : (int, int), optional
        Width and height of the image, for fewer and larger pixels.
    progress : bool or Progress
        As for :func:`render`.

    Raises
    ------
    UserError
        As :func:`render`; thermal bands through weather over the globe, a size that does not fit the camera.

    Examples
    --------
    >>> import horizonval as hv
    >>> camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 8, "height": 8})
    >>> scene = hv.Scene(camera=camera, altitude_km=550, mount_roll_deg=65, render={"orders": "single"})
    >>> hv.render_reference(scene, samples=2, progress=False)
    <Frame scene: 8 x 8 px, band vis>
    """
    from horizonval.renderer.reference.reference import DEFAULT_SPP, render_reference, resized

    if samples is not None and samples < 2:
        raise UserError(f"found {samples}", where="samples", expected="at least 2")
    resolved = scene_of(scene)
    camera = resolved.camera.spec
    if size is not None:
        camera = resized(camera, *size, where="size")
    with shown(progress, "reference", "passes") as listener:
        return Frame.of(render_reference(resolved.spec, camera, samples or DEFAULT_SPP, progress=listener))


def radiance(
    rays: Path,
    atmosphere: str | Path,
    *,
    orders: str = "single",
    thermal: bool = False,
    refraction: bool = False,
    progress: bool | Progress = True,
) -> tuple[RayFile, dict[str, FloatArray]]:
    """Compute the radiance along given rays in a given atmosphere, without camera or scene.

    Raises ``UserError``: a mistake in one of the files, or no back-end works.

    Parameters
    ----------
    rays : Path
        CSV file with the columns obs_x_km .. obs_z_km, dir_x .. dir_z, sun_x .. sun_z.
    atmosphere : str or Path
        Atmosphere file (JSON), or the name of a shipped one.
    orders : {"single", "all"}
        Orders of scattering.
    thermal : bool
        Emission instead of scattered sunlight.
    refraction : bool
        Whether the ``refractivity`` of the atmosphere file bends the rays.
    progress : bool or Progress

    Returns
    -------
    table : RayFile
    radiance : dict of ndarray, shape (n,)
        By band: 1/sr for unit solar irradiance; of emission W m-2 sr-1 um-1 at the wavelength of the band.
    """
    from horizonval.earth.atmosphere_file import file_model, read_atmosphere
    from horizonval.formats.rays import check_above_ground, read_rays
    from horizonval.spec.files import find

    if orders not in ("single", "all"):
        raise UserError(f"found {orders!r}", where="orders", expected="single or all")
    table = read_rays(rays)
    path = find("atmosphere", atmosphere)
    file = read_atmosphere(path)
    check_above_ground(table, file.planet_radius_m, rays)
    model = file_model(file, thermal=thermal, refracted=str(path) if refraction else "")
    if not table.rows:
        return table, {band.name: np.empty(0) for band in file.bands}
    from horizonval.renderer.backend import activate

    activate()
    from horizonval.renderer.rays import RAY_NODES, radiance_along_rays, thermal_radiance
    from horizonval.renderer.scattering.shells import FINE

    rays_in = file.planet_radius_m, table.observer_m, table.direction
    if thermal:
        return table, thermal_radiance(model, *rays_in, nodes=RAY_NODES, round_sky=True)
    scattering = FINE if orders == "all" else None
    with shown(progress) as listener:
        return table, radiance_along_rays(model, *rays_in, table.sun, scattering=scattering, progress=listener)


def open_frame(path: str | Path) -> Frame:
    """Read a rendered frame from an OpenEXR file that this package wrote.

    Raises ``UserError``: no such file, or it is damaged or not written by this package.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.open_frame("frame.exr").radiance["vis"].dtype
    dtype('float32')
    """
    from horizonval.store.exr import read_frame

    return Frame.of(read_frame(path))
