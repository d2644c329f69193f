"""Photographs with depth inside, made by hand: what phones write, by boxes and segments."""

import base64
import hashlib
import io
import struct

import numpy as np
from PIL import Image

RDF = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
    'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">{}</rdf:RDF></x:xmpmeta>'
)
GDEPTH = 'xmlns:GDepth="http://ns.google.com/photos/1.0/depthmap/"'
DYNAMIC = " ".join(
    f'xmlns:{name}="http://ns.google.com/photos/dd/1.0/{name.lower()}/"'
    for name in ("Device", "Container", "Item", "Camera", "DepthMap", "ImagingModel")
)
APPLE = (
    'xmlns:apdi="http://ns.apple.com/pixeldatainfo/1.0/" '
    'xmlns:depthData="http://ns.apple.com/depthData/1.0/"'
)
XMP, EXTENDED = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"


def picture(pixels, kind="JPEG", orientation=None) -> bytes:
    """A picture's file; a JPEG as good as it gets."""
    options = {"quality": 100, "subsampling": 0} if kind == "JPEG" else {}
    if orientation is not None:
        exif = Image.Exif()
        exif[0x0112] = orientation
        options["exif"] = exif
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, **options)
    return stream.getvalue()


def segment(kind: int, content: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, kind, len(content) + 2) + content


def with_segments(jpeg: bytes, *segments: bytes) -> bytes:
    """A JPEG with segments behind its first mark."""
    return jpeg[:2] + b"".join(segments) + jpeg[2:]


def with_xmp(jpeg: bytes, xml: str) -> bytes:
    return with_segments(jpeg, segment(0xE1, XMP + xml.encode()))


def edited(data: bytes, old: bytes, new: bytes) -> bytes:
    """A JPEG whose first segment, its metadata, reads otherwise."""
    (length,) = struct.unpack(">H", data[4:6])
    text = data[6 : 4 + length]
    assert old in text
    return data[:2] + segment(0xE1, text.replace(old, new)) + data[4 + length :]


def gdepth(jpeg: bytes, depth: bytes, extended=0, **message) -> bytes:
    """A JPEG with GDepth; `extended` puts the image into pieces, in their order (1) or not (-1)."""
    message = {"Format": "RangeInverse", "Near": 1, "Far": 4, "Mime": "image/png", **message}
    words = " ".join(f'GDepth:{k}="{v}"' for k, v in message.items() if v is not None)
    data = f'GDepth:Data="{base64.b64encode(depth).decode()}"'
    if not extended:
        return with_xmp(jpeg, RDF.format(f"<rdf:Description {GDEPTH} {words} {data}/>"))
    whole = RDF.format(f"<rdf:Description {GDEPTH} {data}/>").encode()
    guid = hashlib.md5(whole).hexdigest().upper()
    note = f'xmlns:xmpNote="http://ns.adobe.com/xmp/note/" xmpNote:HasExtendedXMP="{guid}"'
    first = RDF.format(f"<rdf:Description {GDEPTH} {note} {words}/>").encode()
    pieces = [
        segment(
            0xE1, EXTENDED + guid.encode() + struct.pack(">II", len(whole), n) + whole[n : n + 100]
        )
        for n in range(0, len(whole), 100)
    ]
    return with_segments(jpeg, segment(0xE1, XMP + first), *pieces[::extended])


def dynamic(
    jpeg: bytes, depth: bytes, padding=7, uri="android/depthmap", model="", **message
) -> bytes:
    """A dynamic depth photograph: a gain map and then the depth are appended."""
    message = {"Format": "RangeInverse", "Near": 1, "Far": 4, "Units": "Meters", **message}
    words = "".join(f"<DepthMap:{k}>{v}</DepthMap:{k}>" for k, v in message.items())
    other = b"\xff\xd8\xff not a picture"
    items = (
        f'<rdf:li rdf:parseType="Resource"><Container:Item Item:Mime="image/jpeg" Item:Length="0" '
        f'Item:Padding="{padding}" Item:DataURI="primary_image"/></rdf:li>'
        f'<rdf:li rdf:parseType="Resource"><Item:Mime>image/jpeg</Item:Mime>'
        f"<Item:Length>{len(other)}</Item:Length><Item:DataURI>gain</Item:DataURI></rdf:li>"
        f'<rdf:li rdf:parseType="Resource"><Container:Item Item:Mime="image/png" '
        f'Item:Length="{len(depth)}" Item:DataURI="android/depthmap"/></rdf:li>'
    )
    xml = RDF.format(
        f"<rdf:Description {DYNAMIC}><Device:Container><Container:Directory><rdf:Seq>{items}"
        "</rdf:Seq></Container:Directory></Device:Container><Device:Cameras><rdf:Seq>"
        f'<rdf:li rdf:parseType="Resource">{model}<Camera:DepthMap rdf:parseType="Resource">{words}'
        f"<DepthMap:DepthURI>{uri}</DepthMap:DepthURI></Camera:DepthMap></rdf:li></rdf:Seq>"
        "</Device:Cameras></rdf:Description>"
    )
    return with_xmp(jpeg, xml) + b"\0" * padding + other + depth


