"""The gallery: every shipped scene in visible light, rendered in three colours and shown on one page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from horizonval.earth import sunlight
from horizonval.errors import UserError
from horizonval.geometry.ephemeris import AU_M, sun_itrs
from horizonval.report.gallery import Exhibit, write_gallery
from horizonval.report.tone import tone_mapped
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.files import shipped_names, shipped_path
from horizonval.spec.load import load_frames
from horizonval.spec.scene import SceneSpec
from horizonval.suggest import nearest

LIMITS_UM = {"red": (0.61, 0.66), "green": (0.52, 0.57), "blue": (0.44, 0.49)}
NODES = 2
"""Of each band: 50 nm are narrow."""


def scenes() -> list[str]:
    """Return the shipped scenes that are seen in visible light."""
    return [n for n in shipped_names("scene") if any(b.kind == "solar" for b in load_frames(n)[0].camera.band)]


def make_gallery(folder: Path, names: Sequence[str], tell: Callable[[str, int, int], None]) -> Path:
    """Render scenes, write their pictures and ``index.html``, and return its path.

    A picture that lies there already is made again: the page is always that of the scenes as they are now.

    Parameters
    ----------
    folder : Path
    names : sequence of str
        Shipped scenes; none for all.
    tell : callable
        Told the name, number and count of each scene before it is rendered.
    """
    known = scenes()
    for name in names:
        if name not in known:
            raise UserError(
                f"no scene {name!r} in visible light", where="SCENE", expected=", ".join(nearest(name, known))
            )
    chosen = list(names) or known
    try:
        folder.mkdir(parents=True, exist_ok=True)
        exhibits = []
        for number, name in enumerate(chosen, start=1):
            tell(name, number, len(chosen))
            exhibits.append(_exhibit(name))
            (folder / f"{name}.png").write_bytes(exhibits[-1].png)
        return write_gallery(exhibits, folder)
    except OSError as e:
        raise UserError(e.strerror or "cannot be written", where=str(folder), expected="a folder to write to") from e


def _exhibit(name: str) -> Exhibit:
    from horizonval.render.frame import render_frame

    first = load_frames(name)[0]
    scene, camera = first.scene, first.camera
    frame = render_frame(scene, in_colour(camera))
    picture = tone_mapped(np.stack(list(_reflectances(scene, frame.radiance)), axis=-1))
    return Exhibit(name, caption(shipped_path("scene", name)), picture.rgb, picture.white)


def in_colour(camera: CameraSpec) -> CameraSpec:
    """Return the camera with the three bands of the gallery in place of its own."""
    bands = [Band(name=name, kind="solar", lo_um=lo, hi_um=hi, nodes=NODES) for name, (lo, hi) in LIMITS_UM.items()]
    return camera.model_copy(update={"band": bands})


def _reflectances(scene: SceneSpec, radiance: dict[str, NDArray[np.float32]]) -> Iterator[NDArray[np.float64]]:
    _, distance_m = sun_itrs(scene.platform.epoch_utc)
    for name, limits in LIMITS_UM.items():
        white = sunlight.band_irradiance(*limits, distance_m / AU_M) / np.pi
        yield radiance[name].astype(np.float64) / white


def caption(path: Path) -> str:
    """Return the comment at the head of a scene file as one paragraph."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").rstrip())
    return " ".join(lines)
