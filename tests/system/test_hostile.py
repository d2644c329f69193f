"""Scenes and files made to harm: each is refused in one line before it can.

Expected: nothing outside the scene's folder is opened, no library beside a scene is run, and what
unfolds without end, or declares more than there is, costs neither time nor memory.
"""

import os
import random
import struct
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from inim.image.files.eia_file import read_eia
from inim.image.files.image import read_exr, write_exr
from inim.image.files.picture import read_texture
from inim.render.meshes.mesh import read_mesh
from inim.render.scene_files.file import FILE_PARAMETERS, SceneFile, read_scene_file
from inim.render.scene_files.parameters import SceneParameters
from inim.system.errors import FileError, SceneError, UsageError
from tests.conftest import scene_text, small_display

SHAPE = '<shape type="{}"><string name="filename" value="{}"/></shape>'
TEXTURE = '<texture type="bitmap"><string name="filename" value="{}"/></texture>'


def scanned(folder: Path, body: str, allowed: Sequence[Path] = ()) -> SceneFile:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "s.xml"
    path.write_text(f'<scene version="3.0.0">{body}</scene>', encoding="utf-8")
    return read_scene_file(path, allowed=allowed)


def assert_quick(started: float, seconds: float = 5) -> None:
    """Limits this process's own time, independent of the machine's load."""
    assert time.process_time() - started < seconds


# --- Files outside the scene's folder -----------------------------------------------------------


@pytest.mark.parametrize(
    "body",
    [
        '<spectrum name="a" filename="../secret.txt"/>',
        '<spectrum name="a" filename="/etc/passwd"/>',
        '<default name="n" value="filename"/><string name="$n" value="../secret.txt"/>',
        '<default name="a" value="../secret"/>' + TEXTURE.format("$a.txt"),
        '<default name="a-b" value="../secret.txt"/>' + TEXTURE.format("$a-b"),
        '<default name="a" value="."/><default name="b" value="$a$a/secret.txt"/>'
        + TEXTURE.format("$b"),
        '<path value=".."/>',
        '<include filename="in/../../secret.txt"/>',
    ],
)
def test_no_spelling_of_a_name_leads_outside(tmp_path, body):
    (tmp_path / "secret.txt").write_text("400 1\n700 1\n")
    (tmp_path / "in" / "in").mkdir(parents=True)
    # Decoys under the names as written, which a scan that reads otherwise would settle for.
    for decoy in ("$a.txt", "$a-b", "$b"):
        (tmp_path / "in" / decoy).write_text("decoy")
    with pytest.raises(SceneError, match="outside the scene's folder"):
        scanned(tmp_path / "in", body)


