"""Small sound files of every format that inim accepts, made anew for each run."""

import atexit
import base64
import io
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image

from inim.apps.stress.pictures import solids_of
from inim.display import Display
from inim.image.files.image import write_exr, write_rgbd
from inim.image.rgbd import RGBD
from inim.render.meshes.ply import write_ply
from inim.render.meshes.triangle_mesh import Mesh
from tests import depth_photographs as photographs
from tests.conftest import box_surface, scene_text, small_display, sphere, square
from tests.serialized_meshes import serialized

_ROOT = str(Path(__file__).parents[2])

#: The display that EIAs are made for and scenes are planned for.
DISPLAY: Display = small_display(4, 3, 8)


def _picture(rows: int, columns: int) -> np.ndarray:
    return np.random.default_rng(1).random((rows, columns, 3)).astype(np.float32)


def _rgbd(folder: Path) -> tuple[bytes, ...]:
    covered = np.random.default_rng(2).random((12, 14)) > 0.3
    write_rgbd(folder / "a.exr", RGBD(_picture(12, 14), np.ones((12, 14)), covered, 0.1))
    return ((folder / "a.exr").read_bytes(), *_exr(folder)[:1])


def _layers(folder: Path) -> tuple[bytes, ...]:
    """Pictures of three layers, and of one."""
    covered = np.random.default_rng(2).random((12, 14)) > 0.3
    depth = np.random.default_rng(3).uniform(1, 9, (12, 14)).astype(np.float32)
    solid = solids_of(RGBD(_picture(12, 14), depth, covered, 0.1), DISPLAY)
    files = []
    for rgbd in (solid, replace(solid, deeper=())):
        write_rgbd(folder / "a.exr", rgbd)
        files.append((folder / "a.exr").read_bytes())
    return tuple(files)


def _exr(folder: Path) -> tuple[bytes, ...]:
    """One part, of each compression: plain, then in scan lines and tiles, half and float."""
    rows, columns = DISPLAY.eia_shape
    write_exr(folder / "b.exr", _picture(rows, columns))
    files = [(folder / "b.exr").read_bytes()]
    kinds = OpenEXR.Compression.__members__
    for k, name in enumerate(sorted(kinds)):
        kind = np.float16 if k % 2 else np.float32
        channels = {c: np.ascontiguousarray(_picture(rows, columns)[..., 0], kind) for c in "ABGR"}
        header: dict[str, Any] = {"compression": kinds[name], "type": OpenEXR.scanlineimage}
        if k % 3 == 2:
            tiles = OpenEXR.TileDescription()
            tiles.xSize = tiles.ySize = 16
            header |= {"type": OpenEXR.tiledimage, "tiles": tiles}
        try:
            OpenEXR.File(header, channels).write(str(folder / "c.exr"))
        except RuntimeError:  # a kind that this version names but does not write
            continue
        files.append((folder / "c.exr").read_bytes())
    return tuple(files)


def _saved(image: Any, kind: str, **options: Any) -> bytes:
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def _png(_: Path) -> tuple[bytes, ...]:
    rows, columns = DISPLAY.eia_shape
    pixels = (_picture(rows, columns) * 255).astype(np.uint8)
    rgb = Image.fromarray(pixels)
    grey = Image.fromarray((_picture(rows, columns)[..., 0] * 65535).astype(np.uint16))
    alpha = rgb.copy()
    alpha.putalpha(200)
    return (
        _saved(rgb, "PNG"),
        _saved(rgb.convert("P"), "PNG", transparency=3),
        _saved(grey, "PNG"),
        _saved(alpha, "PNG", pnginfo=None, compress_level=0),
    )


def _pictures(folder: Path) -> tuple[bytes, ...]:
    rgb = Image.fromarray((_picture(16, 20) * 255).astype(np.uint8))
    others = [_saved(rgb, "JPEG"), _saved(rgb, "JPEG", progressive=True)]
    floats = b"PF\n20 16\n-1.0\n" + _picture(16, 20).tobytes()
    # Each channel of a line: a run of ten and ten by themselves.
    lines = b"".join(b"\2\2\0\x14" + (b"\x8a\x80\x0a" + b"\x70" * 10) * 4 for _ in range(16))
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 20\n"
    flat = head + b"\x40\x50\x60\x80" * 320
    return (*_png(folder)[:2], *_exr(folder)[:4], *others, floats, head + lines, flat)