def apple_xml(kind="disparity", least=0.5, most=2.5, accuracy="relative", camera=None) -> str:
    """Apple's metadata; the camera is focal length, principal point, and the size they are for."""
    matrix = ""
    if camera is not None:
        focal, x, y, columns, rows = camera
        numbers = "".join(f"<rdf:li>{v}</rdf:li>" for v in (focal, 0, 0, 0, focal, 0, x, y, 1))
        matrix = (
            f"<depthData:IntrinsicMatrixReferenceWidth>{columns}"
            "</depthData:IntrinsicMatrixReferenceWidth>"
            f"<depthData:IntrinsicMatrixReferenceHeight>{rows}"
            "</depthData:IntrinsicMatrixReferenceHeight>"
            f"<depthData:IntrinsicMatrix><rdf:Seq>{numbers}</rdf:Seq></depthData:IntrinsicMatrix>"
        )
    return RDF.format(
        f'<rdf:Description rdf:about="" {APPLE}>'
        f"<apdi:AuxiliaryImageType>{kind}</apdi:AuxiliaryImageType>"
        f"<apdi:FloatMinValue>{least}</apdi:FloatMinValue>"
        f"<apdi:FloatMaxValue>{most}</apdi:FloatMaxValue>{matrix}"
        f"<depthData:Accuracy>{accuracy}</depthData:Accuracy></rdf:Description>"
    )


def apple_jpeg(jpeg: bytes, depth: bytes, xml: str, order=">") -> bytes:
    """A multi-picture JPEG: a matte, which is no depth, and then the disparity."""
    further = [with_xmp(depth, apple_xml(kind="portraiteffectsmatte")), with_xmp(depth, xml)]
    head = {"<": b"II*\0", ">": b"MM\0*"}[order]
    index_bytes = 8 + 2 + 3 * 12 + 4 + 16 * 3
    place = 2 + 4 + 4  # of the index: behind the first mark, the segment's head, and "MPF"
    base = len(jpeg) + 4 + 4 + index_bytes - place
    sizes = [place + base, *(len(part) for part in further)]
    offsets = [0, base, base + len(further[0])]
    entries = b"".join(
        struct.pack(f"{order}IIIHH", 0, size, offset, 0, 0)
        for size, offset in zip(sizes, offsets, strict=True)
    )
    index = head + struct.pack(f"{order}IH", 8, 3)
    index += struct.pack(f"{order}HHI4s", 0xB000, 7, 4, b"0100")
    index += struct.pack(f"{order}HHII", 0xB001, 4, 1, 3)
    index += struct.pack(f"{order}HHII", 0xB002, 7, 48, 8 + 2 + 36 + 4) + bytes(4) + entries
    return with_segments(jpeg, segment(0xE2, b"MPF\0" + index)) + b"".join(further)


def heic(color, depth, xml="", orientation=1) -> bytes:
    """A HEIC whose second picture is the first one's depth.

    pillow-heif writes two pictures; the boxes that make the second one a depth image
    (ISO/IEC 23008-12: auxC and the reference auxl) and turn both (irot, imir) are put in.
    """
    import pillow_heif

    images = [Image.fromarray(color), Image.fromarray(depth)]
    exif = Image.Exif()
    exif[0x0112] = 1  # else pillow-heif turns by itself; what is meant is put in below
    images[0].info["exif"] = exif.tobytes()
    if xml:
        images[1].info["xmp"] = xml.encode()
    file = pillow_heif.HeifFile()
    for image in images:
        file.add_from_pillow(image)
    stream = io.BytesIO()
    file.save(stream, quality=-1, chroma=444)
    upright, stored = (struct.pack(">HHIH", 0x0112, 3, 1, n) for n in (1, orientation))
    assert stream.getvalue().count(upright) == 1
    return _with_auxiliary(stream.getvalue().replace(upright, stored), orientation)


