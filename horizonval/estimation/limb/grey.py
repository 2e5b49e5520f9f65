"""Any picture array to one grey plane.

Colour becomes the plain mean of its channels: the limb is looked for where *any* channel changes, and luminance
weights would mute the blue of the daylight limb. Channel order (RGB or BGR) then does not matter either.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray


def to_grey(array: NDArray[Any]) -> FloatArray:
    """Return the grey level of a picture, in the units of its digital numbers.

    Parameters
    ----------
    array : ndarray, shape (H, W), (H, W, 1), (H, W, 2), (H, W, 3) or (H, W, 4)
        Integer or floating point. A second (grey) or fourth (colour) channel is opacity and is left out.

    Returns
    -------
    ndarray, shape (H, W), float64

    Raises
    ------
    ValueError
        If the array has another shape or is not numeric.
    """
    data = np.asarray(array)
    if data.dtype.kind not in "buif":
        raise ValueError(f"a picture of numbers is needed, not {data.dtype}")
    if data.ndim == 2:
        return data.astype(np.float64)
    if data.ndim == 3 and data.shape[2] in (1, 2):
        return data[:, :, 0].astype(np.float64)
    if data.ndim == 3 and data.shape[2] in (3, 4):
        return np.asarray(data[:, :, :3].mean(axis=2, dtype=np.float64))
    raise ValueError(f"a picture of shape (H, W) or (H, W, 1..4) is needed, not {data.shape}")
