"""Requests to images: one session per place, and the contents of a reply.

:class:`LocalClient` is the image service without a socket, in the caller's process: the same requests, the same bytes.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from horizonval import __version__
from horizonval.api.camera import Camera
from horizonval.api.client import Client
from horizonval.api.image import observe
from horizonval.api.scene import Scene
from horizonval.api.session import Session, exposed
from horizonval.core.errors import UserError, one_of
from horizonval.geometry.pose import scene_keys
from horizonval.serve.protocol import ImageRequest, image_request
from horizonval.spec.pose import TABLE_OF, TURNS
from horizonval.wire import SCHEMA, array_to_map

MOST_PLACES = 4
"""Most sessions in memory: as many clients can fly at different places without new tables for each image."""


class ImageSource:
    """Makes the images of one scene, a file or the name of a shipped one, at any position, instant and attitude.

    The same request gives the same reply: missing keys come from the scene, and a session's frames have the bytes of a
    scene rendered alone. All heads of a camera are served.
    """

    def __init__(self, scene: str | Path) -> None:
        self.name = str(scene)
        first, *others = Scene.each_head(scene)
        heads: tuple[str | None, ...] = first.camera.heads or (None,)
        self._scenes = {head: Scene.each_head(scene, head)[0] for head in heads}
        self._default = None if others else first.spec.camera.head
        self._choice = bool(others)
        self._sessions: OrderedDict[tuple[Any, ...], Session] = OrderedDict()

    def first_image(self) -> None:
        """Make an image of the scene as it is, so that a scene that cannot be served fails at the start."""
        self.answer(ImageRequest(head=next(iter(self._scenes)) if self._choice else None))

    def about(self) -> dict[str, Any]:
        """Return what is served: version, scene, and the camera with its bands and heads."""
        camera = next(iter(self._scenes.values())).camera
        return {
            "version": __version__,
            "scene": self.name,
            "camera": camera.name,
            "width": camera.width,
            "height": camera.height,
            "bands": list(camera.bands),
            "heads": list(camera.heads),
        }

    def answer(self, request: ImageRequest) -> dict[str, Any]:
        """Return the reply to a request.

        ``UserError`` for an impossible pose or exposure, or an unknown band or head.
        """
        head, scene = self._scene(request.head)
        camera = _camera(scene.camera, request)
        keys = scene_keys(request, scene.spec, "request")
        place = {key: value for key, value in keys.items() if TABLE_OF[key] == "platform"}
        frame = self._session(head, scene, place).frame({key: keys[key] for key in TURNS if key in keys}, maps=False)
        image = observe(frame, seed=request.seed, band=request.band, camera=camera)
        reply: dict[str, Any] = {
            "schema": SCHEMA,
            "kind": "image",
            "dn": array_to_map(image.dn),
            "band": image.band,
            "head": head,
            "seed": request.seed,
            "full_scale": image.full_scale,
            "scene_id": image.truth.scene_id,
        }
        if request.truth:
            reply |= {"truth": image.truth.to_dict(), "observation": image.observation}
        if request.radiance:
            reply["radiance"] = array_to_map(frame.radiance[image.band])
        return reply

    def _scene(self, head: str | None) -> tuple[str | None, Scene]:
        chosen = self._default if head is None else head
        if chosen in self._scenes:
            return chosen, self._scenes[chosen]
        names = [name for name in self._scenes if name is not None]
        if not names:
            raise UserError(f"found {head!r}", where="request: head", expected="none: the camera has no heads")
        what = "missing" if head is None else f"no head {head!r}"
        raise UserError(what, where="request: head", expected=one_of(head or "", names))

    def _session(self, head: str | None, scene: Scene, place: dict[str, Any]) -> Session:
        key = (head, scene.spec.platform.model_copy(update=place))
        session = self._sessions.pop(key, None)
        if session is None:
            session = Session.of(scene.changed(**place))
        # The oldest goes before the new one makes its tables: memory need not hold both.
        while len(self._sessions) >= MOST_PLACES:
            self._sessions.popitem(last=False)
        self._sessions[key] = session
        return session


def _camera(camera: Camera, request: ImageRequest) -> Camera:
    """Return the camera with the exposure asked for, after checking that it has the band."""
    if request.band is not None and request.band not in camera.bands:
        expected = one_of(request.band, camera.bands)
        raise UserError(f"no band {request.band!r}", where="request: band", expected=expected)
    return exposed(camera, request.exposure_s, "request: exposure_s")


class LocalClient(Client):
    """Answers as a :class:`horizonval.Client` of a server of a scene does, and renders in the calling thread.

    Nothing is sent or packed, so that it needs no extra. Errors have the same text. ``scene``: as of
    `horizonval serve --scene`.

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
