"""OBJ and MTL texts in the form that trimesh reads correctly.

trimesh counts negative indices from the last vertex of the file, not from that of their line, keeps
comments behind numbers, reads one material library, and takes the options of a texture as part of
its name.
"""

import re

_RELATIVE = re.compile(rb"^[ \t]*f\b[^\n]*[ \t/]-\d", re.MULTILINE)
_FROM_ZERO = re.compile(rb"^[ \t]*f\b[^\n]*[ \t/]0+(?=[ \t/\n]|\Z)", re.MULTILINE)
# Names of materials and pictures may contain a number sign.
_COMMENT = re.compile(rb"^([ \t]*(?:v|vt|vn|f|l|p)[ \t][^\n#]*)#[^\n]*", re.MULTILINE)
_COMMENT_LINE = re.compile(rb"^[ \t]*#[^\n]*\n?", re.MULTILINE)
_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\n]*)\n?", re.MULTILINE)
_COUNTED = (b"v", b"vt", b"vn")
# Numbers or words that follow an option of a texture; up to three numbers for None.
_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1,
    "-mm": 2, "-o": None, "-s": None, "-t": None, "-texres": 1, "-type": 1,
}  # fmt: skip
#: Key of a material's scale and offset of texture coordinates: four numbers.
UV_TRANSFORM = "inim_uv"


def prepare_obj(data: bytes) -> tuple[bytes, list[str]]:
    """OBJ text that trimesh reads correctly, and the lines of its material libraries.

    Raises `ValueError`: an index is 0, or counts back from before the first vertex.
    """
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b" ")
    if b"#" in data:
        data = _COMMENT.sub(rb"\1", _COMMENT_LINE.sub(b"", data))
    if _FROM_ZERO.search(data):
        raise ValueError("a face has the index 0, but OBJ counts from 1")
    if _RELATIVE.search(data):
        data = _count_from_the_start(data)
    libraries = [line.strip().decode("utf-8", "replace") for line in _LIBRARY.findall(data)]
    libraries = list(dict.fromkeys(line for line in libraries if line))
    if len(libraries) > 1:
        data = b"mtllib " + libraries[0].encode() + b"\n" + _LIBRARY.sub(b"", data)
    return data, libraries


def _count_from_the_start(data: bytes) -> bytes:
    """Replace indices that count back from their own line."""
    counts = dict.fromkeys(_COUNTED, 0)
    lines = data.split(b"\n")
    for number, line in enumerate(lines):
        words = line.split()
        if words and words[0] in counts:
            counts[words[0]] += 1
        elif words and words[0] == b"f" and b"-" in line:
            corners = [_absolute(word, tuple(counts.values())) for word in words[1:]]
            lines[number] = b" ".join([b"f", *corners])
    return b"\n".join(lines)


def _absolute(corner: bytes, counts: tuple[int, ...]) -> bytes:
    """A corner such as ``-1/-1`` by the vertices, coordinates and normals so far."""
    indices = corner.split(b"/")
    for axis, (text, count) in enumerate(zip(indices, counts, strict=False)):
        if text.startswith(b"-"):
            index = count + 1 + int(text)
            if index < 1:
                raise ValueError(f"a face has the index {int(text)} after {count} vertices")
            indices[axis] = str(index).encode()
    return b"/".join(indices)


def prepare_mtl(data: bytes) -> tuple[bytes, list[str]]:
    """MTL text that trimesh reads correctly, and the keys of maps that nothing reads."""
    lines, unread = [], []
    for line in data.decode("utf-8", "replace").replace("\\\n", " ").splitlines():
        key, _, rest = line.strip().partition(" ")
        if key.lower() == "map_kd":
            name, scale, offset = _texture(rest.replace("\t", " ").strip())
            numbers = " ".join(map(str, (*scale[:2], *offset[:2])))
            lines += [f"map_Kd {name}", f"{UV_TRANSFORM} {numbers}"]
            continue
        if key.lower().startswith(("map_", "bump", "disp", "decal", "refl", "norm")):
            unread.append(key)
        lines.append(line)
    return "\n".join(lines).encode(), unread


def _texture(text: str) -> tuple[str, list[float], list[float]]:
    """Name of a texture with slashes, and its scale and offset."""
    values: dict[str, list[float]] = {"-s": [1.0, 1.0, 1.0], "-o": [0.0, 0.0, 0.0]}
    words = text.split(" ")
    while words and words[0].lower() in _OPTIONS:
        option = words.pop(0).lower()
        count = _OPTIONS[option]
        if count is not None:
            words = words[count:]
            continue
        for axis in range(3):
            number = _number(words[0]) if len(words) > 1 else None
            if number is None:
                break
            words.pop(0)
            if option in values:
                values[option][axis] = number
        while words and not words[0]:
            words.pop(0)
    name = " ".join(words).strip().strip('"').replace("\\", "/")
    return name, values["-s"], values["-o"]


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