def test_a_folder_can_be_allowed(tmp_path):
    """The message proposes the highest folder that is not the scene's own."""
    for name in ("common/meshes/deep", "scenes/one"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("common/meshes/deep/a.ply", "other.ply"):
        (tmp_path / name).write_text("ply")
    folder = tmp_path / "scenes/one"
    body = '<path value="../../common"/>' + SHAPE.format("ply", "meshes/deep/a.ply")
    with pytest.raises(SceneError, match=f"--allow-folder {tmp_path / 'common'}$"):
        scanned(folder, body)
    scene_file = read_scene_file(folder / "s.xml", allowed=[tmp_path / "common"])
    assert scene_file.meshes == (("ply", tmp_path / "common/meshes/deep/a.ply"),)
    shapes = body + SHAPE.format("ply", "../../other.ply")
    with pytest.raises(SceneError, match=f"'../../other.ply' .* --allow-folder {tmp_path}$"):
        scanned(folder, shapes, [tmp_path / "common"])
    assert len(scanned(folder, shapes, [tmp_path]).meshes) == 2
    with pytest.raises(UsageError, match=r"--allow-folder .*nowhere: no such folder"):
        read_scene_file(folder / "s.xml", allowed=[tmp_path / "nowhere"])


def test_a_link_does_not_lead_out_of_an_allowed_folder(tmp_path):
    for name in ("in", "common"):
        (tmp_path / name).mkdir()
    (tmp_path / "secret.txt").write_text("400 1")
    (tmp_path / "common/a.txt").symlink_to("../secret.txt")
    body = '<spectrum name="a" filename="../common/a.txt"/>'
    with pytest.raises(SceneError, match="outside the scene's folder"):
        scanned(tmp_path / "in", body, [tmp_path / "common"])


def test_mesh_named_by_parameters_is_still_checked(tmp_path):
    tmp_path.joinpath("bad.ply").write_text("ply")
    body = '<default name="t" value="ply"/><default name="n" value="filename"/>'
    body += '<shape type="$t"><string name="$n" value="bad.ply"/></shape>'
    assert scanned(tmp_path, body).meshes == (("ply", tmp_path / "bad.ply"),)


def test_name_that_means_two_files_is_refused(tmp_path):
    (tmp_path / "sub").mkdir()
    for folder in (tmp_path, tmp_path / "sub"):
        (folder / "a.ply").write_text("ply")
    with pytest.raises(SceneError, match="names several files"):
        scanned(tmp_path, SHAPE.format("ply", "a.ply") + '<path value="sub"/>')
    part = f'<scene version="3.0.0">{SHAPE.format("ply", "a.ply")}</scene>'
    (tmp_path / "sub" / "part.xml").write_text(part)
    with pytest.raises(SceneError, match="names several files"):
        scanned(tmp_path, '<include filename="sub/part.xml"/>')


def test_renderer_opens_the_files_that_were_scanned(tmp_path, open_fitted, monkeypatch):
    """Mitsuba looks in the current folder first; what lies there must not stand in."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    write_exr(tmp_path / "a.exr", np.full((4, 4, 3), 0.25, np.float32))
    write_exr(elsewhere / "a.exr", np.full((4, 4, 3), 0.75, np.float32))
    monkeypatch.chdir(elsewhere)
    import mitsuba as mi

    textured = '<shape type="rectangle"><bsdf type="diffuse">'
    textured += TEXTURE.format("a.exr").replace("<texture", '<texture name="reflectance"', 1)
    fitted = open_fitted(scene_text(textured + "</bsdf></shape>"), small_display())
    values = [v for k, v in mi.traverse(fitted.scene) if k.endswith("reflectance.data")]
    np.testing.assert_allclose(np.asarray(values[0]), 0.25, rtol=1e-6)


@pytest.mark.parametrize("plugin", ["../plugins/evil", "a/b", "evil.so", "..", "a b", "a\\b"])
def test_plugin_is_a_name_and_not_a_path(tmp_path, plugin):
    with pytest.raises(SceneError, match="name of a plugin"):
        scanned(tmp_path, f'<shape type="{plugin}"/>')


@contextmanager
def ordinary_user() -> Iterator[Path]:
    """Act as a user for whom modes matter, as they do not for root; yield a folder of that user."""
    user = os.geteuid()
    with tempfile.TemporaryDirectory() as folder:
        if user == 0:
            os.chown(folder, 65534, -1)
            os.seteuid(65534)
        try:
            yield Path(folder)
        finally:
            os.seteuid(user)


@pytest.mark.parametrize("name", ["plugins", "data"])
@pytest.mark.parametrize("place", ["scene", "scene/sub", "allowed", "allowed/path"])
@pytest.mark.parametrize("kind", ["unlistable", "link", "file"])
def test_what_mitsuba_could_take_for_its_own_is_refused_by_its_existence(name, place, kind):
    with ordinary_user() as folder:
        body = '<path value="sub"/><path value="../allowed/path"/>'
        body += SHAPE.format("ply", "../allowed/mesh.ply")
        for part in ("scene/sub", "allowed/path"):
            (folder / part).mkdir(parents=True)
        (folder / "allowed/mesh.ply").write_text("ply")
        scanned(folder / "scene", body, [folder / "allowed"])
        path = folder / place / name
        if kind == "unlistable":
            path.mkdir()
            (path / "sphere.so").write_bytes(b"\x7fELF")
            path.chmod(0o111)
        elif kind == "link":
            path.symlink_to("elsewhere")
        else:
            path.write_text("")
        with pytest.raises(SceneError, match=rf"s\.xml: {path} could replace"):
            scanned(folder / "scene", body, [folder / "allowed"])


def test_a_folder_of_a_scene_that_cannot_be_searched_is_refused():
    with ordinary_user() as folder:
        (folder / "sub").mkdir(mode=0o600)
        with pytest.raises(FileError, match="sub cannot be searched"):
            scanned(folder, '<path value="sub"/>')


# --- Files that Mitsuba's plugins open ----------------------------------------------------------

# Symbols of Mitsuba's libraries that open files.
OPENING = (b"file_resolver", b"spectrum_from_file", b"FileStream", b"MemoryMapped", b"TensorFile")
BY_PATH = (
    *("bitmap", "bsplinecurve", "ellipsoids", "ellipsoidsmesh", "envmap", "gridvolume"),
    *("linearcurve", "measured", "measured_polarized", "obj", "ply", "sdfgrid", "serialized"),
)
OPENERS = {
    **dict.fromkeys(BY_PATH, b"filename"),
    **dict.fromkeys(("conductor", "roughconductor"), b"material"),
    **dict.fromkeys(("sunsky", "timed_sunsky"), b""),  # always Mitsuba's own data
}


def test_every_parameter_by_which_a_plugin_opens_a_file_is_known():
    """A plugin of a later release that opens files is a failure here until it is scanned."""
    folder = Path(str(find_spec("mitsuba").origin)).parent / "plugins"
    libraries = {path.stem: path.read_bytes() for path in folder.glob("*.so")}
    opening = {n for n, code in libraries.items() if any(symbol in code for symbol in OPENING)}
    assert opening == set(OPENERS)
    parameters = {name.encode() for name in FILE_PARAMETERS}
    assert parameters == set(filter(None, OPENERS.values()))
    # Short names are not stored as text, but in the instructions that compare them.
    assert all(OPENERS[name] in code for name, code in libraries.items() if name in BY_PATH)
    for name in ("conductor", "roughconductor"):
        assert b"filename" not in libraries[name]


@pytest.mark.parametrize("material", ["../../../x", "/etc/x", "a/b", "..", "", "Au.eta", "Au\\b"])
def test_a_material_is_a_name_and_not_a_path(tmp_path, material):
    body = '<bsdf type="conductor"><string name="material" value="{}"/></bsdf>'
    scanned(tmp_path, body.format("TiO2-e_palik"))
    with pytest.raises(SceneError, match="is no material of Mitsuba"):
        scanned(tmp_path, body.format(material))


# --- The scan reads as Mitsuba does -------------------------------------------------------------


def test_parameters_are_substituted_as_mitsuba_does(renderer):
    """Random texts of dollars, backslashes and names; Mitsuba's own parser is the judge."""
    import mitsuba as mi

    rng = random.Random(5)
    pieces = ["$a", "$ab", "$a.b", "$abc", "\\$a", "\\", "$", "x", "/", ".", "a", "$b", "\\\\$b"]
    agreed = refused = 0
    for _ in range(600):
        names = rng.sample(["a", "ab", "a.b", "abc", "b"], rng.randrange(1, 5))
        values = {n: "".join(rng.choices(pieces, k=rng.randrange(4))) for n in names}
        text = "".join(rng.choices(pieces, k=rng.randrange(1, 6)))
        body = "".join(f'<default name="{k}" value="{v}"/>' for k, v in values.items())
        xml = f'<scene version="3.0.0">{body}<string name="t" value="{text}"/></scene>'
        try:
            config = mi.parser.ParserConfig(mi.variant())
            state = mi.parser.parse_string(config, xml)
            theirs = state.root.props["t"]
        except RuntimeError:
            theirs = None
        parameters = SceneParameters({})
        try:
            for name, value in values.items():
                parameters.define(name, parameters.substitute(value))
            ours = parameters.substitute(text)
        except ValueError:
            ours = None
        assert ours == theirs, xml
        agreed += ours is not None
        refused += ours is None
    assert min(agreed, refused) > 50


@pytest.mark.parametrize(
    "encoding", ["cp037", "utf-7", "utf-32", "shift_jis", "windows-1252", "x" * 5000]
)
def test_encoding_that_mitsuba_reads_otherwise_is_refused(tmp_path, encoding):
    path = tmp_path / "s.xml"
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?><scene version="3.0.0"/>')
    with pytest.raises(FileError, match=r"unknown encoding|broken XML"):
        read_scene_file(path)


# --- What unfolds without end -------------------------------------------------------------------


LAUGHS = "".join(f'<default name="a{k + 1}" value="{f"$a{k}" * 10}"/>' for k in range(9))
MANY = "".join(f'<default name="p{k}" value="$p0"/>' for k in range(1, 2000))


@pytest.mark.parametrize(
    ("body", "says"),
    [
        # A billion laughs without an entity: Mitsuba would take ten gigabytes.
        ('<default name="a0" value="ha ha ha ha "/>' + LAUGHS, r"too (?:long|much)"),
        ('<default name="p0" value="1"/>' + MANY, "parameters; simplify"),
        ('<shape type="sphere"/>' * 50_000, "merge the shapes"),
        (TEXTURE.format("huge.png"), "bytes; at most"),
    ],
    ids=["laughs", "parameters", "crowd of shapes", "file of terabytes"],
)
def test_files_that_expand_or_are_too_large_are_refused_soon(tmp_path, body, says):
    with (tmp_path / "huge.png").open("wb") as file:
        file.truncate(2**36)
    started = time.process_time()
    with pytest.raises(SceneError, match=says):
        scanned(tmp_path, body)
    assert_quick(started)


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE s [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><scene>&b;</scene>',
        '<!DOCTYPE s [<!ENTITY a SYSTEM "file:///etc/passwd">]><scene>&a;</scene>',
        '<!DOCTYPE s SYSTEM "http://127.0.0.1/s.dtd"><scene/>',
        '<!DOCTYPE s [<!ENTITY % a SYSTEM "file:///dev/zero">%a;]><scene/>',
    ],
)
def test_entities_are_refused_unread(tmp_path, text):
    (tmp_path / "s.xml").write_text(text)
    with pytest.raises(SceneError, match="entities are refused"):
        read_scene_file(tmp_path / "s.xml")


