"""Ray tables: what is refused, and that nothing of the user's columns is lost."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.formats.rays import check_above_ground, read_rays, write_radiance

HEAD = "tag,obs_x_km,obs_y_km,obs_z_km,dir_x,dir_y,dir_z,sun_x,sun_y,sun_z,note"
ROW = 'a,0,0,7000.5,1,0,-1,0,0,2,"x, y"'


def _write(tmp_path, text):
    path = tmp_path / "rays.csv"
    path.write_text(text)
    return path


def test_values_and_pass_through(tmp_path):
    path = _write(tmp_path, f"\ufeff{HEAD}\r\n{ROW}\r\n\r\n 007 ,1e0,2,7000,0,0,1,1,0,0,é\n")
    table = read_rays(path)
    np.testing.assert_array_equal(table.observer_m, [[0, 0, 7000500.0], [1000.0, 2000.0, 7e6]])
    np.testing.assert_array_equal(table.direction, [[1, 0, -1], [0, 0, 1]])
    np.testing.assert_array_equal(table.sun, [[0, 0, 2], [1, 0, 0]])
    write_radiance(tmp_path / "out.csv", table, {"b": np.array([0.1, 1 / 3])})
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert lines[0] == HEAD + ",radiance_b"
    assert lines[1] == ROW + ",0.1"
    assert lines[2] == f" 007 ,1e0,2,7000,0,0,1,1,0,0,é,{1 / 3!r}"
    assert [p.name for p in tmp_path.iterdir()].count("out.csv") == 1
    assert not list(tmp_path.glob(".*")), "no temporary file stays"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["empty"]),
        (HEAD.replace("dir_x", "dirx") + "\n", ["line 1", "column dir_x is missing", "dirx"]),
        (HEAD + ",dir_x\n", ["dir_x is there more than once"]),
        (f"{HEAD}\n{ROW}\n{ROW.replace('7000.5', 'high')}\n", ["line 3, column obs_z_km", 'found "high"', "number"]),
        (f"{HEAD}\n{ROW.replace('7000.5', 'nan')}\n", ["line 2, column obs_z_km", 'found "nan"', "number from"]),
        *(
            (f"{HEAD}\n{ROW.replace('7000.5', value)}\n", ["line 2, column obs_z_km", "a number from -1e+12 to 1e+12"])
            for value in ("1e308", "-1e13", "inf", "9" * 400)
        ),
        (f"{HEAD}\n{ROW.replace('7000.5', '')}\n", ["line 2, column obs_z_km", 'found ""']),
        (f"{HEAD}\n{ROW},1\n", ["line 2", "12 fields", "11"]),
        (f"{HEAD}\n{ROW.replace('1,0,-1', '0,0,0')}\n", ["line 2", "dir_x, dir_y, dir_z", "length 0"]),
        (f"{HEAD}\n{ROW.replace('0,0,2', '0,0,-0.0')}\n", ["line 2", "sun_x, sun_y, sun_z", "length 0"]),
        (f'{HEAD}\n"{ROW}\n', ["not a CSV file"]),
    ],
)
def test_refusals_name_the_place(tmp_path, text, parts):
    path = _write(tmp_path, text)
    with pytest.raises(UserError) as caught:
        read_rays(path)
    line = str(caught.value)
    assert str(path) in line
    for part in parts:
        assert part in line, line


def test_observer_below_ground(tmp_path):
    table = read_rays(_write(tmp_path, f"{HEAD}\n{ROW}\n{ROW.replace('7000.5', '6370.999')}\n"))
    check_above_ground(table, 6370.999e3, tmp_path / "rays.csv")
    with pytest.raises(UserError, match=r"ray 2 is below the ground.*at least 6371 km"):
        check_above_ground(table, 6371e3, tmp_path / "rays.csv")


def test_an_existing_column_is_not_overwritten(tmp_path):
    table = read_rays(_write(tmp_path, f"{HEAD.replace('note', 'radiance_b')}\n{ROW}\n"))
    with pytest.raises(UserError, match="radiance_b"):
        write_radiance(tmp_path / "out.csv", table, {"b": np.zeros(1)})
    assert not (tmp_path / "out.csv").exists()
