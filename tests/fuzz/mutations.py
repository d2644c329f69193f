"""Mutations of a file's bytes, each told by its seed: what bit rot, cut transfers and malice do."""

import random
import re
import struct
import zlib
from collections.abc import Callable

# Counts and sizes that overflow, wrap, or ask for more than there is.
_NUMBERS = (
    0, 1, 2, 3, 7, 255, 256, 65535, 65536, 2**24, 2**30, 10**9, 2**31 - 1, 2**31, 2**32 - 1,
    2**32, 2**53, 2**63 - 1, 2**63, 2**64 - 1,
)  # fmt: skip
_TEXTS = (
    b"", b"0", b"-1", b"1", b"1000000000", b"4294967296", b"99999999999999999999", b"1e999",
    b"-1e300", b"1e-320", b"nan", b"inf", b"0x10", b"1.5", b"7/8/9", b"\xff\xfe", b"$a", b"../..",
)  # fmt: skip
_NUMBER_TEXT = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_QUOTED = re.compile(rb"\"[^\"<>]{0,40}\"")
_TEXT_KINDS = ("ply", "obj", "stl", "glb", "gltf", "xml")

Change = Callable[[random.Random, bytearray], None]


def mutated(specimens: tuple[bytes, ...], seed: str, kind: str) -> bytes:
    """One to four changes to one of the specimens; half the time made good where it has sums.

    Parameters
    ----------
    specimens : tuple of bytes
        Sound files of one format.
    seed : str
        Says everything: equal seeds give equal files.
    kind : str
        "png" and "glb" have sums and lengths that most changes would fail at the door.
    """
    rng = random.Random(seed)
    data = bytearray(rng.choice(specimens))
    other = rng.choice(specimens)
    # Half the files stay well formed where their format is text.
    changes = _TEXT_CHANGES if kind in _TEXT_KINDS and rng.random() < 0.5 else _CHANGES
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not data:
            break
        if changes is _CHANGES and rng.random() < 0.1:
            _splice(rng, data, other)
        else:
            rng.choice(changes)(rng, data)
    repair = {"png": _png_sums, "glb": _glb_lengths}.get(kind)
    return repair(bytes(data)) if repair and rng.random() < 0.5 else bytes(data)


def _flip_bits(rng: random.Random, data: bytearray) -> None:
    for _ in range(rng.choice((1, 1, 3, 30))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _flip_in_head(rng: random.Random, data: bytearray) -> None:
    data[rng.randrange(min(len(data), 256))] = rng.randrange(256)


def _cut(rng: random.Random, data: bytearray) -> None:
    del data[rng.randrange(len(data)) :]


def _cut_little(rng: random.Random, data: bytearray) -> None:
    del data[max(0, len(data) - rng.randrange(1, 9)) :]


def _append(rng: random.Random, data: bytearray) -> None:
    data += rng.randbytes(rng.choice((1, 4, 100)))


def _drop(rng: random.Random, data: bytearray) -> None:
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 4, 16, 256))]


def _repeat(rng: random.Random, data: bytearray) -> None:
    at, length = rng.randrange(len(data)), rng.choice((1, 4, 16, 256, 4096))
    data[at:at] = data[at : at + length] * rng.choice((1, 2, 20))


def _blank(rng: random.Random, data: bytearray) -> None:
    at, length = rng.randrange(len(data)), rng.choice((4, 64, 1024))
    length = min(length, len(data) - at)
    data[at : at + length] = rng.choice((b"\0", b"\xff", b" ", b"\n")) * length


def _write_number(rng: random.Random, data: bytearray) -> None:
    """A count or an offset anywhere, of any width and order."""
    code = rng.choice(("<I", "<I", ">I", "<Q", "<H"))
    number = rng.choice((*_NUMBERS, len(data), len(data) - 1)) % 2 ** (8 * struct.calcsize(code))
    most = len(data) - struct.calcsize(code)
    if most > 0:
        struct.pack_into(
            code, data, rng.randrange(min(most, rng.choice((128, 4096, most)))), number
        )


def _write_text(rng: random.Random, data: bytearray) -> None:
    """Another number where a number is written out; the header's are the likeliest."""
    matches = list(_NUMBER_TEXT.finditer(bytes(data[: rng.choice((400, 4000, 10**6))])))
    if matches:
        match = rng.choice(matches)
        text = rng.choice((*_TEXTS, str(rng.choice(_NUMBERS)).encode()))
        data[match.start() : match.end()] = text


def _swap_quoted(rng: random.Random, data: bytearray) -> None:
    """Names and attributes trade places."""
    matches = list(_QUOTED.finditer(bytes(data)))
    if matches:
        match = rng.choice(matches)
        data[match.start() : match.end()] = rng.choice(matches)[0]


def _swap_lines(rng: random.Random, data: bytearray) -> None:
    lines = bytes(data).split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    if rng.random() < 0.3:
        lines.insert(a, lines[b])
    data[:] = b"\n".join(lines)


def _splice(rng: random.Random, data: bytearray, other: bytes) -> None:
    data[rng.randrange(len(data)) :] = other[rng.randrange(len(other)) :]


_CHANGES: tuple[Change, ...] = (
    _flip_bits, _flip_in_head, _cut, _cut_little, _append, _drop, _repeat, _blank,
    _write_number, _write_number, _write_text, _write_text, _swap_lines,
)  # fmt: skip

_TEXT_CHANGES: tuple[Change, ...] = (_write_text, _write_text, _swap_quoted, _swap_lines)


def _png_sums(data: bytes) -> bytes:
    """Right checksums for the chunks of a PNG, so that what they hold is looked at."""
    result, at = bytearray(data), 8
    while at + 12 <= len(data):
        length = struct.unpack_from(">I", data, at)[0]
        end = at + 8 + length
        if end + 4 > len(data):
            break
        struct.pack_into(">I", result, end, zlib.crc32(data[at + 4 : end]))
        at = end + 4
    return bytes(result)


def _glb_lengths(data: bytes) -> bytes:
    """The lengths of a GLB that fit its bytes: the JSON up to the last brace, then the rest."""
    end = data.rfind(b"}") + 1
    if len(data) < 28 or end < 20:
        return data
    text = data[20:end] + b" " * (-(end - 20) % 4)
    rest = data[end:].lstrip(b" ")[8:]
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", len(rest), 0x004E4942) + rest
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
