"""Parameter paths such as `model.geom.floor.friction.slide`, and the numbers of a MuJoCo model that they name.

Only numbers that leave the model's layout unchanged can vary. `mj_setConst` recomputes what follows from them, except
for `stat.meaninertia`, which scales the solver's tolerance. What MuJoCo's compiler derives from sizes and positions of
geoms (inertia, bounding volumes) is taken from models that are compiled for each value.
"""

import dataclasses
import fnmatch
import re
from collections.abc import Callable, Mapping
from copy import copy
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch

from sweep.contract.system import Parameter
from sweep.core.errors import InputError, format_name_suggestion, require_choice
from sweep.core.parameters import choice, count, quantity, setting

XYZ = ("x", "y", "z")
SOLREF_COMPONENTS, SOLIMP_COMPONENTS = ("timeconst", "dampratio"), ("dmin", "dmax", "width", "midpoint", "power")
FRICTION_COMPONENTS = ("slide", "spin", "roll")
OPTION_KIND, PATH_ROOT = "option", "model"


class FieldSpec(NamedTuple):
    """Unit, bounds and component names of a MuJoCo model field that a study may vary."""

    unit: str = ""
    at_least: float = -np.inf
    component_names: tuple[str, ...] = ()  # of its components
    needs_compiler: bool = False  # whether MuJoCo's compiler makes more of it
    field: str = ""  # of MjModel
    is_factor: bool = False  # whether values multiply what the model has


class NumberLocation(NamedTuple):
    """Where a number is in a MuJoCo model: field name, index in the flattened field, and sign."""

    field: str
    flat_index: int
    sign: float = 1.0


class NamedElement(NamedTuple):
    """Element of a MuJoCo model, such as a geom, and its attribute, as a parameter path names them."""

    kind: str
    number: int  # as MuJoCo counts things of the kind; of options, which are one thing, 0
    name: str
    attribute: str  # the rest of the path


