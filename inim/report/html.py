"""The report as one HTML file that needs nothing else: no network, no scripts, no other files.

Pictures are embedded. Should they make the page too large, it is built again with smaller ones;
what is shown smaller or compressed is in full in the folder beside the page. Whatever comes from
outside goes through `text` or `element`, which escape it.
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from inim.report.diagram import plan_view
from inim.report.summary import (
    MISSING,
    best_algorithm,
    check_passed,
    check_value,
    is_number,
    items,
    number,
    part,
    plain,
    relation,
    score,
    verdict,
    viewpoint_names,
)

__all__ = ["DIFFERENCE_GAIN", "LARGEST_PAGE_BYTES", "render_html"]

#: A page above this is built again with smaller pictures.
LARGEST_PAGE_BYTES = 10_000_000
#: Differences are shown this many times brighter: most are below what an eye notices.
DIFFERENCE_GAIN = 4

# Everything is refused but embedded pictures and the page's own style sheet.
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'"
)
_CROP_LENSES = 6
_CROP_ON_PAGE_PX = 300
_THUMBNAIL_PX = 260
_HERO_PX = 400
_WHOLE_EIA_PX = 420
_FAILURES_ON_TOP = 3
_WIDE = 1.5  # pictures wider than this many times their height get a wider column
_NBSP = "\u00a0"


@dataclass(frozen=True)
class _Encoding:
    """How pictures are embedded: `longest_px` 0 leaves them out."""

    form: str
    quality: int
    longest_px: int


# Tried in turn until the page is small enough. The last one always is.
_ENCODINGS = (
    _Encoding("PNG", 0, 640),
    _Encoding("JPEG", 92, 640),
    _Encoding("JPEG", 85, 320),
    _Encoding("JPEG", 75, 160),
    _Encoding("JPEG", 0, 0),
)


def render_html(data: Mapping[str, Any], folder: Path) -> str:
    """The whole report as one HTML page.

    Parameters
    ----------
    data : mapping
        The contents of report.json, schema ``inim.report/1``.
    folder : Path
        Where the report's PNG files lie. One that is missing or unreadable shows as a box.

    Returns
    -------
    str
        The page, below `LARGEST_PAGE_BYTES` unless the data without pictures is above it.
    """
    page = ""
    for encoding in _ENCODINGS:
        page = _page(data, _Pictures(Path(folder), encoding))
        if len(page.encode()) < LARGEST_PAGE_BYTES:
            break
    return page


# -- text and elements -------------------------------------------------------------------------


def text(value: object) -> str:
    """`value` as HTML text or attribute: the one place where escaping happens."""
    return html.escape(plain(value), quote=True)


def element(name: str, *content: str, **attributes: object) -> str:
    """An element around HTML `content`; attributes are escaped, ``class_`` becomes class."""
    given = {key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()}
    written = "".join(f' {k}="{text(v)}"' for k, v in given.items() if v is not None)
    return f"<{name}{written}>{''.join(content)}</{name}>"


def _section(anchor: str, title: str, *content: str) -> str:
    heading = element("h2", text(title), id=f"{anchor}-title")
    return element("section", heading, *content, id=anchor, aria_labelledby=f"{anchor}-title")


def _table(
    caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]], class_: str = ""
) -> str:
    """A table of HTML cells; the first cell of a row names it."""
    head = "".join(element("th", cell, scope="col") for cell in heads)
    body = "".join(
        element(
            "tr", element("th", row[0], scope="row"), *(element("td", cell) for cell in row[1:])
        )
        for row in rows
    )
    table = (
        f"<table><caption>{text(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )
    # Focusable, so that a wide table can be scrolled from the keyboard.
    return element(
        "div",
        table,
        class_=f"scroll {class_}".strip(),
        tabindex=0,
        role="region",
        aria_label=caption,
    )


def _mm(value: object) -> str:
    """A length with four significant digits."""
    return f"{_short(value)}{_NBSP}mm" if is_number(value) else MISSING


def _short(value: object) -> str:
    """Any scalar, numbers with at most four significant digits."""
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return plain(value)
    if not math.isfinite(value):
        return number(value, 0)
    return f"{value:.4g}".replace("-", "−")


# -- pictures ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Pictures:
    """The report's PNG files, and how they are put on the page."""

    folder: Path
    encoding: _Encoding

    def read(self, *names: str) -> np.ndarray | None:
        """(rows, columns, 3) uint8 sRGB, or None where there is no readable picture.

        Names come from the report; one that leads out of its folder is not followed.
        """
        from PIL import Image

        try:
            path = self.folder.joinpath(*names).resolve()
            if not path.is_relative_to(self.folder.resolve()):
                return None
            with Image.open(path) as picture:
                return np.asarray(picture.convert("RGB"))
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
            return None

    def embed(
        self, pixels: np.ndarray | None, alt: str, longest_px: int | None = None, **attributes: Any
    ) -> str:
        """An img with the picture in it, or a visible box that says it is missing."""
        if pixels is None or min(pixels.shape[:2]) < 1:
            return _box("missing", alt)
        limit = min(self.encoding.longest_px, longest_px or self.encoding.longest_px)
        if not limit:
            return _box("left out, the page would be too large", alt)
        height, width = pixels.shape[:2]
        source = _data_uri(_shrink(pixels, limit), self.encoding)
        return _img(source, alt, width=width, height=height, **attributes)

    def crop(self, pixels: np.ndarray | None, window: _Window, alt: str) -> str:
        """A part of a picture, each pixel a whole number of pixels on the page."""
        cut = None if pixels is None else window.of(pixels)
        if cut is None:
            return _box("missing", alt)
        if not self.encoding.longest_px:
            return _box("left out, the page would be too large", alt)
        times = max(1, round(_CROP_ON_PAGE_PX / max(cut.shape[:2])))
        height, width = (times * n for n in cut.shape[:2])
        source = _data_uri(cut, _Encoding("PNG", 0, _CROP_ON_PAGE_PX))
        return _img(
            source, alt, width=width, height=height, class_="pixels", style=f"width:{width}px"
        )


