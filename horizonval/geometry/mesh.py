"""Meshes from files: OBJ and PLY, and glTF through trimesh.

A glTF is checked before trimesh reads it, whose time grows with the square of the depth of the nodes, and which takes
rings of nodes and unknown extensions without a word. Faces of more than three corners become fans.
"""

from __future__ import annotations

import array
import base64
import binascii
import io
import itertools
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt
from horizonval.core.json_types import JsonObject
from horizonval.spec.explain import show

KINDS = (".ply", ".obj", ".gltf", ".glb")
MOST_TRIANGLES = 200_000
MOST_VERTICES = 3 * MOST_TRIANGLES
MOST_PIECES, DEEPEST = 10_000, 200
"""Nodes and primitives of a glTF, and nodes from its scene to a mesh."""
EXPECTED = "a mesh: PLY, OBJ or glTF"
LARGEST_MESH = 64 * 1024 * 1024
"""Size of a mesh file, and of a file with its numbers [bytes]."""
LARGEST_COORDINATE = 1e12
"""Largest coordinate of a mesh in its unit."""


class MeshFile(Mapping[str, bytes]):
    """Bytes of a mesh and ``place``, its name in messages; as a mapping, the files that it names in its folder."""

    def __init__(self, path: Path, where: str) -> None:
        self.path, self.place = path, f"{where}: {path}"
        try:
            self.data = files.read_bytes(path, largest=LARGEST_MESH, expected=EXPECTED)
        except UserError as error:
            raise error.inside(where) from None
        self._named: dict[str, bytes] = {}

    def mistake(self, what: str, at: str = "", expected: str = EXPECTED) -> UserError:
        """Return a mistake at a line or key of the file."""
        return UserError(what, where=f"{self.place}: {at}" if at else self.place, expected=expected)

    def refuse_many(self, count: int, what: str = "triangles", most: int = MOST_TRIANGLES) -> None:
        """Refuse a mesh of more than ``most`` pieces."""
        if count > most:
            what = f"the mesh has {count} {what}"
            raise UserError(what, where=self.place, expected=f"{most} at most", fix="simplify it")

    def __getitem__(self, uri: str) -> bytes:
        if uri not in self._named:
            name = unquote(uri)
            expected = "a file in its own folder"
            if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", uri):
                raise self.mistake(f"names {excerpt(uri)!r}, an address", expected=expected)
            named = self.path.parent / name
            if not files.is_inside(named, self.path.parent):
                raise self.mistake(f"names {excerpt(name)!r}", expected=expected)
            try:
                data = files.read_bytes(named, largest=LARGEST_MESH, expected="numbers of the mesh", links=False)
            except UserError as error:
                raise error.inside(self.place) from None
            self._named[uri] = data
        return self._named[uri]

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


def mesh_triangles(file: str, where: str) -> FloatArray:
    """Return the triangles of a mesh in the file's axes and unit, shape (n, 3, 3); ``where`` is the part, for errors.

    Nodes of a glTF scene are at their positions. Materials and textures are not opened; buffers of a glTF are regular
    files of its own folder. UserError: the file cannot be read, or has no triangles, too many, positions that are not
    finite, or no area.
    """
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix not in KINDS:
        raise UserError(f"no mesh can be read from {suffix!r} files", where=f"{where}: {path}", expected=EXPECTED)
    mesh = MeshFile(path, where)
    triangles = {".obj": _obj, ".ply": _ply}.get(suffix, _gltf)(mesh)
    if not len(triangles):
        raise mesh.mistake("the mesh has no triangles", expected="at least one")
    if not (np.abs(triangles) < LARGEST_COORDINATE).all():
        expected = f"finite numbers below {LARGEST_COORDINATE:g}"
        raise mesh.mistake("the mesh has corners that are not finite, or very far", expected=expected)
    area = 0.5 * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=-1)
    size = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    solid = area > 1e-14 * size**2
    if not solid.any():
        raise mesh.mistake("the mesh is degenerate: its triangles have no area", expected="a surface")
    return triangles[solid]


class _Faces:
    """Triangles of faces, as indices of corners."""

    def __init__(self, mesh: MeshFile) -> None:
        self.mesh, self.corners = mesh, array.array("q")

    def add(self, corners: list[int]) -> None:
        """Add the fan of a face."""
        self.mesh.refuse_many(len(self.corners) // 3 + len(corners) - 2)
        for second, third in itertools.pairwise(corners[1:]):
            self.corners.extend((corners[0], second, third))

    def of(self, vertices: array.array[float]) -> FloatArray:
        """Return the triangles, shape (n, 3, 3)."""
        index = np.array(self.corners, dtype=np.int64).reshape(-1, 3)
        return np.array(vertices, dtype=np.float64).reshape(-1, 3)[index]


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE | re.ASCII)


