r"""A camera as calibration programs tell it, in the terms of our camera files.

All of them mean the pinhole or the fisheye of OpenCV, with other names and other orders::

    Brown-Conrady   k1 k2 p1 p2 k3     plumb_bob, radtan (k3 = 0), MATLAB's [k1 k2 k3] and [p1 p2]
    Kannala-Brandt  k1 k2 k3 k4        equidistant, equi, OpenCV's fisheye

What has more is refused and not fitted: a rational or a thin prism term, a tilted sensor, axes that are not square to
each other, a mirror (``omni``). A term that is there and 0 is no term.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from horizonval.core.errors import UserError

BROWN, FISHEYE = "pinhole", "fisheye"
LARGEST_SKEW = 1e-9
"""Of a focal length: what a computation leaves of axes that are square to each other."""


@dataclass(frozen=True)
class Intrinsics:
    """Image size and lens; pixel 0 is the centre of the first, as in our camera files.

    ``distortion``: ``k1 k2 p1 p2 k3`` of a pinhole, ``k1 k2 k3 k4`` of a fisheye.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    projection: str = BROWN
    name: str = ""

    def table(self, source: str) -> dict[str, Any]:
        """Return the table ``[camera]``; ``source`` says in words where the figures come from."""
        return {
            "name": self.name,
            "source": source,
            "width": self.width,
            "height": self.height,
            "projection": self.projection,
            "fx": self.fx,
            "fy": self.fy,
            "cx": self.cx,
            "cy": self.cy,
            "distortion": list(self.distortion),
        }


class FileReader:
    """The keys of a parsed file, each asked for by name; what is not as expected names file and key.

    Parameters
    ----------
    data : mapping
    where : str
        The file, for messages.
    """

    def __init__(self, data: Mapping[str, Any], where: str) -> None:
        self.data, self.where = data, where

    def fail(self, key: str, what: str, expected: str, fix: str = "") -> UserError:
        """Return the mistake of a key."""
        return UserError(what, where=f"{self.where}: {key}" if key else self.where, expected=expected, fix=fix)

    def first(self, *keys: str) -> str | None:
        """Return the first of some names of one thing that the file has."""
        return next((key for key in keys if key in self.data), None)

    def numbers(self, key: str, count: int | tuple[int, ...]) -> list[float]:
        """Return a list of numbers of that length, or of one of those."""
        value = self.data.get(key)
        if isinstance(value, Mapping):
            # ROS and OpenCV write matrices with their size beside the data.
            value = value.get("data")
        if isinstance(value, int | float) and not isinstance(value, bool):
            value = [value]
        flat = _flat(value)
        counts = (count,) if isinstance(count, int) else count
        wanted = " or ".join(str(c) for c in counts)
        if flat is None or (counts and len(flat) not in counts):
            found = "nothing" if value is None else "no list of numbers" if flat is None else f"{len(flat)} numbers"
            raise self.fail(key, f"found {found}", f"{wanted} finite numbers")
        return flat

    def size(self, key: str) -> int:
        """Return a whole number of pixels."""
        (value,) = self.numbers(key, 1)
        if value != int(value) or value < 1:
            raise self.fail(key, f"found {value:g}", "a whole number of pixels")
        return int(value)

    def matrix(self, key: str, *, transposed: bool = False) -> tuple[float, float, float, float]:
        """Return ``fx fy cx cy`` of a matrix of nine numbers by rows, with 0 where such a matrix has it."""
        m = self.numbers(key, 9)
        if transposed:
            m = [m[3 * column + row] for row in range(3) for column in range(3)]
        fx, skew, cx, below, fy, cy, *last = m
        if not (fx > 0.0 and fy > 0.0) or last != [0.0, 0.0, 1.0] or below != 0.0:
            raise self.fail(key, f"found {m}", "fx 0 cx, 0 fy cy, 0 0 1")
        self.square(key, skew, fx)
        return fx, fy, cx, cy

    def square(self, key: str, skew: float, fx: float) -> None:
        """Refuse axes that are not square to each other."""
        if abs(skew) > LARGEST_SKEW * fx:
            raise self.fail(key, f"a skew of {skew:g}", "0", "calibrate again without skew")

    def brown(self, key: str, k: Sequence[float]) -> tuple[float, ...]:
        """Return ``k1 k2 p1 p2 k3`` of OpenCV's 0, 4, 5, 8, 12 or 14 coefficients, if the others are 0."""
        values = [*k, 0.0, 0.0, 0.0, 0.0, 0.0]
        if any(k[5:]):
            raise self.fail(
                key,
                f"{len(k)} coefficients, of which those after the fifth are not 0",
                "k1 k2 p1 p2 k3",
                "calibrate again without rational, thin prism and tilt terms",
            )
        return tuple(values[:5])


def _flat(value: Any) -> list[float] | None:
    if not isinstance(value, list | tuple):
        return None
    found: list[float] = []
    for item in value:
        if isinstance(item, list | tuple):
            inner = _flat(item)
            if inner is None:
                return None
            found += inner
        elif isinstance(item, bool) or not isinstance(item, int | float) or not math.isfinite(item):
            return None
        else:
            found.append(float(item))
    return found
