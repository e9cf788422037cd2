"""Variables of MATLAB files of version 5: the reader agrees with SciPy's."""

import struct

import numpy as np
import pytest
import scipy.io

from orchestrator.base.files import Location
from orchestrator.data.matlab import read_variables

VARIABLES = {
    "double": np.arange(6.0).reshape(2, 3),
    "single": np.float32(3.5),
    "cube": np.arange(24).reshape(2, 3, 4),
    "small": np.arange(3, dtype=np.uint8),
    "long": np.arange(5, dtype=np.int64) << 40,
    "logical": np.array([True, False]),
    "text": "grün",
    "run": {"y": np.arange(3.0), "inner": {"z": np.ones((2, 2))}, "a_name_of_thirty_characters____": 1},
    "cell": np.array([1, "a"], dtype=object),
}


def equal(ours, theirs):
    if isinstance(theirs, dict):
        return list(ours) == list(theirs) and all(equal(ours[name], theirs[name]) for name in theirs)
    if isinstance(theirs, str):
        return ours == theirs
    return np.array_equal(np.squeeze(ours), theirs)


@pytest.mark.parametrize("packed", [False, True])
def test_variables_are_those_that_scipy_reads(tmp_path, packed):
    """Numbers of all types, texts, structs; cells are left out."""
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, VARIABLES, do_compression=packed)
    expected = {n: v for n, v in scipy.io.loadmat(path, simplify_cells=True).items() if n in VARIABLES}
    del expected["cell"]
    assert equal(read_variables(Location(path)), expected)


def test_version_4_is_read_too(tmp_path):
    """By SciPy."""
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"x": np.arange(3.0)}, format="4")
    assert np.squeeze(read_variables(Location(path))["x"]).tolist() == [0, 1, 2]


def test_bytes_in_the_order_of_other_computers(tmp_path):
    """Files of old workstations are big-endian."""

    def element(kind: int, content: bytes) -> bytes:
        return struct.pack(">II", kind, len(content)) + content + bytes(-len(content) % 8)

    array = element(6, struct.pack(">II", 6, 0)) + element(5, struct.pack(">ii", 2, 1)) + element(1, b"x")
    data = element(14, array + element(9, struct.pack(">dd", 1.5, 2.5)))
    path = tmp_path / "a.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\1\0MI" + data)
    assert read_variables(Location(path))["x"].tolist() == [[1.5], [2.5]]
    assert scipy.io.loadmat(path)["x"].tolist() == [[1.5], [2.5]]
