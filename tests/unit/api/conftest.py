"""A folder as a user of the package has it: a camera, a suite, a frame, an image and a finished run, all small."""

from __future__ import annotations

import contextlib

import pytest

import horizonval as hv

CAMERA = """
[camera]
name = "mycam"
width = 64
height = 64
fov_deg = 60.0

[[band]]
name = "vis"
kind = "solar"
lo_um = 0.5
hi_um = 0.6
nodes = 1

[detector]
kind = "cmos"
pixel_pitch_um = 5.5
exposure_s = 2.0e-4
quantum_efficiency = 0.6
full_well_e = 13500.0
read_noise_e = 13.0
bits = 12
"""

SUITE = """
[suite]
name = "orbit"
estimators = ["altitude-free", "ideal"]

[defaults]
camera = {file = "mycam.toml", mount_roll_deg = 65.0}
platform = {altitude_km = 550.0}
render = {orders = "single"}

[[frame]]
scene = {name = "one"}
"""


@pytest.fixture(scope="session")
def user_folder(tmp_path_factory):
    """``mycam.toml``, ``orbit.toml``, ``frame.exr``, ``image.exr``, and the run ``out`` of the suite."""
    folder = tmp_path_factory.mktemp("user")
    (folder / "mycam.toml").write_text(CAMERA)
    (folder / "orbit.toml").write_text(SUITE)
    with contextlib.chdir(folder):
        # The name of the camera's file is part of the scene's identity, hence of the noise.
        camera, fast = hv.Camera.from_file("mycam.toml"), {"orders": "single"}
        frame = hv.render(hv.Scene(camera, altitude_km=550, mount_roll_deg=65, name="small", render=fast))
        frame.save("frame.exr")
        frame.observe(seed=1).save("image.exr")
        hv.run("orbit.toml", out="out", workers=1)
    return folder


@pytest.fixture
def in_user_folder(user_folder, monkeypatch):
    """The folder, which is the working folder for the test."""
    monkeypatch.chdir(user_folder)
    return user_folder
