"""The covered share of pixels against closed forms and against rays, through every kind of lens."""

from __future__ import annotations

import base64
import json
import math
import os
from typing import Any

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.mesh import mesh_triangles
from horizonval.geometry.part import Outline, _distance, blocked, coverage, outline_of, polygon_coverage, triangles_cam
from horizonval.spec.scene import SpacecraftPart as Part

AHEAD = (0.0, 0.0, 0.0, 1.0)
PINHOLE = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)
BROWN = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5, (-0.2, 0.05, 0.001, 0.002, 0.0))
FISHEYE = CameraModel(64, 64, 22.0, 22.0, 31.5, 31.5, (0.01, 0.0, 0.0, 0.0, 0.0), "fisheye", math.radians(95.0))
UNIFIED = CameraModel(64, 64, 30.0, 31.0, 31.5, 31.5, projection="unified", skew=0.02, shape=(1.1, 0.2, 0.9))
RATIONAL = CameraModel(64, 48, 40.0, 40.0, 31.5, 23.5, (0.9, 0.1, 1e-4, 2e-4, 3e-3, 1.3, 0.35, 0.02, 2e-3, 0, 1e-3, 0))
GRID = CameraModel(64, 48, 80.0, 80.0, 31.5, 23.5, projection="equal_angle")
PARTS = [
    Part(shape="boom", frame="cam", radius_m=0.1, from_m=(-1.0, -1.0, -1.0), to_m=(0.5, 0.6, 2.0)),
    Part(
        shape="panel", frame="cam", width_m=1.0, height_m=0.5, position_m=(0.5, -0.3, 1.0), yaw_deg=20.0, pitch_deg=30.0
    ),
    Part(shape="disc", frame="cam", radius_m=0.4, position_m=(-1.2, 0.3, 0.4), pitch_deg=60.0),
]


def _outline(parts: list[Part], camera: CameraModel) -> Outline:
    return outline_of([triangles_cam(part, AHEAD, "part") for part in parts], camera)


def test_a_polygon_by_the_areas_of_its_trapezia() -> None:
    """A triangle with a level and an upright side: the hypotenuse cuts squares whose areas are known."""
    corner = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 2.0]])
    share = polygon_coverage(corner, np.roll(corner, -1, axis=0), 5, 3)
    exact = [[1.0, 1.0, 0.75, 0.25, 0.0], [0.75, 0.25, 0.0, 0.0, 0.0], [0.0] * 5]
    np.testing.assert_allclose(share, exact, atol=1e-14)
    corner = np.array([[-1e6, -1e6], [1e6, -1e6], [1e6, 1.25], [-1e6, 1.25]])
    share = polygon_coverage(corner, np.roll(corner, -1, axis=0), 4, 3)
    np.testing.assert_allclose(share, np.repeat([[1.0], [0.25], [0.0]], 4, axis=1), atol=1e-9)


def test_a_disc_ahead_is_a_circle_of_its_size() -> None:
    """Area and, pixel by pixel, the circle's own coverage by a fine sum; 0.05 px is what is asked for."""
    camera = CameraModel(256, 256, 200.0, 200.0, 127.5, 127.5)
    disc = Part(shape="disc", frame="cam", radius_m=0.5, position_m=(0.0, 0.0, 1.0))
    share = coverage(_outline([disc], camera), camera)
    assert share.sum() == pytest.approx(math.pi * 100.0**2, rel=1e-5)
    # the upper half of the middle column: how high its edge stands
    column = share[:128, 127]
    assert column.sum() == pytest.approx(math.sqrt(100.0**2 - 0.25), abs=0.005)


def test_a_boom_sideways_is_as_wide_as_its_tangents() -> None:
    """Seen from outside a cylinder's edges are tangents: asin(r / d) to either side of its axis."""
    camera = CameraModel(64, 256, 300.0, 300.0, 31.5, 127.5)
    boom = Part(shape="boom", frame="cam", radius_m=0.2, from_m=(-3.0, 0.0, 1.0), to_m=(3.0, 0.0, 1.0))
    share = coverage(_outline([boom], camera), camera)
    np.testing.assert_allclose(share.sum(axis=0), 2.0 * 300.0 * math.tan(math.asin(0.2)), atol=0.01)


