"""From a path such as `model.geom.floor.friction.slide` to numbers of a MuJoCo model, and back into a batch of models.

Only numbers that a model may differ in while its layout stays as it is: `mj_setConst` works out again what follows, but
for `stat.meaninertia`, which scales a solver's tolerance. What MuJoCo's compiler makes of a size or a place of a geom
(inertia, bounding volumes) comes from models that are compiled anew, one for each of the values.
"""

from collections.abc import Callable, Mapping
from copy import copy
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch

from sweep.core.errors import InputError, known, suggest
from sweep.core.parameters import choice, count, quantity, setting
from sweep.systems.base import Parameter

XYZ = ("x", "y", "z")
SOLREF, SOLIMP = ("timeconst", "dampratio"), ("dmin", "dmax", "width", "midpoint", "power")
FRICTION = ("slide", "spin", "roll")
OPTION, ROOT = "option", "model"


class Numbers(NamedTuple):
    """What may vary of a thing of some kind."""

    unit: str = ""
    at_least: float = -np.inf
    names: tuple[str, ...] = ()  # of its components
    compiled: bool = False  # whether MuJoCo's compiler makes more of it
    field: str = ""  # of MjModel


class Place(NamedTuple):
    """A number of a model: where it is in a flattened field, and how it counts there."""

    field: str
    flat: int
    sign: float = 1.0


RANGE = ("low", "high")
# what may vary of each kind, in MJCF's words; with the field of MjModel where that is not what fields begin with and it
WORDS = {
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
    OPTION: (
        "opt.",
        "gravity wind magnetic density viscosity impratio tolerance ls_tolerance noslip_tolerance ccd_tolerance",
    ),
}
# what these words mean, of any kind or of one; of the others nothing is known
MEANING = {
    "mass": Numbers("kg", 1e-9),  # inertia in proportion: another density
    "inertia": Numbers("kg m^2", 1e-12, XYZ),
    "pos ipos": Numbers("m", names=XYZ),  # the latter of the centre of mass
    "geom.pos": Numbers("m", names=XYZ, compiled=True),
    "geom.size": Numbers("m", 1e-6, compiled=True),  # by the names of its shape: `SIZES`
    "site.size": Numbers("m", 1e-6),
    "friction": Numbers("", 0.0, FRICTION),
    "pair.friction": Numbers("", 0.0, ("slide", "slide2", "spin", "roll", "roll2")),
    "geom.margin pair.margin gap": Numbers("m"),
    "cranklength": Numbers("m", 1e-9),
    "stiffness damping armature frictionloss fluid solmix cutoff": Numbers("", 0.0),
    "solref solreflimit solreffriction": Numbers(names=SOLREF),
    "solimp solimplimit solimpfriction": Numbers(names=SOLIMP),
    "range actuatorfrcrange forcerange ctrlrange actrange": Numbers(names=RANGE),
    "tendon.range springlength": Numbers("m", names=RANGE),
    "gravity": Numbers("m/s^2", names=XYZ),
    "wind": Numbers("m/s", names=XYZ),
    "magnetic": Numbers(names=XYZ),
    "density": Numbers("kg/m^3", 0.0),
    "viscosity": Numbers("Pa s", 0.0),
    "impratio": Numbers("", 1e-9),
    "tolerance ls_tolerance noslip_tolerance ccd_tolerance": Numbers("", 0.0),
}
MEANT = {word: numbers for words, numbers in MEANING.items() for word in words.split()}
VARIED = {
    kind: {
        name: MEANT.get(f"{kind}.{name}", MEANT.get(name, Numbers()))._replace(field=field or begins + name)
        for name, _, field in (word.partition(":") for word in words.split())
    }
    for kind, (begins, words) in WORDS.items()
}
OPTIONS = VARIED.pop(OPTION)
Shape = mujoco.mjtGeom
ROUND = ("radius", "half_length")
SIZES = {  # what numbers of a geom's size are, by its shape
    Shape.mjGEOM_SPHERE: ("radius",),
    Shape.mjGEOM_CAPSULE: ROUND,
    Shape.mjGEOM_CYLINDER: ROUND,
    Shape.mjGEOM_BOX: XYZ,
    Shape.mjGEOM_ELLIPSOID: XYZ,
}
CHOSEN = {"cone": mujoco.mjtCone, "integrator": mujoco.mjtIntegrator, "solver": mujoco.mjtSolver}
COUNTED = {"iterations": 1, "ls_iterations": 1, "noslip_iterations": 0}  # with the least of them
TIMESTEP = "timestep"
MJCF = {name.upper(): name for name in ("Euler", "RK4", "PGS", "CG", "Newton")}  # words that are not in small letters
FREEDOM = {int(mujoco.mjtJoint.mjJNT_FREE): 6, int(mujoco.mjtJoint.mjJNT_BALL): 3}  # of joints; of the others 1
SERVO = {"kp": ((0, 1.0), (1, -1.0)), "kv": ((2, -1.0),)}  # of gainprm's first, of biasprm; both, or its target scales


