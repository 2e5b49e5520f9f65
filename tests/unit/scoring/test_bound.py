"""The bound of a frame, against pictures and closed forms that share no code with it."""

from __future__ import annotations

import math
from dataclasses import replace

import limb_image
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ndtr
from synthetic import truth_at

from horizonval.earth.limb_heights import Relief, systematic_covariance
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.ellipsoid import WGS84, sphere
from horizonval.geometry.horizon import horizon_directions
from horizonval.scoring.bound import ARCSEC, NO_BOUND, bound_of
from horizonval.scoring.information import SHAPES, LimbInformation, limb_information, limb_motion
from horizonval.sensor.expected_image import ExpectedImage

SIGMA = 2.55
"""One per cent of 255."""


def _expected(mean: np.ndarray, variance: float) -> ExpectedImage:
    return ExpectedImage(mean, np.full(mean.shape, variance), np.ones(mean.shape, bool), 0.0, np.ones(mean.shape))


def _information(picture, reliefs=(), variance: float = SIGMA**2 + 1 / 12) -> LimbInformation:
    camera = CameraModel(
        picture.width,
        picture.height,
        picture.focal_px,
        picture.focal_px,
        (picture.width - 1) / 2,
        (picture.height - 1) / 2,
    )
    r = -(limb_image.RADIUS_M + picture.altitude_m) * picture.nadir
    found = limb_information(
        _expected(limb_image.picture(picture), variance), camera, np.eye(3), r, sphere(limb_image.RADIUS_M), reliefs
    )
    return found


def _tilt_arcsec(information: np.ndarray, nadir: np.ndarray, *, altitude_known: bool, distance_m: float) -> float:
    """Root of the trace of the nadir's covariance, yaw and place fixed: tilts about two axes, and the altitude."""
    first = np.cross(nadir, [0.3, 0.8, 0.5])
    first /= np.linalg.norm(first)
    second = np.cross(nadir, first)
    unknowns = np.zeros((len(information), 2 if altitude_known else 3))
    unknowns[:3, 0], unknowns[:3, 1] = first, second
    if not altitude_known:
        unknowns[3:6, 2] = -nadir * distance_m
    covariance = np.linalg.inv(unknowns.T @ information @ unknowns)
    return math.sqrt(np.trace(covariance[:2, :2])) / ARCSEC


NADIR = (0.0, math.sin(math.radians(62.0)), math.cos(math.radians(62.0)))


def _sphere(width, height, fov_deg, nadir=NADIR, altitude_m=500e3, soft_m=0.0):
    return limb_image.Sphere(
        width, height, width / 2 / math.tan(math.radians(fov_deg / 2)), nadir, altitude_m, scale_height_m=soft_m
    )


@pytest.mark.parametrize(
    "picture",
    [
        _sphere(128, 128, 20.0, (0.0, 0.0, 1.0), 35786e3),
        _sphere(192, 192, 60.0),
        _sphere(160, 120, 57.0),
        _sphere(192, 192, 60.0, soft_m=8e3),
    ],
    ids=["disc", "arc", "infrared", "soft arc"],
)
@pytest.mark.parametrize("altitude_known", [False, True])
def test_the_bound_is_that_of_differences_of_whole_pictures(picture, altitude_known):
    """Independent pictures on a fine grid, differentiated by differences, brightness and blur free: those cost 1 % of
    what a place is known to, the spline 0.3 %, and the picture's own bound with them lies between noise and knowledge.
    """
    information = _information(picture)
    distance = limb_image.RADIUS_M + picture.altitude_m
    noise, known = (
        _tilt_arcsec(matrix, picture.nadir, altitude_known=altitude_known, distance_m=distance)
        for matrix in (information.by_noise, information.by_knowledge)
    )
    reference = math.sqrt(np.trace(limb_image.bound_rad(picture, altitude_known=altitude_known))) / ARCSEC
    assert noise == pytest.approx(reference, rel=0.02)
    assert noise < known < 1.10 * reference


def test_a_full_disc_has_the_bound_in_closed_form():
    r"""Around a disc of n = 2 pi r pixels of limb, each with the information ``A^2 / (2 sqrt(pi) s sigma^2)`` on its
    place (the square of a Gaussian slope, summed), a shift by two axes shares it: trace = 2 / (n i / 2).
    """
    picture = _sphere(128, 128, 20.0, (0.0, 0.0, 1.0), 35786e3)
    information = _information(picture)
    blur = math.sqrt(0.7**2 + 1 / 12)
    each = (picture.earth - picture.space) ** 2 / (2 * math.sqrt(math.pi) * blur) / (SIGMA**2 + 1 / 12)
    radius = picture.focal_px * math.tan(math.asin(limb_image.RADIUS_M / (limb_image.RADIUS_M + picture.altitude_m)))
    shift_px = math.sqrt(2.0 / (0.5 * 2.0 * math.pi * radius * each))
    expected = shift_px / picture.focal_px / ARCSEC
    found = _tilt_arcsec(information.by_noise, picture.nadir, altitude_known=True, distance_m=42157e3)
    # The pinhole's stretch over 9 deg, and the spline: 1.5 %.
    assert found == pytest.approx(expected, rel=0.03)


