"""Opening a scene in Mitsuba and fitting its relic into a display's depth range.

Meshes reach Mitsuba as arrays, by the shape plugin `inim_mesh`. Bit for bit, its positions and
normals are those of Mitsuba's shape `ply`.
"""

import itertools
import math
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from inim.display import Display
from inim.image.files.picture import check_volume, read_texture
from inim.render import splats
from inim.render.culling import BoundsGrid, world_points
from inim.render.library import mi
from inim.render.meshes.mesh import read_shapes
from inim.render.meshes.splat_ply import SPLAT_SHAPES, check_splats
from inim.render.meshes.triangle_mesh import Mesh, read_bytes
from inim.render.rays import NonSeparableRays, SeparableRays
from inim.render.scene_files.file import SceneFile
from inim.render.subject import find_subject
from inim.render.trace import FilmCamera
from inim.system.errors import FileError, SceneError
from inim.system.files import utf8_name
from inim.system.process.machine import memory_limit_bytes
from inim.system.process.observer import Observer

# Keep the relic this share of the range clear of both ends: a depth equal to z_min in float64
# falls below it in float32, and whole surfaces become holes.
_DEPTH_MARGIN = 0.01
# Beyond it products of three lengths overflow in the renderer's float32; below its inverse they
# vanish.
_FARTHEST = 1e12
# Thinner than this against its width, a relic is a plate and goes to the central depth plane.
_FLAT = 1e-6
# Integrators that return radiance ray by ray, and know `hide_emitters`. Others trace from the
# lights, or return depth or moments, which would be scored as colour.
_INTEGRATORS = ("path", "direct", "volpath", "volpathmis", splats.INTEGRATOR)
# Those that hold another, and return its radiance with something more.
_WRAPPERS = ("aov", "moment")
# What some plugins need so much that Mitsuba dies without a word where it is missing.
_NEEDS = {"bitmap": "filename", "blendbsdf": "weight"}
# A splat's shell, attributes and place in Embree's tree take.
_SPLAT_BYTES = 2500
_DEFAULT_INTEGRATOR = {"type": "path", "max_depth": 8, "hide_emitters": True}


@dataclass(frozen=True)
class Fit:
    """The affine map between display and world (DESIGN: uniform in x and y, its own scale in z).

    * `display_from_world`, `world_from_display`: (4, 4) float64.
    * `scale_xy`, `scale_z`: display millimetres per world unit.
    """

    display_from_world: np.ndarray
    world_from_display: np.ndarray
    scale_xy: float
    scale_z: float
    depth_mm: float


@dataclass(frozen=True)
class FittedScene:
    """A loaded scene with its place in the display.

    * `start_mm`: plane just in front of the relic, on which camera rays start.
    * `shapes`: shapes of the relic.
    * `left_out`: names of other shapes that are not lights; the loaded scene has none of them.
    * `imports`: lines on the files of the shapes, as they were read.
    * `warnings`: sentences on shapes that are not shown as one might expect.
    """

    scene: Any
    integrator: Any
    fit: Fit
    start_mm: float
    shapes: int
    left_out: tuple[str, ...] = ()
    imports: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def camera(self, rays: SeparableRays | NonSeparableRays) -> FilmCamera:
        """Camera in the scene, from rays in the display frame."""
        return FilmCamera(rays, self.fit.world_from_display)

    @property
    def shows_splats(self) -> bool:
        """True if the scene consists of splats only."""
        return splats.shows_splats(self.integrator)

    @cached_property
    def splats(self) -> int:
        """Number of splats."""
        if not self.shows_splats:
            return 0
        return sum(splats.splat_count(shape) for shape in self.scene.shapes())

    @cached_property
    def bounds(self) -> BoundsGrid:
        """Coarse grid of the space occupied by its shapes."""
        return BoundsGrid.of(self.scene, self.fit.display_from_world, self.start_mm)


