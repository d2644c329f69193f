"""Inspection of a display: `inspect.json`."""

from __future__ import annotations

from typing import Annotated

from inim.display import Display
from inim.documents.document import Document, Part, doc
from inim.documents.parts import DepthRange, InimVersion, Viewpoints


class TracedModel(Part):
    """Lens model that spots and light are traced with."""

    name: Annotated[str, doc("Its name.")]
    reason: Annotated[
        str | None,
        doc("Reason why it replaces the thick lens; null: it was requested, or is the thick lens."),
    ]


class Size(Part):
    """Sizes of array and panel."""

    width_mm: Annotated[float, doc("Width of the lens array, mm.")]
    height_mm: Annotated[float, doc("Height of the lens array, mm.")]
    lens_columns: Annotated[int, doc("Lenses across.")]
    lens_rows: Annotated[int, doc("Lenses down.")]
    panel_columns: Annotated[int, doc("Panel pixels across.")]
    panel_rows: Annotated[int, doc("Panel pixels down.")]
    panel_width_mm: Annotated[float, doc("Width of the panel, mm.")]
    panel_height_mm: Annotated[float, doc("Height of the panel, mm.")]
    pixels_per_lens: Annotated[
        float,
        doc("Panel pixels per elemental image along one axis; rarely an integer in hardware."),
    ]
    has_whole_pixels_per_lens: Annotated[
        bool, doc("True if elemental images are an integer number of pixels wide and high.")
    ]


class DepthFigures(DepthRange):
    """Depths at which the display is sharp."""

    mode: Annotated[
        str,
        doc(
            "Location of pictures: `real` in front of the lens array, `virtual` behind it; "
            "`focused` has no central depth plane."
        ),
    ]
    depth_range_is_stated: Annotated[
        bool, doc("True if the settings give the range; otherwise the formula does.")
    ]
    voxel_at_depth_min_mm: Annotated[float, doc("Width of a pixel's beam at the far end, mm.")]
    voxel_at_depth_max_mm: Annotated[float, doc("Width of a pixel's beam at the near end, mm.")]


class PixelChoice(Part):
    """Benefits and costs of one number of pixels per lens."""

    pixels_per_lens: Annotated[float, doc("Pixels per lens along one axis.")]
    pixel_pitch_mm: Annotated[float, doc("Panel pixel, mm.")]
    views_across: Annotated[float, doc("Directions that each lens can show, across.")]
    views_down: Annotated[float, doc("Directions that each lens can show, down.")]
    angular_step_deg: Annotated[
        float, doc("Angle between adjacent directions, at the axis, degrees.")
    ]
    depth_span_mm: Annotated[
        float | None,
        doc("Displayable depth by the formula, mm; null: infinite, of a focused display."),
    ]
    panel_columns: Annotated[int, doc("Panel pixels across.")]
    panel_rows: Annotated[int, doc("Panel pixels down.")]
    frame_mb: Annotated[
        float, doc("Size of one picture for the panel, 3 bytes per pixel, 10^6 bytes.")
    ]


class ViewingLimits(Part):
    """Limits of the eye position."""

    half_angle_deg: Annotated[
        float, doc("Half of the angle within which no view repeats, degrees.")
    ]
    nearest_distance_mm: Annotated[
        float | None,
        doc(
            "Distance from which an eye on the axis sees no flipped view, mm; null: there is none."
        ),
    ]
    distance_mm: Annotated[float, doc("The viewing distance, mm.")]
    flip_limit_x_mm: Annotated[
        float,
        doc(
            "Largest sideways offset of an eye at that distance at which no lens shows a flipped "
            "view, mm; negative: none."
        ),
    ]
    flip_limit_y_mm: Annotated[
        float, doc("Largest offset up or down at that distance, mm; negative: none.")
    ]
    flip_limit_x_deg: Annotated[float, doc("The limit to the side, degrees.")]
    flip_limit_y_deg: Annotated[float, doc("The limit up or down, degrees.")]
    zone_is_empty: Annotated[bool, doc("True if even an eye on the axis sees flipped views.")]
    zone_distance_and_limit_x_mm: Annotated[
        list[tuple[float, float]], doc("The viewing zone seen from above.")
    ]
    viewpoints: Annotated[Viewpoints, doc("The default eye positions at that distance.")]