def _ply_text(_: Path) -> tuple[bytes, ...]:
    points, faces = box_surface()
    head = "ply\nformat ascii 1.0\ncomment made for tests\nelement vertex 8\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    colors = head + "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    tail = "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
    plain = ["{:g} {:g} {:g}".format(*p) for p in points]
    triangles = ["3 {} {} {}".format(*f) for f in faces]
    quads = ["4 0 1 3 2", "4 4 6 7 5", "3 0 4 5"]
    return tuple(
        text.encode()
        for text in (
            head + tail.format(12) + "\n".join(plain + triangles) + "\n",
            colors + tail.format(12) + "\n".join([p + " 9 99 200" for p in plain] + triangles),
            head + tail.format(3) + "\n".join(plain + quads) + "\n",
        )
    )


def _ply_binary(folder: Path) -> tuple[bytes, ...]:
    points, faces = box_surface()
    rest = {"normals": points - 0.5, "uv": points[:, :2], "color": points}
    write_ply(folder / "a.ply", Mesh(points, faces))
    write_ply(folder / "b.ply", Mesh(points, faces, **rest))
    big = b"ply\nformat binary_big_endian 1.0\nelement vertex 8\nproperty double x\n"
    big += b"property double y\nproperty double z\nelement face 12\n"
    big += b"property list uchar uint vertex_index\nend_header\n" + points.astype(">f8").tobytes()
    big += b"".join(b"\3" + f.astype(">u4").tobytes() for f in faces)
    return (folder / "a.ply").read_bytes(), (folder / "b.ply").read_bytes(), big


def _off(_: Path) -> tuple[bytes, ...]:
    points, faces = box_surface()
    plain = "OFF\n8 12 0\n" + "".join("{:g} {:g} {:g}\n".format(*p) for p in points)
    colored = "# box\nCOFF\n8 12 0\n"
    colored += "".join("{:g} {:g} {:g} 9 99 200 255\n".format(*p) for p in points)
    triangles = "".join("3 {} {} {}\n".format(*f) for f in faces)
    return (plain + triangles).encode(), (colored + triangles).encode()


def _serialized(_: Path) -> tuple[bytes, ...]:
    points, faces = box_surface()
    plain = {"vertices": points, "faces": faces}
    full = {**plain, "normals": points - 0.5, "uv": points[:, :2], "color": points}
    return serialized([plain]), serialized([full, plain], 3), serialized([full], 4, "f8")


def _obj(folder: Path) -> tuple[bytes, ...]:
    points, faces = box_surface()
    (folder / "a.mtl").write_text("newmtl one\nKd 0.5 0.2 0.1\nmap_Kd a.png\n")
    (folder / "a.png").write_bytes(_png(folder)[0])
    vertices = "".join("v {:g} {:g} {:g}\n".format(*p) for p in points)
    plain = "".join("f {} {} {}\n".format(*(f + 1)) for f in faces)
    full = "mtllib a.mtl\no relic\n" + vertices + "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nusemtl one\n"
    full += "".join("f {}/1/1 {}/2/1 {}/3/1\n".format(*(f + 1)) for f in faces) + "s off\ng end\n"
    mixed = "# quads and relative\n" + vertices + "f 1 2 4 3\nf -1 -2 -3\nf 1//1 2//1 3//1\n"
    return (vertices + plain).encode(), full.encode(), mixed.encode()


def _textured_box():
    import trimesh

    points, faces = box_surface()
    skin = Image.fromarray((_picture(8, 8) * 255).astype(np.uint8))
    visual = trimesh.visual.TextureVisuals(uv=points[:, :2], image=skin)
    box = trimesh.Trimesh(points, faces, visual=visual, process=False)
    turned = trimesh.transformations.rotation_matrix(0.5, (0, 1, 0), (1, 2, 3))
    scene = trimesh.Scene([trimesh.creation.box((1, 2, 3))])
    scene.add_geometry(box, transform=turned)
    return scene