def open_scene(
    file: SceneFile,
    display: Display,
    fit_share: float,
    observer: Observer | None = None,
    turn_deg: float | None = None,
    relic: str = "",
) -> FittedScene:
    """Load a scanned scene, check its meshes, fit it.

    With `turn_deg`, turn the relic about its upward axis, and fit the cylinder of all turns.
    `relic` names its shapes (`inim.render.subject`).

    Raises `FileError`: a mesh is damaged, Mitsuba rejects a file, or a file was saved since its
    scan. Raises `SceneError`: a scene without visible shapes, or without a named one.
    """
    try:
        decoded = _read_files(file)
        started = time.perf_counter()
        scene, mirrored = _load_scene(file, decoded)
        shapes = [shape for shape in scene.shapes() if not shape.is_emitter()]
        if not shapes:
            raise SceneError(f"{file.path}: the scene has no shape except lights; add one")
        left_out, warnings = find_subject(file, scene, shapes, relic)
        ids = frozenset(shape.id() for shape in left_out)
        points = np.concatenate([world_points(s) for s in shapes if s.id() not in ids])
        axes, turn = _display_axes(scene), None
        if turn_deg is not None:
            points, turn = _turntable(points, axes, turn_deg)
        if turn is not None or ids:
            scene, mirrored = _load_scene(file, decoded, turn, ids)
        if observer:
            observer.record_rendering(time.perf_counter() - started)
    finally:  # what is wrong with a file that is just being saved is no matter
        file.check_unchanged()
    integrator = scene.integrator() or mi.load_dict(_DEFAULT_INTEGRATOR)
    _check_splats(file, scene, integrator)
    if turn_deg is not None and splats.shows_splats(integrator):
        raise SceneError(
            f"{file.path}: inim.turn_deg: the colours of splats do not turn with them; use a mesh"
        )
    _check_media(file, scene)
    fit = fit_to_display(points, axes, display, fit_share, str(file.path))
    low, high = display.depth_range_mm
    start, count = high + _DEPTH_MARGIN * (high - low), len(shapes) - len(left_out)
    names = tuple(shape.id() for shape in left_out)
    imports = _import_lines(decoded)
    if file.common is not None:
        imports = (*imports, f"files may lie in {file.common}")
    warnings = (*warnings, *mirrored)
    return FittedScene(scene, integrator, fit, start, count, names, imports, warnings)


def _import_lines(decoded: Mapping[Path, Any]) -> tuple[str, ...]:
    """Content of each mesh and picture."""
    lines = []
    for path, content in decoded.items():
        if isinstance(content, tuple):
            triangles = sum(len(mesh.faces) for mesh in content)
            lines.append(f"{path.name}: {triangles} triangles")
        elif content is not None:
            lines.append(f"{path.name}: {content.shape[1]} x {content.shape[0]} pixels")
    return tuple(lines)


def _read_files(file: SceneFile) -> dict[Path, Any]:
    """Meshes and pixels of the files that Mitsuba does not read itself; the others are checked."""
    decoded: dict[Path, Any] = {}
    count = 0
    for plugin, path in file.meshes:
        if plugin in SPLAT_SHAPES:
            count += check_splats(path, read_bytes(path))
        elif path not in decoded:
            decoded[path] = read_shapes(path, plugin)
    needed, limit = count * _SPLAT_BYTES, memory_limit_bytes()
    if limit and needed > limit:  # without room for them, the renderer dies
        raise SceneError(
            f"{file.path}: {count} splats take {needed / 2**30:.1f} GiB of the "
            f"{limit / 2**30:.1f} GiB there are; keep fewer with `inim new-scene --crop`"
        )
    for path in file.pictures:
        decoded[path] = read_texture(path)
    for path in file.volumes:
        check_volume(path)
    return decoded


