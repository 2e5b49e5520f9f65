"""A mistake in a file of any kind becomes one line that names file and key."""

from __future__ import annotations

import pytest

from horizonval.core.errors import UserError
from horizonval.spec.load import load_camera, load_frames, load_prior, load_scene
from horizonval.suites.suite import load_suite

PLAIN = '[camera]\nname = "c"\nwidth = 64\nheight = 48\n'
CAMERA = PLAIN + "fov_deg = 60.0\n"
BAND = '[[band]]\nname = "vis"\nkind = "solar"\nlo_um = 0.5\nhi_um = 0.7\n'
THERMAL_BAND = '[[band]]\nname = "co2"\nkind = "thermal"\nlo_um = 14.0\nhi_um = 16.3\n'
CMOS = (
    '[detector]\nkind = "cmos"\npixel_pitch_um = 5.5\nexposure_s = 1e-3\nquantum_efficiency = 0.6\n'
    "full_well_e = 13500.0\nread_noise_e = 13.0\nbits = 10\n"
)
BOLOMETER = '[detector]\nkind = "microbolometer"\npixel_pitch_um = 17.0\nnetd_k = 0.05\nbits = 14\n'
HEADS = '[[head]]\nname = "a"\n[[head]]\nname = "b"\n'
SCATTER = "scatter = { b0 = 0.1, l_rad = 0.01, s = -2.0 }"
FISHEYE = PLAIN + 'projection = "fisheye"\n'
CAMERAS = [
    ("[camera\n", "not valid TOML"),
    ("\udcff\udcfe[camera]", "not text"),
    ("camera = 3\n", "camera: found 3"),
    ("[scene]\n" + PLAIN, "is a scene, and no camera"),
    ("[camera]\nfile = 'c'\n", "is a scene, and no camera"),
    ("", "camera: missing"),
    ('[camera]\nwidth = "64"\nheight = 48\nfov_deg = 60.0\n', 'camera.width: found "64"'),
    ("[camera]\nwidth = true\nheight = 48\nfov_deg = 60.0\n", "camera.width: found true"),
    ("[camera]\nwidth = 64.5\nheight = 48\nfov_deg = 60.0\n", "camera.width: found 64.5"),
    ("[camera]\nwidth = 0\nheight = 48\nfov_deg = 60.0\n", "camera.width: found 0"),
    ("[camera]\nwidht = 64\nheight = 48\nfov_deg = 60.0\n", "camera.widht: unknown key; expected one of width, "),
    ("[camera]\nwidth = 64\nfov_deg = 60.0\n", "camera.height: missing"),
    (CAMERA.replace('"c"', "3"), "camera.name: found 3"),
    (CAMERA + "cx = inf\n", "camera.cx: found inf"),
    (CAMERA + "distortion = [0.1, 'x']\n", 'camera.distortion[2]: found "x"'),
    # The scale is given once, and once only.
    (PLAIN, "fov_deg and fx, got neither"),
    (CAMERA + "fx = 50.0\n", "fov_deg and fx, got both"),
    ("detector = 3\n" + CAMERA, 'detector: found 3; expected a table with kind = "'),
    (CAMERA + CMOS + "temperature_c = 20.0\n", "temperature_c and dark_reference_c go together: give both or neither"),
    (PLAIN + "focal_length_mm = 8.0\n", "detector.pixel_pitch_um"),
    # 64 x 5.5 um behind 8 mm are 2.5 deg.
    (CAMERA + "focal_length_mm = 8.0\n" + CMOS, "camera.focal_length_mm = 8"),
    (PLAIN + "fx = 1480.0\nfocal_length_mm = 8.0\n" + CMOS, "camera.focal_length_mm = 8"),
    (CAMERA + "cx = 5000.0\n", "cx = 5000"),
    (CAMERA + "cy = -600.0\n", "cy = -600"),
    (PLAIN + "fov_deg = 190.0\n", "fov_deg = 190"),
    (CAMERA + "image_circle_deg = 185.0\n", "image_circle_deg = 185"),
    (FISHEYE + "fov_deg = 360.0\n", "camera.fov_deg: found 360"),
    # theta - 0.1 theta^3 turns back at 104.6 deg.
    (FISHEYE + "fov_deg = 220.0\ndistortion = [-0.1]\n", "209.2"),
    (FISHEYE + "fx = 100.0\ndistortion = [-0.1]\nimage_circle_deg = 210.0\n", "209.2"),
    (FISHEYE + "fov_deg = 190.0\ndistortion = [0.1, 0.1, 0.1, 0.1, 0.1]\n", "distortion has 5"),
    (CAMERA + BAND + BAND, "band names"),
    (CAMERA + BAND.replace("0.5", "0.9"), "band[1]: lo_um"),
    (CAMERA + BAND + THERMAL_BAND + BOLOMETER, "vis (solar), co2 (thermal)"),
    (CAMERA + HEADS + HEADS, "head names"),
    (CAMERA + '[[head]]\nname = "all"\n', "head[1]"),
    (CAMERA + '[[head]]\nname = "a b"\n', "head[1].name"),
    (CAMERA + "[[head]]\nmount_yaw_deg = 1.0\n", "head[1].name: missing"),
    (CAMERA + '[detector]\nkind = "cmso"\n', 'detector.kind: found "cmso"'),
    (CAMERA + "[detector]\nbits = 8\n", "detector.kind: missing"),
    (CAMERA + '[detector]\nkind = "cmos"\nbits = 8\n', "detector.pixel_pitch_um: missing"),
] + [
    (f"{CAMERA}[optics]\n{text}\n", key)
    for text, key in [
        ("transmission = nan", "optics.transmission: found nan"),
        ("vignetting_deg = [0, 10]\nvignetting = [1.0]", "vignetting_deg has 2"),
        ("vignetting_deg = [0, 10, 10]\nvignetting = [1.0, 0.9, 0.8]", "vignetting_deg must rise"),
        ("vignetting_deg = [0, 10]\nvignetting = [1.0, 1.1]", "optics.vignetting[2]"),
        ("psf_field_deg = [0]\npsf_field_sigma_px = []", "psf_field_deg has 1"),
        ("psf_field_deg = [0]\npsf_field_sigma_px = [1.0]\npsf_sigma_px = 0.7", "psf_sigma_px = 0.7"),
        ("psf_field_deg = [0]\npsf_field_sigma_px = [-1.0]", "optics.psf_field_sigma_px[1]"),
        ('pupil = "round"', "optics.pupil"),
        # 2 pi b0 l^2 ln(1 / l) of the light and more
        (SCATTER.replace("0.1", "500.0"), "optics.scatter: b0 = 500.0"),
        (SCATTER.replace("b0 = 0.1", "tis = 1.2"), "optics.scatter: tis = 1.2"),
        (SCATTER.replace("b0 = 0.1", "b0 = 0.1, tis = 0.1"), "optics.scatter: give exactly one of b0 and tis"),
        (SCATTER.replace("b0 = 0.1, ", ""), "optics.scatter: give exactly one of b0 and tis"),
        (SCATTER.replace("-2.0", "0.5"), "optics.scatter.s"),
        ("stray = { angle_deg = [30, 40], pst = [1e-3] }", "optics.stray: angle_deg has 2"),
        ("stray = { angle_deg = [40, 30], pst = [1e-3, 1e-4] }", "optics.stray: angle_deg must rise"),
        ("stray = { angle_deg = [30], pst = [1.5] }", "optics.stray: pst = 1.5"),
        ("stray = { angle_deg = [30, 80], pst = [1e-3, 1e-4], cutoff_deg = 60 }", "cutoff_deg = 60.0"),
        ("ghost = [{ ratio = 0.1, scale = 0.0 }]", "optics.ghost[1]: scale = 0.0"),
        ("ghost = [{ ratio = 0.6 }, { ratio = 0.5 }]", "optics: the ghosts' ratio"),
        ("ghost = [{ ratio = -0.1 }]", "optics.ghost[1].ratio"),
        # 64 pixels of 5.5 um over 60 deg are a focal length of 0.3048 mm.
        (f"f_number = 4.0\naperture_mm = 0.1\n{CMOS}", "optics.aperture_mm = 0.1"),
    ]
]
SCENE = '[camera]\nfile = "c.toml"\n[platform]\naltitude_km = 500.0\n'
SCENES = [
    (SCENE.replace("c.toml", "vis-cmos-512-60dge"), "camera.file: no camera named"),
    (SCENE.replace("c.toml", "bandless.toml"), "camera.file"),
    (SCENE.replace("c.toml", "heads.toml"), "camera.head: missing"),
    (SCENE.replace('c.toml"', 'heads.toml"\nhead = "c"'), "camera.head: found 'c'"),
    (SCENE.replace('c.toml"', 'c.toml"\nhead = "a"'), "camera.head: found 'a'"),
] + [
    (SCENE + text + "\n", key)
    for text, key in [
        ("latitude_deg = 91.0", "platform.latitude_deg: found 91"),
        ("latitude_deg = nan", "platform.latitude_deg: found nan"),
        ('epoch_utc = "noon"', 'platform.epoch_utc: found "noon"'),
        ('epoch_utc = "0001-01-01T00:00:00+02:00"', "platform.epoch_utc"),
        ('[scene]\nname = "a b"', 'scene.name: found "a b"'),
        ("[scene]\nseed = -1", "scene.seed: found -1"),
        ("[earth]\nradius_km = 6000.0", "earth: radius_km"),
        ("[render]\nnodes = 4", "render.nodes: found 4"),
        ('[render]\nmethod = "guess"', 'render.method: found "guess"'),
        ("[render]\nband_error = 0.0", "render.band_error: found 0"),
        ('[surface]\nkind = "erth"', 'surface.kind: found "erth"'),
        ('[surface]\nkind = "earth"\nalbedo = 0.2', "surface: albedo"),
        ('[surface]\nkind = "earth"\nemissivity = 0.9', "surface: emissivity"),
        ("[surface]\nwind_speed_m_s = 5.0", "surface: wind_speed_m_s"),
        ("[surface]\ncity_lights = true", "surface: city_lights"),
        ('[surface]\nkind = "earth"\nwind_speed_m_s = -1.0', "surface.wind_speed_m_s"),
        ('[clouds]\npattern = "uniform"', "clouds: "),
        ("[clouds]\nscale_km = 50.0", "clouds: mean_top_km and scale_km"),
        ("[clouds]\ncover = 1.5", "clouds.cover: found 1.5"),
        ("[clouds]\ncover = 0.5\nemissivity = 1.1", "clouds.emissivity"),
        ("[clouds]\ncover = 0.5\ntop_km = 20.0", "clouds.top_km: found 20"),
        ("[clouds]\ncover = 0.5\nmean_top_km = 12.0", "clouds: mean_top_km"),
        ("[clouds]\ncover = 0.5\nseed = -1", "clouds.seed: found -1"),
        ("[clouds]\ncover = 0.5\ncolor = 1", "clouds.color: unknown key"),
        ("[atmosphere]\nco2_ppm = 200.0", "atmosphere.co2_ppm: found 200"),
        ('[atmosphere]\nprofile = "none"\nco2_ppm = 400.0', "atmosphere: co2_ppm"),
        ('[atmosphere]\nfile = "nope.json"', "atmosphere.file: no atmosphere named 'nope.json'"),
        ('[atmosphere]\nprofile_file = "nope.csv"', "atmosphere.profile_file"),
        ('[atmosphere]\nprofile_file = "a.csv"\nfile = "us76"', "at most one of file and profile_file"),
        ('[atmosphere]\naerosol = "smoke"', 'atmosphere.aerosol: found "smoke"'),
        ('[atmosphere]\naerosol = "background"\nfile = "us76"', "atmosphere: "),
        ('[atmosphere]\naerosol = "background"\nprofile = "none"', "atmosphere: "),
        (
            '[atmosphere]\naerosol = "none"\naerosol_optical_depth_550nm = 0.1',
            "atmosphere: aerosol_optical_depth_550nm",
        ),
        ("[atmosphere]\naerosol_optical_depth_550nm = -0.1", "atmosphere.aerosol_optical_depth_550nm"),
        ("[atmosphere]\nmonth = 13", "atmosphere.month: found 13"),
        ("[atmosphere]\nmonth = 7", "atmosphere: month"),
        ("[atmosphere]\nlatitude_deg = 40.0", "atmosphere: latitude_deg"),
    ]
]
PRIOR = """[prior]
shape = "sphere"
radius_km = 6378.0
altitude_km = 550.0
altitude_sigma_km = 1
position_itrs_km = [6928.0, 0, 0.5]
position_sigma_km = 1.0
q_cam_from_itrs = [0.7071, 0.0, 0.0, 0.7071]
attitude_sigma_deg = [1.0, 1, 2.0]
limb_height_km = -1.5
limb_height_sigma_km = 0.3
climate = "by_latitude_month"
sun_sigma_deg = 0.5
"""
PRIORS = [
    (PRIOR.replace(old, new), key)
    for old, new, key in [
        ("altitude_sigma_km = 1\n", "", "altitude_km without altitude_sigma_km"),
        ("position_sigma_km = 1.0\n", "", "position_itrs_km without position_sigma_km"),
        ("attitude_sigma_deg = [1.0, 1, 2.0]\n", "", "q_cam_from_itrs without attitude_sigma_deg"),
        ("limb_height_sigma_km = 0.3\n", "", "limb_height_km without limb_height_sigma_km"),
        ("altitude_sigma_km = 1\n", "altitude_sigma_km = -1\n", "prior.altitude_sigma_km: found -1"),
        ("altitude_sigma_km = 1\n", "altitude_sigma_km = 0\n", "prior.altitude_sigma_km: found 0"),
        ("[1.0, 1, 2.0]", "[1.0, 0, 2.0]", "prior.attitude_sigma_deg"),
        ("[1.0, 1, 2.0]", "[1.0, 2.0]", "prior.attitude_sigma_deg"),
        ("0.7071]", "0.5]", "prior.q_cam_from_itrs"),
        ("climate =", "limb_scale_height_km = 0.0\nclimate =", "limb_scale_height_sigma_km, or neither"),
        ("climate =", "limb_relief_km = -1.0\nclimate =", "prior.limb_relief_km: found -1.0"),
        ("climate =", "nadir_cam = [0, 1, 0]\nclimate =", "give one of the two"),
        ('"sphere"', '"wgs84"', "radius_km"),
        ('"sphere"', '"flat"', 'prior.shape: found "flat"'),
        ("sun_sigma_deg", "sun_sigma", "prior.sun_sigma: unknown key; expected one of sun_sigma_deg"),
        ('"by_latitude_month"', '""', "climate"),
        ('"by_latitude_month"', '"none.csv"', "prior.climate"),
        ("[prior]", "[priors]", "priors: unknown key"),
        (PRIOR, '[prior]\nclimate = "by_latitude_month"\n', "position_sigma_km"),
    ]
]
HEAD = '[suite]\nname = "s"\nestimators = ["ideal"]\n[defaults]\ncamera.file = "c.toml"\nplatform.altitude_km = 500.0\n'
FRAME = '[[frame]]\nscene.name = "a"\n'
SHARES = (
    '[[cases]]\nname = "a"\nsobol = { share = 0.75, ranges = { attitude.yaw_deg = [-5.0, 5.0] } }\n'
    '[[cases]]\nname = "b"\nsobol = { share = 0.25, ranges = { attitude.yaw_deg = [-5.0, 5.0] } }\n'
)
SHARED = HEAD.replace('"s"\n', '"s"\nframes = 40\n')
ORBIT = '[[cases]]\nname = "o"\n[cases.orbit]\nepoch_utc = 2026-03-20T00:00:00Z\nn = 8\n'
STABILITY = HEAD + FRAME + "[stability]\naltitude_km = 900.0\n"
EDGE = '[[stability.band]]\nname = "co2"\nlo_um = 14.0\nhi_um = 16.3\n'
SUITES = [
    ("", "suite: missing"),
    (HEAD, "frame is missing"),
    (HEAD + "[[frame]]\nattitude.yaw_deg = 5.0\n", "frame 1"),
    (HEAD + FRAME + FRAME, "'a'"),
    (HEAD.replace("platform.altitude_km = 500.0\n", "") + FRAME, "frame[1] (a): platform: missing"),
    (HEAD + FRAME + "platform.altitude = 5.0\n", "frame[1] (a): platform.altitude: unknown key"),
    (HEAD.replace('["ideal"]', "[]") + FRAME, "suite.estimators"),
    (HEAD.replace('["ideal"]', '["ideal", "ideal"]') + FRAME, "suite.estimators: estimator 'ideal' is named"),
    (HEAD + FRAME + 'estimators = "ideal"\n', 'frame[1] (a).estimators: found "ideal"'),
    (SHARED + SHARES.replace("0.75", "0.5"), "0.75"),
    (HEAD + SHARES, "suite.frames and sobol.share"),
    (SHARED + SHARES.replace("share = 0.75", "share = 0.75, n = 4"), "cases[1].sobol: give one of n and share"),
    (SHARED.replace("frames", "draws = 0\nframes") + SHARES, "suite.draws: found 0"),
    (SHARED.replace("frames", "draws = 2.5\nframes") + SHARES, "suite.draws: found 2.5"),
    (HEAD + ORBIT, "cases[1] (o).orbit"),
    (HEAD + ORBIT + "altitude_km = 500.0\n", "cases[1] (o).orbit: give one of inclination_deg"),
    (HEAD + ORBIT + "altitude_km = 7000.0\nsun_synchronous = true\n", "cases[1] (o).orbit"),
    (HEAD + ORBIT.replace("n = 8", 'n = 8\ntle = ["1 2", "2 3"]'), "cases[1] (o).orbit.tle"),
    (HEAD + ORBIT.replace("n = 8", 'n = 8\ntle = "no.txt"'), "cases[1] (o).orbit.tle"),
    (STABILITY, "stability.band: missing"),
    (STABILITY.replace("altitude_km = 900.0\n", "") + EDGE, "stability.altitude_km: missing"),
    (STABILITY.replace("900.0", "100.0") + EDGE, "stability.altitude_km: found 100"),
    (STABILITY + "positions = 3\n" + EDGE, "stability.positions: found 3"),
    (STABILITY + "months = []\n" + EDGE, "stability.months"),
    (STABILITY + "months = [0]\n" + EDGE, "stability.months[1]: found 0"),
    (STABILITY + "months = [1, 1]\n" + EDGE, "months holds a month twice"),
    (STABILITY + "field_deg = 20.0\n" + EDGE, "stability.field_deg: found 20"),
    (STABILITY + EDGE + EDGE, "'co2'"),
    (STABILITY + EDGE.replace("16.3", "13.0"), "stability.band[1]: lo_um"),
] + [
    (f'{HEAD}[[cases]]\nname = "g"\n{text}\n', key)
    for text, key in [
        ("", "cases[1]: give at least one of list, grid"),
        ("grid = { attitude.yaw_deg = 5.0 }", "cases[1] (g).grid.attitude.yaw_deg: found 5.0"),
        ("grid = { attitude.yaw = [5.0] }", "g_yaw_5: attitude.yaw: unknown key"),
        ("grid = { camera.detector.exposure = [5.0] }", "g_exposure_5: camera: detector"),
        ("grid = { camera.band.x.nodes = [5] }", "camera.band: no band 'x'"),
        ("grid = { attitude.yaw_deg = { from = 1, to = 2, step = -1 } }", "step = -1"),
        ('sobol = { n = 4, ranges = { attitude.yaw_deg = [1, "b"] } }', "sobol.ranges"),
        ('estimators = ["idael"]\ngrid = { attitude.yaw_deg = [5.0] }', 'cases[1] (g).estimators: "idael"'),
        ("estimators = []\ngrid = { attitude.yaw_deg = [5.0] }", "cases[1].estimators"),
        ('grid = { attitude.yaw_deg = [5.0] }\n[[cases]]\nname = "g"\ngrid = { attitude.yaw_deg = [5.0] }', "'g'"),
    ]
]


@pytest.mark.parametrize(
    ("load", "text", "key"),
    [
        *((load_camera, *row) for row in CAMERAS),
        *((load_scene, *row) for row in SCENES),
        *((load_frames, *row) for row in SCENES[:5]),
        *((load_prior, *row) for row in PRIORS),
        *((load_suite, *row) for row in SUITES),
    ],
)
def test_a_mistake_is_one_line_with_file_and_key(tmp_path, load, text, key):
    for name, camera in (("c", CAMERA + BAND), ("bandless", CAMERA), ("heads", CAMERA + BAND + HEADS)):
        (tmp_path / f"{name}.toml").write_text(camera)
    path = tmp_path / "x.toml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UserError) as caught:
        load(path)
    line = caught.value.line()
    assert line.startswith(str(path))
    assert key in line
    assert "\n" not in line
