"""Derivatives of frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from horizonval.api.progress import shown
from horizonval.api.scene import Scene
from horizonval.core.errors import UserError, nearest

if TYPE_CHECKING:
    from horizonval.core.progress import Progress


@dataclass(frozen=True, eq=False)
class FrameDerivatives:
    """How the radiance of every pixel of a frame changes; made by :meth:`horizonval.Frame.derivatives`.

    ========================= ================ =====================================================================
    parameter                 unit             what changes
    ========================= ================ =====================================================================
    ``rotation_x`` ``_y _z``  rad              the camera turns about its own axes (x right, y down, z along the
                                               boresight), right-handed
    ``east north up``         m                the camera moves along the geodetic directions of where it is; its
                                               attitude, the Sun and the air stay in Earth-fixed axes
    ``limb_height``           m                the whole air is raised over the ground
    ``gain``                  1                all radiance grows by the same factor
    ``temperature``           K                the air is warmer at all heights, in hydrostatic balance over the same
                                               pressure at the ground; the ground stays
    ``density``               1                all gases grow denser by the same factor
    ``aerosol``               1                all particles grow more by the same factor
    ========================= ================ =====================================================================

    Attributes
    ----------
    images : dict of dict of ndarray, shape (H, W), float32
        By parameter and band: W m-2 sr-1 per unit of the parameter.
    units : dict of str
        By parameter.
    left_out : tuple of str
        What this frame has that jumps, and whose derivative by pose is left out: coasts, edges of clouds, discs.

    Examples
    --------
    >>> import horizonval as hv
    >>> frame = hv.open_frame("frame.exr")
    >>> slopes = frame.derivatives(parameters=["rotation_x", "up"])
    >>> slopes.images["up"]["vis"].shape
    (64, 64)
    >>> slopes.jacobian("vis").shape
    (64, 64, 2)
    """

    images: dict[str, dict[str, NDArray[np.float32]]]
    units: dict[str, str]
    left_out: tuple[str, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order in which they were asked for."""
        return tuple(self.images)

    def jacobian(self, band: str) -> NDArray[np.float32]:
        """Return the derivatives of a band side by side, shape (H, W, number of parameters).

        Raises
        ------
        UserError
            No such band.
        """
        for images in self.images.values():
            if band not in images:
                raise UserError(
                    f"no band {band!r}", where="band", expected="one of " + ", ".join(nearest(band, images))
                )
        return np.stack([images[band] for images in self.images.values()], axis=-1)

    def __repr__(self) -> str:
        return f"<FrameDerivatives by {', '.join(self.images)}>"


def derivatives_of(scene: Scene, parameters: Sequence[str] | None, progress: bool | Progress) -> FrameDerivatives:
    """Return the derivatives of the frame of a scene; see :meth:`horizonval.Frame.derivatives`."""
    from horizonval.renderer.derivatives.frame_derivatives import frame_derivatives
    from horizonval.renderer.derivatives.parameters import PARAMETERS, UNITS

    chosen = PARAMETERS if parameters is None else tuple(dict.fromkeys(parameters))
    for name in chosen:
        if name not in PARAMETERS:
            raise UserError(
                f"unknown parameter {name!r}",
                where="Frame.derivatives: parameters",
                expected="some of " + ", ".join(nearest(name, PARAMETERS)),
            )
    with shown(progress) as listener:
        images, left_out = frame_derivatives(scene.spec, scene.camera.spec, chosen, listener)
    rounded = {p: {band: image.astype(np.float32) for band, image in bands.items()} for p, bands in images.items()}
    return FrameDerivatives(rounded, {p: UNITS[p] for p in chosen}, left_out)
