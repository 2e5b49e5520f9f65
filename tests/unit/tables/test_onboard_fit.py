"""The reference of the fit in C on pictures that are made here: its claim holds, and it refuses what is no limb."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest
from onboard import answer, make_program
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from horizonval.api.estimate import mission_table
from horizonval.estimation.fit.templates import shipped_templates
from horizonval.tables.mission import write_table

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")

WIDTH, HEIGHT, FINER = 160, 120, 4
FOCAL = 0.5 * WIDTH / np.tan(np.radians(57.0 / 2))
CX, CY = 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)
AXES = np.array([6378137.0, 6378137.0, 6356752.314245])
MONTH, BLUR_PX, NOISE = 3.2, 0.6, 20.0
SIGMA_M, SIGMA_RAD = 1000.0, np.radians(2.0)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    folder = tmp_path_factory.mktemp("onboard")
    write_table(mission_table("limb-fits", "lwir", 0.005), folder / "table.h")
    return make_program(folder)


def picture(r_itrs, cam_from_itrs, coefficients):
    """Return a limb from the shipped table, finer pixels blurred by a Gaussian and averaged, shape (HEIGHT, WIDTH)."""
    u, v = ((np.arange(n * FINER) + 0.5) / FINER - 0.5 for n in (WIDTH, HEIGHT))
    x, y = np.meshgrid((u - CX) / FOCAL, (v - CY) / FOCAL)
    los = np.stack([x, y, np.ones_like(x)], axis=-1)
    los /= np.linalg.norm(los, axis=-1, keepdims=True)
    p, e = r_itrs / AXES, los @ cam_from_itrs / AXES
    along = -(e @ p) / (e * e).sum(axis=-1)
    q = p + along[..., None] * e
    distance = np.linalg.norm(q, axis=-1)
    normal = q / distance[..., None] / AXES
    size = np.linalg.norm(normal, axis=-1)
    height, latitude = (distance - 1.0) / size, np.arcsin(normal[..., 2] / size)
    table = shipped_templates("thermal", (8.0, 14.0))
    assert table is not None
    rows = np.radians(np.arange(-90.0, 91.0, 2.0))
    mean, modes, _ = table.at(rows, MONTH)
    values = mean + np.einsum("k,nkh->nh", coefficients, modes)
    at = RegularGridInterpolator((rows, table.height_m), values, bounds_error=False, fill_value=0.0)
    light = at(np.stack([latitude, np.maximum(height, table.height_m[0])], axis=-1)) * los[..., 2] ** 4
    light = gaussian_filter(np.where(along > 0.0, light, 0.0), BLUR_PX * FINER)
    return light.reshape(HEIGHT, FINER, WIDTH, FINER).mean(axis=(1, 3))


def pose(rng):
    """Return a position over -10 to 30 deg and an attitude that looks at the limb."""
    latitude, azimuth = np.radians(rng.uniform(-10.0, 30.0)), rng.uniform(0.0, 2.0 * np.pi)
    up = np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    east, north = np.array([0.0, 1.0, 0.0]), np.array([-np.sin(latitude), 0.0, np.cos(latitude)])
    r_itrs = up * (6371e3 + rng.uniform(400e3, 900e3))
    side = np.cos(azimuth) * east + np.sin(azimuth) * north
    rho = np.arcsin(6371e3 / np.linalg.norm(r_itrs))
    z = -np.cos(rho) * up + np.sin(rho) * side
    y = -np.cos(rho) * side - np.sin(rho) * up
    return r_itrs, np.stack([np.cross(y, z), y, z])


def told(program, numbers, r_itrs, cam_from_itrs):
    q = Rotation.from_matrix(cam_from_itrs).as_quat()
    known = [WIDTH, HEIGHT, FOCAL, FOCAL, CX, CY, *r_itrs, SIGMA_M, *q, SIGMA_RAD, MONTH]
    known += [0, 0, 1, 0, 0, 1, BLUR_PX, 0.3, 300.0]
    return answer(program, [*known, 1.0, 0.0, 0.0], numbers)


def test_errors_are_what_is_claimed(program):
    rng = np.random.default_rng(4)
    table = shipped_templates("thermal", (8.0, 14.0))
    assert table is not None
    modes, squares = len(table.mode_kinds), []
    for _ in range(6):
        r_itrs, cam_from_itrs = pose(rng)
        coefficients = np.where(np.arange(modes) < 5, 0.7 * rng.standard_normal(modes), 0.0)
        light = picture(r_itrs, cam_from_itrs, coefficients)
        noisy = 500.0 + 12_000.0 * light / light.max() + NOISE * rng.standard_normal(light.shape)
        numbers = np.clip(np.rint(noisy), 0, 65535).astype(np.uint16)
        turned = Rotation.from_rotvec(SIGMA_RAD * rng.standard_normal(3)).as_matrix() @ cam_from_itrs
        found = told(program, numbers, r_itrs + SIGMA_M * rng.standard_normal(3), turned)
        assert found["status"] == "valid", found
        truth = -cam_from_itrs @ r_itrs / np.linalg.norm(r_itrs)
        error = np.degrees(np.linalg.norm(np.cross(found["nadir_cam"], truth))) * 3600.0
        assert 20.0 < found["sigma_nadir_arcsec"] < 200.0
        squares.append((error / found["sigma_nadir_arcsec"]) ** 2)
    # the mean of six squares of two dimensions each lies in 0.2 to 2.6 in 99.8 of 100 cases
    assert 0.2 < np.mean(squares) < 2.6


def test_what_is_no_limb_is_refused(program):
    rng = np.random.default_rng(5)
    r_itrs, cam_from_itrs = pose(rng)
    noise = rng.integers(0, 4000, (HEIGHT, WIDTH)).astype(np.uint16)
    assert told(program, noise, r_itrs, cam_from_itrs)["status"] in ("no_limb", "not_converged")
    done = subprocess.run([program], input=b"160 120 nonsense\n", capture_output=True, check=True)
    assert json.loads(done.stdout)["status"] == "bad_input"