def _box(reason: str, alt: str) -> str:
    words = element("b", text(reason)) + element("span", text(alt))
    return element("div", words, class_="missing")


def _img(source: str, alt: str, **attributes: Any) -> str:
    return element("img", src=source, alt=alt, **attributes).removesuffix("</img>")


def _shrink(pixels: np.ndarray, longest_px: int) -> np.ndarray:
    from PIL import Image

    height, width = pixels.shape[:2]
    scale = longest_px / max(height, width)
    if scale >= 1:
        return pixels
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))


def _data_uri(pixels: np.ndarray, encoding: _Encoding) -> str:
    from PIL import Image

    # No "optimize": with it Pillow's JPEG writer runs out of buffer on noisy pictures.
    lossy = encoding.form == "JPEG"
    options = {"quality": encoding.quality, "subsampling": 0} if lossy else {}
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, encoding.form, **options)
    coded = base64.b64encode(stream.getvalue()).decode("ascii")
    return f"data:image/{encoding.form.lower()};base64,{coded}"


def _difference(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
    """|a − b| of the sRGB values, amplified and clipped; None unless the two are alike in size."""
    if a is None or b is None or a.shape != b.shape:
        return None
    change = np.abs(a.astype(np.int16) - b.astype(np.int16))
    return np.asarray(np.minimum(change * DIFFERENCE_GAIN, 255), np.uint8)


# -- the page ----------------------------------------------------------------------------------


def _page(data: Mapping[str, Any], pictures: _Pictures) -> str:
    sections = "".join(section(data, pictures) for section in _SECTIONS)
    title = text(data.get("title") or "Untitled")
    style = resources.files("inim.report").joinpath("report.css").read_text("utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(_POLICY)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{title}: {verdict(data)} – inim report</title>\n<style>\n{style}</style>\n"
        f'</head>\n<body>\n<a class="skip" href="#overview">Skip to the scores</a>\n'
        f"{_header(data)}\n<main>\n{sections}\n</main>\n{_footer(data)}\n</body>\n</html>\n"
    )


def _header(data: Mapping[str, Any]) -> str:
    display = part(data, "display", "given").get("name", MISSING)
    facts = [
        f"Display {text(display)}",
        f"lens model {text(data.get('lens_model', MISSING))}",
        text(part(data, "backend").get("variant", MISSING)),
        f"inim {text(data.get('inim_version', MISSING))}",
        element("time", text(_when(data.get("created")))),
    ]
    title = element("h1", text(data.get("title") or "Untitled"))
    line = element("p", " · ".join(facts), class_="facts")
    left = element("div", title, line)
    return element("header", left, _verdict_badge(data), _navigation())


def _when(created: object) -> str:
    return plain(created or MISSING).replace("T", " ").replace("Z", " UTC")


def _verdict_badge(data: Mapping[str, Any]) -> str:
    """The verdict in a word and a sign, and only then a colour."""
    checks = [part(check) for check in items(part(data, "verdict"), "checks")]
    passed = sum(check_passed(check) for check in checks)
    word = element("strong", _mark(verdict(data)), text(verdict(data).capitalize()))
    lines = [f'<a href="#checks">{passed} of {len(checks)} checks passed</a>']
    warnings = len(items(data, "warnings"))
    if warnings:
        lines.append(f'<a href="#warnings">{warnings} warning{"s" * (warnings > 1)}</a>')
    kind = verdict(data).replace(" ", "-")
    return element("p", word, element("span", " · ".join(lines)), class_=f"verdict {kind}")


def _mark(word: str) -> str:
    sign = {"passed": "✓", "failed": "✕"}.get(word, "?")
    return element("span", sign, class_="mark", aria_hidden="true")


def _navigation() -> str:
    links = [f'<a href="#{anchor}">{text(title)}</a>' for anchor, title in _CONTENTS]
    return element("nav", *links, aria_label="Sections")


def _footer(data: Mapping[str, Any]) -> str:
    version = text(data.get("inim_version", MISSING))
    schema = text(data.get("schema", MISSING))
    return element("footer", element("p", f"inim {version} · data in report.json ({schema})"))


# -- overview ----------------------------------------------------------------------------------


def _overview(data: Mapping[str, Any], pictures: _Pictures) -> str:
    layout = "overview crowded" if len(viewpoint_names(data)) > 6 else "overview"
    body = element("div", _scores(data), _hero(data, pictures), class_=layout)
    return _section("overview", "Scores", body)


def _scores(data: Mapping[str, Any]) -> str:
    names = viewpoint_names(data)
    heads = ["Algorithm", *names, "EIA SSIM", "Holes", "Seconds"]
    best = best_algorithm(data)
    rows = [_algorithm_row(data, name, names, name == best) for name in part(data, "algorithms")]
    rows.append(_reference_row("Ceiling", part(data, "ceiling"), names, "to scene"))
    rows.append(_reference_row("Noise floor", part(data, "noise_floor"), names, "to itself"))
    table = _table("SSIM to the ceiling, per viewpoint", [text(h) for h in heads], rows, "scores")
    note = (
        "Large: SSIM to the ceiling, what the algorithm keeps of what this display can show. "
        "Small: SSIM to the scene, what the viewer gets. "
    )
    link = element("a", "What the numbers mean", href="#meaning")
    return element("div", table, element("p", text(note), link, class_="note"), _failures(data))


def _failures(data: Mapping[str, Any]) -> str:
    """The first failed checks, to be read without scrolling."""
    checks = [part(check) for check in items(part(data, "verdict"), "checks")]
    failed = [check for check in checks if not check_passed(check)]
    if not failed:
        return ""
    lines = [
        element("li", element("b", text(check.get("name", MISSING))), " ", text(_found(check)))
        for check in failed[:_FAILURES_ON_TOP]
    ]
    if len(failed) > _FAILURES_ON_TOP:
        more = f"and {len(failed) - _FAILURES_ON_TOP} more failed checks"
        lines.append(element("li", element("a", text(more), href="#checks")))
    return element("ul", *lines, class_="failures", aria_label="Failed checks")


def _found(check: Mapping[str, Any]) -> str:
    return f"{check_value(check)}, required {relation(check)} {check_value(check, 'limit')}"


def _algorithm_row(
    data: Mapping[str, Any], name: str, names: Sequence[str], is_best: bool
) -> list[str]:
    run = part(data, "algorithms", name)
    eia = part(run, "eia")
    views = [part(run, "views", viewpoint) for viewpoint in names]
    label = text(name) + (element("small", "best mean") if is_best else "")
    cells = [_score_cell(score(v, "ssim_to_ceiling"), f"{score(v, 'ssim')} scene") for v in views]
    last = [score(eia, "ssim"), score(eia, "hole_fraction"), number(run.get("seconds"), 2)]
    return [label, *cells, *map(text, last)]


def _reference_row(
    label: str, scores: Mapping[str, Any], names: Sequence[str], against: str
) -> list[str]:
    cells = [_score_cell(score(part(scores, "views", name), "ssim"), against) for name in names]
    eia = score(part(scores, "eia"), "ssim")
    return [element("em", text(label)), *cells, text(eia), MISSING, MISSING]


def _score_cell(main: str, small: str) -> str:
    return element("span", text(main)) + element("small", text(small))


def _hero(data: Mapping[str, Any], pictures: _Pictures) -> str:
    """The centre viewpoint as the scene shows it and as the best algorithm does."""
    names, best = viewpoint_names(data), best_algorithm(data)
    if not names:
        return ""
    view = "centre" if "centre" in names else names[0]
    truth = pictures.read("truth", f"{view}.png")
    shots = [_shot(pictures, truth, f"Ground truth, viewpoint {view}", "Ground truth", _HERO_PX)]
    if best is not None:
        made = pictures.read("views", best, f"{view}.png")
        shots.append(_shot(pictures, made, f"{best}, viewpoint {view}", best, _HERO_PX))
    kind = "hero wide" if _is_wide(truth) else "hero"
    return element("div", *shots, class_=kind)


def _shot(
    pictures: _Pictures,
    pixels: np.ndarray | None,
    alt: str,
    caption: str,
    longest_px: int | None = None,
) -> str:
    picture = pictures.embed(pixels, alt, longest_px)
    return element("figure", picture, element("figcaption", text(caption)))


def _is_wide(pixels: np.ndarray | None) -> bool:
    return pixels is not None and pixels.shape[1] > _WIDE * pixels.shape[0]


# -- display -----------------------------------------------------------------------------------

# key: (label, unit, what it means)
_GIVEN = {
    "name": ("Name", "", ""),
    "pitch_mm": ("Lens pitch P", "mm", "from one lens to the next"),
    "focal_length_mm": ("Focal length f", "mm", "of each lens"),
    "gap_mm": ("Gap g", "mm", "between lens array and panel"),
    "pixel_pitch_mm": ("Panel pixel", "mm", "from one pixel to the next"),
    "lens_columns": ("Lenses across", "", ""),
    "lens_rows": ("Lenses down", "", ""),
    "panel_columns": ("Panel columns", "px", "as many as cover the array unless given"),
    "panel_rows": ("Panel rows", "px", "as many as cover the array unless given"),
    "depth_min_mm": ("Depth range from", "mm", "from the formula unless given"),
    "depth_max_mm": ("Depth range to", "mm", "from the formula unless given"),
    "elemental_pitch_mm": ("Elemental image pitch", "mm", "the lens pitch unless given"),
    "refractive_index": ("Refractive index", "", "of the lenses"),
    "lens_thickness_mm": ("Lens thickness", "mm", "one pitch unless given"),
    "curved_side": ("Curved side", "", "which way the lenses bulge"),
}
_DERIVED = {
    "width_mm": ("Width", "mm", "of the lens array"),
    "height_mm": ("Height", "mm", "of the lens array"),
    "eia_columns": ("EIA columns", "px", "panel pixels across"),
    "eia_rows": ("EIA rows", "px", "panel pixels down"),
    "pixels_per_lens": ("Pixels per lens", "px", "directions each lens can show, along one axis"),
    "central_depth_mm": ("Central depth plane", "mm", "where the lenses focus the panel"),
    "scene_pixel_mm": ("Scene pixel", "mm", "a panel pixel's image on that plane"),
    "depth_span_mm": ("Depth span", "mm", "depth the display can show, by the formula"),
    "depth_min_mm": ("Depth range from", "mm", "what the relic is fitted into"),
    "depth_max_mm": ("Depth range to", "mm", "what the relic is fitted into"),
    "depth_range_is_cut": ("Depth range cut", "", "whether the formula crossed the array"),
    "viewing_half_angle_deg": ("Viewing half-angle", "°", "beyond it views repeat"),
    "nearest_viewing_distance_mm": ("Nearest viewing distance", "mm", "nearer eyes see flips"),
}


def _display(data: Mapping[str, Any], pictures: _Pictures) -> str:  # noqa: ARG001
    display = part(data, "display")
    given, derived = part(display, "given"), part(display, "derived")
    drawing = plan_view(display, items(data, "viewpoints"))
    caption = "Seen from above. Shaded: where an eye sees no flipped view."
    plan = (
        element(
            "figure",
            element("div", drawing, class_="scroll"),
            element("figcaption", caption),
            class_="plan",
        )
        if drawing
        else ""
    )
    tables = [
        _quantities("Given", given, _GIVEN, "default"),
        _quantities("Derived", derived, _DERIVED, "focused" if _is_focused(derived) else MISSING),
    ]
    return _section(
        "display",
        "Display",
        _display_words(given, derived),
        _display_warnings(derived),
        plan,
        element("div", *tables, class_="columns"),
    )


def _is_focused(derived: Mapping[str, Any]) -> bool:
    return "central_depth_mm" in derived and derived["central_depth_mm"] is None


def _display_words(given: Mapping[str, Any], derived: Mapping[str, Any]) -> str:
    """What the figures mean, in sentences."""
    lenses = f"{_short(given.get('lens_columns'))} × {_short(given.get('lens_rows'))}"
    size = f"{_short(derived.get('width_mm'))} × {_mm(derived.get('height_mm'))}"
    pixels = f"{_short(derived.get('eia_columns'))} × {_short(derived.get('eia_rows'))}"
    words = (
        f"{lenses} lenses of {_mm(given.get('pitch_mm'))} make a display of {size} with {pixels} "
        f"pixels, {_short(derived.get('pixels_per_lens'))} across each lens. "
        f"{_focus_words(derived)} Each lens sends its directions within "
        f"±{_short(derived.get('viewing_half_angle_deg'))}°; an eye on the axis sees one unbroken "
        f"picture from {_mm(derived.get('nearest_viewing_distance_mm'))} onwards."
    )
    return element("p", text(words), class_="lead")


def _focus_words(derived: Mapping[str, Any]) -> str:
    low, high = (_mm(derived.get(f"depth_{end}_mm")) for end in ("min", "max"))
    relic = f"the relic is fitted into {low} to {high}."
    centre = derived.get("central_depth_mm")
    if _is_focused(derived):
        return f"It is focused (gap = focal length), so it has no central depth plane; {relic}"
    if not is_number(centre):
        return f"Its central depth plane is not known; {relic}"
    side = "in front of" if centre > 0 else "behind"
    return f"It is sharpest {_mm(abs(centre))} {side} the lens array; {relic}"


def _display_warnings(derived: Mapping[str, Any]) -> str:
    if derived.get("depth_range_is_cut") is not True:
        return ""
    words = (
        "The depth formula crosses the lens array, so the depth range was cut just off it. "
        "More pixels under each lens would give this display a proper range."
    )
    return element("p", element("b", "Depth range cut."), " ", text(words), class_="caution")


def _quantities(
    caption: str, values: Mapping[str, Any], known: Mapping[str, tuple[str, str, str]], none: str
) -> str:
    rows = []
    for key, value in values.items():
        label, unit, meaning = known.get(key, (key, "", ""))
        space = "" if unit == "°" else _NBSP
        shown = none if value is None else _short(value) + (space + unit if unit else "")
        rows.append([text(label), text(shown), text(meaning)])
    return _table(caption, ["Quantity", "Value", "Meaning"], rows, "quantities")


# -- views -------------------------------------------------------------------------------------


def _views(data: Mapping[str, Any], pictures: _Pictures) -> str:
    intro = (
        "Differences are absolute differences of the sRGB values, amplified "
        f"×{_NBSP}{DIFFERENCE_GAIN}: black is equal. The ceiling is compared with the ground "
        "truth, which shows what the display loses; an algorithm is compared with the ceiling, "
        "which shows what the algorithm loses."
    )
    strips = _parallax(data, pictures)
    rows = [_viewpoint(data, pictures, v) for v in items(data, "viewpoints") if "name" in part(v)]
    return _section("views", "Views", element("p", text(intro), class_="lead"), *rows, strips)


def _viewpoint(data: Mapping[str, Any], pictures: _Pictures, viewpoint: Mapping[str, Any]) -> str:
    view = str(viewpoint["name"])
    truth = pictures.read("truth", f"{view}.png")
    ceiling = pictures.read("views", "ceiling", f"{view}.png")
    place = ", ".join(_short(v) for v in items(viewpoint, "position_mm"))
    heading = element("h3", text(view), element("small", text(f"eye at ({place}) mm")))
    figures = [
        _truth_figure(data, pictures, view, truth),
        _ceiling_figure(data, pictures, view, truth, ceiling),
    ]
    figures += [
        _algorithm_figure(data, pictures, view, name, ceiling) for name in part(data, "algorithms")
    ]
    kind = "views wide" if _is_wide(truth) else "views"
    return heading + element("div", *figures, class_=kind, style=f"--count:{len(figures)}")


def _truth_figure(
    data: Mapping[str, Any], pictures: _Pictures, view: str, truth: np.ndarray | None
) -> str:
    facts = [("To itself", _triple(part(data, "noise_floor", "views", view)))]
    picture = pictures.embed(truth, f"Ground truth from {view}")
    return _captioned("Ground truth", "the scene itself", [picture], facts)


def _ceiling_figure(
    data: Mapping[str, Any],
    pictures: _Pictures,
    view: str,
    truth: np.ndarray | None,
    ceiling: np.ndarray | None,
) -> str:
    change = _difference(ceiling, truth)
    pair = [
        pictures.embed(ceiling, f"Ceiling from {view}"),
        pictures.embed(change, f"Difference of ceiling and ground truth from {view}"),
    ]
    facts = [("To scene", _triple(part(data, "ceiling", "views", view)))]
    return _captioned("Ceiling", "and difference to the ground truth", pair, facts)


def _algorithm_figure(
    data: Mapping[str, Any],
    pictures: _Pictures,
    view: str,
    name: str,
    ceiling: np.ndarray | None,
) -> str:
    scores = part(data, "algorithms", name, "views", view)
    made = pictures.read("views", name, f"{view}.png")
    change = _difference(made, ceiling)
    pair = [
        pictures.embed(made, f"{name} from {view}"),
        pictures.embed(change, f"Difference of {name} and ceiling from {view}"),
    ]
    to_ceiling = [
        ("SSIM", score(scores, "ssim_to_ceiling")),
        ("PSNR", _db(scores, "psnr_to_ceiling_db")),
        ("FLIP", score(scores, "flip_to_ceiling")),
    ]
    on_relic = [("SSIM", score(scores, "ssim_on_relic"))]
    facts = [("To ceiling", to_ceiling), ("To scene", _triple(scores)), ("On the relic", on_relic)]
    return _captioned(name, "and difference to the ceiling", pair, facts)


def _triple(scores: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        ("SSIM", score(scores, "ssim")),
        ("PSNR", _db(scores, "psnr_db")),
        ("FLIP", score(scores, "flip")),
    ]


def _db(scores: Mapping[str, Any], key: str) -> str:
    shown = score(scores, key)
    return shown if shown == MISSING else f"{shown}{_NBSP}dB"


def _captioned(
    name: str,
    remark: str,
    images: Sequence[str],
    facts: Iterable[tuple[str, Sequence[tuple[str, str]]]],
) -> str:
    """A figure of one or two pictures; under its name, per reference, the scores against it."""
    title = element("b", text(name)) + " " + element("span", text(remark))
    rows = "".join(element("div", element("dt", text(k)), _measured(v)) for k, v in facts)
    caption = element("figcaption", title, element("dl", rows))
    kind = "pair" if len(images) == 2 else "single"
    return element("figure", element("div", *images, class_=kind), caption)


def _measured(scores: Iterable[tuple[str, str]]) -> str:
    return "".join(
        element("dd", text(f"{metric} "), element("b", text(value))) for metric, value in scores
    )


def _parallax(data: Mapping[str, Any], pictures: _Pictures) -> str:
    """Viewpoints in the order of their positions, so that parallax shows as a sideways shift."""
    points = [v for v in items(data, "viewpoints") if _position(v) is not None]
    best = best_algorithm(data)
    sources = [("Ground truth", ("truth",))] + ([(best, ("views", best))] if best else [])
    strips = [
        _strip(pictures, direction, [str(v["name"]) for v in line], sources)
        for direction, line in _lines_of_sight(points)
        if len(line) > 1
    ]
    if not strips:
        return ""
    shown = pictures.read("truth", f"{points[0]['name']}.png")
    words = (
        "The frame is the lens array: the farther a point is from it, the more it moves against "
        "the centre line. Both rows should move alike."
    )
    return element("h3", "Parallax", element("small", words)) + element(
        "div", *strips, class_="strips wide" if _is_wide(shown) else "strips"
    )


def _position(viewpoint: Any) -> tuple[float, float] | None:
    position = items(viewpoint, "position_mm")
    if "name" not in part(viewpoint) or len(position) < 2 or not all(map(is_number, position)):
        return None
    return float(position[0]), float(position[1])


def _lines_of_sight(points: Sequence[Any]) -> list[tuple[str, list[Any]]]:
    """Viewpoints left to right and top to bottom through the one nearest to the axis."""
    if not points:
        return []
    places = {id(v): _position(v) or (0.0, 0.0) for v in points}
    x0, y0 = min(places.values(), key=lambda p: math.hypot(*p))
    row = [v for v in points if math.isclose(places[id(v)][1], y0, abs_tol=1e-6)]
    column = [v for v in points if math.isclose(places[id(v)][0], x0, abs_tol=1e-6)]
    return [
        ("left to right", sorted(row, key=lambda v: places[id(v)][0])),
        ("top to bottom", sorted(column, key=lambda v: -places[id(v)][1])),
    ]


def _strip(
    pictures: _Pictures,
    direction: str,
    views: Sequence[str],
    sources: Sequence[tuple[str, tuple[str, ...]]],
) -> str:
    rows = []
    for label, place in sources:
        shots = [_strip_shot(pictures, direction, view, label, place) for view in views]
        title = element("h4", text(f"{label}, {direction}"))
        rows.append(title + element("div", *shots, class_="strip"))
    return element("div", *rows)


def _strip_shot(
    pictures: _Pictures, direction: str, view: str, label: str, place: tuple[str, ...]
) -> str:
    """One small picture with a line through its centre, across the direction of movement."""
    pixels = pictures.read(*place, f"{view}.png")
    picture = pictures.embed(pixels, f"{label} from {view}", _THUMBNAIL_PX)
    kind = "upright" if direction == "left to right" else "level"
    line = element("i", class_=kind, aria_hidden="true")
    return element(
        "figure",
        element("div", picture, line, class_="marked"),
        element("figcaption", text(view)),
    )


# -- elemental images --------------------------------------------------------------------------


@dataclass(frozen=True)
class _Window:
    """A rectangle of an elemental image array, in pixels."""

    top: int
    left: int
    height: int
    width: int

    def of(self, pixels: np.ndarray) -> np.ndarray | None:
        """The part of `pixels` inside, or None where it does not reach that far."""
        cut = pixels[self.top : self.top + self.height, self.left : self.left + self.width]
        return cut if cut.shape[:2] == (self.height, self.width) else None


def _elemental_images(data: Mapping[str, Any], pictures: _Pictures) -> str:
    truth = pictures.read("truth", "eia.png")
    window = _busiest_window(truth, data)
    figures = [
        _eia_figure(
            pictures,
            truth,
            window,
            "Ground truth",
            part(data, "noise_floor", "eia"),
            "To itself",
        )
    ]
    for name in part(data, "algorithms"):
        made = pictures.read("eia", f"{name}.png")
        scores = part(data, "algorithms", name, "eia")
        figures.append(_eia_figure(pictures, made, window, name, scores, "To ground truth"))
    intro = (
        f"What lies on the panel: about {_CROP_LENSES} × {_CROP_LENSES} elemental images, "
        "magnified, where the ground truth varies most near the centre; beside each, the whole "
        "array scaled down, with that place marked."
    )
    return _section(
        "eia",
        "Elemental images",
        element("p", text(intro), class_="lead"),
        element("div", *figures, class_="eias"),
    )


def _eia_figure(
    pictures: _Pictures,
    pixels: np.ndarray | None,
    window: _Window,
    name: str,
    scores: Mapping[str, Any],
    against: str,
) -> str:
    crop = pictures.crop(pixels, window, f"Magnified elemental images, {name}")
    whole = pictures.embed(pixels, f"Whole elemental image array, {name}", _WHOLE_EIA_PX)
    marked = element("div", whole, _marker(pixels, window), class_="marked")
    measured = _triple(scores)
    if "hole_fraction" in scores:
        measured.append(("Holes", score(scores, "hole_fraction")))
    return _captioned(name, "", [crop, marked], [(against, measured)])


def _marker(pixels: np.ndarray | None, window: _Window) -> str:
    """A frame over the whole array where the magnified part lies."""
    if pixels is None or window.of(pixels) is None:
        return ""
    rows, columns = pixels.shape[:2]
    place = (
        f"top:{100 * window.top / rows:.2f}%;left:{100 * window.left / columns:.2f}%;"
        f"height:{100 * window.height / rows:.2f}%;width:{100 * window.width / columns:.2f}%"
    )
    return element("i", style=place, aria_hidden="true")


def _busiest_window(truth: np.ndarray | None, data: Mapping[str, Any]) -> _Window:
    """The few lenses in the central half of the array whose pixels vary most."""
    rows, columns = (0, 0) if truth is None else truth.shape[:2]
    ratio = part(data, "display", "derived").get("pixels_per_lens")
    pixels_per_lens = float(ratio) if is_number(ratio) and 1 <= ratio < 4096 else 1.0
    size = max(1, round(_CROP_LENSES * pixels_per_lens))
    height, width = min(size, rows), min(size, columns)
    if truth is None:
        return _Window(0, 0, size, size)
    tops = _lens_starts(rows, height, pixels_per_lens)
    lefts = _lens_starts(columns, width, pixels_per_lens)
    # Only what the windows can reach: an array of 33 million pixels would take gigabytes.
    reach = np.s_[tops[0] : tops[-1] + height, lefts[0] : lefts[-1] + width]
    grey = truth[reach].mean(axis=2, dtype=np.float64)
    inside = tops - tops[0], lefts - lefts[0], height, width
    variance = _window_mean(grey**2, *inside) - _window_mean(grey, *inside) ** 2
    row, column = np.unravel_index(int(np.argmax(variance)), variance.shape)
    return _Window(int(tops[row]), int(lefts[column]), height, width)


def _lens_starts(pixels: int, size: int, pixels_per_lens: float) -> np.ndarray:
    """First pixels of the lenses, the array centred on the panel, in its central half."""
    lenses = int(pixels / pixels_per_lens)
    first = (pixels - lenses * pixels_per_lens) / 2
    starts = np.round(first + np.arange(lenses) * pixels_per_lens).astype(int)
    central = (starts >= pixels / 4) & (starts + size <= 3 * pixels / 4)
    if central.any():
        return starts[central]
    return np.array([(pixels - size) // 2])


def _window_mean(
    values: np.ndarray, tops: np.ndarray, lefts: np.ndarray, height: int, width: int
) -> np.ndarray:
    """(tops, lefts) means over windows, from a summed-area table."""
    table = np.pad(values.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    below, above = table[tops + height], table[tops]
    total = below[:, lefts + width] - below[:, lefts] - above[:, lefts + width] + above[:, lefts]
    return np.asarray(total / (height * width))


# -- input, checks, timings, words ---------------------------------------------------------------


def _rgbd(data: Mapping[str, Any], pictures: _Pictures) -> str:
    rgbd = part(data, "rgbd")
    covered = rgbd.get("covered_fraction")
    share = f"{number(100 * covered, 1)}{_NBSP}%" if is_number(covered) else MISSING
    low, high = _mm(rgbd.get("depth_min_mm")), _mm(rgbd.get("depth_max_mm"))
    words = (
        f"What the algorithms were given: {_short(rgbd.get('columns'))} × "
        f"{_short(rgbd.get('rows'))} pixels of {_mm(rgbd.get('pixel_mm'))}, {share} of them "
        f"covered by the relic, depths from {low} to {high}."
    )
    colour, depth = (pictures.read(f"rgbd_{kind}.png") for kind in ("color", "depth"))
    shots = [
        _shot(pictures, colour, "RGB-D input, colour", "Colour"),
        _shot(pictures, depth, "RGB-D input, depth", "Depth"),
    ]
    return _section(
        "rgbd",
        "RGB-D input",
        element("p", text(words), class_="lead"),
        element("div", *shots, class_="two"),
    )


def _checks(data: Mapping[str, Any], pictures: _Pictures) -> str:  # noqa: ARG001
    checks = [part(check) for check in items(part(data, "verdict"), "checks")]
    if not checks:
        return _section("checks", "Checks", element("p", "Nothing was checked."))
    rows = [_check_row(check) for check in sorted(checks, key=check_passed)]
    heads = ["Check", "Value", "Relation", "Limit", "Verdict"]
    caption = "Every check, the failed ones first"
    return _section("checks", "Checks", _table(caption, heads, rows, "checks"))


def _check_row(check: Mapping[str, Any]) -> list[str]:
    word = "passed" if check_passed(check) else "failed"
    name = text(check.get("name", MISSING))
    if check.get("detail"):
        name += element("small", text(check["detail"]))
    badge = element("span", _mark(word), word, class_=f"badge {word}")
    value, limit = check_value(check), check_value(check, "limit")
    return [name, text(value), text(relation(check)), text(limit), badge]


def _timings(data: Mapping[str, Any], pictures: _Pictures) -> str:  # noqa: ARG001
    timings = part(data, "timings")
    known = [float(v) for v in timings.values() if is_number(v) and math.isfinite(v)]
    longest = max(known, default=0.0)
    rows = [
        [text(stage.replace("_", " ")), text(number(seconds, 2)), _bar(seconds, longest)]
        for stage, seconds in timings.items()
    ]
    heads = ["Stage", "Seconds", "Share of the longest"]
    return _section("timings", "Timings", _table("Wall-clock time", heads, rows, "timings"))


def _bar(seconds: object, longest: float) -> str:
    share = 100 * seconds / longest if is_number(seconds) and longest > 0 else 0.0
    width = min(max(share, 0.0), 100.0)
    return element("div", class_="bar", style=f"width:{width:.1f}%", aria_hidden="true")


def _warnings(data: Mapping[str, Any], pictures: _Pictures) -> str:  # noqa: ARG001
    warnings = [element("li", text(w)) for w in items(data, "warnings")]
    body = element("ul", *warnings, class_="cautions") if warnings else element("p", "None.")
    return _section("warnings", "Warnings", body)


def _reproduce(data: Mapping[str, Any], pictures: _Pictures) -> str:  # noqa: ARG001
    command = element("pre", element("code", text(data.get("command", MISSING))), tabindex=0)
    versions = {"inim": data.get("inim_version"), **part(data, "versions")}
    scene = {**part(data, "scene"), **part(data, "scene", "fit")}
    tables = [
        _facts("Settings", part(data, "settings")),
        _facts("Scene", {k: v for k, v in scene.items() if k != "fit"}),
        _facts("Versions", versions),
        _facts("Backend", part(data, "backend")),
    ]
    return _section(
        "reproduce", "How to reproduce", command, element("div", *tables, class_="columns")
    )


def _facts(caption: str, values: Mapping[str, Any]) -> str:
    rows = [
        [text(key), element("span", _lines(value), class_="value")] for key, value in values.items()
    ]
    return _table(caption, ["Key", "Value"], rows, "facts")


def _lines(value: object) -> str:
    """A value in full, so that it can be given again; a matrix as one line per row."""
    if isinstance(value, (list, tuple)):
        rows = [v if isinstance(v, (list, tuple)) else [v] for v in value]
        return "<br>".join(text("  ".join(_short(v) for v in row)) for row in rows)
    return text(MISSING if value is None else value)


_MEANINGS = (
    (
        "Ground truth",
        "The scene itself, rendered from the viewpoint; and the elemental images "
        "path traced through the centre of every lens.",
    ),
    (
        "Ceiling",
        "The view through this display's lenses of the ground-truth elemental images: "
        "the best any algorithm can score on it. What lies between ceiling and scene is lost by "
        "the display, not by an algorithm.",
    ),
    (
        "SSIM to ceiling",
        "Likeness of a reconstructed view and the ceiling, from structure: 1 is "
        "identical. It isolates what the algorithm lost, and is the main score.",
    ),
    (
        "SSIM to scene",
        "Likeness of a reconstructed view and the scene: what the viewer gets, "
        "losses of the display included.",
    ),
    (
        "Noise floor",
        "The score of the ground truth against itself with another seed. Differences "
        "between algorithms that are smaller than its distance from 1 mean nothing.",
    ),
    (
        "SSIM on the relic",
        "SSIM to the scene, averaged over the relic's pixels only: an empty "
        "background is easy and flatters every algorithm.",
    ),
    ("PSNR", "Peak signal-to-noise ratio in dB, higher is better; ∞ for identical pictures."),
    ("FLIP", "Difference an eye would notice when flipping between two pictures: 0 is none."),
    ("Holes", "Share of the panel's pixels for which an algorithm found no colour."),
    (
        "Across scenes",
        "Scores are never compared across scenes: a smooth relic scores higher "
        "than a detailed one with the same algorithm. Compare algorithms within this page.",
    ),
)


def _meaning(data: Mapping[str, Any], pictures: _Pictures) -> str:  # noqa: ARG001
    entries = [element("div", element("dt", text(k)), element("dd", text(v))) for k, v in _MEANINGS]
    return _section("meaning", "What the numbers mean", element("dl", *entries, class_="meanings"))


_SECTIONS: tuple[Callable[[Mapping[str, Any], _Pictures], str], ...] = (
    _overview,
    _display,
    _views,
    _elemental_images,
    _rgbd,
    _checks,
    _timings,
    _warnings,
    _reproduce,
    _meaning,
)
_CONTENTS = (
    ("overview", "Scores"),
    ("display", "Display"),
    ("views", "Views"),
    ("eia", "Elemental images"),
    ("rgbd", "RGB-D input"),
    ("checks", "Checks"),
    ("timings", "Timings"),
    ("warnings", "Warnings"),
    ("reproduce", "How to reproduce"),
    ("meaning", "What the numbers mean"),
)
