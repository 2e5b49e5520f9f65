"""The whole chain: order, determinism, what each stage contributes, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.sensor.observe import check_camera, observe
from horizonval.spec.camera import CameraSpec

THERMAL: dict[str, Any] = {
    "camera": {"name": "ir", "width": 64, "height": 48, "fov_deg": 1.0},
    "optics": {"f_number": 1.1},
    "band": [{"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0}],
    "detector": {"kind": "microbolometer", "pixel_pitch_um": 12.0, "netd_k": 0.05, "bits": 14},
}


def camera_with(tables: dict[str, Any], **changes: Any) -> CameraSpec:
    """Return the camera with ``detector__key`` or ``optics__key`` set."""
    tables = {k: dict(v) if isinstance(v, dict) else v for k, v in tables.items()}
    for path, value in changes.items():
        table, key = path.split("__")
        tables[table][key] = value
    return CameraSpec.model_validate(tables)


@pytest.fixture
def seen(make_frame, camera_tables):
    """Observe a frame with the sample camera, parts of it changed; return digital numbers as floats."""
    frame = make_frame()

    def run(*, radiance: Any = None, seed: int = 0, noise: bool = True, **changes: Any) -> np.ndarray:
        source = frame if radiance is None else make_frame(radiance)
        return observe(source, camera_with(camera_tables, **changes), seed=seed, noise=noise).dn.astype(float)

    return run


def test_equal_input_gives_equal_bytes_and_the_observation_is_enough(make_frame, camera_tables):
    first, second = (observe(make_frame(), camera_with(camera_tables), seed=4) for _ in range(2))
    assert first.dn.tobytes() == second.dn.tobytes()
    assert first.observation == second.observation
    assert (first.band, first.full_scale, first.dn.dtype, first.dn.shape) == ("vis", 1023, np.uint16, (30, 40))
    assert first.truth == make_frame().truth
    image = observe(make_frame(), camera_with(camera_tables, detector__exposure_s=1e-4), seed=9)
    note = image.observation
    again = observe(make_frame(), CameraSpec.model_validate(note["camera"]), image.band, note["seed"])
    np.testing.assert_array_equal(again.dn, image.dn)


@pytest.mark.parametrize("camera", [None, THERMAL])
def test_seeds_and_scenes_have_independent_noise(make_frame, camera_tables, camera):
    spec = CameraSpec.model_validate(camera or camera_tables)
    flat = make_frame(50.0 if camera else 10.0, camera)
    other = replace(flat, truth=replace(flat.truth, scene_id="d" * 64))
    images = [observe(flat, spec, seed=s) for s in range(5)] + [observe(other, spec)]
    clean = observe(flat, spec, noise=False).dn.astype(float)
    noise = np.array([(image.dn - clean).ravel() for image in images])
    correlation = np.corrcoef(noise) - np.eye(len(noise))
    assert np.abs(correlation).max() < 5 / np.sqrt(clean.size)


def test_without_noise_the_image_is_the_expected_signal(seen):
    clean = seen(noise=False)
    many = np.mean([seen(seed=s) for s in range(200)], axis=0)
    # Shot noise of at most 11 000 e- and read noise: 7.8 dn in one image, 0.55 dn in the mean of 200; and the clean
    # image is rounded.
    assert np.abs(many - clean).max() < 0.5 + 5 * 0.55
    assert abs((many - clean).mean()) < 0.1


def test_blur_comes_before_the_noise(seen):
    """Blurred noise would be correlated from pixel to pixel."""
    noise = seen(radiance=10.0, optics__psf_sigma_px=1.5) - seen(radiance=10.0, noise=False, optics__psf_sigma_px=1.5)
    neighbours = np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]
    assert abs(neighbours) < 5 / np.sqrt(noise.size)


def test_a_stage_does_not_shift_another_stages_noise(seen):
    """Read noise off: photon noise stays the same electron by electron."""
    settings = {"radiance": 10.0, "detector__gain_e_per_dn": 1.0, "detector__bits": 16}
    whole = seen(**settings)
    no_dark = seen(**settings, detector__dark_current_e_per_s=0.0)
    no_read = seen(**settings, detector__read_noise_e=0.0)
    dark = whole - no_dark
    assert set(np.unique(dark)) <= {0, 1, 2}  # 0.025 electrons on average
    assert (whole - no_read).std() == pytest.approx(13, rel=0.07)  # 3.5 standard errors


def test_full_well_and_converter_saturate(seen):
    bright = seen(radiance=1e7)
    assert (bright >= 1023 - 6).all()  # The read noise of 13 e- is one dn and acts after the full well.
    assert (seen(radiance=1e7, noise=False) == 1023).all()
    assert (seen(radiance=1e7, noise=False, detector__full_well_e=6750.0, detector__gain_e_per_dn=13.6) == 528).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e-6])
def test_impossible_radiance_is_refused(make_frame, camera_tables, value):
    frame = make_frame()
    frame.radiance["vis"][3, 5] = value
    with pytest.raises(UserError, match=r"radiance of band 'vis' is .* at column 5, row 3"):
        observe(frame, camera_with(camera_tables))


def test_cameras_that_do_not_fit_are_refused(make_frame, camera_tables):
    frame = make_frame()
    for key, value, expected in [
        ("detector", None, "detector: the camera has no detector"),
        ("band", [], "band: the camera has no band"),
        ("camera", {**camera_tables["camera"], "fov_deg": 50.0}, "camera.fx: the camera's fx is"),
        ("camera", {**camera_tables["camera"], "width": 41}, "camera.width"),
        ("detector", THERMAL["detector"], "detector.kind: a microbolometer cannot see band 'vis'"),
        ("band", [{**camera_tables["band"][0], "name": "red"}], "the frame has no radiance for band 'red'"),
        ("band", [{**camera_tables["band"][0], "kind": "thermal"}], "detector.kind: a cmos cannot see band 'vis'"),
    ]:
        with pytest.raises(UserError) as caught:
            observe(frame, CameraSpec.model_validate(camera_tables | {key: value}))
        assert expected in str(caught.value)
    with pytest.raises(UserError, match=r"band\.name: no band 'nir'; expected 'vis'"):
        observe(frame, camera_with(camera_tables), "nir")


def test_bands_are_chosen_by_name(make_frame, camera_tables):
    two = [camera_tables["band"][0], {**camera_tables["band"][0], "name": "red", "lo_um": 0.6}]
    spec = CameraSpec.model_validate(camera_tables | {"band": two})
    frame = make_frame({"vis": 5.0, "red": 10.0})
    assert observe(frame, spec).band == "vis"
    red = observe(frame, spec, "red", noise=False)
    assert red.band == "red"
    # Twice the energy, in photons of 0.675 instead of 0.6 um.
    ratio = (red.dn[15, 20] - 32) / (observe(frame, spec, "vis", noise=False).dn[15, 20] - 32)
    assert ratio == pytest.approx(2 * 0.675 / 0.6, rel=0.01)  # quantisation at 190 dn


def test_the_noise_of_a_microbolometer_is_one_power_behind_all_filters(make_frame):
    wide = THERMAL["band"][0]
    two = [wide, {"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}]
    spec = CameraSpec.model_validate(
        THERMAL | {"band": two, "detector": THERMAL["detector"] | {"netd_band": "lwir", "bits": 16}}
    )
    frame = make_frame({"lwir": 40.0, "co2": 5.0}, spec.model_dump(mode="json"))
    notes = {band: observe(frame, spec, band).observation for band in ("lwir", "co2")}
    assert notes["co2"]["sigma_radiance"] == notes["lwir"]["sigma_radiance"]
    clean, noisy = (observe(frame, spec, "co2", noise=noise).dn.astype(float) for noise in (False, True))
    found = (noisy - clean).std() * notes["co2"]["radiance_per_dn"]
    # 3072 pixels: 1.3 % of standard error; NETD at f/1.1 of Planck's slope between 8 and 14 um, 0.838 W m-2 sr-1 K-1.
    assert found == pytest.approx(0.05 * 1.1**2 * 0.838, rel=0.05)
    with pytest.raises(ValueError, match="netd_band = 'mwir' is none of the bands"):
        CameraSpec.model_validate(THERMAL | {"detector": THERMAL["detector"] | {"netd_band": "mwir"}})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"detector": None}, "no detector"),
        ({"detector": THERMAL["detector"]}, "microbolometer cannot see band 'vis' of kind 'solar'"),
        ({"optics": {"f_number": 2.0, "defocus_um": 1e4}}, "defocus_um = 10000, f_number = 2"),
        ({"optics": {"f_number": 900.0, "diffraction": True}}, "f_number = 900 .* pixel_pitch_um = 5.5"),
    ],
)
def test_cameras_that_no_frame_would_suit(camera_tables, changes, words):
    with pytest.raises(UserError, match=words):
        check_camera(CameraSpec.model_validate(camera_tables | changes))


@pytest.mark.parametrize("camera", [None, THERMAL])
def test_scenes_of_one_draw_have_the_same_noise(make_frame, camera_tables, camera):
    spec = CameraSpec.model_validate(camera or camera_tables)
    frame = make_frame() if camera is None else make_frame(camera=camera)

    def noise(scene: dict[str, Any], scene_id: str, head: str | None = None) -> np.ndarray:
        place = {"scene": {"name": "any", "seed": 3, **scene}, "camera": {"head": head}}
        seen = replace(frame, truth=replace(frame.truth, scene=place, scene_id=scene_id))
        return observe(seen, spec).dn

    shared = noise({"draw": "a"}, "1" * 64)
    np.testing.assert_array_equal(noise({"draw": "a"}, "2" * 64), shared)
    for other in (
        noise({"draw": "b"}, "1" * 64),
        noise({"draw": "a", "seed": 4}, "1" * 64),
        noise({"draw": "a"}, "1" * 64, head="left"),
        noise({}, "1" * 64),
    ):
        assert not np.array_equal(other, shared)
