"""The gallery's scenes, their captions and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from horizonval.campaign import gallery
from horizonval.errors import UserError
from horizonval.spec.files import shipped_path
from horizonval.spec.load import load_scene


def test_every_shipped_scene_in_sunlight_has_a_caption() -> None:
    names = gallery.scenes()
    assert {"day-limb", "terminator", "twilight-18", "night", "glint", "volcanic-limb", "broken-clouds"} <= set(names)
    assert "limb-night-ir" not in names
    for name in names:
        caption = gallery.caption(shipped_path("scene", name))
        assert caption.endswith("."), name
        assert "#" not in caption


def test_colours_take_the_place_of_the_cameras_own_bands() -> None:
    _, camera = load_scene("glint")
    assert [band.name for band in gallery.in_colour(camera).band] == ["red", "green", "blue"]


def test_unknown_scene(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="twilight-06"):
        gallery.make_gallery(tmp_path / "out", ["twilight-6"], lambda *_: None)
    assert not (tmp_path / "out").exists()


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="file"):
        gallery.make_gallery(tmp_path / "file" / "out", ["glint"], lambda *_: None)
