"""What is predicted of a limb is what the rendered and observed frame shows.

Frames are 128 pixels wide. Their exposure is set so that the limb lies at half of full scale, and what the image shows
is scaled back: a level above full scale can then be seen, too.
"""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.api.check.limb import LimbView, limb_views
from horizonval.frame import RadianceFrame
from horizonval.geometry.camera import camera_from_spec, project
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.horizon import horizon_cam
from horizonval.renderer.frame import render_frame
from horizonval.scoring.horizon_view import inside_image
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos
from horizonval.spec.earth import Clouds, Surface
from horizonval.spec.load import load_scene
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import truth_of

WIDTH = 128
ABOVE_RAD, BELOW_RAD = 0.02, 0.02
"""Where the limb is looked for about the true horizon: from 50 km above it to 50 km below, from 500 km up."""


def small(camera: CameraSpec) -> CameraSpec:
    scale = WIDTH / camera.camera.width
    height = round(camera.camera.height * scale)
    return camera.model_copy(update={"camera": camera.camera.model_copy(update={"width": WIDTH, "height": height})})


def exposed(camera: CameraSpec, factor: float) -> CameraSpec:
    assert isinstance(camera.detector, Cmos)
    seconds = camera.detector.exposure_s * factor
    return camera.model_copy(update={"detector": camera.detector.model_copy(update={"exposure_s": seconds})})


def scene_of(name: str, aerosol: str = "none") -> tuple[SceneSpec, CameraSpec]:
    scene, camera = load_scene(name)
    assert camera.camera.fov_deg is not None
    settings = scene.render.model_copy(update={"nodes": 64, "subsamples": 1})
    clear = scene.atmosphere.model_copy(update={"aerosol": aerosol, "refraction": False})
    return scene.model_copy(update={"render": settings, "atmosphere": clear}), small(camera)


def shown(frame: RadianceFrame, camera: CameraSpec, view: LimbView) -> np.ndarray:
    """Return the brightest level of every profile across the limb, over full scale above the black level."""
    factor = 1.0
    if isinstance(camera.detector, Cmos):
        assert view.highest is not None
        factor = 0.5 / view.highest
        camera = exposed(camera, factor)
    image = observe(frame, camera, view.band.name, noise=False)
    black = getattr(camera.detector, "black_level_dn", 0.0)
    level = (image.dn - black) / (image.full_scale - black) / factor
    truth, geometry = frame.truth, camera_from_spec(camera.camera)
    los = horizon_cam(truth.r_itrs, truth.q_cam_from_itrs, Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m), 3600)
    los = los[inside_image(geometry, project(geometry, los)[0], 2.0)]
    nadir = np.array(truth.nadir_geocentric_cam)
    down = nadir - (los @ nadir)[:, None] * los
    down /= np.linalg.norm(down, axis=-1)[:, None]
    peak = np.zeros(len(los))
    for angle in np.linspace(-ABOVE_RAD, BELOW_RAD, 41):
        uv, _ = project(geometry, los * np.cos(angle) + down * np.sin(angle))
        column, row = np.clip(np.rint(uv).astype(int), 0, [geometry.width - 1, geometry.height - 1]).T
        peak = np.maximum(peak, np.where(inside_image(geometry, uv), level[row, column], 0.0))
    return peak


def predicted(scene: SceneSpec, camera: CameraSpec) -> tuple[RadianceFrame, list[LimbView]]:
    return render_frame(scene, camera), limb_views(truth_of(scene, camera), camera)


@pytest.mark.parametrize(
    ("name", "aerosol", "tolerance"),
    [
        ("limb-noon-vis", "none", 0.1),
        ("day-limb", "none", 0.1),
        ("twilight-03", "none", 0.5),
        ("day-limb", "background", 0.1),
        ("twilight-03", "background", 0.5),
    ],
)
def test_the_level_of_a_solar_limb(name, aerosol, tolerance):
    """Clear air by day: 5 %, taken as 10. The table of limb radiances promises a factor of two in twilight, where it
    falls by ten within 2 deg of the Sun's height; found 12 %, taken as 50. Haze is darker by a fifth by day, and twice
    as bright in twilight with the Sun ahead.
    """
    scene, camera = scene_of(name, aerosol)
    frame, (view,) = predicted(scene, camera)
    found = shown(frame, camera, view)
    assert view.level == pytest.approx(np.median(found), rel=tolerance)
    assert view.highest == pytest.approx(np.percentile(found, 98), rel=tolerance)


def test_clouds_and_ground_lie_between_the_two_levels():
    """Before clouds the table promises 30 %. The dark ocean is darker than the Earth's mean ground, which is what the
    lower level stands for."""
    scene, camera = scene_of("day-limb")
    scene = scene.model_copy(update={"clouds": Clouds(cover=0.5, seed=1), "surface": Surface(albedo=0.3)})
    frame, (view,) = predicted(scene, camera)
    found = shown(frame, camera, view)
    assert view.patchy
    assert view.highest == pytest.approx(np.percentile(found, 98), rel=0.3)
    assert view.level < np.percentile(found, 98)
    assert view.level == pytest.approx(np.percentile(found, 5), rel=0.3)


@pytest.mark.parametrize("name", ["ir-limb-tropical", "limb-night-ir"])
def test_the_level_of_a_thermal_limb(name):
    """Within 10 % in every band, taken as 15: the blur of a coarse pixel takes, the warmer air below adds."""
    scene, camera = scene_of(name)
    frame, views = predicted(scene, camera)
    for view in views:
        assert view.level == pytest.approx(np.median(shown(frame, camera, view)), rel=0.15), view.band.name


@pytest.mark.parametrize(("level", "clipped"), [(0.9, False), (1.5, True), (5.0, True)])
def test_dark_bright_and_saturated_images(level, clipped):
    """The image clips where the prediction says so; within 10 % of full scale nobody can tell."""
    scene, camera = scene_of("day-limb")
    truth = truth_of(scene, camera)
    (view,) = limb_views(truth, camera)
    camera = exposed(camera, level / view.level)
    frame, (view,) = predicted(scene, camera)
    assert view.level == pytest.approx(level, rel=1e-6)
    image = observe(frame, camera, noise=False)
    assert bool((image.dn == image.full_scale).any()) is clipped
    assert (view.saturated_share == 1.0) is clipped


def test_the_arc_is_the_outline_of_the_rendered_earth():
    """Length of the line on which the rays' lowest height is 0 in the frame's own map: to a pixel."""
    scene, camera = scene_of("limb-noon-vis")
    frame, (view,) = predicted(scene, camera)
    height = frame.maps["tangent_height"].astype(float)
    below = height < 0
    rows = np.argmax(below, axis=0)
    columns = np.arange(WIDTH)[(rows > 0)]
    upper, lower = height[rows[columns] - 1, columns], height[rows[columns], columns]
    outline = rows[columns] - 1 + upper / (upper - lower)
    length = np.hypot(np.diff(columns), np.diff(outline)).sum() * WIDTH / (len(columns) - 1)
    assert len(columns) > 0.9 * WIDTH
    assert view.arc_px == pytest.approx(length, abs=1.5)
