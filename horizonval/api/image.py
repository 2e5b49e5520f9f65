"""Detector images, and the simulation of a detector."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from horizonval.api.camera import Camera, camera_of
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.spec.camera import CameraSpec

if TYPE_CHECKING:
    import xarray


class Image(DetectorImage):
    """Digital numbers of one band of a frame; a notebook shows it as a picture.

    Made by :func:`horizonval.observe` or :func:`horizonval.open_image`.

    Attributes
    ----------
    dn : ndarray, shape (H, W), uint16
        Digital numbers.
    band : str
    truth : FrameTruth
        The exact truth of the frame that was observed.
    full_scale : int
        Largest digital number of the converter.
    observation : dict
        Seed and detector settings.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.open_image("image.exr")
    <Image small: 64 x 64 px, band vis, seed 1, 0.0 % saturated>
    """

    @classmethod
    def of(cls, image: DetectorImage) -> Image:
        """Return a detector image as an :class:`Image`."""
        return cls(image.dn, image.band, image.truth, image.full_scale, image.observation)

    @property
    def camera(self) -> Camera:
        """The camera that took it."""
        return Camera(CameraSpec.model_validate(self.observation.get("camera", self.truth.camera)))

    def to_xarray(self) -> xarray.Dataset:
        """Return the digital numbers with their coordinates; needs the extra ``xarray``."""
        from horizonval.store.export import dataset_of

        return dataset_of(self)

    def save(self, path: str | Path) -> Path:
        """Write the image as an OpenEXR file with its truth in the header; :func:`horizonval.open_image` reads it.

        Raises ``UserError``: the file cannot be written.
        """
        from horizonval.store.exr import write_image

        write_image(path, self)
        return Path(path)

    def _repr_html_(self) -> str:
        from horizonval.report.pictures import grey_levels, png_uri

        return f'<img src="{png_uri(grey_levels(self)[0])}" alt="{self!r}" title="{self!r}">'.replace(
            '"<', '"'
        ).replace('>"', '"')

    def __repr__(self) -> str:
        height, width = self.dn.shape
        saturated = 100 * float((self.dn >= self.full_scale).mean())
        name, seed = self.truth.scene_name, self.observation.get("seed", 0)
        return f"<Image {name}: {width} x {height} px, band {self.band}, seed {seed}, {saturated:.1f} % saturated>"


def observe(
    frame: RadianceFrame,
    *,
    seed: int = 0,
    band: str | None = None,
    camera: Camera | str | Path | dict[str, Any] | None = None,
    noise: bool = True,
) -> Image:
    """Return the detector image of a frame: optics, charge, noise, digital numbers.

    Parameters
    ----------
    frame : Frame
    seed : int
        Seed of all noise.
    band : str, optional
        The camera's first band by default.
    camera : Camera, str, Path or mapping, optional
        Replaces the frame's camera: another detector or lens with the same image geometry.
    noise : bool
        False gives the expected signal, still saturated and quantised.

    Raises
    ------
    UserError
        The camera has no detector or no such band, or does not fit the frame.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.observe(hv.open_frame("frame.exr"), seed=1).dn.dtype
    dtype('uint16')
    """
    from horizonval.sensor.observe import observe as observed

    spec = frame.truth.camera_spec if camera is None else camera_of(camera).spec
    return Image.of(observed(frame, spec, band, seed, noise=noise))


def open_image(path: str | Path) -> Image:
    """Read a detector image from an OpenEXR file that this package wrote.

    Raises ``UserError``: no such file, or it is damaged or not written by this package.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.open_image("image.exr").band
    'vis'
    """
    from horizonval.store.exr import read_image

    return Image.of(read_image(path))