RANGE_COMPONENTS = ("low", "high")
# what may vary of each kind, in MJCF's words; with the field of MjModel where that is not what fields begin with and it
VARIABLE_WORDS = {
    "body": ("body_", "mass inertia pos ipos gravcomp"),
    "geom": ("geom_", "friction margin gap adhesion surfacevel fluid solmix solref solimp size pos"),
    "joint": (
        "jnt_",
        "stiffness stiffnesspoly margin pos range springref:qpos_spring actuatorfrcrange:jnt_actfrcrange "
        "damping:dof_damping armature:dof_armature frictionloss:dof_frictionloss dampingpoly:dof_dampingpoly "
        "solreflimit:jnt_solref solimplimit:jnt_solimp solreffriction:dof_solref solimpfriction:dof_solimp",
    ),
    "actuator": (
        "actuator_",
        "gear gainprm biasprm dynprm damping dampingpoly armature forcerange ctrlrange actrange cranklength",
    ),
    "site": ("site_", "pos size"),
    "sensor": ("sensor_", "cutoff"),
    "tendon": (
        "tendon_",
        "stiffness damping armature frictionloss stiffnesspoly dampingpoly margin range "
        "springlength:tendon_lengthspring actuatorfrcrange:tendon_actfrcrange solreflimit:tendon_solref_lim "
        "solimplimit:tendon_solimp_lim solreffriction:tendon_solref_fri solimpfriction:tendon_solimp_fri",
    ),
    "pair": ("pair_", "friction margin gap adhesion solref solreffriction solimp"),
    "equality": ("eq_", "data solref solimp"),
    OPTION_KIND: (
        "opt.",
        "gravity wind magnetic density viscosity impratio tolerance ls_tolerance noslip_tolerance ccd_tolerance",
    ),
}
# what these words mean, of any kind or of one; of the others nothing is known
WORD_MEANINGS = {
    "mass": FieldSpec("kg", 1e-9),  # inertia in proportion: another density
    "inertia": FieldSpec("kg m^2", 1e-12, XYZ),
    "pos ipos": FieldSpec("m", component_names=XYZ),  # the latter of the centre of mass
    "geom.pos": FieldSpec("m", component_names=XYZ, needs_compiler=True),
    "geom.size": FieldSpec("m", 1e-6, needs_compiler=True),  # by the names of its shape: `SIZE_MEANINGS`
    "site.size": FieldSpec("m", 1e-6),
    "friction": FieldSpec("", 0.0, FRICTION_COMPONENTS),
    "pair.friction": FieldSpec("", 0.0, ("slide", "slide2", "spin", "roll", "roll2")),
    "geom.margin pair.margin gap": FieldSpec("m"),
    "cranklength": FieldSpec("m", 1e-9),
    "stiffness damping armature frictionloss fluid solmix cutoff": FieldSpec("", 0.0),
    "solref solreflimit solreffriction": FieldSpec(component_names=SOLREF_COMPONENTS),
    "solimp solimplimit solimpfriction": FieldSpec(component_names=SOLIMP_COMPONENTS),
    "range actuatorfrcrange forcerange ctrlrange actrange": FieldSpec(component_names=RANGE_COMPONENTS),
    "tendon.range springlength": FieldSpec("m", component_names=RANGE_COMPONENTS),
    "gravity": FieldSpec("m/s^2", component_names=XYZ),
    "wind": FieldSpec("m/s", component_names=XYZ),
    "magnetic": FieldSpec(component_names=XYZ),
    "density": FieldSpec("kg/m^3", 0.0),
    "viscosity": FieldSpec("Pa s", 0.0),
    "impratio": FieldSpec("", 1e-9),
    "tolerance ls_tolerance noslip_tolerance ccd_tolerance": FieldSpec("", 0.0),
}
MEANING_BY_WORD = {word: numbers for words, numbers in WORD_MEANINGS.items() for word in words.split()}
VARIABLE_NUMBERS = {
    kind: {
        name: MEANING_BY_WORD.get(f"{kind}.{name}", MEANING_BY_WORD.get(name, FieldSpec()))._replace(
            field=field or begins + name
        )
        for name, _, field in (word.partition(":") for word in words.split())
    }
    for kind, (begins, words) in VARIABLE_WORDS.items()
}
OPTION_NUMBERS = VARIABLE_NUMBERS.pop(OPTION_KIND)
OBJECT_TYPES = {
    name: getattr(mujoco.mjtObj, f"mjOBJ_{name.upper()}") for name in VARIABLE_NUMBERS
}  # as MuJoCo numbers them
GeomType = mujoco.mjtGeom
SIZE_MEANINGS = {  # what numbers of a geom's size are, by its shape
    GeomType.mjGEOM_SPHERE: ("radius",),
    **dict.fromkeys((GeomType.mjGEOM_CAPSULE, GeomType.mjGEOM_CYLINDER), ("radius", "half_length")),
    **dict.fromkeys((GeomType.mjGEOM_BOX, GeomType.mjGEOM_ELLIPSOID), XYZ),
}
ITERATION_MINIMA = {"iterations": 1, "ls_iterations": 1, "noslip_iterations": 0}  # with the least of them
TIMESTEP = "timestep"
ENUM_OPTIONS = {  # the members of MuJoCo's enumerations in their order, by MJCF's words for them
    "cone": ("pyramidal", "elliptic"),
    "integrator": ("Euler", "RK4", "implicit", "implicitfast", "discrete"),
    "solver": ("PGS", "CG", "Newton"),
}
SERVO_WORDS = {  # what is written of a position servo: gain and bias together, or its target scales
    "kp": (("actuator_gainprm", 0, 1.0), ("actuator_biasprm", 1, -1.0)),
    "kv": (("actuator_biasprm", 2, -1.0),),
}
STRENGTH = "strength"  # factor of the forces of an actuator, its limit included
RELATIVE_SUFFIX = ".relative"  # end of a path of a group whose values are factors
SETTING_NUMBERS = {
    name: FieldSpec(component_names=("",), field=f"opt.{name}") for name in (*ENUM_OPTIONS, *ITERATION_MINIMA, TIMESTEP)
}
FIXED = {  # why no other field of `mujoco.batch` can vary, by patterns of their names
    "*_invweight0 *_length0 actuator_acc0 actuator_lengthrange body_subtreemass body_margin bvh_aabb cam_mat0 *_pos0 "
    "*_poscom0 light_dir0 dof_M0 dof_length efm0_L geom_aabb geom_rbound": "computed from other fields",
    "body_quat body_iquat geom_quat site_quat jnt_axis": "unit vectors: no component can change alone",
    "qpos0 key_*": "start poses: use `begin` or the keyframe",
    "wrap_prm": "the path of a tendon: another model",
    "actuator_delay sensor_delay sensor_interval": "the compiled model has buffers of this size; vary `noise.delay`",
    "*_springyield": "MuJoCo 4: a yielding spring has a plastic state, so it is another model",
    "flex_*": "deformable bodies",
    "opt.o_* opt.sleep_tolerance": "contact override and sleeping bodies, which are not used here",
    "cam_* light_* mat_* *_rgba tendon_width": "only for pictures",
    "*_user numeric_data tuple_objprm sensor_noise": "MuJoCo does not use them",
}


