"""A session answers as single frames do, bit by bit, without the disk and without making anything twice."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import horizonval as hv
from horizonval.renderer import frame as rendering

VISIBLE = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 40, "height": 30})
INFRARED = hv.Camera.from_file("ir-bolometer-160-57deg-full").changed(camera={"width": 24, "height": 18})
PLACE: dict[str, Any] = {"altitude_km": 550, "latitude_deg": 10, "longitude_deg": 20, "mount_roll_deg": 65}

_opened: list[str] | None = None


def _note(event: str, arguments: tuple[Any, ...]) -> None:
    if _opened is not None and (event == "open" or event.startswith(("os.", "shutil.", "subprocess.", "socket."))):
        _opened.append(f"{event} {arguments}")


sys.addaudithook(_note)


@contextmanager
def _watched() -> Iterator[list[str]]:
    """List what the interpreter opens."""
    global _opened
    events: list[str] = []
    _opened = events
    try:
        yield events
    finally:
        _opened = None


def _session(camera: hv.Camera = VISIBLE, **keywords: Any) -> hv.Session:
    return hv.Session(camera, **{**PLACE, "render": {"orders": "single"}, **keywords})


def _assert_same(frame: hv.Frame, other: hv.Frame) -> None:
    assert frame.truth.to_dict() == other.truth.to_dict()
    assert frame.render == other.render
    for part in ("radiance", "energy_radiance", "maps"):
        ours, theirs = getattr(frame, part), getattr(other, part)
        assert list(ours) == list(theirs)
        for name in ours:
            np.testing.assert_array_equal(ours[name], theirs[name])


@pytest.mark.parametrize(
    ("camera", "keywords"),
    [
        (VISIBLE, {"epoch_utc": "2026-06-20T09:00Z", "surface": {"kind": "earth"}, "clouds": {"cover": 0.4}}),
        pytest.param(
            VISIBLE,
            {"sun": {"zenith_deg": 100.0}, "moon": {"zenith_deg": 100.0}, "night": {"airglow": True}},
            marks=pytest.mark.slow,
        ),
        (INFRARED, {"attitude": {"rate_deg_s": [0.0, 0.5, 0.0]}}),
    ],
    ids=["day", "night", "infrared"],
)
def test_a_frame_has_the_bytes_of_its_scene_rendered_alone(camera: hv.Camera, keywords: dict[str, Any]) -> None:
    session = _session(camera, **keywords)
    session.frame((80.0, 3.0, -2.0))
    frame = session.frame((5.0, 1.0, -3.0))
    image = session.image((5.0, 1.0, -3.0), seed=4)
    alone = hv.render(hv.Scene(camera, **PLACE, render={"orders": "single"}, **_merged(keywords)), progress=False)
    _assert_same(frame, alone)
    assert frame.scene == alone.scene
    again = alone.observe(seed=4)
    np.testing.assert_array_equal(image.dn, again.dn)
    assert image.observation == again.observation
    assert image.truth.to_dict() == again.truth.to_dict()


def _merged(keywords: dict[str, Any]) -> dict[str, Any]:
    return {**keywords, "yaw_deg": 5.0, "pitch_deg": 1.0, "roll_deg": -3.0}


def test_angles_quaternions_and_keys_are_the_same_attitude() -> None:
    session = _session()
    truth = session.frame((12.0, -4.0, 3.0)).truth
    _assert_same(session.frame({"yaw_deg": 12, "pitch_deg": np.float64(-4), "roll_deg": 3}), session.frame([12, -4, 3]))
    turned = session.frame(np.array(truth.q_body_from_lvlh)).truth
    assert np.allclose(turned.q_cam_from_itrs, truth.q_cam_from_itrs, rtol=0, atol=1e-14)
    assert session.frame().truth.yaw_rad == 0.0


def test_keys_that_are_not_named_stay() -> None:
    session = _session(yaw_deg=7.0, attitude={"rate_deg_s": [1.0, 0.0, 0.0]})
    scene = session.frame({"roll_deg": 2.0, "mount_roll_deg": 60.0}).scene.spec
    assert (scene.attitude.yaw_deg, scene.attitude.roll_deg, scene.attitude.rate_deg_s) == (7.0, 2.0, (1.0, 0.0, 0.0))
    assert (scene.camera.mount_roll_deg, session.scene.spec.camera.mount_roll_deg) == (60.0, 65.0)


@pytest.mark.parametrize("camera", [VISIBLE, INFRARED], ids=["visible", "infrared"])
def test_no_disk_after_the_first_frame_and_image(camera: hv.Camera) -> None:
    session = _session(camera, surface={"kind": "earth"})
    session.frame()
    session.image()
    with _watched() as events:
        session.frame((10.0, 2.0, 1.0))
        session.image({"yaw_deg": 20.0}, seed=3)
    assert events == []


def test_what_a_place_has_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    described, describe = [], rendering.describe

    def counted(*arguments: Any) -> Any:
        described.append(arguments)
        return describe(*arguments)

    monkeypatch.setattr(rendering, "describe", counted)
    session = _session()
    for yaw in range(3):
        session.image((yaw, 0.0, 0.0))
    assert len(described) == 1
    session.move(latitude_deg=-20.0)
    moved = session.frame()
    assert len(described) == 2
    _assert_same(moved, hv.render(session.scene, progress=False))


def test_truths_share_nothing_that_can_be_changed() -> None:
    session = _session(INFRARED)
    first, second = session.frame(), session.frame()
    first.truth.infrared_horizon["lwir"]["azimuth_deg"].clear()
    first.truth.scene["attitude"]["yaw_deg"] = 90.0
    assert second.truth.infrared_horizon["lwir"]["azimuth_deg"]
    assert session.frame().truth.to_dict() == second.truth.to_dict()


def test_an_exposure_is_that_of_the_camera_with_it() -> None:
    session = _session()
    image = session.image(seed=2, exposure_s=1e-4)
    assert image.camera.spec.detector.exposure_s == 1e-4
    np.testing.assert_array_equal(image.dn, session.frame().observe(seed=2, camera=image.camera).dn)
    assert image.dn.mean() < session.image(seed=2).dn.mean()


@pytest.mark.parametrize(
    ("attitude", "where"),
    [
        ((1.0, 2.0), "Session: attitude"),
        ((1.0, 2.0, float("nan")), "Session: attitude"),
        ("nadir", "Session: attitude"),
        (7.0, "Session: attitude"),
        ((0.0, 0.0, 0.0, 2.0), "Session: attitude"),
        ({"yaw": 3.0}, "Session: attitude: yaw"),
        ({"yaw_deg": "3"}, "Session: attitude: yaw_deg"),
        ({"mount_roll_deg": float("inf")}, "Session: attitude: mount_roll_deg"),
    ],
)
def test_an_attitude_that_is_none_is_one_line(attitude: Any, where: str) -> None:
    with pytest.raises(hv.UserError) as raised:
        _session().frame(attitude)
    assert raised.value.where == where
    assert "\n" not in str(raised.value)


def test_other_mistakes_are_one_line_and_leave_the_session_where_it_is() -> None:
    session = _session()
    place = session.scene
    with pytest.raises(hv.UserError, match="latitude_deg"):
        session.move(latitude_deg=100.0)
    assert session.scene is place
    with pytest.raises(hv.UserError, match="exposure_s"):
        session.image(exposure_s=-1.0)
    with pytest.raises(hv.UserError, match="unknown keyword"):
        hv.Session(VISIBLE, altitude=550)
    assert repr(session).startswith("<Session scene: vis-cmos-512-60deg at 550 km")
