"""Why a parameter of an own model may change nothing, as far as its model tells."""

from collections.abc import Callable

import mujoco
import numpy as np

from sweep.systems.own import fields
from sweep.systems.own.subject import Subject

CONDIM = {"slide": 3, "spin": 4, "roll": 6}  # of contacts, from which a friction counts
SENSED = int(mujoco.mjtObj.mjOBJ_SITE)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def why(own: Subject, side: str, path: str) -> str:
    """Why `path`, varied on a side, may change nothing; empty where nothing is known."""
    root, _, name = path.partition(".")
    if root == "noise":
        return "errors are those of the world" if side == "belief" else ""
    if root == "controller":
        return "its own numbers are believed" if side == "world" else "the controller makes no use of it"
    if root != "model":
        return ""
    if side == "belief":
        told = path in own.controller.believes.values()
        return "" if told else "the controller is not told of it (BELIEVES)"
    kind = name.partition(".")[0]
    if kind == fields.OPTION:
        return _option(own.model, name.partition(".")[2])
    number, called = fields.named(own.model, kind, name.partition(".")[2])
    what = name.removeprefix(f"{kind}.{called}.")
    return REASONS[kind](own, number, what) if kind in REASONS else ""


def _option(model: mujoco.MjModel, what: str) -> str:
    if what.startswith("wind") and not model.opt.density and not model.opt.viscosity:
        return "air has neither density nor viscosity"
    if what == "impratio" and model.opt.cone != int(mujoco.mjtCone.mjCONE_ELLIPTIC):
        return "it is one of elliptic cones (model.option.cone)"
    return "the solver stops by another limit" if "tolerance" in what or "iterations" in what else ""


def _geom(own: Subject, geom: int, what: str) -> str:
    model, name = own.model, own.model.geom
    if geom in model.pair_geom1 or geom in model.pair_geom2:
        return "contacts of a pair have numbers of their own"
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
    if condim.max() < CONDIM[part]:
        return f"contacts have condim {condim.max()}, from {CONDIM[part]} on it counts"
    equal = others[model.geom_priority[others] == model.geom_priority[geom]]
    ranked = sorted((model.geom_friction[other, [*CONDIM].index(part)], name(other).name or other) for other in equal)
    if not ranked:
        return ""
    (least, low), (most, high) = ranked[0], ranked[-1]
    has = f"geom `{low}` has {least:g}" + (f", `{high}` {most:g}" if len(ranked) > 1 else "")
    return f"of two that meet the larger counts: {has}"


def _body(own: Subject, body: int, what: str) -> str:
    model = own.model
    if model.body_weldid[body] == 0 and not what.startswith("pos"):
        return "the body does not move"
    first = model.body_jntadr[body]
    if what.startswith("pos") and first >= 0 and model.jnt_type[first] == FREE:
        return "a free body is where its joint is: in the keyframe"
    return ""


def _joint(own: Subject, joint: int, what: str) -> str:
    if what.startswith("range") and not own.model.jnt_limited[joint]:
        return "the joint has no limits"
    return "it is that of a free joint" if what.startswith("pos") and own.model.jnt_type[joint] == FREE else ""


def _actuator(own: Subject, actuator: int, what: str) -> str:
    model = own.model
    limited = {"forcerange": model.actuator_forcelimited, "ctrlrange": model.actuator_ctrllimited}
    word = what.partition(".")[0]
    return "the actuator has no such limits" if word in limited and not limited[word][actuator] else ""


def _site(own: Subject, site: int, what: str) -> str:
    model = own.model
    sensed = np.isin(SENSED, model.sensor_objtype[model.sensor_objid == site])
    return "" if sensed else "no sensor is at the site"


def _tendon(own: Subject, tendon: int, what: str) -> str:
    return "the tendon has no limits" if what.startswith("range") and not own.model.tendon_limited[tendon] else ""


REASONS: dict[str, Callable[[Subject, int, str], str]] = {
    "geom": _geom,
    "body": _body,
    "joint": _joint,
    "actuator": _actuator,
    "site": _site,
    "tendon": _tendon,
}
