"""Inspection of a display: `inspect.json`."""

from inim.display import Display
from inim.scores.document_parts import DepthRange, InimVersion, Viewpoints
from inim.system.document import Document, Part


class TracedModel(Part):
    """Lens model that spots and light are traced with."""

    name: str  #: Its name.
    #: Reason why it replaces the thick lens; null: it was requested, or is the thick lens.
    reason: str | None


class Size(Part):
    """Sizes of array and panel."""

    width_mm: float  #: Width of the lens array, mm.
    height_mm: float  #: Height of the lens array, mm.
    lens_columns: int  #: Lenses across.
    lens_rows: int  #: Lenses down.
    panel_columns: int  #: Panel pixels across.
    panel_rows: int  #: Panel pixels down.
    panel_width_mm: float  #: Width of the panel, mm.
    panel_height_mm: float  #: Height of the panel, mm.
    #: Panel pixels per elemental image along one axis; rarely an integer in hardware.
    pixels_per_lens: float
    #: True if elemental images are an integer number of pixels wide and high.
    has_whole_pixels_per_lens: bool


class DepthFigures(DepthRange):
    """Depths at which the display is sharp."""

    #: Location of pictures: `real` in front of the lens array, `virtual` behind it; `focused` has
    #: no central depth plane.
    mode: str
    depth_range_is_stated: bool  #: True if the settings give the range; otherwise the formula does.
    voxel_at_depth_min_mm: float  #: Width of a pixel's beam at the far end, mm.
    voxel_at_depth_max_mm: float  #: Width of a pixel's beam at the near end, mm.
    #: Distance from the array beyond which the light of one direction is wider than a lens, mm.
    blur_onset_mm: float
    #: Geometrical length of the gap less its air-equivalent length, mm.
    layers_excess_mm: float
    #: Central depth plane if the gap were a measured length, with the display's layers in it or, if
    #: it has none, 0.5 mm of cover glass, z in mm; null: none.
    central_depth_if_measured_mm: float | None


class PixelChoice(Part):
    """Benefits and costs of one number of pixels per lens."""

    pixels_per_lens: float  #: Pixels per lens along one axis.
    pixel_pitch_mm: float  #: Panel pixel, mm.
    views_across: float  #: Directions that each lens can show, across.
    views_down: float  #: Directions that each lens can show, down.
    angular_step_deg: float  #: Angle between adjacent directions, at the axis, degrees.
    #: Displayable depth by the formula, mm; null: infinite, of a focused display.
    depth_span_mm: float | None
    panel_columns: int  #: Panel pixels across.
    panel_rows: int  #: Panel pixels down.
    frame_mb: float  #: Size of one picture for the panel, 3 bytes per pixel, 10^6 bytes.


class ViewingLimits(Part):
    """Limits of the eye position."""

    half_angle_deg: float  #: Half of the angle within which no view repeats, degrees.
    #: Distance from which an eye on the axis sees no flipped view, mm; null: there is none.
    nearest_distance_mm: float | None
    distance_mm: float  #: The viewing distance, mm.
    #: Largest sideways offset of an eye at that distance at which no lens shows a flipped view, mm;
    #: negative: none.
    flip_limit_x_mm: float
    #: Largest offset up or down at that distance, mm; negative: none; null: no limit.
    flip_limit_y_mm: float | None
    flip_limit_x_deg: float  #: The limit to the side, degrees.
    flip_limit_y_deg: float  #: The limit up or down, degrees.
    zone_is_empty: bool  #: True if even an eye on the axis sees flipped views.
    zone_distance_and_limit_x_mm: list[tuple[float, float]]  #: The viewing zone seen from above.
    viewpoints: Viewpoints  #: The default eye positions at that distance.


class VoxelWidths(Part):
    """Voxel width against depth, lists of one length."""

    depth_mm: list[float]  #: Depths, z in mm, over twice the depth range.
    #: A panel pixel projected through the lens centre onto each depth, mm.
    footprint_mm: list[float]
    blur_mm: list[float]  #: Blur caused by the lens's aperture at each depth, mm.
    width_mm: list[float]  #: Sum of footprint and blur, mm.