def _glb(_: Path) -> tuple[bytes, ...]:
    import trimesh

    blocks = trimesh.Scene([trimesh.creation.box((1, 2, 3)), trimesh.creation.box((1, 1, 1))])
    return tuple(bytes(mesh.export(file_type="glb")) for mesh in (_textured_box(), blocks))


def _gltf(folder: Path) -> tuple[bytes, ...]:
    """Buffers in files of the folder, and in the text itself."""
    files = _textured_box().export(file_type="gltf")
    tree = json.loads(files.pop("model.gltf"))
    for name, content in files.items():
        (folder / name).write_bytes(content)
    beside = json.dumps(tree, indent=1).encode()
    for part in (*tree["buffers"], *tree.get("images", ())):
        if "uri" in part:
            data = base64.b64encode(files[part["uri"]]).decode()
            part["uri"] = f"data:application/octet-stream;base64,{data}"
    return json.dumps(tree).encode(), beside


def _stl(kind: str) -> tuple[bytes, ...]:
    import trimesh

    data = trimesh.Trimesh(*box_surface(), process=False).export(file_type=kind)
    if isinstance(data, str):
        return (data.encode(),)
    return data, b"solid" + data[5:]  # a title that text begins with


def _volume(_: Path) -> tuple[bytes, ...]:
    values = np.random.default_rng(3).random(4 * 4 * 4).astype("<f4").tobytes()
    head = struct.pack("<3sBiiiii6f", b"VOL", 3, 1, 4, 4, 4, 1, 0, 0, 0, 1, 1, 1)
    return (head + values,)


def _xml(folder: Path) -> tuple[bytes, ...]:
    (folder / "a.ply").write_bytes(_ply_binary(folder)[1])
    (folder / "a.png").write_bytes(_png(folder)[0])
    (folder / "part.xml").write_text(f'<scene version="3.0.0">{sphere((0, 0, 2), 0.5)}</scene>')
    defaults = "".join(
        f'<default name="inim.{key}" value="{value}"/>\n'
        for key, value in (("pitch_mm", 1), ("lens_columns", 8), ("lens_rows", 6),
                           ("algorithms", "template"), ("eia_spp", 2), ("title", "a relic"))
    )  # fmt: skip
    mesh = (
        '<default name="mesh" value="a.ply"/>\n<shape type="ply">\n'
        '<string name="filename" value="$mesh"/>\n'
        '<bsdf type="twosided"><bsdf type="principled"><float name="roughness" value="0.7"/>'
        '<texture type="bitmap" name="base_color"><string name="filename" value="a.png"/>'
        "</texture></bsdf></bsdf></shape>\n"
    )
    shapes = sphere((0, 0, 1), 1.2) + square((-1, 1, 0), 1.5, "0.9,0.1,0.1")
    first = scene_text(defaults, shapes).replace(">", ">\n")
    second = scene_text(defaults, mesh, '<include filename="part.xml"/>')
    return first.encode(), f'<?xml version="1.0" encoding="utf-8"?>\n{second}'.encode()


def _depth(folder: Path, kind: str) -> tuple[bytes, ...]:
    """Depth pictures of 12 x 16 in what a kind of file can hold."""
    values = np.linspace(1, 60_000, 12 * 16).reshape(12, 16)
    grey = Image.fromarray(values.astype(np.uint16))
    if kind == "npy":
        files = []
        for dtype in (np.float32, np.float64, np.uint16):
            stream = io.BytesIO()
            np.save(stream, values.astype(dtype))
            files.append(stream.getvalue())
        return tuple(files)
    if kind == "pfm":
        return (b"Pf\n16 12\n-1.0\n" + values.astype("<f4").tobytes(),)
    if kind == "exr":
        header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Z": values.astype(np.float32)}).write(str(folder / "z.exr"))
        return ((folder / "z.exr").read_bytes(),)
    if kind == "tiff":
        floats = Image.fromarray(values.astype(np.float32))
        packed = _saved(grey, "TIFF", compression="tiff_lzw")
        return _saved(grey, "TIFF"), packed, _saved(floats, "TIFF")
    return (_saved(grey, kind.upper()),)


