"""A page of pictures with captions, one file that needs nothing beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from horizonval.report import template
from horizonval.report.figures.frame_picture import png, png_uri


@dataclass(frozen=True)
class Exhibit:
    """One picture: its scene's name, what the scene is, and a remark on the picture itself, if there is one to make."""

    name: str
    caption: str
    rgb: NDArray[np.uint8]
    remark: str = ""

    @property
    def png(self) -> bytes:
        """The picture as a PNG file."""
        return png(self.rgb)

    @property
    def uri(self) -> str:
        """The picture as ``data:`` URI."""
        return png_uri(self.rgb)


def write_gallery(visible: Sequence[Exhibit], infrared: Sequence[Exhibit], folder: Path) -> Path:
    """Write ``folder/index.html`` and return its path."""
    path = folder / "index.html"
    template.write(path, template.environment().get_template("gallery.html").render(visible=visible, infrared=infrared))
    return path
