"""Parts of glTF 2.0 that trimesh does not read, and those that nothing here reads.

Quantized numbers (KHR_mesh_quantization), transformed texture coordinates (KHR_texture_transform)
and other sets of them become what trimesh reads: floating-point numbers in `TEXCOORD_0`. Instances
(EXT_mesh_gpu_instancing) become nodes. A black surface that shines has the colour of its light.
"""

import json
import math
import shlex
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.gltf.extensions import register_handler

from inim.render.meshes.gltf_accessors import Accessors
from inim.system.errors import FileError

# Not of the standard: it calls `_decode` for a primitive.
_DECODED = "INIM_decoded"
_DRACO = "KHR_draco_mesh_compression"
_TRANSFORM = "KHR_texture_transform"
_INSTANCES = "EXT_mesh_gpu_instancing"
# What places an instance; its other attributes, such as _COLOR_0, are not read.
_PLACES = ("TRANSLATION", "ROTATION", "SCALE")
_SPECULAR = "KHR_materials_pbrSpecularGlossiness"
_STRENGTH = "KHR_materials_emissive_strength"
# Extensions that are read here, or by trimesh.
_READ = {_DRACO, _TRANSFORM, _INSTANCES, _SPECULAR, _STRENGTH, "KHR_mesh_quantization",
         "EXT_texture_webp"}  # fmt: skip
# Of a material, whose base colour is all that a relic shows.
_OF_MATERIALS = "KHR_materials_"
# Needed extensions that are not read, with the command of glTF Transform that removes each.
_CONVERTED = {
    "EXT_meshopt_compression": "copy",
    "KHR_meshopt_compression": "copy",
    "KHR_texture_basisu": "ktxdecompress",
}
_MOST_INSTANCES = 100_000
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_GLB_MAGIC = b"glTF"
# File header, and the header of the first chunk.
_GLB_START = 20


def prepare_gltf(
    path: Path, data: bytes, read_companion: Callable[[str], bytes], warn: Callable[[str], object]
) -> bytes:
    """A glTF or GLB file that trimesh reads correctly.

    * `read_companion`: returns the content of a companion file by its name.
    * `warn`: called with a line on content that is not read.

    Raises `FileError`: the file needs an extension that is not read. Raises `ValueError`, or
    another exception, for a damaged file.
    """
    is_binary = data.startswith(_GLB_MAGIC)
    header, end = _header(data)
    _check_extensions(path, header)
    changes = [_complete(header)]
    primitives = [p for mesh in header.get("meshes", []) for p in mesh["primitives"]]
    _check_accessors(header, primitives, len(data))
    if lost := [f"{n} {name}" if n else name for name, n in _unread(header, primitives).items()]:
        warn(f"{path}: not read: {', '.join(lost)}; the relic goes without")
    changes += [_show_diffuse(material) for material in header.get("materials", [])]
    changes += [_show_emission(material) for material in header.get("materials", [])]
    # The header of the second chunk has 8 bytes.
    accessors = Accessors(header, data[end + 8 :], read_companion)
    changes += [_place_instances(node, accessors) for node in [*header.get("nodes", [])]]
    changes += [_mark(primitive, accessors) for primitive in primitives]
    if not any(changes):
        return data
    text = json.dumps(header).encode()
    if not is_binary:
        return text
    text += b" " * (-len(text) % 4)
    chunk = len(text).to_bytes(4, "little") + data[16:_GLB_START] + text
    size = 12 + len(chunk) + len(data) - end
    return data[:8] + size.to_bytes(4, "little") + chunk + data[end:]


def _header(data: bytes) -> tuple[dict[str, Any], int]:
    """JSON of a glTF or GLB file, and where it ends."""
    is_binary = data.startswith(_GLB_MAGIC)
    end = _GLB_START + int.from_bytes(data[12:16], "little") if is_binary else len(data)
    header: dict[str, Any] = json.loads(data[_GLB_START:end] if is_binary else data)
    return header, end