@pytest.mark.parametrize("camera", [PINHOLE, BROWN, FISHEYE, UNIFIED, RATIONAL, GRID])
def test_shares_are_those_of_rays(camera: CameraModel) -> None:
    """20 x 20 rays a pixel, met or not by the triangles themselves: neither the outline nor its edges are used."""
    outline = _outline(PARTS, camera)
    share = coverage(outline, camera)
    edge = np.argwhere((share > 0.02) & (share < 0.98))
    rng = np.random.default_rng(1)
    chosen = edge[rng.permutation(len(edge))[:16]]
    step = (np.arange(20) + 0.5) / 20 - 0.5
    offset = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    triangles = np.concatenate([triangles_cam(part, AHEAD, "part") for part in PARTS])
    compared = 0
    for row, column in chosen:
        d = unproject(camera, np.array([column, row]) + offset)
        if not np.isfinite(d).all():
            continue
        compared += 1
        # an edge through 20 x 20 points: half a step, 0.025 px, at worst, when it runs along the grid
        assert abs(blocked(triangles, d).mean() - share[row, column]) < 0.03
    assert compared > 8


def test_directions_are_hidden_as_rays_are() -> None:
    rng = np.random.default_rng(2)
    for camera in (PINHOLE, FISHEYE):
        d = unproject(camera, rng.uniform([0.0, 0.0], [63.0, 47.0], (200, 2)))
        d = d[np.isfinite(d).all(axis=-1)]
        triangles = np.concatenate([triangles_cam(part, AHEAD, "part") for part in PARTS])
        outline = Outline.from_dict(_outline(PARTS, camera).to_dict())
        # a ray in a thousand may pass within a thousandth of a pixel of an edge
        assert np.mean(outline.covers(d) != blocked(triangles, d)) < 0.005


def test_a_tube_round_the_boresight_leaves_a_hole() -> None:
    camera = CameraModel(128, 128, 60.0, 60.0, 63.5, 63.5)
    baffle = Part(shape="baffle", frame="cam", radius_m=0.1, length_m=0.2, position_m=(0.0, 0.0, 0.01))
    share = coverage(_outline([baffle], camera), camera)
    assert share[64, 64] == 0.0
    assert 128**2 - share.sum() == pytest.approx(math.pi * (60.0 * 0.1 / 0.21) ** 2, rel=1e-4)


def test_parts_turn_in_the_order_of_the_house() -> None:
    """Yaw, pitch and roll turn the frame's axes into the part's: as a mounting turns body axes into the camera's."""
    boom = {"shape": "boom", "radius_m": 0.01, "from_m": (0.0, 0.0, 1.0), "to_m": (0.0, 0.0, 2.0)}
    rolled = triangles_cam(Part(**boom, frame="cam", roll_deg=90.0), AHEAD, "part").reshape(-1, 3)
    # z of the part is then -y of the frame
    np.testing.assert_allclose(rolled.mean(axis=0), [0.0, -1.5, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (Part(name="lid", shape="disc", frame="cam", radius_m=0.1), "0 mm from the camera"),
        (
            Part(name="can", shape="boom", frame="cam", radius_m=0.5, from_m=(0.0, 0.0, -1.0), to_m=(0.0, 0.0, 1.0)),
            "encloses the camera",
        ),
    ],
)
def test_parts_on_or_round_the_camera_are_refused(part: Part, said: str) -> None:
    with pytest.raises(UserError, match=said):
        triangles_cam(part, AHEAD, "part[1]")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("gone.ply", None, "no such file|not found|does not exist"),
        ("flat.obj", "v 0 0 1\nv 1 0 1\nv 2 0 1\nf 1 2 3\n", "degenerate"),
        ("empty.obj", "# nothing\n", "mesh"),
        ("wrong.ply", "this is no mesh\n", "does not begin with ply"),
        ("latin.ply", "ply\nformat ascii 1.0\ncomment \udce9\nend_header\n", "has no vertices or no faces"),
        ("part.stl", "solid\n", "no mesh can be read"),
    ],
)
def test_meshes_that_cannot_be(tmp_path, name: str, text: str | None, said: str) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text, errors="surrogateescape")
    with pytest.raises(UserError, match=f"(?i){said}") as caught:
        triangles_cam(Part(shape="mesh", file=str(path)), AHEAD, "part[1]")
    assert "\n" not in caught.value.line()