def _obj(mesh: MeshFile) -> FloatArray:
    vertices, faces = array.array("d"), _Faces(mesh)
    farthest, held, begin = (0, 0), "", 0
    for number, line in enumerate(mesh.data.decode(errors="replace").split("\n"), start=1):
        begin = begin if held else number
        line = line.rstrip("\r")
        if line.endswith("\\"):
            held += line[:-1]
            mesh.refuse_many(len(held) // 2, "corners in a face", MOST_VERTICES)
            continue
        kind, *words = (held + line).split("#")[0].split() or ("",)
        held, at = "", f"line {begin}"
        if kind == "v":
            if len(words) < 3 or not all(map(_NUMBER.fullmatch, words[:3])):
                raise mesh.mistake(f"{excerpt(' '.join(words))!r} are not coordinates", at, "v and three numbers")
            vertices.extend(map(float, words[:3]))
            mesh.refuse_many(len(vertices) // 3, "vertices", MOST_VERTICES)
        elif kind == "f":
            count, corners = len(vertices) // 3, []
            for word in words:
                index = word.split("/")[0]
                if not re.fullmatch(r"[+-]?\d{1,18}", index, re.ASCII) or not int(index):
                    raise mesh.mistake(f"{excerpt(index)!r} is no number of a vertex", at, "whole numbers from 1")
                corner = int(index)
                if corner < -count:
                    raise mesh.mistake(f"names vertex {corner} of {count}", at, "a vertex of the lines before")
                corners.append(corner - 1 if corner > 0 else count + corner)
                farthest = max(farthest, (corner, begin))
            if len(corners) < 3:
                raise mesh.mistake(f"a face of {len(corners)} corners", at, "three or more")
            faces.add(corners)
    if farthest[0] > len(vertices) // 3:
        what = f"names vertex {farthest[0]} of {len(vertices) // 3}"
        raise mesh.mistake(what, f"line {farthest[1]}", "a vertex of the file")
    return faces.of(vertices)


_PLY_NAMES = (
    ("char", "uchar", "short", "ushort", "int", "uint", "float", "double"),
    ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"),
)
_PLY_TYPES = {name: letter for names in _PLY_NAMES for name, letter in zip(names, "bBhHiIfd", strict=True)}
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_HEADER = 64 * 1024


def _ply(mesh: MeshFile) -> FloatArray:
    order, elements, body, lines = _ply_header(mesh)
    take = _binary_rows(mesh, body, order) if order else _text_rows(mesh, body, lines)
    vertices, faces = array.array("d"), _Faces(mesh)
    if not {"vertex", "face"} <= {name for name, _, _ in elements}:
        raise mesh.mistake("has no vertices or no faces", expected="elements vertex and face")
    for name, count, properties in elements:
        names = [one for one, _, _ in properties]
        corners_at = [k for k, one in enumerate(names) if one in ("vertex_indices", "vertex_index")]
        if name == "face" and not corners_at:
            raise mesh.mistake("its faces have no vertex_indices", expected="property list uchar int vertex_indices")
        if name == "vertex" and not {"x", "y", "z"} <= {one for one, length, _ in properties if not length}:
            raise mesh.mistake("its vertices have no x, y or z", expected="property float x, y and z")
        where = [names.index(axis) for axis in "xyz"] if name == "vertex" else []
        for row in range(count):
            place = f"{name} {row + 1}"
            values = take(place, properties)
            if where:
                vertices.extend(values[k] for k in where)
            if name == "face":
                corners = values[corners_at[0]]
                if not isinstance(corners, list) or len(corners) < 3:
                    raise mesh.mistake("a face of less than three corners", place, "three or more")
                for corner in corners:
                    if not (0 <= corner < MOST_VERTICES and corner == int(corner)):
                        raise mesh.mistake(f"names vertex {corner:g}", place, "whole numbers from 0")
                faces.add([int(corner) for corner in corners])
    take("the end", [])
    total, last = len(vertices) // 3, max(faces.corners, default=-1)
    if last >= total:
        what = f"names vertex {last} of {total}, counted from 0"
        raise mesh.mistake(what, f"triangle {faces.corners.index(last) // 3 + 1}", "vertices that it has")
    return faces.of(vertices)


Properties = list[tuple[str, str, str]]
"""Name, type of the length (empty for a number) and type of each property of an element, as letters of ``struct``."""
Take = Callable[[str, Properties], list[Any]]


def _ply_header(mesh: MeshFile) -> tuple[str, list[tuple[str, int, Properties]], bytes, int]:
    """Return the order of bytes (empty for text), the elements, the bytes after the header, and its number of lines."""
    end = re.search(rb"^end_header\r?\n", mesh.data[:_PLY_HEADER], re.MULTILINE)
    if not mesh.data.startswith(b"ply"):
        raise mesh.mistake("does not begin with ply", expected="a PLY file")
    if end is None:
        raise mesh.mistake(f"has no end_header in its first {_PLY_HEADER // 1024} KiB", expected="a PLY file")
    order, elements = "", []
    lines = mesh.data[: end.start()].decode(errors="replace").splitlines()
    for number, line in enumerate(lines[1:], start=2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", form, _] if form in _PLY_ORDERS:
                order = _PLY_ORDERS[form]
            case ["element", name, count] if re.fullmatch(r"\d{1,18}", count, re.ASCII):
                if int(count) > min(MOST_VERTICES, len(mesh.data)):
                    raise mesh.mistake(f"announces {count} elements", f"line {number}", f"{MOST_VERTICES} at most")
                elements.append((name, int(count), Properties()))
            case ["property", kind, name] if elements and kind in _PLY_TYPES:
                elements[-1][2].append((name, "", _PLY_TYPES[kind]))
            case ["property", "list", length, kind, name] if (
                elements and length in _PLY_TYPES and _PLY_TYPES[length] not in "fd" and kind in _PLY_TYPES
            ):
                elements[-1][2].append((name, _PLY_TYPES[length], _PLY_TYPES[kind]))
            case _:
                what = f"{excerpt(line)!r} is no line of a header"
                raise mesh.mistake(what, f"line {number}", "format, element, property or comment")
    for name, _, properties in elements:
        if [one for one, _, _ in elements].count(name) > 1 or len({one for one, _, _ in properties}) < len(properties):
            raise mesh.mistake("a name that comes twice", f"element {name}")
        if not properties or sum(bool(length) for _, length, _ in properties) > 8:
            raise mesh.mistake("has no property, or more than 8 lists", f"element {name}")
    return order, elements, mesh.data[end.end() :], len(lines) + 1


def _text_rows(mesh: MeshFile, body: bytes, lines: int) -> Take:
    """Return what takes the next row, a line of text."""
    rows = enumerate(io.BytesIO(body), start=lines + 1)

    def take(place: str, properties: Properties) -> list[Any]:
        number, row = next(((number, row) for number, row in rows if row.strip()), (0, b""))
        if bool(number) != bool(properties):
            what = f"ends before {place}" if properties else "more rows than the header announces"
            raise mesh.mistake(what, f"line {number}" if number else "", "a row for every element")
        words = iter(row.decode(errors="replace").split())

        def numbers(count: int) -> list[float]:
            found = list(itertools.islice(words, count))
            if len(found) < count:
                raise mesh.mistake(f"{place} has too few numbers", f"line {number}", f"{count - len(found)} more")
            for word in found:
                if not _NUMBER.fullmatch(word):
                    raise mesh.mistake(f"{excerpt(word)!r} is no number", f"line {number}", f"those of {place}")
            return [float(word) for word in found]

        values: list[Any] = []
        for _, length, _ in properties:
            if not length:
                values += numbers(1)
                continue
            items = numbers(1)[0]
            if not (0 <= items <= MOST_VERTICES and items.is_integer()):
                raise mesh.mistake(f"a list of {items:g} items", f"line {number}", "a face's corners")
            values.append(numbers(int(items)))
        if next(words, None) is not None:
            raise mesh.mistake(f"{place} has too many numbers", f"line {number}", f"{len(properties)} properties")
        return values

    return take


def _binary_rows(mesh: MeshFile, body: bytes, order: str) -> Take:
    """Return what takes the next row of bytes."""
    at = 0

    def numbers(place: str, form: str) -> tuple[Any, ...]:
        nonlocal at
        begin, at = at, at + struct.calcsize(order + form)
        if at > len(body):
            raise mesh.mistake("is truncated", place, "all its numbers")
        return struct.unpack_from(order + form, body, begin)

    def take(place: str, properties: Properties) -> list[Any]:
        if not properties and at < len(body):
            raise mesh.mistake(f"{len(body) - at} bytes more than the header announces")
        values: list[Any] = []
        run = ""
        for _, length, kind in properties:
            if not length:
                run += kind
                continue
            *before, items = numbers(place, run + length)
            if not 0 <= items <= MOST_VERTICES:
                raise mesh.mistake(f"a list of {items} items", place, "a face's corners")
            values += [*before, list(numbers(place, f"{items}{kind}"))]
            run = ""
        return [*values, *numbers(place, run)]

    return take


def _gltf(mesh: MeshFile) -> FloatArray:
    # Loaded here: scenes without meshes have no use for it.
    import trimesh

    text, binary = _chunks(mesh) if mesh.path.suffix.lower() == ".glb" else (mesh.data, None)
    _Tree(mesh, files.parse_json(text.decode(errors="replace"), mesh.place), binary).check()
    try:
        kind = mesh.path.suffix[1:].lower()
        with np.errstate(all="ignore"):
            scene = trimesh.load_scene(io.BytesIO(mesh.data), kind, resolver=mesh, skip_materials=True, process=False)
            return np.asarray(scene.to_mesh().triangles, dtype=np.float64).reshape(-1, 3, 3)
    except UserError:
        raise
    except (Exception, RecursionError):
        # The library's own sentences speak of its code.
        raise mesh.mistake("the mesh cannot be read") from None


def _chunks(mesh: MeshFile) -> tuple[bytes, bytes | None]:
    """Return the JSON and the numbers of a binary glTF."""
    data = mesh.data
    if data[:4] != b"glTF":
        raise mesh.mistake("does not begin as a binary glTF does", expected="glTF")
    if len(data) >= 8 and (version := int.from_bytes(data[4:8], "little")) != 2:
        raise mesh.mistake(f"is a binary glTF of version {version}", expected="version 2")
    whole = int.from_bytes(data[8:12], "little")
    end = 20 + int.from_bytes(data[12:16], "little")
    ends = end + 8 + int.from_bytes(data[end : end + 4], "little") if end + 8 <= len(data) else end
    if len(data) < max(20, whole, end, ends):
        raise mesh.mistake(f"is truncated: {len(data)} of {max(20, whole, end, ends)} bytes", expected="a whole file")
    if data[16:20] != b"JSON" or end == 20:
        raise mesh.mistake("its first chunk is empty or not JSON", expected="a binary glTF")
    return data[20:end], data[end + 8 : ends] if data[end + 4 : end + 8] == b"BIN\0" else None


_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_ITEMS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_NO_SHAPES = re.compile(r"(KHR_materials|KHR_texture|EXT_texture|KHR_lights|KHR_animation)_\w+|KHR_mesh_quantization")
"""Extensions that change no shape, or that trimesh knows."""


class _Tree:
    """What the JSON of a glTF says."""

    def __init__(self, mesh: MeshFile, tree: Any, binary: bytes | None) -> None:
        self.mesh, self.binary = mesh, binary
        if not isinstance(tree, dict):
            raise mesh.mistake("its JSON is no object", expected="a glTF with the keys asset, scenes, nodes, meshes")
        self.tree: JsonObject = tree
        names = ("scenes", "nodes", "meshes", "accessors", "bufferViews", "buffers")
        self.tables = {name: self._objects(tree, name, "") for name in names}
        for name in names:
            mesh.refuse_many(len(self.tables[name]), name, MOST_PIECES if name == "nodes" else 10 * MOST_PIECES)
        self._largest: dict[int, int] = {}

    def check(self) -> None:
        """Refuse what trimesh would misread, or take too long for."""
        required = self.tree.get("extensionsRequired", [])
        if not isinstance(required, list):
            raise self.mesh.mistake("is no list", "extensionsRequired")
        for name in required:
            if not isinstance(name, str) or not _NO_SHAPES.fullmatch(name):
                what = f"requires {excerpt(str(name))!r}, which is not read"
                raise self.mesh.mistake(what, "extensionsRequired", "a mesh without extensions")
        nodes, meshes = self.tables["nodes"], self.tables["meshes"]
        uses = self._uses()
        self._numbers()
        primitives = [self._objects(one, "primitives", f"meshes[{i}].") for i, one in enumerate(meshes)]
        pieces = sum(len(one) for one in primitives)
        drawn = [primitives[nodes[i]["mesh"]] for i in uses if "mesh" in nodes[i]]
        self.mesh.refuse_many(max(pieces, sum(map(len, drawn))), "primitives", MOST_PIECES)
        counts = [
            sum(self._triangles(piece, f"meshes[{i}].primitives[{k}]") for k, piece in enumerate(one))
            for i, one in enumerate(primitives)
        ]
        self.mesh.refuse_many(sum(counts[nodes[i]["mesh"]] for i in uses if "mesh" in nodes[i]))

    def _objects(self, table: JsonObject, name: str, at: str) -> list[JsonObject]:
        found = table.get(name, [])
        if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
            raise self.mesh.mistake("is no list of objects", at + name)
        return found

    def _whole(self, table: JsonObject, key: str, at: str, most: int, least: int = 0, default: Any = None) -> int:
        value = table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            expected = f"a whole number from {least} to {most}" if most > least else f"{least}, the only one there is"
            expected = expected if most >= least else "none: the file has nothing that it could name"
            what = "is missing" if value is None else f"found {show(value)}"
            raise self.mesh.mistake(what, f"{at}.{key}".removeprefix("."), expected)
        return value

    def _index(self, table: JsonObject, key: str, at: str, name: str) -> int:
        return self._whole(table, key, at, len(self.tables[name]) - 1)

    def _named(self, table: JsonObject, key: str, at: str) -> list[int]:
        """Return the nodes that a list names."""
        found = table.get(key, [])
        if not isinstance(found, list):
            raise self.mesh.mistake("is no list", f"{at}.{key}")
        return [self._whole({key: one}, key, at, len(self.tables["nodes"]) - 1) for one in found]

    def _uses(self) -> list[int]:
        """Return the nodes of the scene; the nodes must be trees."""
        nodes, scenes = self.tables["nodes"], self.tables["scenes"]
        parents: dict[int, int] = {}
        children = [self._named(node, "children", f"nodes[{i}]") for i, node in enumerate(nodes)]
        for i, node in enumerate(nodes):
            for child in children[i]:
                if child in parents:
                    of = f"nodes {parents[child]} and {i}" if parents[child] != i else f"node {i} twice"
                    raise self.mesh.mistake(f"is a child of {of}", f"nodes[{child}]", "a node with one parent")
                parents[child] = i
            for key, size in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
                value = node.get(key, [0] * size)
                numbers = isinstance(value, list) and all(isinstance(x, int | float) for x in value)
                if not numbers or len(value) != size:
                    raise self.mesh.mistake(f"is not {size} numbers", f"nodes[{i}].{key}")
            if "mesh" in node:
                self._index(node, "mesh", f"nodes[{i}]", "meshes")
        level, depth = [i for i in range(len(nodes)) if i not in parents], 0
        reached = set(level)
        while level:
            depth += 1
            level = [child for i in level for child in children[i]]
            reached.update(level)
            if level and depth == DEEPEST:
                raise self.mesh.mistake(f"more than {DEEPEST} nodes deep", f"nodes[{level[0]}]", "a flatter tree")
        # What has no root above is in a ring, or below one.
        if (ring := next((i for i in parents if i not in reached), None)) is not None:
            seen: set[int] = set()
            while ring not in seen:
                seen.add(ring)
                ring = parents[ring]
            raise self.mesh.mistake("is below itself: its parents go round in a ring", f"nodes[{ring}]", "a tree")
        shown: list[list[int]] = []
        for i, one in enumerate(scenes):
            roots = self._named(one, "nodes", f"scenes[{i}]")
            twice: set[int] = set(parents)
            for root in roots:
                if root in twice:
                    what = f"is named twice: by scenes[{i}] and by "
                    what += f"nodes[{parents[root]}]" if root in parents else "it again"
                    raise self.mesh.mistake(what, f"nodes[{root}]", "a node with one parent")
                twice.add(root)
            shown.append(roots)
        if "scene" in self.tree:
            self._whole(self.tree, "scene", "", len(scenes) - 1)
        level = shown[self.tree.get("scene", 0)] if shown else []
        uses: list[int] = []
        while level:
            uses += level
            level = [child for i in level for child in children[i]]
        return uses

    def _numbers(self) -> None:
        """Check that accessors lie within their views, and views within their buffers."""
        tables = self.tables
        self.lengths: list[int] = []
        self.contents: list[bytes] = []
        for i, one in enumerate(tables["buffers"]):
            at = f"buffers[{i}]"
            uri = one.get("uri")
            if uri is None and i == 0 and self.binary is not None:
                content = self.binary
            elif not isinstance(uri, str):
                raise self.mesh.mistake("is missing", f"{at}.uri", "the name of a file, or data")
            else:
                content = self._data(uri, at)
            self.lengths.append(self._whole(one, "byteLength", at, len(content), 1))
            self.contents.append(content)
        for i, one in enumerate(tables["bufferViews"]):
            at = f"bufferViews[{i}]"
            length = self.lengths[self._index(one, "buffer", at, "buffers")]
            offset = self._whole(one, "byteOffset", at, length, default=0)
            self._whole(one, "byteLength", at, length - offset, 1)
            self._whole(one, "byteStride", at, 252, 4, default=4)
        total = 0
        for i, one in enumerate(tables["accessors"]):
            at = f"accessors[{i}]"
            count = self._whole(one, "count", at, 2**63, 1)
            total += count
            if max(count / 10, total / 50) > MOST_TRIANGLES:
                raise self.mesh.mistake(f"has an accessor of {count} elements", expected="a mesh")
            if one.get("componentType") not in list(_COMPONENTS) or one.get("type") not in list(_ITEMS):
                what = f"numbers of type {excerpt(str(one.get('componentType')))}, {excerpt(str(one.get('type')))}"
                raise self.mesh.mistake(what, at, "a componentType and type of glTF 2.0")
            if "bufferView" not in one:
                continue
            view = tables["bufferViews"][self._index(one, "bufferView", at, "bufferViews")]
            size = np.dtype(_COMPONENTS[one["componentType"]]).itemsize * _ITEMS[one["type"]]
            length = view["byteLength"] - self._whole(one, "byteOffset", at, view["byteLength"], default=0)
            if view.get("byteStride", size) * (count - 1) + size > length:
                raise self.mesh.mistake(f"{count} elements do not fit into the {length} bytes of their view", at)

    def _data(self, uri: str, at: str) -> bytes:
        if not uri.startswith("data:"):
            return self.mesh[uri]
        head, _, text = uri.partition(",")
        try:
            if head.endswith(";base64"):
                return base64.b64decode(unquote(text), validate=True)
        except (binascii.Error, ValueError):
            pass
        raise self.mesh.mistake("its data are not base64", f"{at}.uri", "data:application/octet-stream;base64,...")

    def _triangles(self, piece: JsonObject, at: str) -> int:
        """Return the number of triangles of a primitive whose corners are vertices that it has."""
        accessors, attributes = self.tables["accessors"], piece.get("attributes", {})
        if not isinstance(attributes, dict):
            raise self.mesh.mistake("is no object", f"{at}.attributes")
        mode = self._whole(piece, "mode", at, 6, default=4)
        if "POSITION" not in attributes:
            return 0
        position = accessors[self._index(attributes, "POSITION", f"{at}.attributes", "accessors")]
        if position["type"] != "VEC3" or position.get("normalized"):
            raise self.mesh.mistake("are not three plain numbers", f"{at}.attributes.POSITION")
        count = position["count"]
        if "indices" in piece:
            index = self._index(piece, "indices", at, "accessors")
            count = accessors[index]["count"]
            if self._last(index, at) >= position["count"]:
                what = f"name vertex {self._last(index, at)} of {position['count']}, counted from 0"
                raise self.mesh.mistake(what, f"{at}.indices", "vertices that it has")
        return {4: count // 3, 5: count - 2, 6: count - 2}.get(mode, 0)

    def _last(self, index: int, at: str) -> int:
        """Return the largest index of an accessor of indices."""
        if index not in self._largest:
            one = self.tables["accessors"][index]
            kind = _COMPONENTS[one["componentType"]]
            if one["type"] != "SCALAR" or "u" not in kind:
                raise self.mesh.mistake("are not whole numbers without a sign", f"{at}.indices")
            if "bufferView" not in one:
                return 0
            view = self.tables["bufferViews"][one["bufferView"]]
            begin = view.get("byteOffset", 0) + one.get("byteOffset", 0)
            found = np.frombuffer(self.contents[view["buffer"]], dtype=kind, count=one["count"], offset=begin)
            self._largest[index] = int(found.max())
        return self._largest[index]