def parameter_field(model: mujoco.MjModel, path: str) -> Parameter:
    """Return unit, bounds and nominal value of the model parameter that a path names. Raises `InputError`."""
    if is_group(path):
        return _group_parameter(model, path)
    if (name := path.removeprefix(f"{PATH_ROOT}.{OPTION_KIND}.")) in ENUM_OPTIONS:
        return choice(ENUM_OPTIONS[name][getattr(model.opt, name)], *ENUM_OPTIONS[name])
    if name in ITERATION_MINIMA:
        return count(getattr(model.opt, name), at_least=ITERATION_MINIMA[name], at_most=10_000)
    if name == TIMESTEP:
        return setting(model.opt.timestep, "s", above=0, at_most=0.1)
    numbers, places = resolve_parameter_path(model, path)
    if numbers.is_factor:
        return quantity(1.0, numbers.unit, at_least=numbers.at_least)
    value = places[0].sign * float(field_values(model, numbers.field).flat[places[0].flat_index])
    return quantity(value, numbers.unit, at_least=numbers.at_least)


def select_batchable_values(model: mujoco.MjModel, values: Mapping[str, Any]) -> dict[str, Any]:
    """Select the parameter values, by path, that may differ between models of one batch: quantities, not options."""
    return {
        path: value for path, value in values.items() if parameter_field(model, path).metadata["role"] == "quantity"
    }


def replace_scalar_options(model: mujoco.MjModel, values: Mapping[str, Any]) -> mujoco.MjModel:
    """Return a copy of a model in which the given scalar simulation options have new values."""
    changed = copy(model)
    for path, value in values.items():
        name = path.removeprefix(f"{PATH_ROOT}.{OPTION_KIND}.")
        setattr(changed.opt, name, ENUM_OPTIONS[name].index(value) if name in ENUM_OPTIONS else value)
    return changed