def test_a_tiny_part_is_at_its_distance() -> None:
    """Triangles without an area have corners and edges; numpy's warnings are errors here."""
    with np.errstate(all="raise", under="ignore"):
        assert _distance(1e-200 * np.ones((1, 3, 3)) + [0.0, 0.0, 2.0]) == pytest.approx([2.0])


TRIANGLE = "v 0 0 2\nv 1 0 2\nv 0 1 2\n"
FLAT = base64.b64encode(np.array([[0, 0, 2], [1, 0, 2], [0, 1, 2]], "<f4").tobytes()).decode()


def _gltf(
    uri: str = f"data:application/octet-stream;base64,{FLAT}",
    count: int = 3,
    nodes: int = 1,
    nodes_: Any = None,
    index: Any = None,
    **more: Any,
) -> str:
    buffers = [{"uri": uri, "byteLength": 36}]
    accessors = [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}] + [index] * bool(index)
    mesh = {"primitives": [{"attributes": {"POSITION": 0}} | ({"indices": 1} if index else {})]}
    tree = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(nodes))}], "meshes": [mesh]}
    tree |= {"nodes": [{"mesh": 0}] * nodes if nodes_ is None else nodes_, "buffers": buffers, "accessors": accessors}
    return json.dumps(tree | {"bufferViews": [{"buffer": 0, "byteLength": 36}]} | more)


@pytest.mark.skipif(os.name != "posix", reason="no FIFO")
@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.obj", f"mtllib fifo\nusemtl a\n{TRIANGLE}vt 0 0\nf 1/1 2/1 3/1\n", ""),
        ("a.gltf", _gltf(images=[{"uri": "fifo"}], textures=[{"source": 0}], materials=[{}]), ""),
        ("a.ply", "ply\nformat ascii 1.0\ncomment TextureFile fifo\nelement vertex 3\nproperty float x\n"
         "property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
         "0 0 2\n1 0 2\n0 1 2\n3 0 1 2\n", ""),
        ("b.gltf", _gltf("fifo"), "fifo: is a FIFO"),
        ("b.gltf", _gltf("link"), "link: is a link"),
        ("b.gltf", _gltf("../b.bin"), "names '../b.bin'; expected a file in its own folder"),
        ("b.gltf", _gltf("/etc/passwd"), "names '/etc/passwd'"),
        ("b.gltf", _gltf(count=10**12), "an accessor of 1000000000000 elements"),
        ("b.gltf", _gltf(nodes=200_001), "has 200001 nodes; expected 10000 at most"),
        ("b.gltf", "[" * 100_000, "nested too deeply"),
        ("b.gltf", "1" * 10_000, "a number of thousands of digits"),
        ("b.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n",
         "announces 99999999999 elements"),
        ("b.obj", TRIANGLE.replace("1", "1e300") + "f 1 2 3\n", "not finite, or very far"),
        ("b.obj", TRIANGLE.replace("1", "1e9") + "f 1 2 3\n", "lies too far from the camera"),
        ("b.obj", TRIANGLE + "f 1 2 99999999999999999999\n",
         "line 4: '99999999999999999999' is no number of a vertex"),
    ],
)  # fmt: skip
def test_a_mesh_waits_for_nothing_and_takes_no_memory_that_it_does_not_fill(tmp_path, name, text, said) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "link").symlink_to("fifo")
    (tmp_path / name).write_text(text)
    part = Part(shape="mesh", file=str(tmp_path / name), frame="cam")
    if not said:
        assert triangles_cam(part, AHEAD, "part[1]").shape == (1, 3, 3)
        return
    with pytest.raises(UserError) as refused:
        triangles_cam(part, AHEAD, "part[1]")
    assert said in refused.value.line()


def _tree(**more: Any) -> bytes:
    return _gltf(**more).encode()


