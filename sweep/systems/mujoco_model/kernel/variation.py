"""Which numbers of a model differ between rollouts; all others are compiled as constants.

They are found from the names of what a study varies, not from its values, so that a row has the same bits in any batch.
"""

from collections.abc import Iterable

import mujoco
import numpy as np

from sweep.systems.mujoco_model import fields
from sweep.systems.mujoco_model.payloads import PREFIX, Payload

COMPILED = ("geom_size", "geom_pos", "body_mass", "body_inertia", "body_ipos", "body_iquat")  # from sizes of geoms
FORMING = {
    "body_mass",
    "body_inertia",
    "body_pos",
    "body_ipos",
    "body_iquat",
    "dof_armature",
    "jnt_pos",
    "tendon_armature",
}
DERIVED = ("body_invweight0", "dof_invweight0")  # what follows from them, and the kernel reads


def find_varied_elements(
    model: mujoco.MjModel, paths: Iterable[str], payloads: tuple[Payload, ...]
) -> dict[str, np.ndarray]:
    """Return which elements of MuJoCo's model fields may differ between rollouts of a study.

    Args:
        model: The model.
        paths: Paths of what is varied, such as `model.body.trunk.mass`.
        payloads: Payloads of the scenario.

    Returns:
        Booleans in the shape of each field, by MuJoCo's name; fields that do not differ are left out.
    """
    found: dict[str, np.ndarray] = {}

    def mark(field: str, *flat: int) -> None:
        shape = np.shape(fields.field_values(model, field))
        mask = found.setdefault(field, np.zeros(shape, bool)).reshape(-1)
        mask[list(flat) if flat else slice(None)] = True
        found[field] = mask.reshape(shape)

    for path in paths:
        for member in fields.group_members(model, path) if fields.is_group(path) else [path]:
            numbers, places = fields.resolve_parameter_path(model, member)
            if numbers.needs_compiler:
                for field in COMPILED:
                    mark(field)
                continue
            for place in places:
                mark(place.field, place.flat_index)
                if place.field == "body_mass":
                    mark("body_inertia", *range(3 * place.flat_index, 3 * place.flat_index + 3))
    for one in payloads:
        body = model.body(f"{PREFIX}{one.name}").id
        mark("body_mass", body)
        for field in ("body_inertia", "body_pos"):
            mark(field, *range(3 * body, 3 * body + 3))
    if FORMING & set(found):
        for field in (*DERIVED, *(("tendon_invweight0",) if model.ntendon else ())):
            mark(field)
    return found
