"""Pairs of geoms that may touch, by MuJoCo's filters or as explicit pairs of a model."""

import mujoco
import numpy as np


def may_touch(model: mujoco.MjModel, one: int | np.ndarray, other: int | np.ndarray) -> np.ndarray:
    """Return whether MuJoCo's filters `contype` and `conaffinity` let two geoms touch.

    Args:
        model: The model.
        one: Ids (k,) of geoms, or one id.
        other: Ids (k,) of the other geoms, or one id.
    """
    types, able = model.geom_contype, model.geom_conaffinity
    return ((types[one] & able[other]) | (types[other] & able[one])) != 0


def find_geom_pairs(model: mujoco.MjModel) -> np.ndarray:
    """Return the pairs (k, 2) of geoms that may touch: those that pass MuJoCo's filters, then the explicit pairs.

    Filters leave out geoms of bodies that are welded together or excluded. Explicit pairs that pass them come twice.
    """
    one, other = np.triu_indices(model.ngeom, 1)
    bodies = model.geom_bodyid[one], model.geom_bodyid[other]
    welds = [model.body_weldid[body] for body in bodies]
    parents = [model.body_weldid[model.body_parentid[weld]] for weld in welds]
    may = may_touch(model, one, other) & (welds[0] != welds[1])
    if not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        is_parent = (welds[0] == parents[1]) | (welds[1] == parents[0])
        may &= ~(is_parent & (welds[0] != 0) & (welds[1] != 0))
    low, high = np.minimum(*bodies), np.maximum(*bodies)
    may &= ~np.isin((low << 16) + high, model.exclude_signature)
    filtered = np.stack([one[may], other[may]], axis=1)
    explicit = np.stack([model.pair_geom1, model.pair_geom2], axis=1)
    return np.concatenate([filtered, explicit])