class VoxelWidths(Part):
    """Voxel width against depth, lists of one length."""

    depth_mm: Annotated[list[float], doc("Depths, z in mm, over twice the depth range.")]
    footprint_mm: Annotated[
        list[float], doc("A panel pixel projected through the lens centre onto each depth, mm.")
    ]
    blur_mm: Annotated[list[float], doc("Blur caused by the lens's aperture at each depth, mm.")]
    width_mm: Annotated[list[float], doc("Sum of footprint and blur, mm.")]


class SpotFigures(Part):
    """Image of a point on the panel, through one lens."""

    field_angle_deg: Annotated[
        float, doc("Angle between the axis and the line to the point, degrees.")
    ]
    colour: Annotated[
        str,
        doc("`red`, `green` or `blue`; `all`: the material refracts all colours equally."),
    ]
    rms_radius_um: Annotated[
        float | None,
        doc(
            "Root mean square distance from the centre, weighted by light, µm; null: no ray "
            "reaches the panel."
        ),
    ]
    rms_radius_px: Annotated[float | None, doc("The same in panel pixels, or null.")]
    centre_x_mm: Annotated[
        float | None, doc("Centre of gravity on the panel, to the right, mm, or null.")
    ]
    centre_y_mm: Annotated[
        float | None, doc("Centre of gravity on the panel, upwards, mm, or null.")
    ]
    lost_share: Annotated[
        float,
        doc("Share of the aperture's rays that are blocked or bent by a neighbour, 0 to 1."),
    ]


class LightRecord(Part):
    """Shares of the rays; those up to `reflected_share` add up to 1."""

    own_share: Annotated[float, doc("From the lens's own elemental image, 0 to 1.")]
    neighbour_share: Annotated[float, doc("From under a neighbouring lens, 0 to 1.")]
    past_lenses_share: Annotated[
        float, doc("Through the bare sheet between lenses, without refraction, 0 to 1.")
    ]
    beside_panel_share: Annotated[float, doc("From outside all elemental images, 0 to 1.")]
    dark_between_share: Annotated[float, doc("Lost at the paint between lenses, 0 to 1.")]
    blocked_share: Annotated[float, doc("Vignetted or totally reflected, 0 to 1.")]
    reflected_share: Annotated[float, doc("Lost at the lens's two faces, 0 to 1.")]
    crosstalk_share: Annotated[
        float | None,
        doc(
            "Share of the arriving light that comes from under a neighbour, 0 to 1; null: no light"
            " arrives."
        ),
    ]
    astray_share: Annotated[
        float, doc("All light except the lens's own and the reflected light, 0 to 1.")
    ]


class CrosstalkGrid(Part):
    """Crosstalk over eye positions at the viewing distance."""

    eye_x_mm: Annotated[list[float], doc("Positions of the eye to the right, mm.")]
    eye_y_mm: Annotated[list[float], doc("Positions of the eye upwards, mm.")]
    share: Annotated[list[list[float | None]], doc("A row for each of `eye_y_mm`.")]


class InspectDocument(Document, tag="inim.inspect/2"):
    """Inspection of a display.

    `inspect.json` of `inim inspect DISPLAY -o OUT`, and the output of `--json`: the properties of a
    display, before anything is rendered. null stands for infinity, and for unknown values.
    """

    inim_version: InimVersion
    source: Annotated[str, doc("The scene file or preset.")]
    display: Annotated[Display, doc("Parameters of the display, as designed.")]
    lens_model: TracedModel
    size: Size
    depth: DepthFigures
    pixels_per_lens: Annotated[
        list[PixelChoice],
        doc("Benefits and costs of half as many pixels per lens, of these, and of twice as many."),
    ]
    viewing: ViewingLimits
    voxel: VoxelWidths
    spots: Annotated[
        list[SpotFigures], doc("Images of a point through one lens, by field angle and colour.")
    ]
    light: Annotated[
        dict[str, LightRecord],
        doc(
            "Destinations of the rays from an eye to the lens array, by the name of the eye "
            "position."
        ),
    ]
    crosstalk: CrosstalkGrid
    misalignment: Annotated[
        list[str],
        doc("Sentences on the misalignment of the array."),
    ]
    warnings: Annotated[list[str], doc("Warnings and hints, one text each.")]
