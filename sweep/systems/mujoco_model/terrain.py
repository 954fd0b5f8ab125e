"""Terrain of user models: a height field that replaces the model's floor.

Models of a batch share one structure. Each distinct terrain of a batch is a height field of its model, and each rollout
collides with one of them.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch

from sweep.contract.system import Parameter
from sweep.core.errors import InputError, require_choice
from sweep.core.parameters import convert_and_check_value, setting
from sweep.systems.mujoco_model import fields
from sweep.systems.mujoco_model.terrain_heights import (
    KIND,
    KINDS,
    NUMBERS,
    compute_heights,
    height_upper_bound,
)

PREFIX = "model.terrain."  # of paths
FIELD = "terrain"  # name of height fields, before their number
RANGE = 16.0  # m, of heights above and below the floor: a power of two, so that heights are stored exactly
GROUND_BELOW = 0.1  # m of ground below the lowest place, in pictures
MOST_POINTS = 4_000_000  # of a height field
Shape = mujoco.mjtGeom
SIZES: Mapping[str, Parameter] = {  # that fix the number of points; another value compiles another model
    "length": setting(10.0, "m", above=0, at_most=1000),  # along the x axis
    "width": setting(10.0, "m", above=0, at_most=1000),  # along the y axis
    "resolution": setting(0.05, "m", above=0, at_most=10),  # largest distance between neighbouring points
}
PARAMETERS = {"kind": KIND, **SIZES, **NUMBERS}


@dataclass(frozen=True)
class TerrainConfig:
    """Settings of a terrain from `model.terrain`: kind, image file, and number of height-field points."""

    geom: str = ""  # the plane that it replaces; "" for the only one
    file: str = ""  # image of the kind `image`
    kind: str = "flat"
    length: float = SIZES["length"].default
    width: float = SIZES["width"].default
    resolution: float = SIZES["resolution"].default

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Number of height-field points along the y and the x axis."""
        rows, columns = (max(2, round(side / self.resolution + 0.499999) + 1) for side in (self.width, self.length))
        return rows, columns

    @property
    def grid_coordinates(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates (m) of the height-field points along x (columns,) and y (rows,), from the terrain's middle."""
        rows, columns = self.grid_shape
        return tuple(np.linspace(-side / 2, side / 2, n) for side, n in ((self.length, columns), (self.width, rows)))  # pyright: ignore[reportReturnType]

    def values_by_path(self) -> dict[str, Any]:
        """Return the terrain settings that affect results (kind, image, grid), by path."""
        return {f"{PREFIX}{name}": getattr(self, name) for name in ("kind", "geom", *SIZES)} | (
            {f"{PREFIX}file": self.file} if self.file else {}
        )

    def replace_settings(self, values: Mapping[str, Any]) -> "TerrainConfig":
        """Return these terrain settings with other kind, image or grid, by path; other parameters are ignored."""
        own = {path.removeprefix(PREFIX): value for path, value in values.items() if path.startswith(PREFIX)}
        return replace(self, **{key: value for key, value in own.items() if key in (*SIZES, "kind", "file")})


def is_terrain_path(path: str) -> bool:
    """Return whether a path names a parameter of the terrain."""
    return path.startswith(PREFIX)


def parse_terrain(given: Any) -> tuple[TerrainConfig | None, dict[str, Any]]:
    """Return the settings of a terrain, and its numeric parameters by path; None if none is configured.

    Raises:
        InputError: A key or a value is not allowed.
    """
    if given is None:
        return None, {}
    if not isinstance(given, Mapping):
        raise InputError(f"model.terrain = {given!r:.80} is not allowed: keys and values, such as {{kind: rough}}")
    allowed = ("kind", "geom", "file", *SIZES, *NUMBERS)
    for key in given:
        require_choice(str(key), allowed, f"{PREFIX}{key}")
    for key in ("geom", "file"):
        if not isinstance(given.get(key, ""), str):
            raise InputError(f"{PREFIX}{key} = {given[key]!r} is not allowed: a name")
    structure = {"kind": KIND, **SIZES}
    told = {
        key: convert_and_check_value(one, given[key], PREFIX + key) for key, one in structure.items() if key in given
    }
    shape = TerrainConfig(**told, **{key: given[key] for key in ("geom", "file") if key in given})
    numbers = {
        key: convert_and_check_value(one, given.get(key, one.default), PREFIX + key) for key, one in NUMBERS.items()
    }
    check_terrain_size(shape)
    return shape, {PREFIX + key: value for key, value in numbers.items()}


def check_terrain_size(shape: TerrainConfig) -> None:
    """Raise `InputError` if a terrain has too many points, or its image file is not given."""
    rows, columns = shape.grid_shape
    if rows * columns > MOST_POINTS:
        raise InputError(
            f"model.terrain.resolution = {shape.resolution:g} is not allowed: {rows} x {columns} points, and at most "
            f"{MOST_POINTS} are"
        )
    if shape.kind == "image" and not shape.file:
        raise InputError("model.terrain.kind = image needs model.terrain.file, a PNG file")


def check_height_range(shape: TerrainConfig, numbers: Mapping[str, Any]) -> None:
    """Raise `InputError` if terrain heights exceed what a height field of the model can hold.

    Args:
        shape: The structure.
        numbers: Numbers of the terrain by name, which may be arrays of one shape.
    """
    most = float(np.max(height_upper_bound(shape.kind, numbers, float(np.hypot(shape.length, shape.width)) / 2)))
    if most >= RANGE:
        raise InputError(
            f"model.terrain.kind = {shape.kind} is not allowed with heights up to {most:.4g} m: below {RANGE:g} m"
        )


def replace_floor(spec: mujoco.MjSpec, shape: TerrainConfig, count: int) -> None:
    """Replace the floor of a model's source by a level height field.

    Args:
        spec: The source, which changes.
        shape: The structure of the terrain.
        count: Number of height fields for the rollouts of a batch; the geom has the first of them.

    Raises:
        InputError: The model has no plane that the terrain could replace, or several.
    """
    if any(one.name == f"{FIELD}0" for one in spec.hfields):
        raise InputError(f"model.terrain is not allowed: the model has a height field called {FIELD}0")
    geom = _find_floor(spec, shape)
    rows, columns = shape.grid_shape
    for k in range(count):
        made = spec.add_hfield(name=f"{FIELD}{k}", nrow=rows, ncol=columns)
        made.size = [shape.length / 2, shape.width / 2, RANGE, RANGE]
        made.userdata = np.zeros(rows * columns)
    geom.type, geom.hfieldname, geom.size = Shape.mjGEOM_HFIELD, f"{FIELD}0", np.zeros(3)


def _find_floor(spec: mujoco.MjSpec, shape: TerrainConfig) -> mujoco.MjsGeom:
    """Return the plane that a terrain replaces. Raises `InputError`."""
    planes = [one for one in spec.worldbody.geoms if one.type == Shape.mjGEOM_PLANE]
    if shape.geom:
        require_choice(shape.geom, [one.name for one in planes], f"model.terrain.geom: {shape.geom}")
        planes = [one for one in planes if one.name == shape.geom]
    if not planes:
        raise InputError(
            "model.terrain is not allowed: the model has no plane as its floor, which the terrain replaces"
        )
    if len(planes) > 1:
        names = ", ".join(one.name or "one without a name" for one in planes)
        raise InputError(f"model.terrain needs the key geom: the model has {len(planes)} planes ({names})")
    return planes[0]


def require_level_floor(model: mujoco.MjModel) -> None:
    """Raise `InputError` if the floor plane that a terrain replaces is rotated."""
    geom = find_terrain_geom(model)
    if not np.array_equal(model.geom_quat[geom], [1, 0, 0, 0]):
        name = model.geom(geom).name
        raise InputError(f"model.terrain is not allowed: the plane {name} is turned; it has to be level and along x")


def find_terrain_geom(model: mujoco.MjModel) -> int:
    """Return the index of the terrain's geom in a model."""
    field = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_HFIELD, f"{FIELD}0")
    (geom,) = np.flatnonzero((model.geom_type == int(Shape.mjGEOM_HFIELD)) & (model.geom_dataid == field))
    return int(geom)