def write_batch_parameters(
    batch: Batch, values: Mapping[str, Any], source: Callable[[], mujoco.MjSpec]
) -> frozenset[str]:
    """Write parameter values into the models of a batch, and recompute derived fields.

    Args:
        batch: The batch of n models.
        values: Values (n,) by path.
        source: Returns what the model was compiled from.

    Returns:
        Names of the fields that were written.
    """
    values = _expand_groups(batch.model, values)
    made = {
        path: value for path, value in values.items() if resolve_parameter_path(batch.model, path)[0].needs_compiler
    }
    written = _compile(batch, made, source()) if made else set()
    factors = [
        path for path in values if resolve_parameter_path(batch.model, path)[0].is_factor
    ]  # of what the others wrote
    for path in [*(path for path in values if path not in (*made, *factors)), *factors]:
        value = np.asarray(values[path])
        for field, flat, sign in resolve_parameter_path(batch.model, path)[1]:
            rows = batch.expand(field).reshape(batch.nsim, -1)
            if path in factors:
                rows[:, flat] *= value
                written |= {field}
                continue
            if field == "body_mass":
                inertia = batch.expand("body_inertia").reshape(batch.nsim, -1, 3)
                inertia[:, flat] *= (value / rows[:, flat])[:, None]
            rows[:, flat] = sign * value
            written |= {field, "body_inertia"} if field == "body_mass" else {field}
    if values:
        batch.set_const()
    return frozenset(written)


def require_variable_parameter(source: Callable[[], mujoco.MjSpec], model: mujoco.MjModel, path: str) -> None:
    """Raise `InputError` if a parameter path names a number of the model that a study cannot vary.

    Args:
        source: Returns what the model was compiled from.
        model: The compiled model.
        path: Path of the parameter.
    """
    if is_group(path):
        for member in group_members(model, path):
            require_variable_parameter(source, model, member)
        return
    kind, number, name, what = find_element(model, path)
    geom = source().geom(name) if resolve_parameter_path(model, path)[0].needs_compiler else None
    for wrong, why in (
        (kind == "body" and what == "mass" and not model.body_mass[number],
         "the body has no mass in the file, so its inertia cannot be scaled"),
        (kind == "body" and what.startswith("ipos") and model.body_simple[number],
         'MuJoCo simplified the body: set simple="false" in its file'),
        (geom and np.isfinite(geom.fromto[0]) and what != "size.radius", "the geom's fromto sets its ends"),
        (geom and geom.type == GeomType.mjGEOM_MESH, "its mesh sets the geom's position"),
    ):  # fmt: skip
        if wrong:
            raise InputError(f"axis {path} is not allowed: {why}")


def _compile(batch: Batch, values: Mapping[str, Any], source: mujoco.MjSpec) -> set[str]:
    """Compile a model for each distinct row of `values`, and copy all fields that differ; return their names."""
    model, names = batch.model, sorted(MODEL_FIELDS - {"opt.timestep"})
    rows, which = np.unique(np.stack([*values.values()], axis=1), axis=0, return_inverse=True)
    written = set()
    for k, row in enumerate(rows):
        spec = source.copy()
        for path, value in zip(values, row, strict=True):
            (place,) = resolve_parameter_path(model, path)[1]
            getattr(spec.geom(find_element(model, path).name), place.field.removeprefix("geom_"))[
                place.flat_index % 3
            ] = value
        other = spec.compile()
        for name in names:
            new = None if name.startswith("opt.") else field_values(other, name)
            if new is not None and new.dtype.kind in "fi" and (new != field_values(model, name)).any():
                batch.expand(name)[which == k] = new
                written.add(name)
    return written


def find_element(model: mujoco.MjModel, path: str) -> NamedElement:
    """Find the model element, such as a geom, that a parameter path names. Raises `InputError` where there is none."""
    root, _, rest = path.partition(".")
    kind, _, rest = rest.partition(".")
    require_choice(
        kind if root == PATH_ROOT else root,
        (*VARIABLE_NUMBERS, OPTION_KIND),
        f"axis {path} is not allowed: {kind or root}",
    )
    if kind == OPTION_KIND:
        return NamedElement(kind, 0, "", rest)
    parts = rest.split(".")
    heads = [".".join(parts[:k]) for k in range(len(parts), 0, -1)]  # names may have points in them, too
    for name in filter(None, heads):
        if (number := mujoco.mj_name2id(model, OBJECT_TYPES[kind], name)) >= 0:
            return NamedElement(kind, number, name, rest.removeprefix(name).removeprefix("."))
    count = len(field_values(model, next(iter(VARIABLE_NUMBERS[kind].values())).field))
    names = (mujoco.mj_id2name(model, OBJECT_TYPES[kind], k) for k in range(count))
    near = format_name_suggestion(parts[0], filter(None, names))
    raise InputError(f"axis {path} is not allowed: no {kind} is called {parts[0]}{near}")


