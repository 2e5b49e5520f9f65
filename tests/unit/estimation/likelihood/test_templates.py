"""Tables of profiles: interpolation, files, damage."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.estimation.fit.heights import everywhere
from horizonval.estimation.fit.templates import (
    FOLDER,
    LimbTemplates,
    load_templates,
    templates_of,
)

HEIGHT = np.array([-10e3, 0.0, 10e3, 30e3])


def table(kind: str = "thermal") -> LimbTemplates:
    """Return profiles that are linear in both coordinates, so that multilinear interpolation is exact."""
    if kind == "thermal":
        axes = (np.radians([-90.0, -30.0, 40.0, 90.0]), np.array([1.0, 4.0, 7.0, 10.0]))
    else:
        axes = (np.radians([0.0, 60.0, 95.0]), np.radians([0.0, 90.0, 180.0]))
    a, b = np.meshgrid(*axes, indexing="ij")
    shape = np.array([4.0, 3.0, 2.0, 0.0])
    mean = (10.0 + a + 0.1 * b)[..., None] * shape
    modes = np.stack([0.1 * mean, np.broadcast_to([0.0, 1.0, 0.0, 0.0], mean.shape)], axis=2)
    return LimbTemplates(
        band_kind=kind,  # type: ignore[arg-type]
        band_um=(8.0, 14.0),
        height_m=HEIGHT,
        axes=axes,
        mean=mean,
        modes=modes,
        mode_kinds=("air", "below"),
        correlation_rad=everywhere([0.4, 0.05], len(axes[0])),
        left_sigma=0.01 * np.abs(mean),
    )


def test_between_places_profiles_are_linear():
    rng = np.random.default_rng(1)
    latitude, month = rng.uniform(-1.5, 1.5, 50), rng.uniform(1.0, 10.0, 50)
    mean, modes, left = table().at(latitude, month)
    expected = (10.0 + latitude + 0.1 * month)[:, None] * [4.0, 3.0, 2.0, 0.0]
    np.testing.assert_allclose(mean, expected, rtol=1e-12)
    np.testing.assert_allclose(modes[:, 0], 0.1 * expected, rtol=1e-12)
    np.testing.assert_allclose(left, 0.01 * expected, rtol=1e-12)
    assert modes.shape == (50, 2, 4)


def test_a_year_is_a_circle():
    t = table()
    december, january = (t.at(0.3, m)[0][0] for m in (10.0, 1.0))
    np.testing.assert_allclose(t.at(0.3, 11.5)[0][0], 0.5 * (december + january), rtol=1e-12)
    np.testing.assert_allclose(t.at(0.3, 0.5)[0][0], t.at(0.3, 12.5)[0][0], rtol=1e-12)
    np.testing.assert_allclose(t.at(0.3, 13.0)[0][0], january, rtol=1e-12)


def test_azimuths_have_no_side_and_ends_hold():
    t = table("solar")
    np.testing.assert_allclose(t.at(1.0, -0.7)[0], t.at(1.0, 0.7)[0], rtol=1e-12)
    np.testing.assert_allclose(t.at(1.0, 2.0 * np.pi - 0.7)[0], t.at(1.0, 0.7)[0], rtol=1e-12)
    np.testing.assert_allclose(t.at(2.5, 0.7)[0], t.at(np.radians(95.0), 0.7)[0], rtol=1e-12)


def test_tables_that_reach_into_twilight_end_in_the_dark():
    t = table("solar")
    evening = replace(t, axes=(np.radians([0.0, 60.0, 99.0]), t.axes[1]))
    assert evening.at(np.radians(106.0), 0.7)[0].max() < 1e-12
    assert evening.at(np.radians(106.0), 0.7)[1].max() < 1e-12
    light = evening.mean_at(np.radians([99.0, 101.0, 103.0, 105.0, 120.0]), 0.7)[:, 0]
    assert (np.diff(light) <= 0.0).all()
    assert light[-1] == pytest.approx(0.0, abs=1e-12)


def test_sunlit_profiles_between_places_are_splines_of_their_roots():
    """Light that changes with the azimuth as a forward peak does: straight lines would be off by 7 %."""
    t = table("solar")
    azimuth = np.radians([0.0, 20.0, 45.0, 75.0, 105.0, 140.0, 180.0])
    root = 2.0 + np.cos(azimuth)
    mean = np.broadcast_to((root**2)[None, :, None], (3, 7, 4)).copy()
    fine = replace(
        t,
        axes=(t.axes[0], azimuth),
        mean=mean,
        modes=np.zeros((3, 7, 0, 4)),
        mode_kinds=(),
        correlation_rad=everywhere([], 3),
        left_sigma=0.0 * mean,
    )
    at = np.radians(np.linspace(-180.0, 180.0, 37))
    np.testing.assert_allclose(fine.mean_at(0.5, at)[:, 0], (2.0 + np.cos(at)) ** 2, rtol=3e-3)


def test_a_file_keeps_the_table_to_its_rounding_and_has_always_the_same_bytes(tmp_path):
    t = table()
    t.save(tmp_path / "a.npz")
    t.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    back = load_templates(tmp_path / "a.npz")
    # half of a 32767th and of a 127th of the largest value of a profile
    assert np.abs(back.mean - t.mean).max() <= 0.6 / 32767 * t.mean.max()
    assert np.abs(back.modes - t.modes).max() <= 0.6 / 127 * t.modes.max()
    np.testing.assert_array_equal(back.height_m, t.height_m)
    back.save(tmp_path / "c.npz")
    assert (tmp_path / "c.npz").read_bytes() == (tmp_path / "a.npz").read_bytes()


def test_what_is_no_table_is_refused_in_one_line(tmp_path):
    good = tmp_path / "good.npz"
    table().save(good)
    bad = {
        "text.npz": b"hello",
        "empty.npz": b"",
        "cut.npz": good.read_bytes()[: good.stat().st_size // 2],
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with np.load(good) as data:
        arrays = {key: np.asarray(data[key]) for key in data.files}
    np.savez(tmp_path / "later.npz", **{**arrays, "format": np.array(9)})
    np.savez(tmp_path / "short.npz", **{**arrays, "height_m": HEIGHT[:3]})
    for name in (*bad, "other.npz", "later.npz", "short.npz", "missing.npz"):
        with pytest.raises(UserError) as caught:
            load_templates(tmp_path / name)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(UserError):
        table().save(tmp_path / "no" / "folder.npz")


@pytest.mark.parametrize(
    "change",
    [
        {"band_kind": "radio"},
        {"height_m": HEIGHT[::-1]},
        {"correlation_rad": everywhere([0.4, -0.05], 4)},
        {"correlation_rad": np.array([0.4, 0.05])},
        {"mean": np.full((4, 4, 4), np.nan)},
        {"mode_kinds": ("air",)},
        {"band_um": (14.0, 8.0)},
    ],
)
def test_tables_that_cannot_be_are_refused(change):
    with pytest.raises(UserError):
        replace(table(), **change)


def test_shipped_profiles_end_in_space_and_reach_deep():
    for path in sorted((Path(__file__).parents[4] / "horizonval/estimation/fit/data").glob("limb-*.npz")):
        t = load_templates(path)
        assert t.height_m[0] <= -300e3
        assert (t.mean[..., -1] < 0.02 * t.mean.max()).all()
        # one step of a kilometre or less where the limb is
        steps = np.diff(t.height_m[(t.height_m >= 0.0) & (t.height_m <= 70e3)])
        assert steps.max() <= 1000.0


def test_a_files_table_is_read_again_when_it_has_changed(tmp_path: Path):
    path = tmp_path / "t.npz"
    table().save(path)
    first = templates_of(path)
    assert templates_of(path) is first
    replace(table(), made_by="a longer story than before").save(path)
    assert templates_of(path).made_by != first.made_by
    path.unlink()
    with pytest.raises(UserError, match=r"t\.npz: No such file"):
        templates_of(path)


def test_a_table_with_a_damaged_part_is_refused_in_one_line(tmp_path: Path) -> None:
    """Wherever the damage lies: of some places inflating fails, of others the checksum."""
    whole = (FOLDER / "limb-blue.npz").read_bytes()
    part = max(zipfile.ZipFile(FOLDER / "limb-blue.npz").infolist(), key=lambda one: one.compress_size)
    for k in range(1, 41):
        at = part.header_offset + 60 + part.compress_size * k // 42
        damaged = tmp_path / f"{k}.npz"
        damaged.write_bytes(whole[:at] + b"\xff\x00\xff\x13" + whole[at + 4 :])
        with pytest.raises(UserError, match="damaged"):
            load_templates(damaged)


def test_a_name_that_no_file_can_have_is_refused() -> None:
    with pytest.raises(UserError):
        templates_of(Path("a\0.npz"))