def height_data_slice(model: mujoco.MjModel, number: int = 0) -> slice:
    """Return where the heights of one terrain are in a model's `hfield_data`, as a slice.

    Args:
        model: The model.
        number: Number of the terrain, of those that the model has.
    """
    field = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_HFIELD, f"{FIELD}{number}")
    start = int(model.hfield_adr[field])
    return slice(start, start + int(model.hfield_nrow[field] * model.hfield_ncol[field]))


class TerrainBatch(NamedTuple):
    """Terrains of the n rollouts in a batch, of which k are distinct."""

    shape: TerrainConfig
    heights: np.ndarray  # (k, rows, columns) m, in the axes of the terrain's geom
    which: np.ndarray  # (n,) index of each rollout's terrain
    varies: bool  # whether numbers of the terrain are axes

    @property
    def height_data(self) -> np.ndarray:
        """Heights of the k terrains (k, rows * columns) in MuJoCo's storage order, in units of `RANGE`."""
        return (self.heights / RANGE).astype(np.float32).reshape(len(self.heights), -1)

    def metric_inputs(self, place: np.ndarray) -> dict[str, np.ndarray]:
        """Return the terrain heights and positions from which metrics compute the ground under the robot, by name.

        Args:
            place: Places (n, 3) of the terrain's geom in the world, m.

        Returns:
            `ground` (k, rows, columns), heights in m; `ground_index` (n,), which of these fields each rollout has; and
            `ground_place` (n, 3). Where numbers of the terrain are axes, each rollout has a field, so that shapes are
            those of every batch.
        """
        if self.varies:
            return {
                "ground": self.heights[self.which],
                "ground_index": np.arange(len(self.which)),
                "ground_place": place,
            }
        return {"ground": self.heights, "ground_index": self.which, "ground_place": place}

    def fill_height_fields(self, model: mujoco.MjModel) -> mujoco.MjModel:
        """Return a copy of a model whose k height fields have the heights of the k terrains."""
        model = copy(model)
        for k, values in enumerate(self.height_data):
            model.hfield_data[height_data_slice(model, k)] = values
        return model

    def assign_height_fields(self, batch: Batch) -> None:
        """Let every rollout of a batch collide with its own height field."""
        batch.expand("geom_dataid")[:, find_terrain_geom(batch.model)] += self.which

    def make_render_model(self, batch: Batch, slot: int, alone: mujoco.MjModel) -> mujoco.MjModel:
        """Return the model of one rollout with the heights of its own terrain only, for drawing.

        Args:
            batch: The batch.
            slot: Index of the rollout.
            alone: A model of the same structure with one height field.
        """
        alone, full, heights = copy(alone), batch.get_model(slot), self.heights[self.which[slot]]
        for name in MODEL_FIELDS:
            if not name.startswith("name") and name != "geom_dataid":
                owner, attribute = fields.locate_field(alone, name)
                if isinstance(getattr(owner, attribute), np.ndarray):
                    getattr(owner, attribute)[...] = fields.field_values(full, name)
        alone.hfield_data[height_data_slice(alone)] = heights.ravel() / RANGE
        alone.hfield_size[alone.geom_dataid[find_terrain_geom(alone)], 3] = GROUND_BELOW - min(
            heights.min(), 0.0
        )  # else it is drawn as a deep block
        return alone