def resolve_parameter_path(model: mujoco.MjModel, path: str) -> tuple[FieldSpec, list[NumberLocation]]:
    """Return the meaning of a parameter path, and which numbers of the model it sets. Raises `InputError`."""
    if is_group(path):
        every = [resolve_parameter_path(model, member) for member in group_members(model, path)]
        return every[0][0], [place for _, places in every for place in places]
    kind, number, _, what = find_element(model, path)
    if kind == "actuator" and what == STRENGTH:
        return _strength(model, number)
    if kind == "actuator" and what in SERVO_WORDS:
        return _servo(model, path, what, number)
    varied = OPTION_NUMBERS | SETTING_NUMBERS if kind == OPTION_KIND else VARIABLE_NUMBERS[kind]
    if kind == "geom":
        sizes = SIZE_MEANINGS.get(GeomType(model.geom_type[number]), ())
        varied = {**varied, "size": varied["size"]._replace(component_names=sizes)}
        if not sizes:
            del varied["size"]
    attribute, _, part = what.partition(".")
    require_choice(attribute, varied, f"axis {path} is not allowed: {attribute or 'what of it'}")
    numbers = varied[attribute]
    count, firsts = _places(model, kind, number, numbers.field)
    names = [*(numbers.component_names or map(str, range(count)))][:count]
    if count == 1 and not part:
        part = names[0]
    require_choice(part, names, f"axis {path} is not allowed: {part or 'which of its numbers'}")
    return numbers, [NumberLocation(numbers.field, first + names.index(part)) for first in firsts]


def _places(model: mujoco.MjModel, kind: str, number: int, field: str) -> tuple[int, list[int]]:
    """Return how many numbers an element has in a field, and the first index for each joint freedom."""
    if kind == OPTION_KIND:
        return field_values(model, field).size, [0]
    size = field_values(model, field)[0].size
    if kind != "joint" or field.startswith("jnt_"):
        return size, [number * size]
    freedoms = [*map(int, np.flatnonzero(model.dof_jntid == number))]
    if field == "qpos_spring":
        return int(len(freedoms) == 1), [int(model.jnt_qposadr[number])]
    return (len(freedoms), freedoms[:1]) if size == 1 else (size, [k * size for k in freedoms])


def _servo(model: mujoco.MjModel, path: str, word: str, number: int) -> tuple[FieldSpec, list[NumberLocation]]:
    gain, bias = model.actuator_gainprm[number], model.actuator_biasprm[number]
    if model.actuator_biastype[number] != int(mujoco.mjtBias.mjBIAS_AFFINE) or gain[0] != -bias[1]:
        what = "the actuator is no position servo; vary gainprm.0 and biasprm.0, .1, .2 instead"
        raise InputError(f"axis {path} is not allowed: {what}")
    places = [
        NumberLocation(field, number * field_values(model, field)[0].size + k, sign)
        for field, k, sign in SERVO_WORDS[word]
    ]
    return FieldSpec("", 0.0, field=places[0].field), places


def _strength(model: mujoco.MjModel, number: int) -> tuple[FieldSpec, list[NumberLocation]]:
    """Gain, bias and limit of force of an actuator, all of which its strength multiplies."""
    width, gains = model.actuator_gainprm.shape[1], range(3)  # of a fixed or affine law
    places = [
        NumberLocation(field, width * number + k) for field in ("actuator_gainprm", "actuator_biasprm") for k in gains
    ]
    places += [NumberLocation("actuator_forcerange", 2 * number + k) for k in range(2)]
    return FieldSpec("", 0.0, field="actuator_gainprm", is_factor=True), places


