"""Faults put in on purpose: the lane they belong to catches each and names the scenes; without them all is quiet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from nights import key_of, plainly
from scipy import ndimage

from horizonval.core.outcome import Refusal
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.studies.regression.images import LIMB, regions_of
from horizonval.studies.regression.partners import changed, pairs_of


def test_nothing_changed_passes_bit_by_bit(night):
    images = night.unchanged()
    assert all(one["same_radiance"] and one["same_images"] == one["n_images"] == 1 for one in images.values())
    again = night.replayed(plainly)
    assert changed(pairs_of(again, night.rows)) == []
    assert night.failed(again, images) == {}


def test_a_larger_error_is_caught_by_replay(night):
    """Every claimed nadir is pushed away from the true one by three tenths of the mean error."""
    claims = [row for row in night.rows if row.nadir_error_arcsec is not None]
    before = np.mean([row.nadir_error_arcsec for row in claims])
    truth = {
        night.arrays[f"{name}:dn.vis.0"].tobytes(): about["truth"]["nadir_geocentric_cam"]
        for name, about in night.scenes.items()
    }

    def worse(name, observation):
        result = plainly(name, observation)
        if isinstance(result, Refusal):
            return result
        true = np.array(truth[observation.image.astype(np.uint16).tobytes()])
        off = result.nadir_cam - true
        pushed = result.nadir_cam + 0.3 * np.radians(before / 3600.0) * off / np.linalg.norm(off)
        return replace(result, nadir_cam=pushed / np.linalg.norm(pushed))

    rows = night.replayed(worse)
    found = night.failed(rows)
    assert found["nadir_error"] == {row.case for row in claims}
    assert len(claims) > 5
    assert not found.keys() & {"availability", "false_valid", "crashes", "without_sigma"}
    moved = changed(pairs_of(rows, night.rows))
    assert {one["scene"] for one in moved} == {row.case for row in claims}
    assert all("nadir error" in one["what"] for one in moved)


def test_half_a_pixel_is_caught_by_rendering_again(night):
    def shifted(scene, camera):
        frame = night.frames[key_of(scene)]
        moved = ndimage.shift(frame.radiance["vis"].astype(float), (0.5, 0.5), order=1, mode="nearest")
        return replace(frame, radiance={"vis": moved.astype(np.float32)})

    images = night.again(render=shifted)
    # Half a pixel in both axes is 0 to 0.71 px across the limb, by its direction.
    assert all(0.1 < image["limb_displacement"] < 0.71 for image in images.values())
    assert night.failed(images=images)["limb_displacement"] == set(night.scenes)


def test_a_wrong_sign_of_k1_is_caught_by_rendering_again(night):
    from horizonval.renderer.frame import render_frame

    def wrong(scene, camera):
        lens = camera.camera.model_copy(update={"distortion": [0.02, 0.0, 0.0, 0.0, 0.0]})
        made = render_frame(scene, camera.model_copy(update={"camera": lens}))
        return replace(night.frames[key_of(scene)], radiance=made.radiance)

    assert night.failed(images=night.again(render=wrong))["limb_displacement"] == set(night.scenes)


def test_two_percent_more_light_at_the_limb_is_caught_there(night):
    def brighter(scene, camera):
        frame = night.frames[key_of(scene)]
        limb = regions_of(frame.maps["hit"], frame.maps["tangent_height"]) == LIMB
        return replace(frame, radiance={"vis": frame.radiance["vis"] * np.where(limb, 1.02, 1.0).astype(np.float32)})

    images = night.again(render=brighter)
    assert all(image["limb_radiance"] == pytest.approx(2.0, abs=0.02) for image in images.values())
    assert night.failed(images=images) == {"limb_radiance": set(night.scenes)}, "light is not displacement"


def test_doubled_read_noise_is_caught_by_observing_again(night):
    def noisier(frame, camera: CameraSpec, **options):
        detector = camera.detector.model_copy(update={"read_noise_e": 2 * camera.detector.read_noise_e})
        return observe(frame, camera.model_copy(update={"detector": detector}), **options)

    images = night.again(observe=noisier)
    # 1 DN of read noise beside 0.29 DN of rounding: a factor of 1.93.
    assert all(80 < image["noise"] < 105 for image in images.values())
    assert night.failed(images=images) == {"noise": set(night.scenes)}


def test_rows_have_the_bound_of_their_frame(night):
    rows = [row for row in night.rows if row.is_claim]
    assert len(rows) > 5
    for row in rows:
        # Of 96 pixels over 110 deg with nothing known of the position: the flattening alone is 0.13 deg.
        assert 300.0 < row.bound_arcsec < 1500.0
        assert row.error_over_bound == pytest.approx(row.nadir_error_arcsec / row.bound_arcsec)
    # What no unbiased method undercuts in the mean square, one fit of a cone does not undercut by much.
    assert np.mean([row.error_over_bound**2 for row in rows]) > 0.3
