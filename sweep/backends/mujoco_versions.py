"""One interface to the supported versions of MuJoCo, 3.17 and 4, and of MJX.

No other module of the package asks which version is installed.
"""

import importlib
import io
from collections.abc import Collection
from contextlib import redirect_stdout
from importlib.metadata import PackageNotFoundError, version

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch

from sweep.core.errors import InputError

# Fields of numbers that `mj_setConst` writes: MJSETCONST_ARRAYS in mjxmacro.h of MuJoCo 3.17.
SET_CONST_FIELDS = frozenset(
    (
        *("body_subtreemass", "body_invweight0", "body_margin", "bvh_aabb", "dof_invweight0", "dof_M0", "dof_length"),
        *("geom_size", "geom_aabb", "geom_rbound", "geom_fluid", "cam_poscom0", "cam_pos0", "cam_mat0"),
        *("light_poscom0", "light_pos0", "light_dir0", "flex_vertmetric", "flexedge_length0", "flexedge_invweight0"),
        *("efm0_L", "eq_data", "tendon_length0", "tendon_invweight0", "actuator_acc0", "actuator_length0"),
    )
)
# MuJoCo 4: springs that yield, by their words in MJCF. MJX 3.17 has no such springs.
YIELDING_SPRING_FIELDS = {
    f"{kind}.springyield": field
    for kind, field in (("joint", "jnt_springyield"), ("tendon", "tendon_springyield"))
    if field in MODEL_FIELDS
}


def differing_model_fields(batch: Batch, written: Collection[str]) -> dict[str, np.ndarray]:
    """Return the fields that may differ among the n MuJoCo models of a batch, arrays (n, ...) by name.

    Args:
        batch: The batch of n models.
        written: Names of the fields that were written since the batch was made; `set_const` was called after that.

    Returns:
        What was written and what `set_const` derived from it, by name.
    """
    if hasattr(Batch, "expanded"):  # MuJoCo 4
        found = {name: batch.expanded(name) for name in MODEL_FIELDS}
        return {name: rows for name, rows in found.items() if rows is not None and rows.dtype.kind == "f"}
    names = {
        *written,
        *(SET_CONST_FIELDS & MODEL_FIELDS if written else ()),
    }  # 3.17 does not say which fields are expanded
    return {name: rows for name in names if (rows := batch.expand(name)).dtype.kind == "f"}


def require_mjx(setting: str, instead: str) -> None:
    """Raise `InputError` unless MJX is installed and imports with the installed MuJoCo.

    Args:
        setting: The setting that asks for MJX, such as `engine.name = mjx`.
        instead: A setting that does not, such as `engine=native`.
    """
    try:
        with redirect_stdout(io.StringIO()):  # MJX prints which of its parts are not installed
            importlib.import_module("mujoco.mjx")
    except Exception as error:  # a mismatch of versions can raise anything
        try:
            name = f"mujoco-mjx {version('mujoco-mjx')}"
        except PackageNotFoundError:
            raise InputError(f"{setting} is not allowed: it needs MJX: pip install mujoco-mjx, or {instead}") from None
        reason = " ".join(str(error).split())
        pair = f"{name} does not import with MuJoCo {mujoco.__version__}"
        raise InputError(f"{setting} is not allowed: {pair}: {reason} (or {instead})") from None
