"""Extensions of glTF 2.0 that trimesh does not read, and those that nothing here reads.

Quantized numbers (KHR_mesh_quantization), transformed texture coordinates (KHR_texture_transform)
and other sets of them become what trimesh reads: floating-point numbers in `TEXCOORD_0`.
"""

import json
import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.gltf.extensions import register_handler

from inim.system.errors import FileError

# Not of the standard: it calls `_decode` for a primitive.
_DECODED = "INIM_decoded"
_DRACO = "KHR_draco_mesh_compression"
_TRANSFORM = "KHR_texture_transform"
# Needed extensions that are not read, with the command of glTF Transform that removes each.
_UNREAD = {
    "EXT_meshopt_compression": "copy",
    "KHR_meshopt_compression": "copy",
    "KHR_texture_basisu": "ktxdecompress",
}
_GLB_MAGIC = b"glTF"
# File header, and the header of the first chunk.
_GLB_START = 20


def prepare_gltf(path: Path, data: bytes) -> bytes:
    """A glTF or GLB file that trimesh reads correctly.

    Raises `FileError`: the file needs an extension that is not read. Raises `ValueError`, or
    another exception, for a damaged file.
    """
    is_binary = data.startswith(_GLB_MAGIC)
    end = _GLB_START + int.from_bytes(data[12:16], "little") if is_binary else len(data)
    header = json.loads(data[_GLB_START:end] if is_binary else data)
    _check_extensions(path, header)
    primitives = [p for mesh in header.get("meshes", []) for p in mesh["primitives"]]
    _check_accessors(header, primitives, len(data))
    changes = [_mark(header, primitive) for primitive in primitives]
    if not any(changes):
        return data
    text = json.dumps(header).encode()
    if not is_binary:
        return text
    text += b" " * (-len(text) % 4)
    chunk = len(text).to_bytes(4, "little") + data[16:_GLB_START] + text
    size = 12 + len(chunk) + len(data) - end
    return data[:8] + size.to_bytes(4, "little") + chunk + data[end:]


def _check_extensions(path: Path, header: dict[str, Any]) -> None:
    for name in header.get("extensionsRequired", []):
        if name in _UNREAD:
            converted = f"{path.stem}-converted.glb"
            command = ["npx", "@gltf-transform/cli", _UNREAD[name], str(path), converted]
            raise FileError(
                f"{path}: needs {name}, which inim does not read; convert it with glTF Transform "
                f"(Node.js): {shlex.join(command)}"
            )


def _check_accessors(header: dict[str, Any], primitives: list[dict[str, Any]], size: int) -> None:
    """Reject accessors without data, which trimesh would fill with zeros of the declared size."""
    accessors = header.get("accessors", [])
    compressed = set()
    for primitive in primitives:
        if _DRACO in primitive.get("extensions", {}):
            compressed |= {primitive.get("indices"), *primitive["attributes"].values()}
    zeros = sum(
        accessor["count"]
        for index, accessor in enumerate(accessors)
        if "bufferView" not in accessor and index not in compressed
    )
    if zeros > size:
        raise ValueError(f"declares {zeros} items without data")


def _mark(header: dict[str, Any], primitive: dict[str, Any]) -> bool:
    """Note how a primitive's attributes are decoded, where that is more than reading numbers.

    Returns True if something was noted.
    """
    attributes = primitive["attributes"]
    texture = _base_color_texture(header, primitive)
    transform = texture.get("extensions", {}).get(_TRANSFORM, {})
    coordinates = f"TEXCOORD_{transform.get('texCoord', texture.get('texCoord', 0))}"
    is_another_set = coordinates != "TEXCOORD_0" and coordinates in attributes
    if is_another_set:
        attributes["TEXCOORD_0"] = attributes[coordinates]
    normalized = [
        name for name, index in attributes.items() if header["accessors"][index].get("normalized")
    ]
    is_decoded = bool(normalized or transform)
    if is_decoded:
        decoding = {"normalized": normalized, "transform": transform}
        primitive.setdefault("extensions", {})[_DECODED] = decoding
    return is_decoded or is_another_set


def _base_color_texture(header: dict[str, Any], primitive: dict[str, Any]) -> dict[str, Any]:
    if "material" not in primitive:
        return {}
    material = header["materials"][primitive["material"]]
    glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    texture: dict[str, Any] = glossy.get("diffuseTexture") or material.get(
        "pbrMetallicRoughness", {}
    ).get("baseColorTexture", {})
    return texture


@register_handler(_DECODED, scope="primitive_preprocess")  # type: ignore[untyped-decorator]
def _decode(context: Any) -> None:
    """Replace a primitive's accessors by decoded copies; others may share the originals."""
    accessors, attributes = context["accessors"], context["primitive"]["attributes"]
    decoding = context["data"]
    for name in decoding["normalized"]:
        numbers = accessors[attributes[name]]
        if numbers.dtype.kind in "iu":
            share = numbers.astype(np.float32) / np.iinfo(numbers.dtype).max
            _replace(accessors, attributes, name, np.maximum(share, -1))
    if decoding["transform"] and "TEXCOORD_0" in attributes:
        u, v = np.asarray(accessors[attributes["TEXCOORD_0"]], np.float64).T
        transform = decoding["transform"]
        across, down = transform.get("scale", (1, 1))
        right, below = transform.get("offset", (0, 0))
        angle = transform.get("rotation", 0)
        c, s = math.cos(angle), math.sin(angle)
        moved = (c * across * u + s * down * v + right, c * down * v - s * across * u + below)
        _replace(accessors, attributes, "TEXCOORD_0", np.stack(moved, axis=-1).astype(np.float32))


def _replace(accessors: list[Any], attributes: dict[str, int], name: str, numbers: Any) -> None:
    attributes[name] = len(accessors)
    accessors.append(numbers)
