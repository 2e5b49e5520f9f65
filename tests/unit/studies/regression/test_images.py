"""Regions, displacement and the file of frozen images."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
from scipy.special import erf

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.studies.regression import baseline
from horizonval.studies.regression.baseline import FrozenFrame, FrozenImage, Pack, read_pack, write_pack
from horizonval.studies.regression.images import (
    DISC,
    ELSEWHERE,
    LIMB,
    SPACE,
    bias,
    compare_images,
    displacement_px,
    noise_in_space,
    regions_of,
)

Y, X = np.mgrid[0:64, 0:64].astype(float)
RADIUS = np.hypot(X - 32, Y - 90)
NEAR = np.abs(RADIUS - 45) < 4


def disc(dx: float, dy: float, gain: float = 1.0) -> np.ndarray:
    """A soft-edged disc that darkens towards its rim, its centre moved by so many pixels."""
    r = np.hypot(X - 32 - dx, Y - 90 - dy) - 45
    return gain * 20 * 0.5 * (1 - erf(r / (np.sqrt(2) * 0.8))) * (1 - 0.01 * r)


@pytest.mark.parametrize("shift", [(0.0, 0.5), (0.35, 0.35), (0.0, -0.1)])
def test_displacement_of_a_known_shift(shift):
    """Root mean square of the shift across the limb, to a fifth of it."""
    nx, ny = (X - 32) / RADIUS, (Y - 90) / RADIUS
    expected = np.sqrt(np.mean((nx * shift[0] + ny * shift[1])[NEAR] ** 2))
    assert displacement_px(disc(0, 0), disc(*shift), NEAR) == pytest.approx(expected, rel=0.2)


def test_more_light_is_no_displacement():
    assert displacement_px(disc(0, 0), disc(0, 0, 1.02), NEAR) < 0.002
    assert bias(disc(0, 0), disc(0, 0, 1.02), NEAR) == pytest.approx(0.02)
    assert displacement_px(np.zeros((64, 64)), np.zeros((64, 64)), NEAR) is None
    assert bias(np.zeros((64, 64)), disc(0, 0), NEAR) is None


def test_regions_follow_the_truth_maps():
    height = np.where(RADIUS < 80, (RADIUS - 45) * 50e3, np.inf)
    hit = np.where(RADIUS < 45, 1.0, 0.0)
    hit[0, 0] = 3.0
    found = regions_of(hit, height)
    assert found[0, 0] == ELSEWHERE
    assert set(np.unique(found)) == {ELSEWHERE, SPACE, LIMB, DISC}
    # Three pixels on either side of the edge.
    assert np.abs(RADIUS[found == LIMB] - 45).max() == pytest.approx(3.0, abs=0.1)
    assert RADIUS[found == DISC].max() < 45 < RADIUS[found == SPACE].min()


def test_noise_in_space_is_that_of_space():
    rng = np.random.default_rng(0)
    clean = np.full((64, 64), 100)
    regions = np.full((64, 64), DISC, np.uint8)
    regions[:32] = SPACE
    dn = clean + np.rint(np.where(regions == SPACE, 2.0, 20.0) * rng.normal(size=(64, 64))).astype(int)
    assert noise_in_space(dn, clean, regions) == pytest.approx(np.hypot(2.0, 1 / np.sqrt(12)), rel=0.05)
    assert noise_in_space(dn, clean, np.full((64, 64), DISC, np.uint8)) is None


def some_pack() -> Pack:
    rng = np.random.default_rng(1)
    images = [
        FrozenImage(f"s{i}", "vis", k, 511, rng.integers(0, 512, (20 + i, 30)).astype(np.uint16), k / 3 if k else None)
        for i in range(2)
        for k in range(3)
    ]
    frames = [
        FrozenFrame(f"s{i}", "vis", "ab" * 32, disc(i, 0).astype(np.float32).astype(float), NEAR.astype(np.uint8))
        for i in range(2)
    ]
    return Pack(tuple(images), tuple(frames), {"s0": {"a": 1 / 3}, "s1": {}})


def test_a_pack_comes_back_and_equal_content_gives_equal_bytes(tmp_path):
    made = some_pack()
    write_pack(tmp_path / "a.npz", made)
    write_pack(tmp_path / "b.npz", made)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    read = read_pack(tmp_path / "a.npz")
    assert read.truths == made.truths
    for mine, theirs in zip(read.images, made.images, strict=True):
        assert (mine.scene, mine.replicate, mine.full_scale) == (theirs.scene, theirs.replicate, theirs.full_scale)
        assert np.array_equal(mine.dn, theirs.dn)
        assert mine.radiance_per_dn == theirs.radiance_per_dn
    for frame, other in zip(read.frames, made.frames, strict=True):
        assert np.array_equal(frame.regions, other.regions)
        # Half a step of the code at the brightest pixel; its square far below.
        assert np.abs(frame.radiance - other.radiance).max() < other.radiance.max() / baseline.CODES
    # NumPy alone opens it.
    with np.load(tmp_path / "a.npz") as file:
        assert file["dn_20x30_low"].shape == (3, 20, 30)


def rewritten(path, change):
    """Change the head of a pack."""
    with np.load(path) as file:
        arrays = dict(file)
    head = json.loads(arrays["head"].tobytes())
    change(head)
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)
    np.savez(path, **arrays)


def test_a_pack_of_another_version_is_refused(tmp_path):
    path = tmp_path / "new.npz"
    write_pack(path, some_pack())
    rewritten(path, lambda head: head.update(schema=3))
    with pytest.raises(DamagedFileError, match="schema 3"):
        read_pack(path)


@pytest.mark.parametrize(
    ("shape", "dtype"), [((2**36,), "|u1"), ((2**20, 2**20), "|u1"), ((4,), "<f8"), ((2**62, 2**62), "|u1")]
)
def test_arrays_are_bounded_by_their_heads_before_they_are_read(tmp_path, shape, dtype):
    path = tmp_path / "bomb.npz"
    write_pack(path, some_pack())
    with zipfile.ZipFile(path, "a", zipfile.ZIP_LZMA) as archive, archive.open("more.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": False, "shape": shape})
    with pytest.raises(DamagedFileError, match="unpacks to more"):
        read_pack(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda head: head["images"].append(head["images"][0]),
        lambda head: head["images"][0].__setitem__(6, -1),
        lambda head: head["images"][0].__setitem__(6, 99),
        lambda head: head["frames"][0].__setitem__(5, 1e308),
        lambda head: head["frames"][0].__setitem__(5, "bright"),
        lambda head: head.pop("truths"),
    ],
)
def test_a_pack_whose_head_is_nonsense_is_refused(tmp_path, change):
    path = tmp_path / "a.npz"
    write_pack(path, some_pack())
    rewritten(path, change)
    with pytest.raises(DamagedFileError):
        read_pack(path)


def test_a_damaged_pack_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    write_pack(path, some_pack())
    data = path.read_bytes()
    for k, damaged in enumerate((data[:-100], data[:400] + bytes([data[400] ^ 1]) + data[401:], b"no archive")):
        other = tmp_path / f"damaged-{k}.npz"
        other.write_bytes(damaged)
        with pytest.raises(DamagedFileError):
            read_pack(other)
    with pytest.raises(UserError, match="no such file"):
        read_pack(tmp_path / "none.npz")


@pytest.mark.parametrize(
    ("now", "before", "percent"),
    [(1.1, 1.0, 10.0), (1.0, 1.25, -20.0), (0.0, 0.0, 0.0), (0.3, 0.0, 100.0), (None, 1.0, None)],
)
def test_noise_is_compared_in_per_cent_and_equal_digests_no_further(now, before, percent):
    about = {"radiance_sha256": "a", "images": ["x", "y"], "noise_dn": now}
    base = {"radiance_sha256": "a", "images": ["x", "z"], "noise_dn": before}
    frozen = FrozenFrame("s", "vis", "a", disc(0, 0), np.where(NEAR, LIMB, DISC).astype(np.uint8))
    found = compare_images("day", about, base, None, frozen)
    assert found["noise"] == (percent if percent is None else pytest.approx(percent))
    assert (found["same_radiance"], found["same_images"], found["n_images"]) == (True, 1, 2)
    assert (found["limb_radiance"], found["limb_displacement"]) == (0.0, 0.0)
    brighter = compare_images("day", about | {"radiance_sha256": "b"}, base, disc(0, 0, 1.02), frozen)
    assert not brighter["same_radiance"]
    assert brighter["limb_radiance"] == pytest.approx(2.0, abs=1e-3)
    assert compare_images("day", about, base, None, None)["limb_radiance"] is None


def test_a_row_of_elements_has_a_limb_that_can_move():
    """One pixel high: half an element is found, by the slope along the row alone."""
    elements = np.arange(160.0)
    height = (elements[None] - 79.5) * 4e3
    regions = regions_of(np.where(height > 0, 0, 1), height)
    assert LIMB in regions
    assert ELSEWHERE not in regions

    def edge(at):
        return (1.0 / (1.0 + np.exp((elements - at) / 4.0)))[None]

    assert displacement_px(edge(79.5), edge(79.5), regions == LIMB) == 0.0
    assert displacement_px(edge(79.5), edge(80.0), regions == LIMB) == pytest.approx(0.5, abs=0.05)