def boxes(data: bytes) -> list[tuple[bytes, bytes]]:
    contents = []
    while data:
        size, kind = struct.unpack(">I4s", data[:8])
        contents.append((kind, data[8:size]))
        data = data[size:]
    return contents


def box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", len(content) + 8, kind) + content


#: By EXIF's orientation: quarters of a turn to the left, then what is exchanged (0: up and down).
_TURNS = {1: (), 2: (None, 1), 3: (2,), 4: (None, 0), 5: (1, 0), 6: (3,), 7: (1, 1), 8: (1,)}


def _turning(orientation: int) -> list[bytes]:
    pairs = zip((b"irot", b"imir"), _TURNS[orientation], strict=False)
    return [box(kind, bytes([value])) for kind, value in pairs if value is not None]


def _with_auxiliary(data: bytes, orientation: int) -> bytes:
    top = boxes(data)
    meta = next(content for kind, content in top if kind == b"meta")
    inner = dict(boxes(meta[4:]))
    properties = dict(boxes(inner[b"iprp"]))
    items = [struct.unpack(">IHH4s", entry[:12]) for _, entry in boxes(inner[b"iinf"][6:])]
    first, second = (number for _, number, _, kind in items if kind == b"hvc1")
    count = len(boxes(properties[b"ipco"]))
    added = [*_turning(orientation), box(b"auxC", bytes(4) + b"urn:mpeg:hevc:2015:auxid:2\0")]
    properties[b"ipco"] += b"".join(added)
    indices = [count + 1 + n for n in range(len(added))]
    for item, own in ((first, indices[:-1]), (second, indices)):
        properties[b"ipma"] = _associated(properties[b"ipma"], item, own)
    inner[b"iprp"] = b"".join(box(*property_box) for property_box in properties.items())
    references = inner.get(b"iref", bytes(4)) + box(b"auxl", struct.pack(">HHH", second, 1, first))
    inner[b"iref"] = references
    longer = len(b"".join(box(*property_box) for property_box in inner.items())) + 4 - len(meta)
    inner[b"iloc"] = _moved(inner[b"iloc"], longer)
    changed = meta[:4] + b"".join(box(*property_box) for property_box in inner.items())
    return b"".join(box(kind, changed if kind == b"meta" else content) for kind, content in top)


def _associated(ipma: bytes, item: int, indices: list[int]) -> bytes:
    result, at = ipma[:8], 8
    for _ in range(struct.unpack(">I", ipma[4:8])[0]):
        number, count = struct.unpack(">HB", ipma[at : at + 3])
        own = ipma[at + 3 : at + 3 + count]
        at += 3 + count
        own += bytes(0x80 | index for index in indices) if number == item else b""
        result += struct.pack(">HB", number, len(own)) + own
    return result


def _moved(iloc: bytes, by: int) -> bytes:
    """Items whose places are base offsets of 4 bytes, as libheif writes them."""
    assert iloc[:6] == b"\0\0\0\0\x44\x40"
    result, at = bytearray(iloc), 8
    for _ in range(struct.unpack(">H", iloc[6:8])[0]):
        base, extents = struct.unpack(">IH", iloc[at + 4 : at + 10])
        struct.pack_into(">I", result, at + 4, base + by)
        at += 10 + 8 * extents
    return bytes(result)


def room(rows=96, columns=128) -> tuple[np.ndarray, np.ndarray]:
    """Colour, and codes from 0 to 255 with no two corners alike; both tell up from down."""
    y, x = np.mgrid[0:rows, 0:columns]
    codes = (np.where(x < columns // 3, 200, 40) + y * 50 / rows).round().astype(np.uint8)
    color = np.stack([codes, 255 - codes, np.full_like(codes, 128)], axis=-1)
    return color, codes
