"""The gallery's scenes, their captions and what it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from horizonval.api import gallery
from horizonval.core.errors import UserError
from horizonval.core.progress import Silent
from horizonval.frame import RadianceFrame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_scene
from horizonval.spec.scene import SceneSpec


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, make_frame: Any) -> dict[str, CameraSpec]:
    """Frames by hand instead of rendered ones; what cameras they were asked of, by scene."""
    asked: dict[str, CameraSpec] = {}

    def render(scene: SceneSpec, camera: CameraSpec) -> RadianceFrame:
        asked[scene.scene.name] = camera
        return make_frame({band.name: 5.0 for band in camera.band}, camera.model_dump(mode="json"))

    monkeypatch.setattr(gallery, "_render", render)
    return asked


def test_scenes_are_shown_in_what_their_cameras_see(tmp_path: Path, drawn: dict[str, CameraSpec]) -> None:
    told = []

    class Listening(Silent):
        def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
            told.append(total)

        def done(self, name: str, *, failed: str | None = None) -> None:
            told.append(name)

    page = gallery.make_gallery(tmp_path, ["glint", "ir-limb-tropical"], progress=Listening())
    assert told == [2, "glint", "ir-limb-tropical"]
    assert [band.name for band in drawn["glint"].band] == ["red", "green", "blue"]
    assert drawn["ir-limb-tropical"] == load_scene("ir-limb-tropical")[1]
    text = page.read_text()
    assert text.index('id="glint"') < text.index('id="ir-limb-tropical"')
    assert sorted(path.name for path in tmp_path.iterdir()) == ["glint.png", "index.html", "ir-limb-tropical.png"]


def test_what_cannot_be_shown_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for folder, name, words in (("out", "twilight-6", "twilight-06"), ("file/out", "glint", "file")):
        with pytest.raises(UserError, match=words):
            gallery.make_gallery(tmp_path / folder, [name], progress=Silent())
    assert not (tmp_path / "out").exists()
