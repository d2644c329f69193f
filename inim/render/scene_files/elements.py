"""Record of a scene's elements by name, to list changes between two scenes.

An element's name is its path of tags with XML ids or names, such as
`shape amphora / bsdf clay / rgb reflectance`. Its value is the canonical text of its other
attributes. Comments, white space, the order of attributes and the form of numbers do not count, and
the digest of a file takes the place of its path.
"""

import hashlib
import re
from collections import Counter
from collections.abc import Mapping

#: Largest number of elements that are recorded singly; a longer scene is recorded by its shapes,
#: materials and lights, each with the digest of its content.
MOST_RECORDED = 500
_SEPARATOR = " / "
_LONGEST_VALUE = 200
_SHA256 = re.compile(r"[0-9a-f]{64}")


class ElementRecord:
    """Elements of a scene, recorded while it is parsed."""

    def __init__(self) -> None:
        self._values: dict[str, str] = {}
        self._paths: list[tuple[str, str, Counter[str]]] = [("", "scene", Counter())]

    def start(self, tag: str, attributes: Mapping[str, str], *, is_seen: bool = True) -> None:
        """Add an element; one that is not seen, such as an include, leaves no name in the path."""
        path, parent, counts = self._paths[-1]
        if not is_seen:
            self._paths.append((path, parent, counts))
            return
        label = next((key for key in ("id", "name", "type") if attributes.get(key)), "")
        name = " ".join(filter(None, (tag, attributes.get(label, ""))))
        # The order of a transform's steps counts.
        group = "" if parent == "transform" else name
        counts[group] += 1
        if not group or counts[group] > 1:
            name += f" {counts[group]}"
        path = f"{path}{_SEPARATOR}{name}" if path else name
        rest = {key: value for key, value in sorted(attributes.items()) if key != label}
        values = [canonical(v) if k == "value" else f"{k}={canonical(v)}" for k, v in rest.items()]
        self._values[path] = _shortened(" ".join(values))
        self._paths.append((path, tag, Counter()))

    def end(self) -> None:
        """Close the last element."""
        self._paths.pop()

    @property
    def elements(self) -> dict[str, str]:
        """Canonical text by name."""
        if len(self._values) <= MOST_RECORDED:
            return dict(self._values)
        digests: dict[str, hashlib._Hash] = {}
        for path, value in self._values.items():
            digest = digests.setdefault(path.partition(_SEPARATOR)[0], hashlib.sha256())
            digest.update(repr((path, value)).encode())
        if len(digests) > MOST_RECORDED:
            parts = [digest.digest() for digest in digests.values()]
            return {f"{len(parts)} elements": hashlib.sha256(b"".join(parts)).hexdigest()}
        return {path: digest.hexdigest() for path, digest in digests.items()}


def canonical(text: str) -> str:
    """Text with single spaces instead of commas and white space, and numbers in one form."""
    return " ".join(map(_canonical_word, text.replace(",", " ").split()))


def _canonical_word(word: str) -> str:
    try:
        return word if _SHA256.fullmatch(word) else f"{float(word):.9g}"
    except ValueError:
        return word


def _shortened(text: str) -> str:
    """A text, or the digest of a long one."""
    return text if len(text) <= _LONGEST_VALUE else hashlib.sha256(text.encode()).hexdigest()
