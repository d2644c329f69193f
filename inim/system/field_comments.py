"""Descriptions of a class's fields: `#:` comments behind them or above them, as Sphinx has them."""

import inspect
from functools import cache


@cache
def field_comments(declaration: type) -> dict[str, str]:
    """Texts of the `#:` comments of a class, by field."""
    texts: dict[str, str] = {}
    above: list[str] = []
    for line in inspect.getsource(declaration).splitlines():
        code, _, comment = line.strip().partition("#: ")
        above += [comment] if comment else []
        if code and above:
            texts[code.partition(":")[0]] = " ".join(above)
            above = []
    return texts