TINY = {
    "lens_columns": 8, "lens_rows": 6,
    "capture_spp": 2, "eia_spp": 2, "view_spp": 2, "reconstruction_spp": 4,
}  # fmt: skip
STUDY = """
[study]
title = "A study"
scenes = ["scene.xml"]
displays = ["mine", "nominal", "scene"]
algorithms = ["template", "wang2024:matching=ray"]
viewpoints = ["centre", "left"]
lens_model = ["thin", "thick"]
backend = "auto"
time = false
keep_reports = false

[settings]
capture_spp = [2, 4]
seed = 1
pupil_mm = 0.5

[[display]]
name = "mine"
preset = "nominal"
pitch_mm = 0.8
lens_columns = 12
lens_rows = 10
"""


def _scene(folder: Path) -> Path:
    path = folder / "scene.xml"
    path.write_bytes(_xml(folder)[0])
    return path


@cache
def _run() -> Path:
    """A finished run's folder with its scene, its report in `OUT`, and its baseline in `base`."""
    folder = Path(tempfile.mkdtemp(prefix="inim-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    words = [f"-Dinim.{key}={value}" for key, value in TINY.items()]
    run = [sys.executable, "-m", "inim", "validate", _scene(folder).name, "-o", "OUT", "--quiet"]
    accept = ["accept", "OUT", "--reason", "a specimen", "-o", "base"]
    for command in ([*run, *words], [sys.executable, "-m", "inim", *accept]):
        subprocess.run(command, cwd=folder, check=True, env=os.environ | {"PYTHONPATH": _ROOT})
    return folder


def _of_run(folder: Path, name: str) -> tuple[bytes, ...]:
    """A document of the run, whose folders come along."""
    shutil.copytree(_run(), folder, dirs_exist_ok=True)
    shutil.copytree(folder / "OUT", folder / "OTHER", dirs_exist_ok=True)
    return ((folder / name).read_bytes(),)


def _study(folder: Path) -> tuple[bytes, ...]:
    _scene(folder)
    return (STUDY.encode(),)


def _photos(_: Path) -> tuple[bytes, ...]:
    color, codes = photographs.room(24, 32)
    jpeg, depth = photographs.picture(color), photographs.picture(codes, "PNG")
    xml = photographs.apple_xml()
    return (
        photographs.gdepth(jpeg, depth, 1),
        photographs.dynamic(jpeg, depth),
        photographs.apple_jpeg(jpeg, photographs.picture(codes), xml),
        photographs.heic(color, codes, xml),
    )


#: By format: the suffix its files get, and what makes sound ones, given a folder for companions.
SPECIMENS = {
    "exr-rgbd": (".exr", _rgbd),
    "exr-layers": (".exr", _layers),
    "exr-eia": (".exr", _exr),
    "png-eia": (".png", _png),
    "picture": (".png", _pictures),
    "ply-text": (".ply", _ply_text),
    "ply-binary": (".ply", _ply_binary),
    "obj": (".obj", _obj),
    "off": (".off", _off),
    "serialized": (".serialized", _serialized),
    "glb": (".glb", _glb),
    "gltf": (".gltf", _gltf),
    "stl-text": (".stl", lambda _: _stl("stl_ascii")),
    "stl-binary": (".stl", lambda _: _stl("stl")),
    "volume": (".vol", _volume),
    "depth-exr": (".exr", lambda folder: _depth(folder, "exr")),
    "depth-png": (".png", lambda folder: _depth(folder, "png")),
    "depth-ppm": (".pgm", lambda folder: _depth(folder, "ppm")),
    "depth-tiff": (".tif", lambda folder: _depth(folder, "tiff")),
    "depth-npy": (".npy", lambda folder: _depth(folder, "npy")),
    "depth-pfm": (".pfm", lambda folder: _depth(folder, "pfm")),
    "color": (".png", lambda folder: (*_png(folder)[:2], _png(folder)[3], *_exr(folder)[:3])),
    "photo": (".jpg", _photos),
    "xml": (".xml", _xml),
    "document-report": (".json", lambda folder: _of_run(folder, "OUT/report.json")),
    "document-baseline": (".json", lambda folder: _of_run(folder, "base/baseline.json")),
    "document-arrays": (".npz", lambda folder: _of_run(folder, "base/baseline.npz")),
    "document-study": (".toml", _study),
    "document-scene": (".xml", _xml),
}
