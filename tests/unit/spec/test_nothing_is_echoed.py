"""Files that are something else are refused without showing a word of them, whatever reads them."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from horizonval.api.check import kind_of
from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.profile_file import read_profiles
from horizonval.earth.atmosphere_file import read_atmosphere
from horizonval.formats.rays import read_rays
from horizonval.spec.files import find
from horizonval.spec.load import load_camera, load_scene, read_toml
from horizonval.spec.orbit import OrbitSpec
from horizonval.store import exr
from horizonval.store.picture import read_picture
from horizonval.suites import flight

SECRET = "hunter2"
TEXTS = {
    "shadow": f"root:$6${SECRET}:19000:0:99999:7:::\nbin:*:19000:0:99999:7:::\n",
    "environment": f"PATH=/bin\0TOKEN={SECRET}\0",
    "settings": f"password {SECRET}\n[{SECRET}]\n",
    "quoted": f'"{SECRET} and more"\n',
    "table twice": f"[{SECRET}]\n[{SECRET}]\n",
    "key twice": f"a = {{ {SECRET} = 1, {SECRET} = 2 }}\n",
    "escaped": f'key = "\\{SECRET}"\n',
    "a date": f"key = 2026-99-99{SECRET}\n",
    "table of something else": f"name,token,{SECRET}\nme,{SECRET},{SECRET}\n",
    "object of something else": f'{{"{SECRET}": "{SECRET}"}}\n',
    "broken object": f'{{"token": {SECRET}}}\n',
    "list": f'["{SECRET}"]\n',
    "two lines": f"{SECRET}\n{SECRET}\n",
    "two long lines": "".join(f"{n} {SECRET}{'x' * 60}"[:69] + "\n" for n in (1, 2)),
    "two lines with sums": "".join(f"{n} {SECRET}{'x' * 60}"[:68] + f"{n + 2}\n" for n in (1, 2)),
    "bytes": f"\udcff{SECRET}",
}


def of_lines(path: Path) -> object:
    orbit = OrbitSpec.model_validate({"tle": path.name, "n": 1, "duration_s": 1.0})
    return flight._track(orbit, path.parent)


READERS: dict[str, Callable[[Path], object]] = {
    "TOML": read_toml,
    "scene": load_scene,
    "camera": load_camera,
    "atmosphere": read_atmosphere,
    "profile": read_profiles,
    "profile.json": lambda path: read_profiles(path.rename(path.with_suffix(".json"))),
    "rays": read_rays,
    "picture": read_picture,
    "EXR": exr.read_frame,
    "two lines": of_lines,
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("text", TEXTS)
def test_a_file_that_is_something_else_is_not_shown(tmp_path, text, reader):
    path = tmp_path / "file"
    path.write_bytes(TEXTS[text].encode("utf-8", "surrogateescape"))
    try:
        READERS[reader](path)
    except UserError as error:
        line = str(error)
    else:
        assert reader == "TOML", "it is not what was asked for"
        return
    # A key of a file that is TOML is the offending token.
    parsed = reader in ("scene", "camera") and text in ("key twice", "list")
    assert SECRET not in line or parsed, line
    assert str(path.stem) in line or reader == "two lines"


def test_words_of_a_users_own_file_are_shown_but_not_at_length(tmp_path):
    path = tmp_path / "profile.csv"
    path.write_text(f"altitude_km,temperature_K,pressure_Pa,ozon{'e' * 1000}\n0,1,2,3\n")
    with pytest.raises(UserError, match=r"unknown key 'ozone{36}\.\.\.'"):
        read_profiles(path)


@pytest.mark.parametrize("text", [f"x = {'9' * 5000}\n", f"x = {'[' * 100_000}\n"])
def test_what_a_parser_cannot_hold_is_one_line(tmp_path, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(UserError, match="not valid TOML") as refused:
        read_toml(path)
    assert len(str(refused.value)) < 300
    (tmp_path / "a.json").write_text(text.removeprefix("x = "))
    with pytest.raises(UserError, match="not JSON"):
        read_atmosphere(tmp_path / "a.json")


@pytest.mark.skipif(sys.platform == "win32", reason="FIFOs of POSIX")
def test_what_is_no_file_is_said_where_it_is_named(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for call in (lambda: find("atmosphere", fifo, where="a.toml: atmosphere.file"), lambda: kind_of(fifo)):
        with pytest.raises(UserError, match="is a FIFO; expected a"):
            call()


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
