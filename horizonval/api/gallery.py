"""The gallery: the shipped scenes on one page, in three visible bands or in their camera's infrared."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from horizonval.core import atomic, files
from horizonval.core.errors import UserError, nearest
from horizonval.core.progress import Progress
from horizonval.frame import RadianceFrame
from horizonval.jobs.progress import shown
from horizonval.report.pictures import (
    GALLERY_TITLE,
    Exhibit,
    infrared_picture,
    reflectance,
    thermal_panel,
    tone_mapped,
    write_gallery,
)
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.files import head_comment, shipped_names, shipped_path
from horizonval.spec.load import load_frames
from horizonval.spec.scene import SceneSpec

LIMITS_UM = {"red": (0.61, 0.66), "green": (0.52, 0.57), "blue": (0.44, 0.49)}
NODES = 2
"""Spectral nodes of each band, 50 nm wide."""


def make_gallery(folder: Path, names: Sequence[str] = (), *, progress: bool | Progress = True) -> Path:
    """Render the named shipped scenes, or all, write their pictures and ``index.html``, and return its path.

    Pictures of an earlier gallery are replaced; ``UserError`` for a folder with anything else.
    """
    known = shipped_names("scene")
    for name in names:
        if name not in known:
            raise UserError(f"no scene {name!r}", where="SCENE", expected=", ".join(nearest(name, known)))
    chosen = list(names) or known
    halls: dict[str, list[Exhibit]] = {"visible": [], "infrared": []}
    files.check_folder(folder, ours=_is_gallery(folder))
    atomic.make_folder(folder)
    with shown(progress, "gallery", "scenes") as listener:
        listener.start(len(chosen), 0, unit="scenes")
        for name in chosen:
            for hall, exhibit in _exhibits(name):
                halls[hall].append(exhibit)
            listener.done(name)
    # Together, so that pictures without their page are nobody's or a stranger's.
    for exhibit in (*halls["visible"], *halls["infrared"]):
        atomic.write_bytes(folder / f"{exhibit.name}.png", exhibit.png)
    return write_gallery(halls["visible"], halls["infrared"], folder)


def _is_gallery(folder: Path) -> bool:
    try:
        return GALLERY_TITLE in files.read_text(folder / "index.html", largest=1 << 30)
    except UserError:
        return False


def _exhibits(name: str) -> Iterator[tuple[str, Exhibit]]:
    first = load_frames(name)[0]
    scene, camera = first.scene, first.camera
    text = head_comment(shipped_path("scene", name))
    if any(band.kind == "solar" for band in camera.band):
        yield "visible", _visible(name, text, scene, camera)
    if any(band.kind == "thermal" for band in camera.band):
        yield "infrared", _infrared(name, text, scene, camera)


def _visible(name: str, text: str, scene: SceneSpec, camera: CameraSpec) -> Exhibit:
    coloured = in_colour(camera)
    frame, when = _render(scene, coloured), scene.platform.epoch_utc
    rgb = [reflectance(frame.radiance[band.name], band, when) for band in coloured.band]
    picture = tone_mapped(np.stack(rgb, axis=-1))
    return Exhibit(name, text, picture.rgb, f"white is {picture.white:.2g} of a white ground under the Sun")


def _infrared(name: str, text: str, scene: SceneSpec, camera: CameraSpec) -> Exhibit:
    thermal = [band for band in camera.band if band.kind == "thermal"]
    if len(thermal) < len(camera.band):
        name += "-infrared"
    frame = _render(scene, camera.model_copy(update={"band": thermal}))
    return Exhibit(name, text, infrared_picture([thermal_panel(band, frame) for band in thermal]))


def _render(scene: SceneSpec, camera: CameraSpec) -> RadianceFrame:
    # Imported here: the list of scenes needs no renderer.
    from horizonval.renderer.frame import render_frame

    return render_frame(scene, camera)


def in_colour(camera: CameraSpec) -> CameraSpec:
    """Return the camera with the three bands of the gallery instead of its bands."""
    bands = [Band(name=name, kind="solar", lo_um=lo, hi_um=hi, nodes=NODES) for name, (lo, hi) in LIMITS_UM.items()]
    return camera.model_copy(update={"band": bands})
