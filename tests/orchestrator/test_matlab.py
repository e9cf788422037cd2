"""Variables of MATLAB files of version 5: the reader agrees with SciPy's."""

import struct

import h5py
import numpy as np
import pytest
import scipy.io
from kit.mistakes import problem

from orchestrator.base.files import Location
from orchestrator.data.matlab import NotNumbers, read_variables
from orchestrator.data.table import read_columns

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
NOT_NUMBERS = {
    **{"cell": "a cell array", "cell(:,2)": "a cell array", "inner.cell": "a cell array"},
    **{"run.y": "an array of structs", "thin": "a sparse array", "none": "an empty array"},
    "texts": "an array of texts",
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
    found = read_variables(Location(path))
    assert found.pop("cell") == NotNumbers("a cell array")
    assert equal(found, expected)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_what_is_not_numbers_is_named_when_it_is_asked_for(tmp_path, version):
    """And is no obstacle otherwise."""
    path = tmp_path / "a.mat"
    if version == "5":
        structs, texts = np.array([(1.0,), (2.0,)], dtype=[("y", "f8")]), np.array(["a", "b"])
        others = {"run": structs, "thin": scipy.sparse.eye(3), "none": np.empty((0, 0)), "texts": texts}
        others |= {"cell": VARIABLES["cell"], "inner": {"cell": VARIABLES["cell"]}}
        scipy.io.savemat(path, {"t": np.arange(3.0), "x": np.arange(3.0), **others})
    else:
        with h5py.File(path, "w") as file:
            file["t"] = file["x"] = np.arange(3.0)[None]
            file["cell"] = np.array([[file["t"].ref]], dtype=h5py.ref_dtype)
            file["cell"].attrs["MATLAB_class"] = np.bytes_("cell")
    assert list(read_columns(path, {"t", "x"}).values) == ["t", "x"]
    asked = {"7.3": {"cell": "of type cell"}, "5": NOT_NUMBERS}[version]
    for name, what in asked.items():
        told = problem(lambda name=name: read_columns(path, {"t", name}))
        assert told == f"{path}: column {name!r}: expected numbers, got {what}"


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