def make_terrain_batch(
    shape: TerrainConfig, numbers: Mapping[str, np.ndarray], varies: bool, image: np.ndarray | None = None
) -> TerrainBatch:
    """Compute the terrain heights of n rollouts from the parameters of their terrains.

    Args:
        shape: The structure.
        numbers: Numbers (n,) by name.
        varies: Whether numbers of the terrain are axes.
        image: Brightness of the pixels of the kind `image`.
    """
    uses = KINDS[shape.kind].uses
    rows = np.stack([np.asarray(numbers[name], float) for name in NUMBERS], axis=1)
    rows[:, [k for k, name in enumerate(NUMBERS) if name not in uses]] = 0  # which count for nothing
    distinct, which = np.unique(rows, axis=0, return_inverse=True)
    x, y = shape.grid_coordinates
    made = [compute_heights(shape.kind, dict(zip(NUMBERS, row, strict=True)), x, y, image) for row in distinct]
    return TerrainBatch(shape, np.stack(made), which.reshape(-1), varies)


def lift_above_terrain(ground: TerrainBatch, batch: Batch, qpos: np.ndarray) -> None:
    """Shift free bodies vertically so that they start as far above the terrain as above the level floor.

    Each tree that begins with a free joint keeps, between its geoms and the highest ground under them, the least
    distance that its lowest geom has from the level floor.

    Args:
        ground: The terrains of the rollouts.
        batch: The batch at its start, whose positions of geoms are worked out.
        qpos: Positions (n, nq) of the rollouts, which change.
    """
    model, floor = batch.model, find_terrain_geom(batch.model)
    free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
    places, turns = batch.bind("geom_xpos"), batch.bind("geom_xmat").reshape(batch.nsim, -1, 3, 3)
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    for joint in np.flatnonzero(free):
        mine = model.body_rootid[model.geom_bodyid] == model.jnt_bodyid[joint]
        geoms = np.flatnonzero(mine & collides if (mine & collides).any() else mine)
        if not len(geoms):
            continue
        halves = np.stack([geom_half_extents(model, int(geom), turns[:, geom]) for geom in geoms], axis=1)
        centres = places[:, geoms] + _box_centres(model, geoms, turns) - places[:, [floor]]
        below = centres[..., 2] - halves[..., 2]
        highest = _highest_ground(ground, centres[..., :2], halves[..., :2])
        lift = (highest - below).max(axis=1) + below.min(axis=1)
        qpos[:, model.jnt_qposadr[joint] + 2] += np.where(np.isfinite(lift), lift, 0.0)