def is_group(path: str) -> bool:
    """Return whether a parameter path names several elements by a pattern, such as `model.actuator.*.kp`."""
    return path.startswith(f"{PATH_ROOT}.") and any(sign in path for sign in "*?[{")


def group_members(model: mujoco.MjModel, path: str) -> list[str]:
    """Return the parameter paths that a pattern matches, in the model's order. Raises `InputError` if there are none.

    Args:
        model: The model.
        path: A path whose name is a pattern: `*`, `?`, `[ab]`, `{lf,rf}`; `.relative` at its end is left out.
    """
    kind, _, rest = path.removeprefix(f"{PATH_ROOT}.").removesuffix(RELATIVE_SUFFIX).partition(".")
    require_choice(kind, VARIABLE_NUMBERS, f"axis {path} names nothing: {kind}")
    count = len(
        field_values(model, next(iter(VARIABLE_NUMBERS[kind].values())).field if kind != "joint" else "jnt_type")
    )
    first = int(kind == "body")  # the world is a body, too
    names = [name for k in range(first, count) if (name := mujoco.mj_id2name(model, OBJECT_TYPES[kind], k))]
    parts = rest.split(".")
    for k in range(len(parts) - 1, 0, -1):  # names may have points in them
        patterns = _alternatives(".".join(parts[:k]))
        if found := [name for name in names if any(fnmatch.fnmatchcase(name, one) for one in patterns)]:
            return [f"{PATH_ROOT}.{kind}.{name}.{'.'.join(parts[k:])}" for name in found]
    raise InputError(f"axis {path} names nothing: no {kind} fits {parts[0]} (names: {', '.join(names)})")


def _alternatives(pattern: str) -> list[str]:
    """Return the patterns without braces that one with braces stands for."""
    if not (found := re.search(r"\{([^{}]*)\}", pattern)):
        return [pattern]
    every = (pattern[: found.start()] + one + pattern[found.end() :] for one in found[1].split(","))
    return [one for each in every for one in _alternatives(each)]


def _group_parameter(model: mujoco.MjModel, path: str) -> Parameter:
    """Return the field that describes a group: one value for all, or a factor. Raises `InputError`."""
    members = group_members(model, path)
    about = [parameter_field(model, member) for member in members]
    if path.endswith(RELATIVE_SUFFIX):
        return quantity(1.0, f"of {len(members)} numbers", at_least=0)
    values: list[float] = [one.default for one in about]  # pyright: ignore[reportAssignmentType]
    if max(values) != min(values):
        differ = f"{len(values)} numbers from {min(values):g} to {max(values):g} differ"
        raise InputError(f"axis {path} has no nominal value, {differ}: multiply them by {path}{RELATIVE_SUFFIX}")
    told = dict(about[0].metadata)
    told["unit"] = ", ".join(filter(None, (told["unit"], f"{len(members)} numbers")))
    return dataclasses.field(default=values[0], metadata=told)  # pyright: ignore[reportReturnType]


def _expand_groups(model: mujoco.MjModel, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by path of single numbers; those of groups come first, so that single ones replace them."""
    found: dict[str, Any] = {}
    for path in sorted(values, key=is_group, reverse=True):
        for member in group_members(model, path) if is_group(path) else [path]:
            value = np.asarray(values[path])
            found[member] = value * parameter_field(model, member).default if path.endswith(RELATIVE_SUFFIX) else value
    return found


def locate_field(model: Any, field: str) -> tuple[Any, str]:
    """Return the object (model or its options) that holds a field of `mujoco.batch`, and the field's name there."""
    return (model.opt, field[4:]) if field.startswith("opt.") else (model, field)


def field_values(model: mujoco.MjModel, field: str) -> np.ndarray:
    """Return the values of a model's field, named as in `mujoco.batch`."""
    return np.asarray(getattr(*locate_field(model, field)))
