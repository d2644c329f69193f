"""Documents with a title and the command that repeats them."""

from __future__ import annotations

from typing import Annotated

from inim.documents.document import Document, Part, doc
from inim.documents.parts import Command, Created, InimVersion, Sha256


class Record(Document):
    """A document with a title and the command that repeats it."""

    title: Annotated[str, doc("Title of its page.")]
    created: Created
    inim_version: InimVersion
    command: Command


class SceneFile(Part):
    """A scene's file."""

    path: Annotated[str, doc("Path of the scene's XML, as given.")]
    sha256: Annotated[Sha256, doc("SHA-256 over the XML and all files it names.")]