def _complete(header: dict[str, Any]) -> bool:
    """Add a scene of all root nodes where there is none, and remove cameras; True if changed."""
    nodes = header.get("nodes", [])
    cameras = [node.pop("camera", None) for node in nodes]
    changed = any(camera is not None for camera in cameras)
    if nodes and not header.get("scenes"):
        children = {child for node in nodes for child in node.get("children", [])}
        header["scenes"] = [{"nodes": [n for n in range(len(nodes)) if n not in children]}]
        header["scene"], changed = 0, True
    return changed


def count_triangles(data: bytes) -> int | None:
    """Triangles that the nodes of the scene place, instances included; None for damaged files."""
    header, _ = _header(data)
    _complete(header)
    try:
        return _placed_triangles(header)
    except (IndexError, KeyError, TypeError, ValueError):
        return None


def _placed_triangles(header: dict[str, Any]) -> int:
    left = list(header["scenes"][header.get("scene", 0)].get("nodes", []))
    total = visits = 0
    while left:
        visits += 1
        if visits > len(header["nodes"]):
            raise ValueError("a node has several parents")
        node = header["nodes"][left.pop()]
        left += node.get("children", [])
        instances = node.get("extensions", {}).get(_INSTANCES, {}).get("attributes", {})
        if "mesh" in node:
            copies = [header["accessors"][index]["count"] for index in instances.values()] or [1]
            for primitive in header["meshes"][node["mesh"]]["primitives"]:
                total += max(copies) * _triangles(header, primitive)
    return total


def _triangles(header: dict[str, Any], primitive: dict[str, Any]) -> int:
    corners = primitive.get("indices", primitive["attributes"].get("POSITION"))
    count = int(header["accessors"][corners]["count"])
    mode = primitive.get("mode", _TRIANGLES)
    return count // 3 if mode == _TRIANGLES else max(0, count - 2) * (mode in (_STRIP, _FAN))


def _check_extensions(path: Path, header: dict[str, Any]) -> None:
    for name in header.get("extensionsRequired", []):
        if name in _CONVERTED:
            converted = f"{path.stem}-converted.glb"
            command = ["npx", "@gltf-transform/cli", _CONVERTED[name], str(path), converted]
            raise FileError(
                f"{path}: needs {name}, which inim does not read; convert it with glTF Transform "
                f"(Node.js): {shlex.join(command)}"
            )
        if name not in _READ and not name.startswith(_OF_MATERIALS):
            raise FileError(
                f"{path}: needs {name}, which inim does not read; export it without that extension"
            )


def _unread(header: dict[str, Any], primitives: list[dict[str, Any]]) -> Counter[str]:
    """Content of a file that changes what is seen and is not read, with its number or 0."""
    extensions = header.get("extensionsUsed", [])
    lost = Counter({name: 0 for name in extensions if isinstance(extensions, list)})
    lost = Counter({name: 0 for name in lost if name not in _READ})
    for name in ("animations", "skins"):
        lost[name] = len(header.get(name, []))
    lost["morph targets"] = sum(len(p.get("targets", [])) for p in primitives)
    lost["sets of points or lines"] = sum(
        p.get("mode", _TRIANGLES) < _TRIANGLES for p in primitives
    )
    for node in header.get("nodes", []):
        attributes = node.get("extensions", {}).get(_INSTANCES, {}).get("attributes", {})
        for name in set(attributes) - set(_PLACES):
            lost[f"{name} of instances"] += 1
    lost["further scenes"] = max(0, len(header.get("scenes", [])) - 1)
    for material in header.get("materials", []):
        is_lit = "emissiveTexture" in material or any(material.get("emissiveFactor", ()))
        lost["emissions of coloured surfaces"] += is_lit and not _is_black(material)
        color = material.get("pbrMetallicRoughness", {}).get("baseColorFactor", (1, 1, 1, 1))
        is_clear = material.get("alphaMode", "OPAQUE") != "OPAQUE"
        lost["transparent materials"] += is_clear and (
            color[3] < 0.5 or material["alphaMode"] == "MASK"
        )
    return Counter({name: n for name, n in lost.items() if n or name in extensions})


def _is_black(material: dict[str, Any]) -> bool:
    glossy = material.get("extensions", {}).get(_SPECULAR)
    if glossy is not None:
        return not any(glossy.get("diffuseFactor", (1,))[:3])
    return not any(material.get("pbrMetallicRoughness", {}).get("baseColorFactor", (1,))[:3])