def test_a_straight_edge_has_the_bound_in_closed_form():
    """Of a linear array that a limb crosses there is one number to know, and it is the edge's place."""
    camera = CameraModel(160, 1, 160.0, 160.0, 79.5, 0.0)
    altitude = 500e3
    rho = math.asin(6371e3 / (6371e3 + altitude))
    nadir = np.array([math.sin(rho), 0.0, math.cos(rho)])
    blur = 0.9
    limb_px = 79.5
    mean = 20.0 + 100.0 * ndtr((np.arange(160) - limb_px) / blur)[None, :]
    found = limb_information(_expected(mean, 1.0), camera, np.eye(3), -(6371e3 + altitude) * nadir, sphere(6371e3))
    px_per_rad = 160.0
    expected = (100.0**2 / (2.0 * math.sqrt(math.pi) * blur)) * px_per_rad**2
    # A turn about the camera's y axis carries the limb along the row.
    assert found.by_noise[1, 1] == pytest.approx(expected, rel=0.01)
    assert found.by_noise[2, 2] < 1e-6 * expected


def test_the_limb_moves_as_the_exact_horizon_does():
    """Directions of the exact horizon of a pose are on the limb, and stay on it where the motion says they go."""
    r = np.array([4000e3, 3000e3, 4700e3])
    camera = CameraModel(512, 512, 443.0, 443.0, 255.5, 255.5)
    nadir = -r / np.linalg.norm(r)
    directions = horizon_directions(r, WGS84, np.linspace(0.0, 6.28, 400))
    z = directions[7]
    x = np.cross(nadir, z)
    x /= np.linalg.norm(x)
    cam_from_itrs = np.array([x, np.cross(z, x), z])

    def seen(position, ellipsoid=WGS84):
        uv, ahead = project(
            camera, horizon_directions(position, ellipsoid, np.linspace(0.0, 6.28, 4000)) @ cam_from_itrs.T
        )
        inside = ahead & (uv > 20).all(axis=1) & (uv < 490).all(axis=1)
        return uv[inside]

    uv = seen(r)
    motion = limb_motion(camera, uv, cam_from_itrs, r, WGS84.axes_m)
    assert np.abs(motion.distance_px).max() < 1e-7
    for k, move in enumerate(np.eye(3) * 1e3):
        moved = seen(r + move)
        at = limb_motion(camera, moved, cam_from_itrs, r, WGS84.axes_m)
        # F of the old pose where the new limb is, and what the derivative takes it down by: a kilometre, second order.
        assert at.value + at.by_pose[3 + k] * 1e3 == pytest.approx(
            0.0, abs=2e-3 * np.abs(at.by_pose[3 + k] * 1e3).max() + 1e-9
        )
    risen = seen(r, WGS84.raised(1e3))
    at = limb_motion(camera, risen, cam_from_itrs, r, WGS84.axes_m)
    assert at.height_m == pytest.approx(1e3, rel=5e-3)
    turn = np.array([2e-4, -1e-4, 3e-4])
    at = limb_motion(camera, uv, cam_from_itrs, r, WGS84.axes_m)
    # The camera turns by theta in its own axes: itrs_from_cam' = itrs_from_cam exp(theta).
    turned = limb_motion(camera, uv, Rotation.from_rotvec(turn).as_matrix().T @ cam_from_itrs, r, WGS84.axes_m)
    assert turned.value - at.value == pytest.approx(
        turn @ at.by_pose[:3], abs=1e-3 * np.abs(turn @ at.by_pose[:3]).max()
    )


def test_relief_and_height_cost_what_they_are_unknown_by():
    picture = _sphere(160, 120, 57.0)
    flat, uneven = _information(picture), _information(picture, (Relief(800.0, 0.4),))
    assert np.array_equal(flat.by_noise, uneven.by_noise)
    tilts = [
        _tilt_arcsec(one.by_knowledge, picture.nadir, altitude_known=True, distance_m=6871e3) for one in (flat, uneven)
    ]
    # 800 m of limb over 0.4 rad, seen over 2600 km, is 63 arcsec where it is all of an arc.
    assert 20.0 < math.sqrt(tilts[1] ** 2 - tilts[0] ** 2) < 120.0


def test_two_heads_know_what_both_know_and_text_keeps_it():
    one = _information(_sphere(64, 64, 20.0, (0.0, 0.0, 1.0), 35786e3))
    both = one + one
    assert both.by_noise == pytest.approx(2.0 * one.by_noise)
    kept = LimbInformation.from_dict(both.to_dict())
    assert kept.by_knowledge == pytest.approx(both.by_knowledge, rel=1e-11)
    assert LimbInformation.from_dict(None) is None
    assert LimbInformation.from_dict({**both.to_dict(), "schema": 0}) is None


