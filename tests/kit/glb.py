"""Writes a box as a binary glTF file."""

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def box(low: Sequence[float], high: Sequence[float], top: Any = None, **node: Any) -> bytes:
    """A red box between two corners in the frame of the file; node, top: further keys of node and file."""
    ends = list(zip(low, high, strict=True))
    points = np.array([[x, y, z] for x in ends[0] for y in ends[1] for z in ends[2]], "<f4").tobytes()
    corners = np.array([(s[0], s[k], s[k + 1]) for s in SIDES for k in (1, 2)], "<u2").tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        "buffers": [{"byteLength": len(points + corners)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(corners)},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        **(top or {}),
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(points + corners), b"BIN\0") + points + corners
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks
