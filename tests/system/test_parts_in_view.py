"""Frames with parts of the spacecraft in view: files, truth, scoring, turning cameras, mistakes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import horizonval as hv
from horizonval.core.errors import UserError
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.horizon_view import horizon_view

PLATE = {"shape": "panel", "frame": "cam", "width_m": 0.3, "height_m": 3.0, "position_m": [0.1, 0.0, 1.0]}


def _scene(part: list[dict] | None = None, **keywords: object) -> hv.Scene:
    camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 64, "height": 64, "fov_deg": 90.0})
    keywords = {"atmosphere": {"profile": "none"}, "render": {"part_samples": 16}} | keywords
    scene = {"altitude_km": 500.0, "mount_roll_deg": 68.0, "sun": {"zenith_deg": 30.0, "azimuth_deg": 200.0}}
    return hv.Scene(camera, part=part, **scene, **keywords)


def test_a_frame_without_parts_says_nothing_of_them() -> None:
    frame = hv.render(_scene(render={}))
    assert '"part' not in json.dumps(frame.truth.to_dict())
    assert set(frame.maps) == {"distance", "tangent_height", "solar_zenith", "hit"}
    assert not frame.behind


def test_a_file_alone_tells_what_is_hidden(tmp_path) -> None:
    """Written, read and judged after the mesh is gone."""
    mesh = tmp_path / "plate.obj"
    mesh.write_text("v -0.15 -1.5 0\nv 0.15 -1.5 0\nv 0.15 1.5 0\nv -0.15 1.5 0\nf 1 2 3 4\n")
    part = {"shape": "mesh", "file": str(mesh), "frame": "cam", "position_m": [0.1, 0.0, 1.0]}
    frame, plain = hv.render(_scene([part])), hv.render(_scene())
    frame.save(tmp_path / "frame.exr")
    mesh.unlink()
    read = hv.open_frame(tmp_path / "frame.exr")
    assert read.truth == frame.truth
    np.testing.assert_array_equal(read.maps["part"], frame.maps["part"])
    np.testing.assert_array_equal(read.behind["vis"], plain.radiance["vis"])
    # the mask is the product's own in the picture: uncovered pixels are those of the frame without parts
    clear = read.maps["part"] == 0.0
    np.testing.assert_array_equal(read.radiance["vis"][clear], plain.radiance["vis"][clear])
    # 0.3 m at 1 m by 32 px per unit, over the full height
    assert read.maps["part"].sum() == pytest.approx(0.3 * 32.0 * 64, rel=1e-4)
    assert (read.maps["hit"] == 6).sum() == pytest.approx(0.3 * 32.0 * 64, abs=64)
    # of a plate at depth 1 m, along each pixel's own line of sight
    row, column = (np.indices(clear.shape) - 31.5) / 32.0
    hit = read.maps["hit"] == 6
    expected = np.sqrt(1.0 + row**2 + column**2)[hit]
    np.testing.assert_allclose(read.maps["distance"][hit], expected, rtol=1e-3)
    visible, all_of_it = expected_outcome(read.truth), expected_outcome(plain.truth)
    hidden = read.truth.parts["hidden_limb"]
    assert 0.05 < hidden < 0.3
    shares = visible.horizon_fraction_in_view / all_of_it.horizon_fraction_in_view
    assert shares == pytest.approx(1.0 - hidden, abs=0.01)
    assert visible.horizon_arc_px < 0.95 * all_of_it.horizon_arc_px


def test_a_limb_behind_a_part_is_no_limb() -> None:
    truth = hv.render(_scene([PLATE | {"width_m": 9.0}])).truth
    assert not horizon_view(truth, truth.camera_model).in_view.any()
    assert expected_outcome(truth).outcome.value == "no_limb"


def test_the_sun_behind_a_part_is_not_in_the_frame() -> None:
    sun = {"sun": {"zenith_deg": 60.0, "azimuth_deg": 270.0}, "mount_roll_deg": 110.0}
    plain = _scene(heading_deg=0.0).changed(**sun)
    hidden = plain.changed(part=[PLATE | {"width_m": 9.0, "height_m": 9.0}])
    assert expected_outcome(hv.render(plain).truth).sun_in_frame
    truth = hv.render(hidden).truth
    assert not expected_outcome(truth).sun_in_frame
    assert truth.parts["hidden_sun"] == 1.0


def test_a_session_turns_the_earth_behind_parts_that_stand_still() -> None:
    scene = _scene([PLATE])
    session = hv.Session.of(scene)
    masks = [session.frame((0.0, 0.0, roll)).maps["part"] for roll in (0.0, 5.0)]
    np.testing.assert_array_equal(*masks)
    turned = session.frame((0.0, 0.0, 5.0))
    assert turned.radiance["vis"].tobytes() == hv.render(turned.scene).radiance["vis"].tobytes()


def test_a_turning_camera_blurs_the_earth_and_not_its_parts() -> None:
    """A fast roll drags the limb over many pixels; the plate's upright edge before black space stays as sharp."""
    frame = hv.render(_scene([PLATE | {"material": "white_paint"}]))
    camera = frame.camera.changed(detector={"exposure_s": 0.001}, optics={"psf_sigma_px": 0.0})
    turning = frame.truth.scene | {"attitude": frame.truth.scene["attitude"] | {"rate_deg_s": [0.0, 0.0, 4000.0]}}
    moved = replace(frame, truth=replace(frame.truth, scene=turning))
    still_dn, moved_dn = (f.observe(camera=camera, noise=False).dn.astype(float) for f in (frame, moved))
    covered = frame.maps["part"]
    assert np.abs(moved_dn - still_dn)[covered == 1.0].max() == 0.0
    assert np.abs(moved_dn - still_dn)[covered == 0.0].max() > 20.0


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ({"shape": "panel", "width_m": 1.0}, "needs height_m"),
        ({"shape": "disc", "radius_m": 1.0, "file": "a.ply"}, "file does not go with"),
        ({"shape": "mesh", "file": "nowhere.ply"}, "nowhere.ply"),
        ({"shape": "cube"}, "shape"),
        ({"shape": "boom", "radius_m": 0.1, "from_m": [0, 0, 1.0], "to_m": [0, 0, 1.0]}, "same point"),
        (PLATE | {"bsdf": {"reflectance": 0.5}}, "bsdf needs type"),
        (PLATE | {"bsdf": {"type": "velvety"}}, "Mitsuba refuses it"),
        (PLATE | {"bsdf": {"type": "sphere"}}, "not a BSDF|refuses"),
        (PLATE | {"bsdf": {"type": "diffuse", "shine": 2}}, "Mitsuba refuses it"),
        (PLATE | {"position_m": [0.0, 0.0, 0.0]}, "from the camera's pupil"),
    ],
)
def test_mistakes_are_one_line(part: dict, said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        hv.render(_scene([part]))
    assert "\n" not in caught.value.line()
    assert "part" in caught.value.line()


def test_derivatives_are_refused() -> None:
    with pytest.raises(UserError, match="parts of the spacecraft"):
        hv.render(_scene([PLATE])).derivatives(parameters=["up"])