def _turntable(
    points: np.ndarray, axes: np.ndarray, turn_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box around all turns of a relic, (2, 3) world points, and one turn, (4, 4).

    The axis points up through the middle of the relic's bounding box. The turn is
    counter-clockwise, seen from above. Points and axes are those of `fit_to_display`.
    """
    placed = points @ axes.T
    low, high = placed.min(axis=0), placed.max(axis=0)
    middle = (low + high) / 2
    radius = np.hypot(*(placed - middle)[:, [0, 2]].T).max()
    low[[0, 2]], high[[0, 2]] = middle[[0, 2]] - radius, middle[[0, 2]] + radius
    angle = math.radians(turn_deg % 360)  # a whole turn is none, bit for bit
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.eye(4)
    turn[:3, :3] = axes.T @ [[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]] @ axes
    turn[:3, 3] = middle @ axes - turn[:3, :3] @ (middle @ axes)
    return np.stack([low, high]) @ axes, turn


def _load_scene(
    file: SceneFile,
    decoded: Mapping[Path, Any],
    turn: np.ndarray | None = None,
    left_out: Collection[str] = (),
) -> tuple[Any, tuple[str, ...]]:
    """Load a scene without the shapes of some ids; turn the others, but not lights, (4, 4).

    Also returns warnings of mirrored shapes.
    """
    config = mi.parser.ParserConfig(mi.variant())
    # Merged shapes come in the order of a hash table of pointers, and lights with them: equal seeds
    # would light a scene otherwise from one process to the next.
    config.merge_meshes = False
    try:
        state = _parse_scene(config, file)
        # Our rays are structured (through vertices, edges and centres): Embree's default mode
        # lets some of them slip between triangles.
        state.root.props["embree_use_robust_intersections"] = True
        _name_shapes(state)
        _remove_shapes(state, left_out)
        mirrored = _mirrored(file, state)
        if turn is not None:
            for node in _children(state, state.root, mi.ObjectType.Shape):
                _turn_shape(state, node, turn)
        for node in state.nodes:
            _pass_file(file, node.props, decoded)
        for node in _children(state, state.root, mi.ObjectType.Integrator):
            _unwrap_integrator(file, state, node)
            node.props["hide_emitters"] = True
        mi.parser.transform_all(config, state)
        loaded = mi.parser.instantiate(config, state)
    except (FileError, SceneError):
        raise
    except Exception as error:  # Mitsuba raises bare RuntimeErrors for everything
        text = str(error).strip()
        if "Traceback (most recent call last)" in text:  # of a plugin in Python
            text = text.splitlines()[-1]
        cause = " ".join(text.split())
        raise FileError(f"{file.path}: the renderer refuses it: {cause[:400]}") from error
    return loaded[0] if isinstance(loaded, list) else loaded, mirrored


def _parse_scene(config: Any, file: SceneFile) -> Any:
    """Parse a scene's XML, with its included files and spectra.

    The folders of the scene are searched only here, where no plugin is loaded.
    """
    own = mi.file_resolver()
    # The file that was scanned: a link's own folder may hold other parts of the same names.
    path = Path(utf8_name(file.path.resolve()))
    resolver = mi.FileResolver(own)
    resolver.prepend(str(path.parent))
    mi.set_file_resolver(resolver)
    try:
        return mi.parser.parse_file(config, str(path), **file.parameters)
    finally:
        mi.set_file_resolver(own)


def _children(state: Any, node: Any, kind: mi.ObjectType) -> list[Any]:
    """Nodes of a kind directly below a node."""
    reference = mi.Properties.Type.ResolvedReference
    names = [name for name in node.props if node.props.type(name) == reference]
    nodes = [state.nodes[node.props[name].index()] for name in names]
    return [node for node in nodes if node.type == kind]


# Materials that are black from behind.
_ONE_SIDED = ("diffuse", "conductor", "roughconductor", "plastic", "roughplastic", "principled",
              "principledthin", "pplastic")  # fmt: skip


def _mirrored(file: SceneFile, state: Any) -> tuple[str, ...]:
    """Warnings of meshes that their transform turns inside out, with one-sided materials."""
    texts = []
    for node in _children(state, state.root, mi.ObjectType.Shape):
        properties = node.props
        if properties.plugin_name() not in _FLIPS_BY_DEFAULT or "to_world" not in properties:
            continue
        matrix = np.asarray(properties["to_world"].matrix, np.float64).reshape(4, 4)
        materials = _children(state, node, mi.ObjectType.BSDF)
        plugin = materials[0].props.plugin_name() if materials else "diffuse"
        if np.linalg.det(matrix[:3, :3]) < 0 and plugin in _ONE_SIDED:
            texts.append(
                f"{file.path}: to_world mirrors the shape {properties.id()}, whose material "
                f"{plugin} is black from behind; wrap it in a bsdf of type twosided"
            )
    return tuple(texts)


def _name_shapes(state: Any) -> None:
    """Give shapes without an id the name of their file, or of their type, and a number."""
    nodes = _children(state, state.root, mi.ObjectType.Shape)
    names = {node.props.id() for node in nodes}
    for node in nodes:
        if node.props.id():
            continue
        properties = node.props
        has_file = "filename" in properties
        path = properties["filename"].replace("\\", "/") if has_file else ""
        base = Path(path).stem or properties.plugin_name()
        name = next(n for k in itertools.count(1)
                    if (n := base if k == 1 else f"{base}-{k}") not in names)  # fmt: skip
        names.add(name)
        properties.set_id(name)


def _remove_shapes(state: Any, ids: Collection[str]) -> None:
    """Remove the shapes of some ids from a scene."""
    reference = mi.Properties.Type.ResolvedReference
    for name in [name for name in state.root.props if state.root.props.type(name) == reference]:
        node = state.nodes[state.root.props[name].index()]
        if node.type == mi.ObjectType.Shape and node.props.id() in ids:
            del state.root.props[name]


def _turn_shape(state: Any, node: Any, turn: np.ndarray) -> None:
    """Turn a shape unless it is a light, or a group, whose instances turn instead."""
    if _children(state, node, mi.ObjectType.Emitter) or node.props.plugin_name() == "shapegroup":
        return
    own = node.props.get("to_world", mi.ScalarAffineTransform4d())
    node.props["to_world"] = mi.ScalarAffineTransform4d(turn) @ own


def _unwrap_integrator(file: SceneFile, state: Any, node: Any) -> None:
    """Replace an integrator that wraps others by the first of them."""
    while node.props.plugin_name() in _WRAPPERS and (
        inner := _children(state, node, mi.ObjectType.Integrator)
    ):
        node.props = inner[0].props
    name = node.props.plugin_name()
    if name not in _INTEGRATORS:
        raise SceneError(
            f"{file.path}: integrator {name!r} gives no radiance ray by ray; use 'path' or "
            "'volpath'"
        )


def _pass_file(file: SceneFile, properties: Any, decoded: Mapping[Path, Any]) -> None:
    """Pass decoded files as arrays; let other plugins open the scanned file itself."""
    plugin = properties.plugin_name()
    need = _NEEDS.get(plugin)
    if need and need not in properties:
        raise SceneError(f"{file.path}: a {plugin!r} has no {need!r}; give it one")
    if "filename" not in properties:
        return
    name = properties["filename"]
    if name not in file.named:
        raise SceneError(f"{file.path}: {name!r} was not found when the scene was scanned")
    path = file.named[name]
    content = decoded.get(path)
    if isinstance(content, tuple):
        number = properties.get("shape_index", 0)
        if not 0 <= number < len(content):
            raise SceneError(
                f"{file.path}: shape_index {number} of {name!r}, whose meshes are 0 to "
                f"{len(content) - 1}"
            )
        use_mesh(properties, content[number])
    elif content is not None:
        del properties["filename"]
        properties["bitmap"] = mi.Bitmap(content)
    else:
        properties["filename"] = str(path)


def _check_splats(file: SceneFile, scene: Any, integrator: Any) -> None:
    """Refuse splats among other shapes or under another integrator: they would not be seen."""
    are_splats = [shape.is_ellipsoids() for shape in scene.shapes()]
    if splats.shows_splats(integrator) and not all(are_splats):
        raise SceneError(
            f"{file.path}: integrator {splats.INTEGRATOR!r} shows splats only; remove all other "
            "shapes and the lights, because splats emit light"
        )
    if any(are_splats) and not splats.shows_splats(integrator):
        raise SceneError(
            f"{file.path}: splats emit light, which this integrator does not show; use "
            f"{splats.INTEGRATOR!r}"
        )


def _check_media(file: SceneFile, scene: Any) -> None:
    """Refuse participating media: a depth camera would take their boundaries for surfaces."""
    for shape in scene.shapes():
        if shape.is_medium_transition():
            raise SceneError(
                f"{file.path}: shape {shape.id()!r} bounds a participating medium, such as fog or "
                "smoke, which has no depth; remove the medium, or give the shape a surface"
            )


def _display_axes(scene: Any) -> np.ndarray:
    """Rows: the display's x, y, z axes in the world, as the scene's first camera looks at it."""
    if not scene.sensors():
        return np.eye(3)
    matrix = np.asarray(scene.sensors()[0].world_transform().matrix, np.float64).reshape(4, 4)
    towards_viewer = -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    right = np.cross(matrix[:3, 1], towards_viewer)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(towards_viewer, right), towards_viewer])


def fit_to_display(
    points: np.ndarray, axes: np.ndarray, display: Display, fit_share: float, source: str
) -> Fit:
    """Map a relic into the display: as large as its share of the array, as deep as the range.

    * `points`, (n, 3) float64: world points that span the relic.
    * `axes`, (3, 3) float64: rows are the display's axes in the world.
    * `fit_share`: share of the array's width or height that the relic fills.

    Raises `SceneError`: points that are not finite or span no area.
    """
    with np.errstate(invalid="ignore"):
        turned = points @ axes.T
    if not np.isfinite(turned).all():
        raise SceneError(
            f"{source}: the scene's shapes have no finite bounding box; check its transforms"
        )
    low, high = turned.min(axis=0), turned.max(axis=0)
    if (farthest := float(np.abs(turned).max())) > _FARTHEST:
        raise SceneError(
            f"{source}: the scene's shapes reach {farthest:.3g} from the origin, and at most "
            f"{_FARTHEST:g} are allowed; check its transforms"
        )
    extent = high - low
    if max(extent[:2]) < 1 / _FARTHEST:
        raise SceneError(
            f"{source}: the scene's shapes have no width or height to fit; check its transforms"
        )
    with np.errstate(divide="ignore"):
        scale = fit_share * min(display.width_mm / extent[0], display.height_mm / extent[1])
    z_min, z_max = display.depth_range_mm
    margin = _DEPTH_MARGIN * (z_max - z_min)
    flat = extent[2] <= _FLAT * max(extent[:2])
    scale_z = scale if flat else (z_max - z_min - 2 * margin) / extent[2]
    centre_z = (z_min + z_max) / 2
    if flat and z_min <= display.central_depth_mm <= z_max:
        centre_z = display.central_depth_mm
    forward = np.eye(4)
    forward[:3, :3] = np.diag([scale, scale, scale_z]) @ axes
    forward[:3, 3] = np.array([0, 0, centre_z]) - forward[:3, :3] @ (axes.T @ ((low + high) / 2))
    depth_mm = float(scale_z * extent[2])
    return Fit(forward, np.linalg.inv(forward), float(scale), float(scale_z), depth_mm)


MESH_PLUGIN = "inim_mesh"
_ARRAYS = ("faces", "vertex_positions", "vertex_normals", "vertex_texcoords")
_ATTRIBUTE = "attribute."
# Mitsuba's readers differ in which way v grows.
_FLIPS_BY_DEFAULT = {"ply": False, "obj": True, "serialized": False}


def register() -> None:
    """Register the plugin in the active variant."""
    mi.register_shape(MESH_PLUGIN, _build_mesh)


def use_mesh(properties: Any, mesh: Mesh) -> None:
    """Let a `ply`, `obj` or `serialized` shape have a mesh instead of the file that it names.

    * `properties`: of the shape; changed in place.
    * `mesh`: with indices in range.
    """
    flipped = _FLIPS_BY_DEFAULT[properties.plugin_name()]
    if "flip_tex_coords" in properties:
        flipped = properties["flip_tex_coords"]
        del properties["flip_tex_coords"]
    for name in ("filename", "shape_index"):
        if name in properties:
            del properties[name]
    properties.set_plugin_name(MESH_PLUGIN)
    transform = properties.get("to_world", mi.ScalarAffineTransform4d())
    matrix, normal_matrix = (
        mi.Matrix4f(np.asarray(m, np.float32).reshape(4, 4))
        for m in (transform.matrix, transform.inverse_transpose)
    )
    to_world = mi.AffineTransform4f(matrix, normal_matrix)
    arrays = {
        "faces": mesh.faces.astype(np.uint32),
        "vertex_positions": np.array(to_world @ mi.Point3f(mesh.vertices.T)).T,
    }
    if mesh.normals is not None and not properties.get("face_normals", False):
        x, y, z = np.array(to_world @ mi.Normal3f(mesh.normals.T))
        # In the order of Mitsuba's own sum.
        scale = np.float32(1) / np.sqrt(x * x + z * z + y * y)
        arrays["vertex_normals"] = np.stack([x * scale, y * scale, z * scale], axis=1)
    if mesh.uv is not None:
        u, v = mesh.uv.T
        arrays["vertex_texcoords"] = np.stack([u, 1 - v if flipped else v], axis=1)
    colors = {} if mesh.color is None else {"vertex_color": mesh.color}
    for name, values in {**mesh.attributes, **colors}.items():
        arrays[_ATTRIBUTE + name] = values
    for name, values in arrays.items():
        kind = mi.TensorXu if name == "faces" else mi.TensorXf
        properties[name] = kind(np.ascontiguousarray(values))


def _build_mesh(properties: Any) -> Any:
    """Build the shape; Mitsuba computes normals that are missing."""
    arrays = {
        name: properties[name]
        for name in list(properties.keys())
        if name in _ARRAYS or name.startswith(_ATTRIBUTE)
    }
    shape = mi.Mesh(
        properties.id(),
        arrays["vertex_positions"].shape[0],
        arrays["faces"].shape[0],
        properties,
        has_vertex_normals=not properties.get("face_normals", False),
        has_vertex_texcoords="vertex_texcoords" in arrays,
    )
    parameters = mi.traverse(shape)
    for name, values in arrays.items():
        if name.startswith(_ATTRIBUTE):
            shape.add_attribute(name.removeprefix(_ATTRIBUTE), values.shape[1], values.array)
        else:
            parameters[name] = values.array
    parameters.update()
    return shape