class SpotFigures(Part):
    """Image of a point on the panel, through one lens."""

    field_angle_deg: float  #: Angle between the axis and the line to the point, degrees.
    colour: str  #: `red`, `green` or `blue`; `all`: the material refracts all colours equally.
    #: Root mean square distance from the centre, weighted by light, µm; null: no ray reaches the
    #: panel.
    rms_radius_um: float | None
    rms_radius_px: float | None  #: The same in panel pixels, or null.
    centre_x_mm: float | None  #: Centre of gravity on the panel, to the right, mm, or null.
    centre_y_mm: float | None  #: Centre of gravity on the panel, upwards, mm, or null.
    #: Share of the aperture's rays that are blocked or bent by a neighbour, 0 to 1.
    lost_share: float


class LightRecord(Part):
    """Shares of the rays; those up to `reflected_share` add up to 1."""

    own_share: float  #: From the lens's own elemental image, 0 to 1.
    neighbour_share: float  #: From under a neighbouring lens, 0 to 1.
    past_lenses_share: float  #: Through the bare sheet between lenses, without refraction, 0 to 1.
    beside_panel_share: float  #: From outside all elemental images, 0 to 1.
    dark_between_share: float  #: Lost at the paint between lenses, 0 to 1.
    blocked_share: float  #: Vignetted or totally reflected, 0 to 1.
    reflected_share: float  #: Lost at the lens's two faces, 0 to 1.
    #: Share of the arriving light that comes from under a neighbour, 0 to 1; null: no light
    #: arrives.
    crosstalk_share: float | None
    astray_share: float  #: All light except the lens's own and the reflected light, 0 to 1.


class CrosstalkGrid(Part):
    """Crosstalk over eye positions at the viewing distance."""

    eye_x_mm: list[float]  #: Positions of the eye to the right, mm.
    eye_y_mm: list[float]  #: Positions of the eye upwards, mm.
    share: list[list[float | None]]  #: A row for each of `eye_y_mm`.


class Suitability(Part):
    """Figures to choose a display by, for a viewer at the viewing distance."""

    lens_columns: int  #: Lenses across.
    lens_rows: int  #: Lenses down.
    #: Width of the finest detail at the worst depth of the depth range, mm: voxel of a panel pixel
    #: that the lens blurs by twice the RMS radius of its spot.
    detail_mm: float
    details_across: float  #: Such details over the width of the array.
    depth_mm: float  #: Length of the depth range, mm.
    #: Length of the depths at which details are at most twice as wide as at the sharpest depth, mm.
    sharp_depth_mm: float
    zone_width_mm: float  #: Width of the viewing zone at the viewing distance, mm; 0: none.
    zone_height_mm: float | None  #: Its height, mm; null: unlimited, without vertical parallax.
    #: True if two eyes 63 mm apart fit into the viewing zone without its border, in which lenses
    #: show part of a neighbour's picture.
    two_eyes_fit: bool
    #: Largest movement of the head from the middle to either side with both eyes there, mm; null:
    #: two eyes do not fit.
    head_movement_mm: float | None
    #: Luminance of a white picture on the axis, as a share of the panel's own.
    brightness: float
    #: Accuracy to which the alignment must be known, by parameter of `inim.misalign`: the error
    #: that shifts the observed panel point by a tenth of a pixel.
    accuracy: dict[str, float]


class InspectDocument(Document, tag="inim.inspect/3"):
    """Inspection of a display.

    `inspect.json` of `inim inspect DISPLAY -o OUT`, and the output of `--json`: the properties of a
    display, before anything is rendered. null stands for infinity, and for unknown values.
    """

    inim_version: InimVersion
    source: str  #: The scene file or preset.
    display: Display  #: Parameters of the display, as designed.
    lens_model: TracedModel
    size: Size
    depth: DepthFigures
    #: Benefits and costs of half as many pixels per lens, of these, and of twice as many.
    pixels_per_lens: list[PixelChoice]
    viewing: ViewingLimits
    suitability: Suitability
    voxel: VoxelWidths
    #: Diffraction by a lens's aperture: wavelength x gap / (aperture x panel pixel). No lens model
    #: includes it.
    diffraction_px: float
    spots: list[SpotFigures]  #: Images of a point through one lens, by field angle and colour.
    #: Destinations of the rays from an eye to the lens array, by the name of the eye position.
    light: dict[str, LightRecord]
    crosstalk: CrosstalkGrid
    #: Of a lenticular: shares of the light from the eye's own view, its neighbours, their
    #: neighbours, and farther views, 0 to 1, by the name of the eye position; `pixels_per_lens` has
    #: the number of views. Empty lists for other displays.
    views: dict[str, list[float]]
    misalignment: list[str]  #: Sentences on the misalignment of the array.
    warnings: list[str]  #: Warnings and hints, one text each.
