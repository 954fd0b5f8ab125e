"""Reasons why a parameter of a MuJoCo model may have no effect."""

from typing import Any

import mujoco
import numpy as np

from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import split_side_prefix
from sweep.systems.mujoco_model import fields, terrain, terrain_heights
from sweep.systems.mujoco_model.model_spec import PHYSICAL, ModelSpec

CONDIM_OF_FRICTION = {"slide": 3, "spin": 4, "roll": 6}  # of contacts, from which a friction counts
SITE_TYPE, FREE_JOINT = mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtJoint.mjJNT_FREE


def explain_inactive(spec: ModelSpec, column: str, settings: EngineSettings, ends: tuple[Any, Any]) -> str:
    """Explain why varying a parameter cannot change any result, if the MuJoCo model proves it."""
    side, path = split_side_prefix(column)
    root = path.partition(".")[0]
    if root == "noise":
        return "sensor errors are part of the world" if side == "belief" else ""
    if root in PHYSICAL:
        return "it is part of the world" if side == "belief" else _physical(spec, path, ends)
    if root in ("controller", "schedule"):
        return "controller parameters are part of the belief" if side == "world" else ""
    if root != "model":
        return ""
    if side == "belief":
        return "" if path in spec.controller.belief_paths.values() else "the controller's BELIEVES does not name it"
    if terrain.is_terrain_path(path):
        return _terrain(spec, path)
    if fields.is_group(path):
        why = [explain_inactive(spec, one, settings, ends) for one in fields.group_members(spec.model, path)]
        return why[0] if all(why) else ""
    kind, number, _, what = fields.find_element(spec.model, path)
    if kind == fields.OPTION_KIND:
        return _option(spec.model, what)
    if kind == "geom":
        return _geom(spec.model, number, what, ends)
    return _other(spec.model, kind, number, what.partition(".")[0])


def _terrain(spec: ModelSpec, path: str) -> str:
    """Why a number of the terrain counts for nothing, at the nominal kind."""
    shape, name = spec.config.terrain, path.removeprefix(terrain.PREFIX)
    if shape is None or name not in terrain_heights.NUMBERS or name in terrain_heights.KINDS[shape.kind].uses:
        return ""
    return f"terrain of the kind {shape.kind} does not use it"


def _physical(spec: ModelSpec, path: str, ends: tuple[Any, Any]) -> str:
    if path.startswith("push.") and path.endswith(".start") and min(ends) >= spec.config.duration:
        return f"rollouts end at {spec.config.duration:g} s"
    return ""


def _option(model: mujoco.MjModel, what: str) -> str:
    if what.startswith("wind") and not model.opt.density and not model.opt.viscosity:
        return "air has neither density nor viscosity"
    if what == "impratio" and model.opt.cone != int(mujoco.mjtCone.mjCONE_ELLIPTIC):
        return "it applies to elliptic cones only (model.option.cone)"
    return ""


def _geom(model: mujoco.MjModel, geom: int, what: str, ends: tuple[Any, Any]) -> str:
    name = model.geom
    if geom in model.pair_geom1 or geom in model.pair_geom2:
        return "contacts of its pairs have their own parameters"
    types, able = model.geom_contype, model.geom_conaffinity
    meets = ((types & able[geom]) | (types[geom] & able)) != 0
    still = model.body_weldid == model.body_weldid[model.geom_bodyid[geom]]
    others = np.flatnonzero(meets & ~still[model.geom_bodyid])
    if not len(others):
        return f"geom `{name(geom).name}` collides with nothing"
    higher = others[model.geom_priority[others] > model.geom_priority[geom]]
    if len(higher) == len(others):
        return f"geom `{name(higher[0]).name or higher[0]}` has priority"
    word, _, part = what.partition(".")
    if word != "friction":
        return ""
    lower = model.geom_priority[others] < model.geom_priority[geom]
    condim = np.where(lower, model.geom_condim[geom], np.maximum(model.geom_condim[others], model.geom_condim[geom]))
    if condim.max() < CONDIM_OF_FRICTION[part]:
        return f"contacts have condim {condim.max()}, it needs {CONDIM_OF_FRICTION[part]}"
    equal = others[model.geom_priority[others] == model.geom_priority[geom]]
    ranked = sorted(
        (model.geom_friction[other, [*CONDIM_OF_FRICTION].index(part)], name(other).name or other) for other in equal
    )
    if lower.any() or not ranked or max(ends) > ranked[0][0]:  # then the geom's own number counts somewhere
        return ""
    (least, low), (most, high) = ranked[0], ranked[-1]
    has = f"geom `{low}` has {least:g}" + (f", `{high}` {most:g}" if len(ranked) > 1 else "")
    return f"the larger friction of two geoms counts: {has}"


def _other(model: mujoco.MjModel, kind: str, number: int, what: str) -> str:
    """Why the attribute `what` of something that is no geom counts for nothing; empty where it counts."""
    match kind, what:
        case "body", "pos" if (first := model.body_jntadr[number]) >= 0 and model.jnt_type[first] == FREE_JOINT:
            return "the keyframe sets the position of a free body"
        case "body", _ if what != "pos" and model.body_weldid[number] == 0:
            return "the body does not move"
        case "joint", "pos" if model.jnt_type[number] == FREE_JOINT:
            return "a free joint ignores it"
        case "joint", "range" if not model.jnt_limited[number]:
            return "the joint has no limits"
        case "tendon", "range" if not model.tendon_limited[number]:
            return "the tendon has no limits"
        case "actuator", "forcerange" if not model.actuator_forcelimited[number]:
            return "the actuator does not have these limits"
        case "actuator", "ctrlrange" if not model.actuator_ctrllimited[number]:
            return "the actuator does not have these limits"
        case "site", _ if SITE_TYPE not in model.sensor_objtype[model.sensor_objid == number]:
            return "no sensor is at the site"
        case _:
            return ""