_PLY = b"ply\nformat %s 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
_PLY += b"property list %s int vertex_indices\nend_header\n"
_CORNERS = np.array([[0, 0, 2], [1, 0, 2], [1, 1, 2], [0, 1, 2]])
_FACES = ((3, 0, 1, 2), (4, 0, 1, 2, 3))
_TEXT = "".join(" ".join(map(str, row)) + "\n" for row in (*_CORNERS.tolist(), *_FACES)).encode()
_BYTES = _CORNERS.astype(">f4").tobytes() + b"".join(np.array(face, ">i4").tobytes() for face in _FACES)
_INDEX = {"componentType": 5121, "count": 3, "type": "SCALAR", "bufferView": 0}


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.obj", b"v 0 0 2\r\nv 1 0 \\\n2\nv 0 1 2 # c\nf -3/1 -2//2 -1\nv 9 9 9\n", 1),
        ("a.obj", b"v 0 0 2\nv 1 0 2\nv 1 1 2\nv 0 1 2\nf 1 2 3 4\nf 1 2 3\n", 3),
        ("a.obj", b"v 0 0 2\nv 1 0 two\n", "line 2: '1 0 two' are not coordinates"),
        ("a.obj", b"v 0 0 2\nv 1 0 \\\n2_0\n", "line 2: '1 0 2_0' are not coordinates"),
        ("a.obj", TRIANGLE.encode() + b"f 1 2 4\n", "line 4: names vertex 4 of 3"),
        ("a.obj", TRIANGLE.encode() + b"f 1 2 -4\n", "line 4: names vertex -4 of 3"),
        ("a.obj", TRIANGLE.encode() + b"f 0 1 2\n", "line 4: '0' is no number of a vertex"),
        ("a.obj", TRIANGLE.encode() + b"f 1 2\n", "line 4: a face of 2 corners"),
        ("a.ply", _PLY % (b"ascii", b"int") + _TEXT, 3),
        ("a.ply", _PLY % (b"binary_big_endian", b"int") + _BYTES, 3),
        ("a.ply", _PLY % (b"binary_big_endian", b"uint") + _BYTES[:48] + b"\xff" * 20, "face 1: a list of 4294967295"),
        ("a.ply", _PLY % (b"binary_big_endian", b"int") + _BYTES[:48] + b"\xff" * 20, "face 1: a list of -1 items"),
        ("a.ply", _PLY % (b"binary_big_endian", b"int") + _BYTES[:-1], "face 2: is truncated"),
        ("a.ply", _PLY % (b"binary_big_endian", b"int") + _BYTES + b"0", "1 bytes more than the header announces"),
        ("a.ply", _PLY % (b"ascii", b"int") + _TEXT + b"1\n", "line 16: more rows than the header announces"),
        ("a.ply", _PLY % (b"ascii", b"int") + _TEXT.replace(b"3 0", b"3 1e300"), "face 1: names vertex 1e+300"),
        ("a.ply", _PLY % (b"ascii", b"int") + _TEXT.replace(b"3 0", b"3 7"), "triangle 1: names vertex 7 of 4"),
        ("a.ply", _PLY % (b"ascii", b"int") + _TEXT.replace(b"1 0 2", b"1 0"), "line 11: vertex 2 has too few"),
        ("a.ply", _PLY.replace(b"float x", b"list int float x") % (b"ascii", b"int") + _TEXT, "have no x, y or z"),
        ("a.ply", _PLY.replace(b"float y", b"float x") % (b"ascii", b"int") + _TEXT, "a name that comes twice"),
        ("a.ply", b"ply\nelement vertex -3\nend_header\n", "line 2: 'element vertex -3' is no line of a header"),
        ("a.ply", b"ply\n" + b"comment\n" * 9000, "has no end_header in its first 64 KiB"),
        ("a.gltf", _tree(uri="my%20numbers.bin"), 1),
        ("a.gltf", _tree(uri="http://127.0.0.1:9/x.bin"), "names 'http://127.0.0.1:9/x.bin', an address"),
        ("a.gltf", _tree(uri="%2e%2e/x.bin"), "names '../x.bin'; expected a file in its own folder"),
        ("a.gltf", _tree(extensionsRequired=["KHR_draco_mesh_compression"]), "requires 'KHR_draco_mesh_compression'"),
        ("a.gltf", _tree(extensionsRequired=["KHR_materials_unlit"]), 1),
        ("a.gltf", _tree(nodes=2, nodes_=[{"mesh": 0, "children": [1]}, {}]), "nodes[1]: is named twice"),
        ("a.gltf", _tree(nodes_=[{"mesh": 0}, {"children": [2]}, {"children": [1]}]), "nodes[2]: is below itself"),
        ("a.gltf", _tree(nodes_=[{"children": [1, 1]}, {"mesh": 0}]), "nodes[1]: is a child of node 0 twice"),
        ("a.gltf", _tree(nodes_=[{"children": [i + 1]} for i in range(300)] + [{"mesh": 0}]), "than 200 nodes deep"),
        ("a.gltf", _tree(nodes_=[{"mesh": 9}]), "nodes[0].mesh: found 9; expected 0, the only one there is"),
        ("a.gltf", _tree(nodes_=[{"mesh": 0}] * 10_001), "has 10001 nodes"),
        ("a.gltf", _tree(nodes_="abc"), "nodes: is no list of objects"),
        ("a.gltf", _tree(nodes_=[{"mesh": 0, "matrix": [1.0]}]), "nodes[0].matrix: is not 16 numbers"),
        ("a.gltf", _tree(scene=7), "scene: found 7"),
        ("a.gltf", _tree(meshes=[{"primitives": [{}] * 10_001}]), "has 10001 primitives"),
        ("a.gltf", _tree(count=4), "accessors[0]: 4 elements do not fit into the 36 bytes of their view"),
        ("a.gltf", _tree(buffers=[{"byteLength": 37, "uri": f"data:;base64,{FLAT}"}]), "byteLength: found 37"),
        ("a.gltf", _tree(bufferViews=[{"buffer": 0, "byteLength": 36, "byteOffset": -4}]), "byteOffset: found -4"),
        ("a.gltf", _tree(accessors=[{"componentType": [], "type": {}, "count": 3}]), "accessors[0]: numbers of type"),
        ("a.gltf", _tree(index=_INDEX | {"count": 36}), "indices: name vertex 128 of 3"),
        ("a.gltf", b"[1, 2]", "its JSON is no object"),
        ("a.glb", b"glTF\2\0\0\0\x80\0\0\0", "is truncated: 12 of 128 bytes"),
        ("a.glb", b"glTF\1\0\0\0\x0c\0\0\0", "is a binary glTF of version 1"),
        ("a.glb", b"{}", "does not begin as a binary glTF"),
    ],
)  # fmt: skip
def test_a_mesh_is_read_as_its_standard_says_or_the_wrong_place_is_named(tmp_path, name, data, said) -> None:
    (tmp_path / "my numbers.bin").write_bytes(base64.b64decode(FLAT))
    (tmp_path / name).write_bytes(data)
    if isinstance(said, int):
        assert mesh_triangles(str(tmp_path / name), "part[1]").shape == (said, 3, 3)
        return
    with pytest.raises(UserError) as refused:
        mesh_triangles(str(tmp_path / name), "part[1]")
    assert said in refused.value.line()
    assert "\n" not in refused.value.line()


def test_a_mesh_file_is_what_its_triangles_are(tmp_path) -> None:
    """A cube as OBJ, as PLY and as binary glTF covers what six panels do."""
    import trimesh

    cube = trimesh.creation.box((0.4, 0.4, 0.4))
    seen = []
    for kind in ("obj", "ply", "glb"):
        path = tmp_path / f"cube.{kind}"
        cube.export(path)
        part = Part(shape="mesh", file=str(path), frame="cam", position_m=(0.1, 0.0, 1.0), yaw_deg=30.0, scale=0.8)
        seen.append(coverage(_outline([part], PINHOLE), PINHOLE))
    # the front face alone, turned about the boresight
    assert seen[0].sum() == pytest.approx((50.0 * 0.32 / 0.84) ** 2, rel=1e-3)
    for other in seen[1:]:
        np.testing.assert_allclose(seen[0], other, atol=1e-4)