def test_what_is_known_beside_the_image_is_in_the_bound():
    """An altitude known to a metre gives the bound of a known one; the limb's height alone cannot be told from it."""
    picture = _sphere(160, 120, 57.0)
    information = _information(picture)
    bounds = {}
    for name, prior in {
        "free": {},
        "altitude": {"altitude_sigma_km": 1e-3},
        "altitude and limb": {"altitude_sigma_km": 1e-3, "limb_height_sigma_km": 1e-3},
    }.items():
        truth = truth_at(altitude_km=500.0)
        truth = replace(truth, ellipsoid_b_m=truth.ellipsoid_a_m)
        # The information is of axes in which the body looks as this truth's nadir says.
        turned = _turned(information, picture.nadir, np.array(truth.nadir_geocentric_cam), truth)
        bounds[name] = bound_of(
            turned, replace(truth, scene={**truth.scene, "prior": prior}), truth.camera_spec.band[0].name
        )
    free, altitude, limb = (bounds[name] for name in ("free", "altitude", "altitude and limb"))
    assert free.noise_arcsec == pytest.approx(55.8, rel=0.03)
    assert altitude.noise_arcsec == pytest.approx(8.0, rel=0.03)
    assert altitude.known_arcsec > 3.0 * limb.known_arcsec
    assert bound_of(None, truth_at(), "vis") == NO_BOUND


def _turned(information: LimbInformation, seen_nadir, nadir, truth) -> LimbInformation:
    """Return an information in the axes of a truth: turn of the body, position in Earth-fixed axes."""
    body_from_cam = Rotation.from_quat(truth.q_cam_from_body).inv().as_matrix()
    itrs_from_cam = Rotation.from_quat(truth.q_cam_from_itrs).inv().as_matrix()
    turn = Rotation.align_vectors([nadir], [seen_nadir])[0].as_matrix()
    both = np.zeros((12, 12))
    both[:3, :3], both[3:6, 3:6], both[6, 6] = body_from_cam @ turn, itrs_from_cam @ turn, 1.0
    # The shape's matrices turn with the axes that they are in.
    moved = itrs_from_cam @ turn
    both[7:, 7:] = np.einsum("kab,ac,lcd,bd->kl", SHAPES, moved, SHAPES, moved)
    return LimbInformation(
        both @ information.by_noise @ both.T, both @ information.by_knowledge @ both.T, information.limb_height_m
    )


def test_an_image_without_limb_has_no_bound():
    camera = CameraModel(64, 64, 100.0, 100.0, 31.5, 31.5)
    r = np.array([0.0, 0.0, 7000e3])
    assert limb_information(_expected(np.ones((64, 64)), 1.0), camera, np.eye(3), r, WGS84) is None
    down = np.diag([1.0, -1.0, -1.0])
    assert limb_information(_expected(np.ones((64, 64)), 1.0), camera, down, r, WGS84) is None


def test_a_limb_of_one_pixel_says_nothing_in_numbers():
    """Its level may be all of it, and of the gain of a single pixel nothing is known."""
    camera = CameraModel(160, 1, 160.0, 160.0, 79.5, 0.0)
    rho = math.asin(6371e3 / 6871e3)
    mean = 20.0 + 100.0 * ndtr((np.arange(160) - 79.5) / 0.9)[None, :]
    expected = replace(_expected(mean, 1.0), reads=np.arange(160)[None, :] == 80)
    r = -6871e3 * np.array([math.sin(rho), 0.0, math.cos(rho)])
    found = limb_information(expected, camera, np.eye(3), r, sphere(6371e3))
    assert np.isfinite(found.by_noise).all()
    # A hundred kilometres of height, or a radian of tilt, would be as likely.
    assert np.abs(found.by_knowledge[:3, :3]).max() < 1.0
    assert abs(found.by_knowledge[6, 6]) < 1e-5**2


def test_a_flattening_with_a_pole_anywhere_is_the_oblateness_of_cones():
    """Of a full disc alone the tilt that the flattening may make, against that of a cone, the mean over 400 poles."""
    picture = _sphere(96, 96, 20.0, (0.0, 0.0, 1.0), 35786e3)
    truth = truth_at(altitude_km=35786.0)
    turned = _turned(_information(picture), picture.nadir, np.array(truth.nadir_geocentric_cam), truth)
    flat = replace(truth, ellipsoid_b_m=truth.ellipsoid_a_m)
    band = truth.camera_spec.band[0].name
    oblate, round_ = (bound_of(turned, one, band).known_rad for one in (truth, flat))
    rho = math.asin(limb_image.RADIUS_M / (limb_image.RADIUS_M + picture.altitude_m))
    around = np.linspace(0.0, 2.0 * math.pi, 360, endpoint=False)
    los = np.column_stack([math.sin(rho) * np.cos(around), math.sin(rho) * np.sin(around), np.full(360, math.cos(rho))])
    systematic = systematic_covariance(
        los,
        np.array([0.0, 0.0, 1.0]),
        rho,
        flattening=truth.ellipsoid.flattening,
        reliefs=(),
        earth_radius_m=truth.ellipsoid_a_m,
    )
    expected = math.sqrt(np.trace(systematic[:2, :2]))
    # The disc's own bound is a tenth of it; weights of pixels differ round the disc by 2 %.
    assert math.sqrt(oblate**2 - round_**2) == pytest.approx(expected, rel=0.03)
