"""Documents that inim writes: one typed declaration per document and file.

A declaration is a `Document` of typed fields, each with its description. Its JSON Schema, its
reader with all checks, and the table in the documentation follow from it.
"""

from inim.documents.document import (
    NAMES,
    Document,
    Part,
    doc,
    read_document,
    schema,
    write_document,
)

__all__ = ["NAMES", "Document", "Part", "doc", "read_document", "schema", "write_document"]