def _show_diffuse(material: dict[str, Any]) -> bool:
    """Let the diffuse colour of a material with a specular one be its colour; True if it has."""
    glossy = material.get("extensions", {}).get(_SPECULAR)
    if glossy is None:
        return False
    material.pop("pbrMetallicRoughness", None)
    glossy.pop("specularGlossinessTexture", None)
    glossy["specularFactor"] = [0, 0, 0]
    return True


def _show_emission(material: dict[str, Any]) -> bool:
    """Give a black material that shines the colour of its light; True if it is one."""
    factor = material.get("emissiveFactor", (0, 0, 0))
    if not _is_black(material) or not any(factor):
        return False
    strength = material.get("extensions", {}).get(_STRENGTH, {}).get("emissiveStrength", 1)
    light = [min(1.0, strength * share) for share in factor]
    surface: dict[str, Any] = {"baseColorFactor": [*light, 1.0]}
    if "emissiveTexture" in material:
        surface["baseColorTexture"] = material["emissiveTexture"]
    material["pbrMetallicRoughness"] = surface
    material.get("extensions", {}).pop(_SPECULAR, None)
    return True


def _place_instances(node: dict[str, Any], accessors: Accessors) -> bool:
    """Give a node a child for each instance of its mesh; True if it has instances."""
    extension = node.get("extensions", {}).pop(_INSTANCES, None)
    attributes = {} if extension is None else extension["attributes"]
    if not attributes or "mesh" not in node:
        return False
    header = accessors.header
    keys = [key for key in _PLACES if key in attributes]
    count = header["accessors"][next(iter(attributes.values()))]["count"]
    if count > _MOST_INSTANCES:
        raise ValueError(f"{count} instances of one mesh")
    columns = [accessors.numbers(attributes[key]) for key in keys]
    mesh, first = node.pop("mesh"), len(header["nodes"])
    for number in range(count):
        place = {k.lower(): c[number].tolist() for k, c in zip(keys, columns, strict=True)}
        header["nodes"].append({"mesh": mesh, **place})
    node["children"] = [*node.get("children", []), *range(first, first + count)]
    return True


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


def _mark(primitive: dict[str, Any], accessors: Accessors) -> bool:
    """Note how a primitive's attributes are decoded, where that is more than reading numbers.

    Returns True if something was noted.
    """
    header, attributes = accessors.header, primitive["attributes"]
    names = {**attributes, "indices": primitive.get("indices")}
    sparse = {
        name: [part.tolist() for part in accessors.substitutions(index)]
        for name, index in names.items()
        if accessors.is_sparse(index)
    }
    texture = _base_color_texture(header, primitive)
    transform = texture.get("extensions", {}).get(_TRANSFORM, {})
    coordinates = f"TEXCOORD_{transform.get('texCoord', texture.get('texCoord', 0))}"
    is_another_set = coordinates != "TEXCOORD_0" and coordinates in attributes
    if is_another_set:
        attributes["TEXCOORD_0"] = attributes[coordinates]
    normalized = [
        name for name, index in attributes.items() if header["accessors"][index].get("normalized")
    ]
    decoding = {
        "normalized": normalized,
        "transform": transform,
        "sparse": sparse,
        "fan": primitive.get("mode") == _FAN,
    }
    is_decoded = any(decoding.values())
    if is_decoded:
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
    primitive = context["primitive"]
    for name, (places, values) in decoding["sparse"].items():
        owner = primitive if name == "indices" else attributes
        numbers = np.array(accessors[owner[name]])
        numbers[places] = np.reshape(values, (len(places), *numbers.shape[1:]))
        _replace(accessors, owner, name, numbers)
    if decoding["fan"]:
        count = len(accessors[attributes["POSITION"]])
        index = primitive.get("indices")
        corners = np.ravel(np.arange(count) if index is None else accessors[index])
        triangles = np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]])
        _replace(accessors, primitive, "indices", triangles.T.ravel().astype(np.uint32))
        primitive["mode"] = _TRIANGLES
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


def _replace(accessors: list[Any], attributes: dict[str, Any], name: str, numbers: Any) -> None:
    attributes[name] = len(accessors)
    accessors.append(numbers)
