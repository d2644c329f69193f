"""Display section: description, drawing and parameters; and the RGB-D input of the algorithms."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import msgspec

from inim.display import Display
from inim.display.declaration import setting_text
from inim.display.panel import panel_words
from inim.image.files.image import read_rgbd
from inim.report.diagram import depth_profile, describe_plan, describe_profile, plan_view
from inim.report.document import ReportDocument, Translucency
from inim.report.images import ReportImages
from inim.report.labels import mm, per_cent, short
from inim.report.page import element, figure, folded, lead, plot, svg_source, text, text_table, void
from inim.report.sections import ReportSection
from inim.scores.document_parts import DerivedDisplay
from inim.system.document import document_schema
from inim.system.errors import InimError

# The renderer works in single precision, and so does the depth picture.
_SLACK = 1e-5


def display(data: ReportDocument, images: ReportImages) -> str:
    """The section on the display."""
    derived = data.display.derived
    parameters = data.display.parameters
    own = {f.name: getattr(parameters, f.name) for f in fields(parameters)}
    defaults = {f.name: f.default for f in fields(parameters)}
    stated = {
        name: setting_text(value) if isinstance(value, tuple) else value
        for name, value in own.items()
        if value != defaults[name]
    }
    parts = document_schema(ReportDocument, "")["$defs"]
    tables = [
        _quantities("Design; other parameters have their defaults", parts["Display"], stated),
        _quantities("Derived", parts["DerivedDisplay"], msgspec.structs.asdict(derived)),
    ]
    words = _display_words(data)
    if derived.depth_range_is_cut:
        words += _caution(
            "Depth range cut.",
            "The formula's depth range reaches into the lens array and was cut there. More pixels "
            "per lens would avoid this.",
        )
    if data.misalign.strip():
        words += _caution(
            "Misaligned.",
            f"The array is misaligned by {data.misalign}. The ground-truth EIA and the views use "
            "the misaligned display; the algorithms use the design.",
        )
    every = folded(element("h3", "Parameters"), element("div", *tables, class_="columns"))
    return words + _plan_view(data, images) + every


def _plan_view(data: ReportDocument, images: ReportImages) -> str:
    display, eyes = data.display.parameters, data.viewpoints
    places = [(eye.name, eye.position_mm) for eye in eyes]
    drawing = images.drawing(
        "plan view", lambda: plan_view(display, eyes), display=display, eyes=places
    )
    return plot(drawing, describe_plan(display, eyes))


def _display_words(data: ReportDocument) -> str:
    """Meaning of the figures, in sentences."""
    parameters, derived = data.display.parameters, data.display.derived
    lenses = parameters.layout.lens_counts("×")
    size = f"{short(derived.width_mm)} × {mm(derived.height_mm)}"
    pixels = f"{derived.eia_columns} × {derived.eia_rows}"
    words = (
        f"{lenses} lenses of {mm(parameters.pitch_mm)} make a display of {size} with {pixels} "
        f"pixels, {short(derived.pixels_per_lens)} across each lens. "
        f"{_focus_words(derived)} Each lens covers viewing angles within "
        f"±{short(derived.viewing_half_angle_deg)}°. {_distance_words(derived)}"
    )
    return lead(words + _relic_depth_words(data) + _panel_words(parameters))


def _panel_words(display: Display) -> str:
    """Light of a panel that is not ideal, and the views that have it; empty for an ideal one."""
    words = panel_words(display)
    if not words:
        return ""
    return (
        f" {words[0]} The reference views include it, too; the views of the scene do not. So "
        "scores to the scene contain the panel's loss, and scores to the reference do not."
    )


def _relic_depth_words(data: ReportDocument) -> str:
    """Depth of the relic on the display; empty if unknown."""
    if data.scene is None or data.scene.fit.depth_mm is None:
        return ""
    fit = data.scene.fit
    return (
        f" The relic is {mm(fit.depth_mm)} deep here, {per_cent(fit.depth_share, 0)} of its own "
        "depth at this width. Less depth is an easier task: compare scores of displays at equal "
        "depth."
    )


def _distance_words(derived: DerivedDisplay) -> str:
    nearest = derived.nearest_viewing_distance_mm
    if nearest is None:
        return "An eye on the axis sees flipped views at every distance."
    return f"At {mm(nearest)} or farther, an eye on the axis sees no flipped view."


def _focus_words(derived: DerivedDisplay) -> str:
    relic = f"the depth range is {mm(derived.depth_min_mm)} to {mm(derived.depth_max_mm)}."
    centre = derived.central_depth_mm
    if centre is None:
        return f"It is focused (gap = focal length), so it has no central depth plane; {relic}"
    side = "in front of" if centre > 0 else "behind"
    return f"It is sharpest {mm(abs(centre))} {side} the lens array; {relic}"


def _caution(title: str, words: str) -> str:
    return element("p", element("b", title), " ", text(words), class_="caution")


def _quantities(caption: str, part: Mapping[str, Any], values: Mapping[str, Any]) -> str:
    """Table of values with their descriptions in a part of the schema of `report.json`."""
    rows = []
    for name, value in values.items():
        meaning = part["properties"][name]["description"].replace("null:", "none:")
        rows.append([name, "none" if value is None else short(value), meaning])
    return text_table(caption, ["Quantity", "Value", "Meaning"], rows, "quantities")


def rgbd_input(data: ReportDocument, images: ReportImages) -> str:
    """The section on the RGB-D input."""
    colour, depth = (images.read(f"rgbd_{kind}.png") for kind in ("color", "depth"))
    rgbd, (far, near) = data.rgbd, map(mm, data.display.parameters.depth_range_mm)
    words = (
        f"Input of the algorithms: {rgbd.columns} × {rgbd.rows} pixels of "
        f"{mm(rgbd.pixel_mm)}. The relic covers {per_cent(rgbd.covered_fraction, 1)} of them, at "
        f"depths from {mm(rgbd.depth_min_mm)} to {mm(rgbd.depth_max_mm)}."
    )
    remark = f"lighter is nearer to the viewer, from {far} to {near}; black is background"
    shots = [
        figure(images.embed(colour, "RGB-D input, colour"), "Colour"),
        figure(images.embed(depth, "RGB-D input, depth"), "Depth", remark),
    ]
    if drawing := _profile(data, images):
        shots.append(figure(drawing, "Depth along the array", _profile_words(data)))
    return lead(words) + element("div", *shots, class_="three")


def _profile(data: ReportDocument, images: ReportImages) -> str:
    """Depth profile; empty without a readable ``rgbd.exr`` that shows something."""
    try:
        rgbd = read_rgbd(images.folder / "rgbd.exr")
    except InimError:
        return ""
    if not rgbd.covered.any():
        return ""
    display = data.display.parameters
    parts = {"display": display, "depth": rgbd.depth_mm, "covered": rgbd.covered}
    drawing = images.drawing("depth profile", lambda: depth_profile(rgbd, display), **parts)
    return void("img", src=svg_source(drawing), alt=describe_profile(rgbd), class_="drawing")


def _profile_words(data: ReportDocument) -> str:
    """Position of the relic relative to the depth range, in sentences."""
    low, high = data.display.parameters.depth_range_mm
    first, last = data.rgbd.depth_min_mm, data.rgbd.depth_max_mm
    if first is None or last is None:
        return "seen from above"
    slack = _SLACK * max(abs(low), abs(high))
    inside = low - slack <= first and last <= high + slack
    place = "is inside" if inside else "extends beyond"
    return f"seen from above, all rows together: the relic {place} the display's depth range"


def splats(data: ReportDocument, _images: ReportImages) -> str:
    """The section on splats; empty for other scenes."""
    translucency = None if data.scene is None else data.scene.splats
    if translucency is None:
        return ""
    shares = translucency.coverage_histogram
    rows = [
        (f"{k / len(shares):.0%} to {(k + 1) / len(shares):.0%}", per_cent(share, 1))
        for k, share in enumerate(shares)
    ]
    return lead(_words(data, translucency)) + text_table(
        "Coverage: share of the light that a pixel's ray loses", ["Coverage", "Pixels"], rows
    )


def _words(data: ReportDocument, translucency: Translucency) -> str:
    """Meaning of the figures, in sentences."""
    words = (
        f"{short(translucency.count)} splats touch {per_cent(translucency.touched_fraction, 1)} "
        f"of the picture's pixels, and take {per_cent(translucency.mean_coverage, 1)} of their "
        "light on average. A depth map has one depth per pixel: here, the depth at which half of "
        f"the light is lost. {per_cent(translucency.without_depth_fraction, 1)} of these pixels "
        "never lose half, so the algorithms do not receive them. "
        f"{per_cent(translucency.never_opaque_fraction, 1)} never lose nine tenths; the "
        "background visible through them moves differently. "
    )
    if translucency.depth_spread_mm is not None:
        low, high = data.display.parameters.depth_range_mm
        words += (
            "In the other pixels, the depths at which one tenth and nine tenths of the light are "
            f"lost differ by {mm(translucency.depth_spread_mm)} (median; in one of twenty, by more "
            f"than {mm(translucency.depth_spread_p95_mm)}). The depth range is {mm(high - low)}."
        )
    return words


SECTIONS = (
    ReportSection(40, "display", "Display", display, is_folded=True),
    ReportSection(90, "rgbd", "RGB-D input", rgbd_input, is_folded=True),
    ReportSection(45, "splats", "Translucency", splats),
)
