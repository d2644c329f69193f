"""Expectations for public files, from other programs than inim.

``python -m reports.zoo.expect FOLDER`` writes ``reports/zoo/zoo.jsonl``. FOLDER has a folder for
each repository of `REPOSITORIES`, ``OWNER+NAME``, with a checkout of the given commit. Sizes of
meshes are those of ``assimp info`` (assimp), of glTF those of the sum over its nodes below. Means
of EXR are those of ``oiiotool --stats`` (OpenImageIO), those of HEIC and their depth come from
``heif-convert`` (libheif), quantiles of depth pictures from Pillow, and shapes of scenes from
Mitsuba. `BY_HAND` has the files that these programs read otherwise than their formats say.
"""

import base64
import hashlib
import io
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from PIL import Image, ImageCms

REPOSITORIES = {
    "kovacsv/Online3DViewer": "f4260cc7be355b3cfe0fa6cb421d2864bc396133",
    "tinyobjloader/tinyobjloader": "b5346fac929c8a862a1c1d4d89db5477d30b7e6f",
    "mikedh/trimesh": "a513c0e2cfa6dfbd3121a6dfd8ceb002b9ef55d8",
    "AcademySoftwareFoundation/openexr-images": "e38ffb0790f62f05a6f083a6fa4cac150b3b7452",
    "andyzeng/tsdf-fusion-python": "3f22a940d90f684145b1f29b1feaa92e09eb1db6",
    "panrafal/depthy": "6ff99c1eb975e820e7feee988cd0df3978ce0df2",
    "bigcat88/pillow_heif": "657f27d7955bbd730701e2e966e7e8751e119eb9",
    "mitsuba-renderer/mitsuba-data": "01100fa9b0b154492061a92404f26dcd7b784dbb",
}
_MESHES = (".obj", ".ply", ".off", ".stl", ".glb", ".gltf")
_PHOTOS = (".heic", ".heif", ".hif")
#: Kinds of files, by how their names end.
KINDS = {
    **dict.fromkeys(_MESHES, "mesh"),
    **dict.fromkeys(_PHOTOS, "photograph"),
    ".exr": "EXR",
    ".depth.png": "RGB-D",
    "-depth.jpg": "RGB-D",
    "-image.jpg": "photograph",
    ".xml": "scene",
}
_NO_FACES = "it has no triangles"
#: Size, or the reason to refuse a file, by its name: what the other programs do differently.
BY_HAND: dict[str, Any] = {
    "cube_with_materials_comments.obj": [1.0, 1.0, 1.0],  # refused for a comment
    "single_triangle_with_comments.off": [1.0, 1.0, 0.0],
    "single_triangle_with_comments.ply": [1.0, 1.0, 0.0],
    "single_triangle_no_normal.stl": [1.0, 1.0, 0.0],
    "single_triangle_with_comments.stl": "the format has no comments",
    "lines_triangles_colors.obj": [5.0, 0.0, 1.0],  # with lines
    "lines.obj": _NO_FACES,
    "lines_colors.obj": _NO_FACES,
    "lines_in_meshes.obj": _NO_FACES,
    "lines_in_meshes_2.obj": _NO_FACES,
    "lines_with_vt.obj": _NO_FACES,
    "line-prim.obj": _NO_FACES,
    "points-prim.obj": _NO_FACES,
    "obj_wireframe.obj": _NO_FACES,
    "cube-vertex-w-component.obj": [2.0, 2.0, 2.0],  # the weight is of curves only
    "cubevt.obj": [1.0, 1.0, 1.0],  # has a face of one corner, too
    "notenoughindices.obj": [1000.0, 500.0, 0.0],  # has a face of two corners, too
    "leading-decimal-dot-issue-201.obj": [0.86, 71.0, 11.429],  # an index too large for assimp
    "leading-zero-in-exponent-notation-issue-210.obj": [0.86, 71.0, 11.429],
    "pbr-mat-ext.obj": [552.8, 0.0, 559.2],  # refused for a word in its MTL
    "test-nan.obj": "coordinates that are no numbers",
    "fuze_ascii.ply": "its faces have more numbers than its header declares",
    "mode5.gltf": None,  # the sum over nodes, without its restart indices
    # The same picture as Rec709.exr, in other primaries.
    "XYZ.exr": [0.3653, 0.2778, 0.1153],
    "XYZ_YC.exr": [0.3653, 0.2778, 0.1153],
    "Carrots.exr": None,  # in primaries of their own, which oiiotool does not convert
    "Tree.exr": None,
    "test_various_emitters_ptracer.xml": "its integrator follows no rays from the camera",
    "WideFloatRange.exr": "it has green only",
    "Rec709_YC.exr": [0.3653, 0.2778, 0.1153],  # that of Rec709.exr
}
_TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}