def _box_centres(model: mujoco.MjModel, geoms: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return from the places of geoms to the middles of their bounding boxes, (n, g, 3), in world axes."""
    return np.einsum("ngij,gj->ngi", turns[:, geoms], model.geom_aabb[geoms, :3])


def geom_half_extents(model: mujoco.MjModel, geom: int, turns: np.ndarray) -> np.ndarray:
    """Return half the extents (m) of a geom along world axes; meshes count by their bounding boxes.

    Args:
        model: The model.
        geom: Index of the geom.
        turns: Rotations (n, 3, 3) of the geom.

    Returns:
        Half extents (n, 3) in m.
    """
    size, along = model.geom_size[geom], np.abs(turns[..., 2])
    match Shape(model.geom_type[geom]):
        case Shape.mjGEOM_SPHERE:
            return np.full(turns.shape[:2], size[0])
        case Shape.mjGEOM_CAPSULE:
            return size[0] + size[1] * along
        case Shape.mjGEOM_CYLINDER:
            return size[1] * along + size[0] * np.sqrt(np.maximum(1 - along**2, 0))
        case Shape.mjGEOM_ELLIPSOID:
            return np.sqrt(((turns * size) ** 2).sum(axis=2))
        case _:
            return np.abs(turns) @ model.geom_aabb[geom, 3:]


def _highest_ground(ground: TerrainBatch, centres: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """Return the greatest height (n, g) under rectangles of places (n, g, 2), all in m; -inf beside the terrain."""
    found = np.full(centres.shape[:2], -np.inf)
    spans = []
    for k, axis in enumerate(ground.shape.grid_coordinates):
        step, last = axis[1] - axis[0], len(axis) - 1
        low, high = ((centres[..., k] + sign * halves[..., k] - axis[0]) / step for sign in (-1, 1))
        spans.append((np.floor(low + 1e-9), np.ceil(high - 1e-9), last))
    (left, right, columns), (near, far, rows) = spans
    inside = (right >= 0) & (left <= columns) & (far >= 0) & (near <= rows)
    which, geom = np.nonzero(inside & np.isfinite(left + right + near + far))
    if not len(which):
        return found
    first_row, first_column = (np.maximum(one[which, geom], 0).astype(int) for one in (near, left))
    last_row, last_column = (
        np.minimum(one[which, geom], last).astype(int) for one, last in ((far, rows), (right, columns))
    )
    sizes = np.stack([last_row - first_row, last_column - first_column], axis=1)
    for size in np.unique(sizes, axis=0):  # rectangles of one size at a time: there are few sizes
        alike = (sizes == size).all(axis=1)
        row = first_row[alike, None, None] + np.arange(size[0] + 1)[:, None]
        column = first_column[alike, None, None] + np.arange(size[1] + 1)
        heights = ground.heights[ground.which[which[alike], None, None], row, column]
        found[which[alike], geom[alike]] = heights.max(axis=(1, 2))
    return found
