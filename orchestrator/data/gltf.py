"""Triangles of a binary glTF 2.0 file (.glb): positions and colours, without textures and compression.

glTF has y upwards. Here z is upwards and x stays, as programs that draw with z upwards export it: x, y, z are
x, -z, y of the file.
"""

import json
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem, one_line
from orchestrator.base.files import Location
from orchestrator.data.table import Array

MAX_BYTES, MAX_TRIANGLES = 5_000_000, 200_000
MAX_PARTS, MAX_POINTS = 10_000, 6_000_000  # nodes and primitives; points, which primitives may share
NUMBERS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3}
TRIANGLES = 4  # mode of a primitive
UPRIGHT = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
DAMAGED = (
    *(KeyError, IndexError, TypeError, AttributeError, ValueError, OverflowError),
    *(struct.error, RecursionError),
)
EXPECTED = "expected the triangles of a binary glTF 2.0 file (.glb)"


@dataclass(frozen=True)
class Mesh:
    """Triangles of one colour.

    colour    "#rrggbb"; empty without a material
    points    three little-endian floats of 32 bit each [m]
    corners   three numbers of points for each triangle, of 32 bit
    """

    colour: str
    points: bytes
    corners: bytes


def read_file(file: Location) -> tuple[Mesh, ...]:
    """The meshes of a file. Raises `Problem` for one that has none."""
    try:
        with np.errstate(all="ignore"):  # numbers that are not finite are refused
            meshes = tuple(_meshes(*_chunks(file.read(MAX_BYTES))))
    except Problem as problem:
        raise Problem(str(problem) if str(problem).startswith(str(file)) else f"{file}: {problem}") from None
    except DAMAGED as error:
        raise Problem(f"{file}: {EXPECTED}, got a damaged one: {one_line(repr(error))[:80]}") from None
    if not meshes:
        raise Problem(f"{file}: {EXPECTED}, got none")
    return meshes


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Description and numbers."""
    if data[:8] != b"glTF\x02\0\0\0":
        raise Problem(f"{EXPECTED}, which begins with b'glTF' and version 2, got {data[:8]!r}")
    (size,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + size])
    if needed := document.get("extensionsRequired"):
        raise Problem(f"{EXPECTED} without extensions, got {', '.join(map(str, needed))[:80]}")
    return document, data[28 + size :]


def _meshes(document: dict[str, Any], binary: bytes) -> Iterator[Mesh]:
    left, parts, points_left, nodes = MAX_TRIANGLES, MAX_PARTS, MAX_POINTS, document["nodes"]
    below = {k for node in nodes for k in node.get("children", ())}
    roots = [k for k in range(len(nodes)) if k not in below]
    if "scenes" in document:
        roots = document["scenes"][document.get("scene", 0)]["nodes"]
    for place, mesh in _placed(document, roots, UPRIGHT, set()):
        for primitive in document["meshes"][mesh]["primitives"]:
            if primitive.get("mode", TRIANGLES) != TRIANGLES:
                raise Problem(f"{EXPECTED}, got points, lines, strips or fans")
            at = _numbers(document, binary, primitive["attributes"]["POSITION"])
            parts, points_left = parts - 1, points_left - len(at)
            if parts < 0 or points_left < 0:
                raise Problem(f"{EXPECTED}, at most {MAX_PARTS} parts of {MAX_POINTS} points, got more")
            points = (at @ place[:3, :3].T + place[:3, 3]).astype("<f4")
            order = np.arange(len(points))
            if "indices" in primitive:
                order = _numbers(document, binary, primitive["indices"])[:, 0].astype(int)
            corners = order.reshape(-1, 3)
            if np.linalg.det(place) < 0:  # mirrored: the outside stays outside
                corners = corners[:, ::-1]
            left -= len(corners)
            if left < 0:
                raise Problem(f"{EXPECTED}, at most {MAX_TRIANGLES} of them, got more")
            low, high = corners.min(initial=0), corners.max(initial=0)
            if not np.isfinite(points).all() or low < 0 or high >= len(points):
                raise ValueError("a number out of range")
            if len(corners):
                colour = _colour(document, primitive.get("material"))
                yield Mesh(colour, points.tobytes(), corners.astype("<u4").tobytes())


def _placed(
    document: dict[str, Any], nodes: Sequence[int], place: Array, seen: set[int]
) -> Iterator[tuple[Array, int]]:
    """Place and number of each mesh below these nodes."""
    for number in nodes:
        if number in seen or len(seen) > MAX_PARTS:
            raise ValueError("a node has two parents, or there are too many")
        seen.add(number)
        node = document["nodes"][number]
        here = place @ _matrix(node)
        if "mesh" in node:
            yield here, node["mesh"]
        yield from _placed(document, node.get("children", ()), here, seen)


def _matrix(node: dict[str, Any]) -> Array:
    """Place of a node in its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    matrix, turn = np.eye(4), np.array(node.get("rotation", (0, 0, 0, 1)), dtype=float)
    x, y, z, w = turn / np.linalg.norm(turn)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=float)
    matrix[:3, :3] = (np.eye(3) + 2 * (w * cross + cross @ cross)) * node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _numbers(document: dict[str, Any], binary: bytes, number: int) -> Array:
    """The rows of an accessor."""
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    if "sparse" in accessor or view["buffer"] != 0 or "uri" in document["buffers"][0]:
        raise Problem(f"{EXPECTED} with all numbers inside, got sparse ones or another file")
    kind, width = np.dtype(NUMBERS[accessor["componentType"]]), WIDTHS[accessor["type"]]
    if accessor["count"] > 3 * MAX_TRIANGLES:
        raise Problem(f"{EXPECTED}, at most {MAX_TRIANGLES} of them, got more")
    begin = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    strides = view.get("byteStride", width * kind.itemsize), kind.itemsize
    return np.ndarray((accessor["count"], width), kind, binary, begin, strides)


def _colour(document: dict[str, Any], material: int | None) -> str:
    """Base colour of a material, which is linear, as sRGB (IEC 61966-2-1)."""
    if material is None:
        return ""
    about = document["materials"][material].get("pbrMetallicRoughness", {})
    base = about.get("baseColorFactor", (1, 1, 1, 1))
    linear = np.clip(np.array(base[:3], dtype=float), 0, 1)
    if not np.isfinite(linear).all():
        raise ValueError("a colour that is no number")
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    red, green, blue = (255 * encoded).round().astype(int).tolist()
    return f"#{red:02x}{green:02x}{blue:02x}"