def parameter(model: mujoco.MjModel, path: str) -> Parameter:
    """The number or the choice that `path` names, at its nominal value. Raises `InputError`."""
    if (name := _setting(path)) in CHOSEN:
        words = _words(CHOSEN[name])
        return choice(next(word for word, kind in words.items() if kind == getattr(model.opt, name)), *words)
    if name in COUNTED:
        return count(getattr(model.opt, name), at_least=COUNTED[name], at_most=10_000)
    if name == TIMESTEP:
        return setting(model.opt.timestep, "s", above=0, at_most=0.1)
    numbers, places = _resolved(model, path)
    value = places[0].sign * float(whole(model, numbers.field).flat[places[0].flat])
    return quantity(value, numbers.unit, at_least=numbers.at_least)


def by_rollout(model: mujoco.MjModel, values: Mapping[str, Any]) -> dict[str, Any]:
    """Of `values` by path those in which the models of a batch may differ."""
    return {path: value for path, value in values.items() if parameter(model, path).metadata["role"] == "quantity"}


def with_options(model: mujoco.MjModel, values: Mapping[str, Any]) -> mujoco.MjModel:
    """A copy of a model with other options, by path; of vectors none."""
    changed = copy(model)
    for path, value in values.items():
        name = _setting(path)
        setattr(changed.opt, name, _words(CHOSEN[name])[value] if name in CHOSEN else value)
    return changed


def _setting(path: str) -> str:
    return path.removeprefix(f"{ROOT}.{OPTION}.")


def _words(kinds: Any) -> dict[str, int]:
    """The members of one of MuJoCo's enumerations by the words for them in MJCF: `mjINT_EULER` is `Euler`."""
    names = {str(name).partition("_")[2]: int(kind) for name, kind in kinds.__members__.items()}
    return {MJCF.get(name, name.lower()): number for name, number in names.items()}


def write(batch: Batch, values: Mapping[str, Any], source: Callable[[], mujoco.MjSpec]) -> None:
    """Give a batch's models their own `values` (n,) by path, and work out what follows from them.

    `source` gives what the model was compiled from.
    """
    made = {path: value for path, value in values.items() if compiled(batch.model, path)}
    if made:
        _compile(batch, made, source())
    for path in values.keys() - made.keys():
        value = np.asarray(values[path])
        for field, flat, sign in _resolved(batch.model, path)[1]:
            rows = batch.expand(field).reshape(batch.nsim, -1)
            if field == "body_mass":
                inertia = batch.expand("body_inertia").reshape(batch.nsim, -1, 3)
                inertia[:, flat] *= (value / rows[:, flat])[:, None]
            rows[:, flat] = sign * value
    if values:
        batch.set_const()


def compiled(model: mujoco.MjModel, path: str) -> bool:
    """Whether a model has to be compiled anew for another value."""
    return path.startswith(f"{ROOT}.geom.") and _resolved(model, path)[0].compiled


def check(source: Callable[[], mujoco.MjSpec], model: mujoco.MjModel, path: str) -> None:
    """Raise `InputError` where a path names a number that cannot vary in the model that `source` gives."""
    kind, _, rest = path.removeprefix(f"{ROOT}.").partition(".")
    number, called = named(model, kind, rest) if kind in KINDS else (-1, "")
    what = rest.removeprefix(f"{called}.")
    if kind == "body" and what == "mass" and not model.body_mass[number]:
        raise InputError(f"axis {path} is not allowed: the body has no mass in the file, so no inertia to scale")
    if kind == "body" and what.startswith("ipos") and model.body_simple[number]:
        raise InputError(f'axis {path} is not allowed: MuJoCo has the body as a simple one, without simple="false"')
    if not compiled(model, path):
        return
    geom = source().geom(called)
    if np.isfinite(geom.fromto[0]) and what != "size.radius":
        raise InputError(f"axis {path} is not allowed: the geom's fromto says where it ends")
    if geom.type == Shape.mjGEOM_MESH:
        raise InputError(f"axis {path} is not allowed: the geom is where its mesh has its middle")


def fields_of(model: mujoco.MjModel, path: str) -> list[str]:
    """The fields of MjModel that a path writes."""
    return [place.field for place in _resolved(model, path)[1]]


def _compile(batch: Batch, values: Mapping[str, Any], source: mujoco.MjSpec) -> None:
    """Have MuJoCo compile a model for each of the rows of `values`, and take over all that it has otherwise."""
    model, names = batch.model, sorted(MODEL_FIELDS - {"opt.timestep"})
    rows, which = np.unique(np.stack([*values.values()], axis=1), axis=0, return_inverse=True)
    for k, row in enumerate(rows):
        spec = source.copy()
        for path, value in zip(values, row, strict=True):
            number, called = named(model, "geom", path.removeprefix(f"{ROOT}.geom."))
            (place,) = _resolved(model, path)[1]
            field = place.field.removeprefix("geom_")
            getattr(spec.geom(called), field)[place.flat - 3 * number] = value
        other = spec.compile()
        for name in names:
            new = None if name.startswith("opt.") else whole(other, name)
            if new is not None and new.dtype.kind in "fi" and (new != whole(model, name)).any():
                batch.expand(name)[which == k] = new


