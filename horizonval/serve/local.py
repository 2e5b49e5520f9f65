"""The image service without a socket, in the process of the one who asks: the same requests, the same bytes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from horizonval.api.client import Client
from horizonval.serve.images import ImageSource
from horizonval.serve.request import image_request


class LocalClient(Client):
    """Answers as a :class:`horizonval.Client` of a server of a scene does, and renders in the calling thread.

    Nothing is sent and nothing packed, so that it needs no extra. A mistake in a request is told in the same words.

    Parameters
    ----------
    scene : str or Path
        As of `horizonval serve --scene`.

    Raises
    ------
    UserError
        No such scene, or a mistake in it.

    Examples
    --------
    >>> from horizonval.serve.local import LocalClient
    >>> LocalClient("limb-noon-vis").image(roll_deg=2.0, seed=7)
    <ServedImage 512 x 512 px, band vis, seed 7>
    """

    def __init__(self, scene: str | Path) -> None:
        self._source = ImageSource(scene)

    def close(self) -> None:
        """Nothing is open."""

    def __repr__(self) -> str:
        return f"<LocalClient of {self._source.name}>"

    def _ask(self, kind: str, keys: Mapping[str, Any]) -> dict[str, Any]:
        return self._source.answer(image_request(keys)) if kind == "image" else self._source.about()