def _size_by_assimp(path: Path) -> Any:
    """Size along x, y and z by assimp, or why it refuses the file."""
    words = ["assimp", "info", str(path)]
    ended = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    corners = [
        re.search(rf"^{end} point\s+\(([^)]*)\)", ended.stdout, re.MULTILINE)
        for end in ("Minimum", "Maximum")
    ]
    if corners[0] is None or corners[1] is None:
        return "not readable"
    low, high = (np.array(match[1].split(), float) for match in corners if match)
    return [round(float(length), 6) for length in high - low]


def _size_of_gltf(path: Path) -> Any:
    """Size of all triangles of the nodes of a glTF without compression, from its specification."""
    data = path.read_bytes()
    binary = data[:4] == b"glTF"
    end = 20 + int.from_bytes(data[12:16], "little") if binary else len(data)
    header = json.loads(data[20:end] if binary else data)
    if header.get("extensionsRequired"):
        return _size_by_assimp(path)

    def numbers(index: int) -> np.ndarray:
        accessor = header["accessors"][index]
        kind = np.dtype("<" + _TYPES[accessor["componentType"]])
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        values = np.zeros((accessor["count"], width))
        if "bufferView" in accessor:
            values[:] = stored(accessor, kind, width)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            shared = {"count": sparse["count"]}
            of = np.dtype("<" + _TYPES[sparse["indices"]["componentType"]])
            places = stored({**shared, **sparse["indices"]}, of, 1).ravel().astype(int)
            values[places] = stored({**shared, **sparse["values"]}, kind, width)
        return values

    def stored(accessor: dict[str, Any], kind: np.dtype[Any], width: int) -> np.ndarray:
        view = header["bufferViews"][accessor["bufferView"]]
        uri = header["buffers"][view["buffer"]].get("uri")
        if uri is None:
            source = data[end + 8 :]
        elif uri.startswith("data:"):
            source = base64.b64decode(uri.partition(",")[2])
        else:
            source = (path.parent / uri).read_bytes()
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", width * kind.itemsize)
        shape = accessor["count"], width
        return np.ndarray(shape, kind, source, start, (stride, kind.itemsize)).astype(float)

    points: list[np.ndarray] = []

    def visit(index: int, parent: np.ndarray) -> None:
        node = header["nodes"][index]
        matrix = np.array(node.get("matrix", np.eye(4).ravel()), float).reshape(4, 4).T
        x, y, z, w = node.get("rotation", (0, 0, 0, 1))
        turn = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        own = np.eye(4)
        own[:3, :3] = turn * node.get("scale", (1, 1, 1))
        own[:3, 3] = node.get("translation", (0, 0, 0))
        matrix = parent @ matrix @ own
        for primitive in header["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
            if primitive.get("mode", 4) < 4:
                continue
            place = numbers(primitive["attributes"]["POSITION"])
            if "indices" in primitive:
                place = place[numbers(primitive["indices"]).ravel().astype(int)]
            points.append(place @ matrix[:3, :3].T + matrix[:3, 3])
        for child in node.get("children", ()):
            visit(child, matrix)

    for root in header["scenes"][header.get("scene", 0)].get("nodes", ()):
        visit(root, np.eye(4))
    if not points:
        return _NO_FACES
    every = np.concatenate(points)
    return [round(float(length), 6) for length in every.max(axis=0) - every.min(axis=0)]


def _mean_by_oiio(path: Path) -> Any:
    """Mean of red, green and blue, or of the first channel, of an EXR's first part."""
    words = ["oiiotool", "--stats", str(path)]
    ended = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    if " deep " in ended.stdout:
        return "several depths per pixel"
    mean = re.search(r"Stats Avg: ([^(]*)\(", ended.stdout)
    if mean is None:
        return None
    values = [float(word) for word in mean[1].split()]
    return values[:3] if len(values) >= 3 else values[:1]


def quantiles(depth: np.ndarray, empty: np.ndarray) -> list[float]:
    """Share of missing depths, and their 5, 50 and 95 % quantiles."""
    return [float(empty.mean()), *map(float, np.quantile(depth[~empty], (0.05, 0.5, 0.95)))]


def _depth_by_pillow(path: Path) -> Any:
    """Quantiles of a depth picture; 0 and, in 16 bits, 65535 are missing, as in its own reader."""
    with Image.open(path) as picture:
        codes = np.asarray(picture if picture.mode.startswith("I") else picture.convert("L"))
    return quantiles(codes, (codes == 65535) | ((codes == 0) & (path.suffix == ".png")))


def _photo_by_libheif(path: Path) -> Any:
    """Mean sRGB codes of a HEIC photograph and quantiles of its depth codes from 0 to 1."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "picture.png")
        words = ["heif-convert", "--with-aux", str(path), str(out)]
        ended = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
        if ended.returncode:
            return "not readable"
        depth = sorted(Path(folder).glob("picture*depth*.png"))
        if not depth:
            return "no depth inside"
        with Image.open(out) as picture:
            profile, color = picture.info.get("icc_profile"), picture.convert("RGB")
            if profile:
                source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
                target = ImageCms.createProfile("sRGB")
                color = ImageCms.profileToProfile(color, source, target, outputMode="RGB")
            mean = np.asarray(color).mean(axis=(0, 1))
        with Image.open(depth[0]) as picture:
            codes = np.asarray(picture.convert("L")).astype(float)
        unit = (codes - codes.min()) / np.ptp(codes)
        return [*map(float, mean), *quantiles(unit, np.zeros(unit.shape, bool))]


def _shapes_by_mitsuba(path: Path) -> Any:
    """Number of shapes that are no lights, or why Mitsuba or a documented limit refuses it."""
    if "<medium" in path.read_text("utf-8", "replace"):
        return None  # refused, unless the shape that bounds it is left out
    mi.set_variant("scalar_rgb")
    try:
        scene = mi.load_file(str(path), optimize=False)
    except Exception:  # of any plugin
        return "Mitsuba refuses it"
    if not isinstance(scene, mi.Scene):
        return "no scene"
    shapes = sum(not shape.is_emitter() for shape in scene.shapes())
    return [float(shapes)] if shapes else "no shape except lights"


def kind_of(path: Path) -> str | None:
    """Kind of a file by its name; None for others."""
    name = path.name.lower()
    return next((kind for end, kind in KINDS.items() if name.endswith(end)), None)


def expectation(path: Path) -> Any:
    """Numbers of a file; a text: why it is refused; None: that it is read or refused."""
    if path.name in BY_HAND:
        return BY_HAND[path.name]
    suffix, kind = path.suffix.lower(), kind_of(path)
    if kind == "EXR":
        return _mean_by_oiio(path)
    if kind == "RGB-D":
        return _depth_by_pillow(path)
    if kind == "photograph":
        return _photo_by_libheif(path) if suffix in _PHOTOS else "no depth inside"
    if kind == "scene":
        return _shapes_by_mitsuba(path)
    if suffix in (".gltf", ".glb"):
        try:
            return _size_of_gltf(path)
        except (KeyError, IndexError, ValueError, TypeError, OSError) as error:
            return f"damaged ({type(error).__name__})"
    return _size_by_assimp(path)


def main(words: list[str]) -> int:
    """Write the list of files."""
    folder, entries = Path(words[0]), []
    for repository, commit in REPOSITORIES.items():
        root = folder / repository.replace("/", "+")
        for path in sorted(root.rglob("*")):
            if kind_of(path) and path.is_file():
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
                entry = {"repository": repository, "commit": commit}
                entry |= {"path": str(path.relative_to(root)), "sha256": digest}
                entries.append({**entry, "expected": expectation(path)})
    out = Path(__file__).with_name("zoo.jsonl")
    out.write_text("".join(f"{json.dumps(entry)}\n" for entry in entries), "utf-8")
    print(f"{out}: {len(entries)} files")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