def _resolved(model: mujoco.MjModel, path: str) -> tuple[Numbers, list[Place]]:
    root, _, rest = path.partition(".")
    kind, _, rest = rest.partition(".")
    kinds = [*VARIED, OPTION]
    if root != ROOT or kind not in kinds:
        raise _nothing(path, f"{kind or root} is unknown{suggest(kind or root, kinds)}")
    if kind == OPTION:
        varied = OPTIONS | {name: Numbers(names=("",), field=f"opt.{name}") for name in (*CHOSEN, *COUNTED, TIMESTEP)}
        return _component(path, varied, rest, lambda name: (np.size(whole(model, name)), [0]))
    number, name = named(model, kind, rest)
    if number < 0:
        word = rest.partition(".")[0]
        raise _nothing(path, f"no {kind} is called {word}{suggest(word, _names(model, kind))}")
    rest = rest.removeprefix(name).removeprefix(".")
    if kind == "actuator" and rest in SERVO:
        return _servo(model, path, rest, number)

    def at(field: str) -> tuple[int, list[int]]:
        """How many numbers a thing has in a field, and where the first of them is: one of each freedom of a joint."""
        size = whole(model, field)[0].size
        if kind != "joint" or field.startswith("jnt_"):
            return size, [number * size]
        first, freedom = int(model.jnt_dofadr[number]), FREEDOM.get(int(model.jnt_type[number]), 1)
        if field == "qpos_spring":
            return int(freedom == 1), [int(model.jnt_qposadr[number])]
        return (freedom, [first]) if size == 1 else (size, [(first + k) * size for k in range(freedom)])

    varied = VARIED[kind]
    if kind == "geom":
        sizes = SIZES.get(Shape(model.geom_type[number]), ())
        varied = {**varied, "size": varied["size"]._replace(names=sizes)}
        if not sizes:
            del varied["size"]
    return _component(path, varied, rest, at)


def _component(path: str, varied: dict[str, Numbers], rest: str, at: Any) -> tuple[Numbers, list[Place]]:
    attribute, _, part = rest.partition(".")
    known(attribute, varied, f"axis {path} names nothing: {attribute or 'what of it'}")
    numbers = varied[attribute]
    count, firsts = at(numbers.field)
    names = [*(numbers.names or map(str, range(count)))][:count]
    if count == 1 and not part:
        part = names[0]
    known(part, names, f"axis {path} names nothing: {part or 'which of its numbers'}")
    return numbers, [Place(numbers.field, first + names.index(part)) for first in firsts]


def _servo(model: mujoco.MjModel, path: str, word: str, number: int) -> tuple[Numbers, list[Place]]:
    gain, bias = model.actuator_gainprm[number], model.actuator_biasprm[number]
    if model.actuator_biastype[number] != int(mujoco.mjtBias.mjBIAS_AFFINE) or gain[0] != -bias[1]:
        raise _nothing(path, "the actuator is no position servo: gainprm.0 and biasprm.0, .1, .2")
    places = [Place("actuator_biasprm", number * bias.size + k, s) for k, s in SERVO[word] if k]
    if word == "kp":
        places.insert(0, Place("actuator_gainprm", number * gain.size))
    return Numbers("", 0.0, field=places[0].field), places


def _nothing(path: str, why: str) -> InputError:
    return InputError(f"axis {path} names nothing: {why}")


KINDS = {name: getattr(mujoco.mjtObj, f"mjOBJ_{name.upper()}") for name in VARIED}  # as MuJoCo numbers them


def named(model: mujoco.MjModel, kind: str, rest: str) -> tuple[int, str]:
    """Number and name of the thing that `rest` begins with; names may have points in them, too. -1 for none."""
    parts = rest.split(".")
    heads = (".".join(parts[:k]) for k in range(len(parts), 0, -1))
    found = ((mujoco.mj_name2id(model, KINDS[kind], head), head) for head in heads if head)
    return next(((number, head) for number, head in found if number >= 0), (-1, ""))


def _names(model: mujoco.MjModel, kind: str) -> list[str]:
    """What the things of a kind are called; those without a name are not there."""
    count = {"joint": "njnt", "actuator": "nu", "equality": "neq"}.get(kind, f"n{kind}")
    found = (mujoco.mj_id2name(model, KINDS[kind], k) for k in range(getattr(model, count)))
    return [name for name in found if name]


def located(model: Any, field: str) -> tuple[Any, str]:
    """What has a field that `mujoco.batch` calls so, a model or its options, and the field's name there."""
    return (model.opt, field[4:]) if field.startswith("opt.") else (model, field)


def whole(model: mujoco.MjModel, field: str) -> np.ndarray:
    """A field of a model by the name that `mujoco.batch` has for it."""
    return np.asarray(getattr(*located(model, field)))
