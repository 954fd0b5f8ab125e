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

from sweep.core.errors import InputError, suggest
from sweep.core.parameters import choice, count, quantity, setting
from sweep.systems.base import Parameter

XYZ = ("x", "y", "z")
SOLREF, SOLIMP = ("timeconst", "dampratio"), ("dmin", "dmax", "width", "midpoint", "power")
FRICTION = ("slide", "spin", "roll")
OPTION, ROOT = "option", "model"


class Numbers(NamedTuple):
    """What may vary of a thing of some kind."""

    field: str  # of MjModel
    unit: str = ""
    at_least: float = -np.inf
    names: tuple[str, ...] = ()  # of its components
    compiled: bool = False  # whether MuJoCo's compiler makes more of it


class Place(NamedTuple):
    """A number of a model: where it is in a flattened field, and how it counts there."""

    field: str
    flat: int
    sign: float = 1.0


RANGE = ("low", "high")
# of each kind, attributes that are alike; a field that is told to its last _ or . goes on with the attribute's name
ALIKE: dict[str, dict[str, Numbers]] = {
    "body": {
        "mass": Numbers("body_", "kg", 1e-9),  # inertia in proportion: another density
        "inertia": Numbers("body_", "kg m^2", 1e-12, XYZ),
        "pos ipos": Numbers("body_", "m", names=XYZ),  # the latter of the centre of mass
        "gravcomp": Numbers("body_"),
    },
    "geom": {
        "friction": Numbers("geom_", "", 0.0, FRICTION),
        "margin gap": Numbers("geom_", "m"),
        "adhesion surfacevel": Numbers("geom_"),
        "fluid solmix": Numbers("geom_", "", 0.0),
        "solref": Numbers("geom_", names=SOLREF),
        "solimp": Numbers("geom_", names=SOLIMP),
        "size": Numbers("geom_", "m", 1e-6, compiled=True),  # by the names of its shape: `SIZES`
        "pos": Numbers("geom_", "m", names=XYZ, compiled=True),
    },
    "joint": {
        "stiffness": Numbers("jnt_", "", 0.0),
        "damping armature frictionloss": Numbers("dof_", "", 0.0),
        "stiffnesspoly margin": Numbers("jnt_"),
        "dampingpoly": Numbers("dof_"),
        "pos": Numbers("jnt_", "m", names=XYZ),
        "range": Numbers("jnt_", names=RANGE),
        "springref": Numbers("qpos_spring"),
        "actuatorfrcrange": Numbers("jnt_actfrcrange", names=RANGE),
        "solreflimit": Numbers("jnt_solref", names=SOLREF),
        "solimplimit": Numbers("jnt_solimp", names=SOLIMP),
        "solreffriction": Numbers("dof_solref", names=SOLREF),
        "solimpfriction": Numbers("dof_solimp", names=SOLIMP),
    },
    "actuator": {
        "gear gainprm biasprm dynprm dampingpoly": Numbers("actuator_"),
        "forcerange ctrlrange actrange": Numbers("actuator_", names=RANGE),
        "cranklength": Numbers("actuator_", "m", 1e-9),
        "damping armature": Numbers("actuator_", "", 0.0),
    },
    "site": {"pos": Numbers("site_", "m", names=XYZ), "size": Numbers("site_", "m", 1e-6)},
    "sensor": {"cutoff": Numbers("sensor_", "", 0.0)},
    "tendon": {
        "stiffness damping armature frictionloss": Numbers("tendon_", "", 0.0),
        "stiffnesspoly dampingpoly margin": Numbers("tendon_"),
        "range": Numbers("tendon_", "m", names=RANGE),
        "springlength": Numbers("tendon_lengthspring", "m", names=RANGE),
        "actuatorfrcrange": Numbers("tendon_actfrcrange", names=RANGE),
        "solreflimit": Numbers("tendon_solref_lim", names=SOLREF),
        "solimplimit": Numbers("tendon_solimp_lim", names=SOLIMP),
        "solreffriction": Numbers("tendon_solref_fri", names=SOLREF),
        "solimpfriction": Numbers("tendon_solimp_fri", names=SOLIMP),
    },
    "pair": {
        "friction": Numbers("pair_", "", 0.0, ("slide", "slide2", "spin", "roll", "roll2")),
        "margin gap": Numbers("pair_", "m"),
        "adhesion": Numbers("pair_"),
        "solref solreffriction": Numbers("pair_", names=SOLREF),
        "solimp": Numbers("pair_", names=SOLIMP),
    },
    "equality": {
        "data": Numbers("eq_"),
        "solref": Numbers("eq_", names=SOLREF),
        "solimp": Numbers("eq_", names=SOLIMP),
    },
    OPTION: {
        "gravity": Numbers("opt.", "m/s^2", names=XYZ),
        "wind": Numbers("opt.", "m/s", names=XYZ),
        "magnetic": Numbers("opt.", names=XYZ),
        "density": Numbers("opt.", "kg/m^3", 0.0),
        "viscosity": Numbers("opt.", "Pa s", 0.0),
        "impratio": Numbers("opt.", "", 1e-9),
        "tolerance ls_tolerance noslip_tolerance ccd_tolerance": Numbers("opt.", "", 0.0),
    },
}
VARIED = {
    kind: {
        name: one._replace(field=one.field + name) if one.field.endswith(("_", ".")) else one
        for names, one in alike.items()
        for name in names.split()
    }
    for kind, alike in ALIKE.items()
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
        varied = OPTIONS | {name: Numbers(f"opt.{name}", names=("",)) for name in (*CHOSEN, *COUNTED, TIMESTEP)}
        return _component(path, varied, rest, lambda name: (np.size(whole(model, name)), [0]))
    number, name = named(model, kind, rest)
    if number < 0:
        known, word = _names(model, kind), rest.partition(".")[0]
        raise _nothing(path, f"no {kind} is called {word}{suggest(word, known)}")
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
    if attribute not in varied:
        raise _nothing(path, f"{attribute or 'what of it'} is unknown{suggest(attribute, varied)}")
    numbers = varied[attribute]
    count, firsts = at(numbers.field)
    names = [*(numbers.names or map(str, range(count)))][:count]
    if count == 1 and not part:
        part = names[0]
    if part not in names:
        raise _nothing(path, f"{part or 'which of its numbers'} is unknown{suggest(part, names)}")
    return numbers, [Place(numbers.field, first + names.index(part)) for first in firsts]


def _servo(model: mujoco.MjModel, path: str, word: str, number: int) -> tuple[Numbers, list[Place]]:
    gain, bias = model.actuator_gainprm[number], model.actuator_biasprm[number]
    if model.actuator_biastype[number] != int(mujoco.mjtBias.mjBIAS_AFFINE) or gain[0] != -bias[1]:
        raise _nothing(path, "the actuator is no position servo: gainprm.0 and biasprm.0, .1, .2")
    places = [Place("actuator_biasprm", number * bias.size + k, s) for k, s in SERVO[word] if k]
    if word == "kp":
        places.insert(0, Place("actuator_gainprm", number * gain.size))
    return Numbers(places[0].field, "", 0.0), places


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
