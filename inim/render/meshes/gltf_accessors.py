"""Numbers of the accessors of a glTF file (glTF 2.0, sections 3.6.1 and 3.6.2)."""

import base64
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

_TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Accessors(NamedTuple):
    """Accessors of scalars and vectors.

    * `header`: the file's JSON.
    * `binary`: second chunk of a GLB.
    * `read_companion`: returns the content of another file by its name.

    Methods raise `ValueError`, or another exception, for damaged files.
    """

    header: dict[str, Any]
    binary: bytes
    read_companion: Callable[[str], bytes]

    def numbers(self, index: int) -> np.ndarray:
        """Numbers of an accessor, (count, width) float64; whole ones as shares of one."""
        accessor = self.header["accessors"][index]
        numbers = np.array(self._stored(accessor))
        if "sparse" in accessor:
            places, values = self.substitutions(index)
            numbers[places] = values
        if numbers.dtype.kind == "f":
            return numbers.astype(np.float64)
        return np.maximum(numbers / np.iinfo(numbers.dtype).max, -1)

    def is_sparse(self, index: int | None) -> bool:
        """True if an accessor replaces some of its numbers."""
        return index is not None and "sparse" in self.header["accessors"][index]

    def substitutions(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Places, (n,), and values, (n, width), that a sparse accessor replaces."""
        accessor = self.header["accessors"][index]
        sparse, kind = accessor["sparse"], accessor["componentType"]
        shared = {"count": sparse["count"]}
        places = {"type": "SCALAR", **shared, **sparse["indices"]}
        values = {"type": accessor["type"], "componentType": kind, **shared, **sparse["values"]}
        return self._stored(places).ravel().astype(np.int64), self._stored(values)

    def _stored(self, accessor: dict[str, Any]) -> np.ndarray:
        kind = np.dtype("<" + _TYPES[accessor["componentType"]])
        width, count = _WIDTHS[accessor["type"]], accessor["count"]
        size = width * kind.itemsize
        if "bufferView" not in accessor:
            return np.zeros((count, width), kind)
        view = self.header["bufferViews"][accessor["bufferView"]]
        source = self._buffer(view["buffer"])
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", size)
        if count < 1 or start < 0 or stride < size:
            raise ValueError("an accessor has an impossible size")
        if start + (count - 1) * stride + size > len(source):
            raise ValueError("an accessor is beyond the end of its buffer")
        return np.ndarray((count, width), kind, source, start, (stride, kind.itemsize))

    def _buffer(self, number: int) -> bytes:
        uri = self.header["buffers"][number].get("uri")
        if uri is None:
            return self.binary
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self.read_companion(uri)
