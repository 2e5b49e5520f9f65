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
from horizonval.spec.files import head_comment, shipped_names, shipped_path
from horizonval.spec.load import load_scene
from horizonval.spec.scene import SceneSpec


def test_every_shipped_scene_has_a_caption() -> None:
    names = shipped_names("scene")
    assert {"day-limb", "terminator", "twilight-18", "night", "glint", "volcanic-limb", "broken-clouds"} <= set(names)
    assert {"limb-night-ir", "ir-limb-tropical", "ir-cold-cloud", "ir-day-side", "ir-night-side"} <= set(names)
    for name in names:
        caption = head_comment(shipped_path("scene", name))
        assert caption.endswith("."), name
        assert "#" not in caption


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
    assert text.index("Scenes in visible light") < text.index('id="glint"') < text.index("Scenes in the infrared")
    assert text.index("Scenes in the infrared") < text.index('id="ir-limb-tropical"')
    assert sorted(path.name for path in tmp_path.iterdir()) == ["glint.png", "index.html", "ir-limb-tropical.png"]


def test_a_hall_without_pictures_is_not_there(tmp_path: Path, drawn: dict[str, CameraSpec]) -> None:
    assert "infrared" not in gallery.make_gallery(tmp_path, ["glint"], progress=Silent()).read_text()
    assert "visible light" not in gallery.make_gallery(tmp_path, ["limb-night-ir"], progress=Silent()).read_text()


def test_colours_take_the_place_of_the_cameras_own_bands() -> None:
    _, camera = load_scene("glint")
    assert [band.name for band in gallery.in_colour(camera).band] == ["red", "green", "blue"]


def test_unknown_scene(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="twilight-06"):
        gallery.make_gallery(tmp_path / "out", ["twilight-6"], progress=Silent())
    assert not (tmp_path / "out").exists()


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="file"):
        gallery.make_gallery(tmp_path / "file" / "out", ["glint"], progress=Silent())
