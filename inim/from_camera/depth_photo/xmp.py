"""Metadata of photographs (XMP, ISO 16684-1): XML from anybody, read in bounded time.

Nothing is expanded or fetched: a document type, the one way to entities, is refused.
"""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

from inim.errors import FileError

_NAMESPACES = {
    "http://ns.google.com/photos/1.0/depthmap/": "GDepth",
    "http://ns.google.com/photos/dd/1.0/depthmap/": "DepthMap",
    "http://ns.google.com/photos/dd/1.0/item/": "Item",
    "http://ns.google.com/photos/1.0/container/item/": "Item",
    "http://ns.google.com/photos/dd/1.0/imagingmodel/": "ImagingModel",
    "http://ns.apple.com/pixeldatainfo/1.0/": "apdi",
    "http://ns.apple.com/depthData/1.0/": "depthData",
    "http://ns.adobe.com/xmp/note/": "xmpNote",
}
_DEEPEST = 64
_MOST_ELEMENTS = 20_000
# Texts up to this length count as their parents', too: the numbers of a list are one text so.
_SHORT = 4096


def read_xmp(packet: bytes, path: Path) -> list[dict[str, str]]:
    """Properties by element, in the order of the document.

    Parameters
    ----------
    packet : bytes
    path : Path
        Of the photograph, for messages.

    Returns
    -------
    list of dict of str to str
        Of each element its properties ("DepthMap:Near"), be they attributes or elements in it.

    Raises
    ------
    FileError
        Broken XML, or a document type, or more than a photograph has.
    """
    nodes: list[dict[str, str]] = []
    stack: list[tuple[dict[str, str], list[str]]] = []

    def start(_: str, attributes: dict[str, str]) -> None:
        if len(stack) >= _DEEPEST or len(nodes) >= _MOST_ELEMENTS:
            raise FileError(f"{path}: its XMP metadata nest too deep or never end; {_WAY_OUT}")
        node = {name: text for key, text in attributes.items() if (name := _name(key))}
        nodes.append(node)
        stack.append((node, []))

    def end(tag: str) -> None:
        text = "".join(stack.pop()[1]).strip()
        if not (text and stack):
            return
        if name := _name(tag):
            stack[-1][0].setdefault(name, text)
        if len(text) <= _SHORT:
            stack[-1][1].append(f" {text} ")

    def doctype(*_: object) -> None:
        raise FileError(f"{path}: its XMP metadata have a DOCTYPE; entities are refused")

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = doctype
    parser.CharacterDataHandler = lambda text: stack[-1][1].append(text)
    try:
        parser.Parse(packet.strip(b"\0 \n\r\t"), True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise FileError(f"{path}: its XMP metadata are broken ({error}); {_WAY_OUT}") from None
    return nodes


_WAY_OUT = "take the photograph's original file"


def _name(key: str) -> str:
    """The usual name of a property; empty where it is none of ours."""
    namespace, _, local = key.rpartition(" ")
    prefix = _NAMESPACES.get(namespace)
    return f"{prefix}:{local}" if prefix else ""


def merged(nodes: list[dict[str, str]], prefix: str) -> dict[str, str]:
    """All properties of a namespace, wherever they stand; the first of each."""
    found: dict[str, str] = {}
    for node in nodes:
        for name, text in node.items():
            if name.startswith(f"{prefix}:"):
                found.setdefault(name, text)
    return found
