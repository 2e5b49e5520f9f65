"""Values at the edge of what numbers can be, in files that are otherwise right: one line, soon."""

from __future__ import annotations

import time

import pytest

from horizonval.core.errors import UserError
from horizonval.formats.rays import read_rays
from horizonval.spec.load import load_camera, read_toml

CAMERA = "[camera]\nwidth = 40\nheight = 30\nfov_deg = 60.0\ndistortion = [{}]\n"


@pytest.mark.parametrize("value", ["1e308", "-1e308", "1e7", "nan", "inf"])
def test_a_distortion_that_no_lens_has_is_refused(tmp_path, value):
    path = tmp_path / "c.toml"
    path.write_text(CAMERA.format(f"0.0, 0.0, 0.0, 0.0, {value}"))
    with pytest.raises(UserError, match=r"camera\.distortion\[5\]: found .* from -1e\+06 to 1e\+06"):
        load_camera(path)


@pytest.mark.parametrize(
    "text", ["a." * 200_000 + "a = 1\n", "[" + "a . " * 200_000 + "a]\n", 'x = { "a".' + "b." * 10**5]
)
def test_a_key_of_many_parts_is_refused_soon(tmp_path, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    start = time.process_time()
    with pytest.raises(UserError, match="a key of 64 parts or more"):
        read_toml(path)
    assert time.process_time() - start < 5.0


def test_long_words_and_numbers_are_no_deep_keys(tmp_path):
    path = tmp_path / "a.toml"
    numbers = ", ".join(["0.25"] * 10_000)
    path.write_text(f'a.b.c = [{numbers}]\ntext = "{"x" * 10**6}"\nfile = "{"../" * 100}x"\n')
    start = time.process_time()
    assert len(read_toml(path)["a"]["b"]["c"]) == 10_000
    assert time.process_time() - start < 5.0


@pytest.mark.parametrize("value", ["1e308", "-1e13", "inf", "nan", "9" * 400])
@pytest.mark.parametrize("column", ["obs_x_km", "dir_y", "sun_z"])
def test_a_ray_of_numbers_without_bound_is_refused(tmp_path, value, column):
    path = tmp_path / "r.csv"
    columns = [f"{name}_{axis}{unit}" for name, unit in (("obs", "_km"), ("dir", ""), ("sun", "")) for axis in "xyz"]
    path.write_text(",".join(columns) + "\n" + ",".join(value if name == column else "7000" for name in columns) + "\n")
    with pytest.raises(UserError, match=rf"line 2, column {column}: .*a number from -1e\+12 to 1e\+12"):
        read_rays(path)
