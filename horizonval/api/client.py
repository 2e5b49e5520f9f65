"""Client of an image server (``horizonval serve``), for simulations."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Self, Unpack

import numpy as np
from numpy.typing import NDArray

from horizonval.api.image import Image
from horizonval.api.scene import plain
from horizonval.core.errors import UserError
from horizonval.frame import FrameTruth
from horizonval.spec.pose import PoseKeywords
from horizonval.wire import (
    LONGEST_BODY,
    SCHEMA,
    Address,
    array_of_map,
    check_installed,
    error_of_message,
    pack,
    receive,
    send,
    unpack,
)

_RETRY_S = 0.05


@dataclass(frozen=True)
class ServedImage:
    """The answer of a server to a request.

    Attributes
    ----------
    dn : ndarray, shape (H, W), uint16
        Digital numbers.
    band : str
    head : str or None
        Of a camera with several.
    seed : int
        Of the noise.
    full_scale : int
        Largest digital number of the converter.
    scene_id : str
        Digest of the scene and camera that were rendered.
    truth : FrameTruth or None
        The exact truth, if requested.
    radiance : ndarray, shape (H, W), float32, or None
        Of the band [W m-2 sr-1], if requested.
    observation : dict
        Seed and detector settings; empty without the truth.
    """

    dn: NDArray[np.uint16]
    band: str
    head: str | None
    seed: int
    full_scale: int
    scene_id: str
    truth: FrameTruth | None = None
    radiance: NDArray[np.float32] | None = None
    observation: dict[str, Any] = field(default_factory=dict)

    @property
    def image(self) -> Image:
        """The image as :func:`horizonval.observe` returns it; ``UserError`` without its truth."""
        if self.truth is None:
            raise UserError("came without its truth", where="ServedImage", fix="ask with truth=True")
        return Image(self.dn, self.band, self.truth, self.full_scale, self.observation)

    def __repr__(self) -> str:
        height, width = self.dn.shape
        return f"<ServedImage {width} x {height} px, band {self.band}, seed {self.seed}>"


class ImageKeywords(PoseKeywords, total=False):
    """Keywords of :meth:`Client.image`, for type checkers and editors."""

    exposure_s: float
    seed: int
    band: str | None
    truth: bool
    radiance: bool


class Client:
    """Client of an image server; each call waits for its answer.

    Start a server with `horizonval serve --scene SCENE`. For one thread; several clients may use one server.

    Parameters
    ----------
    address : str
        ``ipc://PATH`` or ``tcp://HOST:PORT``; by default that of the server.
    token : str, optional
        The word in the server's ``--token-file``.
    timeout_s : float
        Longest time of an answer. The first image of a position takes seconds.
    wait_s : float
        Longest time until a server listens.

    Raises
    ------
    UserError
        No server listens there, or the address is invalid.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.Client("ipc://nobody.sock")
    Traceback (most recent call last):
    horizonval.core.errors.UserError: ipc://nobody.sock: nobody listens there; ...
    """

    def __init__(
        self, address: str = "", *, token: str | None = None, timeout_s: float = 120.0, wait_s: float = 0.0
    ) -> None:
        check_installed()
        self.address = Address.parse(address)
        self._token, self._timeout_s = token, timeout_s
        end = time.monotonic() + wait_s
        while True:
            try:
                self._stream = self.address.connect(timeout_s)
                return
            except OSError as e:
                # A server creates its socket before it can answer, so a refused connection may succeed later.
                if time.monotonic() >= end:
                    raise UserError(
                        "nobody listens there",
                        where=str(self.address),
                        fix="start a server with `horizonval serve --scene SCENE`",
                    ) from e
            time.sleep(_RETRY_S)

    def image(self, **keys: Unpack[ImageKeywords]) -> ServedImage:
        """Return the image of a pose; missing keys come from the server's scene, not from earlier requests.

        Raises ``UserError``: the server refused, did not answer in time, or the connection is lost.

        Parameters
        ----------
        **keys
            Keys of a pose are keywords of :class:`horizonval.Scene`, from ``epoch_utc`` to ``head``. Others are
            ``exposure_s``; ``seed`` of the noise; ``band``; and whether the answer has ``truth`` and ``radiance``.
        """
        given = {key: x.isoformat() if isinstance(x, datetime) else x for key, x in keys.items() if x is not None}
        answer = self._ask("image", plain(given))
        stated = answer.get("truth")
        packed = answer.get("radiance")
        return ServedImage(
            dn=array_of_map(answer.get("dn"), "reply: dn"),
            band=answer["band"],
            head=answer["head"],
            seed=answer["seed"],
            full_scale=answer["full_scale"],
            scene_id=answer["scene_id"],
            truth=None if stated is None else FrameTruth.from_dict(stated),
            radiance=None if packed is None else array_of_map(packed, "reply: radiance"),
            observation=answer.get("observation", {}),
        )

    def status(self) -> dict[str, Any]:
        """Return the server's version, scene, camera, bands, heads and number of images; raises as :meth:`image`."""
        return {key: value for key, value in self._ask("status", {}).items() if key not in ("schema", "kind")}

    def close(self) -> None:
        """End the connection."""
        self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Client of {self.address}>"

    def _ask(self, kind: str, keys: Mapping[str, Any]) -> dict[str, Any]:
        request = {"schema": SCHEMA, "kind": kind, **keys}
        if self._token is not None:
            request["token"] = self._token
        where = str(self.address)
        try:
            # A full server sends a message and closes; the message is readable although sending fails.
            with contextlib.suppress(ConnectionError):
                send(self._stream, pack(request), self._timeout_s)
            body = receive(self._stream, LONGEST_BODY, self._timeout_s, self._timeout_s)
        except OSError as e:
            self.close()
            raise UserError(f"the connection is lost ({e})", where=where, fix="connect again") from e
        except UserError as e:
            self.close()
            raise e.inside(where) from e
        if body is None:
            self.close()
            raise UserError("the server has closed the connection", where=where, fix="connect again")
        reply = unpack(body)
        if reply.get("kind") == "error":
            raise error_of_message(reply)
        return reply