def test_fan_of_includes_ends_soon(tmp_path):
    for k in range(8):
        text = f'<include filename="{k + 1}.xml"/>' * 10
        (tmp_path / f"{k}.xml").write_text(f'<scene version="3.0.0">{text}</scene>')
    (tmp_path / "8.xml").write_text('<scene version="3.0.0"/>')
    started = time.process_time()
    with pytest.raises(SceneError, match="includes"):
        read_scene_file(tmp_path / "0.xml")
    assert_quick(started)


@pytest.mark.parametrize("name", ["a" * 5000, "a" * 300, "", ".", "a/" * 2000])
def test_name_that_no_file_can_have_is_refused(tmp_path, name):
    with pytest.raises(FileError, match=r"s\.xml:1: "):
        scanned(tmp_path, TEXTURE.format(name))


def png(columns: int, rows: int, body: bytes) -> bytes:
    """A grey PNG of one bit a pixel that says it is of that size."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", columns, rows, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


@pytest.mark.parametrize("side", [12_000, 60_000])
def test_png_bomb_is_refused_as_a_texture_and_as_an_eia(tmp_path, side):
    path = tmp_path / "a.png"
    path.write_bytes(png(side, side, zlib.compress(bytes((side // 8 + 1) * 1000), 9)))
    started = time.process_time()
    with pytest.raises(FileError, match=r"unfolds|exceeds limit"):
        read_texture(path)
    with pytest.raises(FileError, match=r"unfolds|exceeds limit"):
        read_eia(path, small_display())
    assert_quick(started)


def resized_exr(folder: Path, columns: int, rows: int) -> Path:
    """A sound small EXR whose header says another size."""
    path = folder / "a.exr"
    write_exr(path, np.zeros((8, 8, 3), np.float32))
    data = path.read_bytes()
    wrong = data.replace(
        struct.pack("<4i", 0, 0, 7, 7), struct.pack("<4i", 0, 0, columns - 1, rows - 1)
    )
    assert wrong != data
    path.write_bytes(wrong)
    return path


@pytest.mark.parametrize(
    "size", [(100_000, 100_000), (2**31 - 1, 2**31 - 1), (2**28, 1), (16_000, 16_000)]
)
def test_exr_of_absurd_size_is_refused(tmp_path, size):
    path = resized_exr(tmp_path, *size)
    started = time.process_time()
    for reader in (read_exr, read_texture, lambda p: read_eia(p, small_display())):
        with pytest.raises(FileError, match=r"a\.exr"):
            reader(path)
    assert_quick(started)


def test_exr_bomb_is_refused(tmp_path):
    """Zeros to a thousandth: 768 MB of pixels in less than a megabyte."""
    path = tmp_path / "a.exr"
    zeros = np.zeros((8192, 8192), np.float16)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"R": zeros, "G": zeros, "B": zeros}).write(str(path))
    assert path.stat().st_size < 2**20
    with pytest.raises(FileError, match="unfolds"):
        read_exr(path)


@pytest.mark.parametrize("companion", ["pipe.mtl", "huge.mtl", "../secret.mtl", "link.mtl"])
def test_companion_of_a_mesh_is_a_file_of_its_folder(tmp_path, companion):
    folder = tmp_path / "in"
    folder.mkdir()
    os.mkfifo(folder / "pipe.mtl")
    (tmp_path / "secret.mtl").write_text("newmtl one\nKd 1 0 0\n")
    (folder / "link.mtl").symlink_to(tmp_path / "secret.mtl")
    with (folder / "huge.mtl").open("wb") as file:
        file.truncate(2**40)
    path = folder / "a.obj"
    path.write_text(f"mtllib {companion}\nusemtl one\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    warnings: list[str] = []
    (mesh,) = read_mesh(path, warnings.append)
    assert mesh.color is None
    assert [companion in line for line in warnings] == [True]


# --- Regressions: what mutated files have found -------------------------------------------------


def test_radiance_line_without_its_mark_is_refused(tmp_path):
    """Mitsuba takes the whole rest for plain pixels there and writes past its buffer."""
    line = b"\2\2\0\x14" + (b"\x8a\x80\x0a" + b"\x70" * 10) * 4
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 20\n"
    sound, path = head + line * 16, tmp_path / "a.hdr"
    path.write_bytes(sound)
    read_texture(path)
    damaged = bytearray(sound)
    damaged[len(head) + 3 * len(line)] = 9
    for data in (bytes(damaged), sound[:-1], sound.replace(b"+X 20", b"+X 21")):
        path.write_bytes(data)
        with pytest.raises(FileError, match=r"a\.hdr"):
            read_texture(path)


@pytest.mark.parametrize("columns", [5, 40])
@pytest.mark.parametrize("name", ["a.hdr", "a.pfm"])
def test_hdr_and_pfm_have_the_pixels_of_mitsuba(renderer, tmp_path, name, columns):
    """Bit for bit; Radiance HDR of fewer than 8 columns is not run-length coded."""
    import mitsuba as mi

    pixels = np.random.default_rng(2).random((9, columns, 3)).astype(np.float32) ** 8 * 100
    pixels[2:4] = 0.25
    mi.Bitmap(pixels).write(str(tmp_path / name))
    theirs = np.array(mi.Bitmap(str(tmp_path / name)))
    np.testing.assert_array_equal(read_texture(tmp_path / name), theirs)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ('<texture type="bitmap" name="reflectance"><string name="filEname" value="a.png"/>'
         "</texture>", "'bitmap' has no 'filename'"),
        ('</bsdf><bsdf type="blendbsdf">', "'blendbsdf' has no 'weight'"),
    ],
)  # fmt: skip
def test_a_plugin_without_its_required_parts_is_named(open_fitted, body, says):
    """Mitsuba ends the process there, without a word."""
    shape = f'<shape type="sphere"><bsdf type="diffuse">{body}</bsdf></shape>'
    with pytest.raises(SceneError, match=says):
        open_fitted(scene_text(shape), small_display())


# --- Names in reports ---------------------------------------------------------------------------
