"""A page of colour pictures with captions, one file that needs nothing beside it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import jinja2
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Exhibit:
    """One picture: its scene's name, what the scene is, and the reflectance that became white."""

    name: str
    caption: str
    rgb: NDArray[np.uint8]
    white: float

    @property
    def png(self) -> bytes:
        """The picture as a PNG file."""
        done, data = cv2.imencode(".png", self.rgb[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if not done:
            raise RuntimeError("OpenCV cannot write PNG")
        return data.tobytes()

    @property
    def uri(self) -> str:
        """The picture as ``data:`` URI."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")

    @property
    def exposure(self) -> str:
        """How bright white is, in words."""
        return f"white is {self.white:.2g} of a white ground under the Sun"


def write_gallery(exhibits: Sequence[Exhibit], folder: Path) -> Path:
    """Write ``folder/index.html`` and return its path."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    path = folder / "index.html"
    path.write_text(environment.get_template("gallery.html").render(exhibits=exhibits), encoding="utf-8")
    return path
