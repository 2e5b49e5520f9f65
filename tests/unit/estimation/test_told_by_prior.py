"""What the keys of a prior and a camera's uncertainty do to an answer, by files as a user gives them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from limb_image import Sphere, bound_rad, noisy, picture

import horizonval as hv

ARCSEC = np.radians(1.0 / 3600.0)
OFF, TURN = np.radians(64.0), np.radians(100.0)
SMALL = Sphere(
    160, 120, 147.3, (np.sin(OFF) * np.cos(TURN), np.sin(OFF) * np.sin(TURN), np.cos(OFF)), 500e3, tilt=(2e-3, -5e-3)
)
CAMERA = "[camera]\nwidth = 160\nheight = 120\nfx = 147.3\n"
EXACT = """[camera.uncertainty]
focal_length_sigma_percent = 0.0
principal_point_sigma_px = 0.0
distortion_sigma_px = 0.0
"""
SPHERE = '[prior]\nshape = "sphere"\nradius_km = 6371.0088\n'
HARD = "limb_scale_height_km = 0.0\nlimb_scale_height_sigma_km = 0.0\nlimb_relief_km = 0.0\n"
KNOWN = "altitude_km = 500.0\naltitude_sigma_km = 0.001\nlimb_height_km = 0.0\nlimb_height_sigma_km = 0.001\n"


def _answers(folder: Path, prior: str, draws: int, camera: str = CAMERA + EXACT) -> list[hv.Fit]:
    """Return the answers of the fit of a sphere to pictures with different noise."""
    (folder / "camera.toml").write_text(camera)
    (folder / "prior.toml").write_text(prior)
    rng, clean, fits = np.random.default_rng(4), picture(SMALL), []
    for _ in range(draws):
        cv2.imwrite(str(folder / "sphere.png"), noisy(clean, rng).astype(np.uint8))
        fit = hv.estimate(
            folder / "sphere.png", "limb-sphere", camera=folder / "camera.toml", prior=folder / "prior.toml"
        )
        assert isinstance(fit, hv.Fit), fit
        fits.append(fit)
    return fits


def _claimed(fit: hv.Fit) -> float:
    return float(np.sqrt(np.trace(fit.total_covariance_nadir_cam)))


@pytest.mark.parametrize(("known", "stated"), [(False, HARD), (True, HARD + KNOWN)], ids=["free", "known"])
def test_a_hard_sphere_is_found_to_the_bound_by_who_says_that_it_is_hard(
    tmp_path: Path, known: bool, stated: str
) -> None:
    """Ten draws: an rms of one direction has a standard error of 22 %."""
    fits = _answers(tmp_path, SPHERE + stated, 10)
    bound = float(np.sqrt(np.trace(bound_rad(SMALL, altitude_known=known))))
    rms = float(np.sqrt(np.mean([np.sum((fit.nadir_cam - SMALL.nadir) ** 2) for fit in fits])))
    assert rms < 1.7 * bound
    assert _claimed(fits[0]) == pytest.approx(bound, rel=0.1)


def test_who_says_nothing_of_the_limb_has_an_honest_claim(tmp_path: Path) -> None:
    (fit,) = _answers(tmp_path, SPHERE, 1)
    error = np.array(SMALL.across) @ (fit.nadir_cam - SMALL.nadir)
    claimed = np.array(SMALL.across) @ fit.total_covariance_nadir_cam @ np.array(SMALL.across).T
    assert error @ np.linalg.solve(claimed, error) < 9.0
    assert _claimed(fit) > 200.0 * ARCSEC


def test_a_rough_nadir_is_a_prior_of_the_tilt(tmp_path: Path) -> None:
    """Ten degrees change nothing; ten arcseconds are the claim where the image says 50."""
    (free,) = _answers(tmp_path, SPHERE + HARD, 1)
    towards = f"nadir_cam = {SMALL.nadir.tolist()}\n"
    (rough,) = _answers(tmp_path, f"{SPHERE}{HARD}{towards}attitude_sigma_deg = [10, 10, 10]\n", 1)
    (tight,) = _answers(tmp_path, f"{SPHERE}{HARD}{towards}attitude_sigma_deg = [0.003, 0.003, 0.003]\n", 1)
    assert np.linalg.norm(rough.nadir_cam - free.nadir_cam) < 1e-2 * _claimed(free)
    assert _claimed(tight) < 0.4 * _claimed(free)
    assert np.linalg.norm(tight.nadir_cam - SMALL.nadir) < 3.0 * _claimed(tight)


def test_errors_of_the_lens_are_claimed_as_a_camera_with_them_turns_the_answer(tmp_path: Path) -> None:
    """Where the image cannot show them: of the focal length it shows more than a sigma of 0.5 %, and uses it."""
    known = SPHERE + HARD + KNOWN
    (exact,) = _answers(tmp_path, known, 1)
    (told,) = _answers(tmp_path, known, 1, CAMERA + EXACT.replace("point_sigma_px = 0.0", "point_sigma_px = 0.5"))
    (moved,) = _answers(tmp_path, known, 1, CAMERA + "cy = 60.0\n" + EXACT)
    along = moved.nadir_cam - exact.nadir_cam
    size = float(np.linalg.norm(along))
    added = told.total_covariance_nadir_cam - exact.total_covariance_nadir_cam
    assert np.sqrt(along @ added @ along) / size == pytest.approx(size, rel=0.1)
    longer = CAMERA.replace("147.3", "148.0365")
    (wrong,) = _answers(tmp_path, known, 1, longer + EXACT)
    (open_,) = _answers(tmp_path, known, 1, longer + EXACT.replace("sigma_percent = 0.0", "sigma_percent = 0.5"))
    assert np.linalg.norm(wrong.nadir_cam - SMALL.nadir) > 2.0 * _claimed(wrong)
    assert np.linalg.norm(open_.nadir_cam - SMALL.nadir) < 2.0 * _claimed(open_)


def test_a_picture_whose_camera_states_no_uncertainty_has_that_of_a_careful_calibration(tmp_path: Path) -> None:
    (exact,) = _answers(tmp_path, SPHERE + HARD + KNOWN, 1)
    (usual,) = _answers(tmp_path, SPHERE + HARD + KNOWN, 1, CAMERA)
    added = np.sqrt(_claimed(usual) ** 2 - _claimed(exact) ** 2)
    # 0.2 px on the axis across and along the plane of boresight and nadir, and the rest of it.
    assert 0.2 / 147.3 < added < 0.4 / 147.3
