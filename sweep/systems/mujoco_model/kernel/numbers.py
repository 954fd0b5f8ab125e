"""Numbers of a model as `Scalar`s: known ones of the model, or a rollout's own where its models differ."""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from sweep.systems.mujoco_model import fields
from sweep.systems.mujoco_model.kernel.scalars import (
    Scalar,
    Vector,
    largest,
    look_up_number,
    quaternion_axes,
    rotation_matrix,
)


class ModelFieldValues:
    """Access to the numbers of one rollout's model: constants, or values that differ between the rollouts of a batch.

    Args:
        model: The nominal model.
        rows: Fields in which rollouts differ, of one rollout, by MuJoCo's name and in its shape.
        varied: Which elements of these fields differ, see `find_varied_elements`.
    """

    def __init__(self, model: mujoco.MjModel, rows: Mapping[str, Any], varied: Mapping[str, np.ndarray]):
        self.model, self._rows, self._varied = model, rows, varied
        self.read: set[str] = set()  # fields that were asked for

    def get(self, name: str, ids: np.ndarray | None = None, *component: int) -> Scalar:
        """Return the values of a model field for some elements, or a simulation option, as a `Scalar`.

        Args:
            name: MuJoCo's name of the field.
            ids: Elements (n,).
            *component: Index in the field's other axes.
        """
        self.read.add(name)
        place = component if ids is None else (np.asarray(ids) if len(ids) > 1 else int(ids[0]), *component)
        if self.is_varied(name, place):
            return Scalar(self._rows[name][place])
        known = np.asarray(fields.field_values(self.model, name), float)[place]
        return Scalar(known if np.ndim(known) else float(known))

    def look_up(self, name: str, place: Scalar) -> Scalar:
        """Return numbers of a model field (k,) at places that a rollout computes.

        Args:
            name: MuJoCo's name of the field.
            place: Their indices, whole numbers within the field.
        """
        self.read.add(name)
        return look_up_number(self._rows[name] if name in self._varied else getattr(self.model, name), place)

    def is_varied(self, name: str, place: Any) -> bool:
        """Return whether elements of a model field, given by an index of its array, differ between rollouts."""
        return name in self._varied and bool(np.any(self._varied[name][place]))

    def get_vector(self, name: str, ids: np.ndarray | None = None) -> Vector:
        """Return the first three numbers of a model field for some elements as a vector."""
        return Vector(*(self.get(name, ids, k) for k in range(3)))

    def may_be_nonzero(self, name: str, ids: np.ndarray) -> bool:
        """Return whether a model field may have a number other than 0 for some elements."""
        return self.is_varied(name, ids) or bool(np.any(fields.field_values(self.model, name)[ids]))

    def get_rotation_columns(self, name: str, ids: np.ndarray) -> tuple[Vector, Vector, Vector] | None:
        """Return the columns of the rotation matrices of quaternions in a model field; None if they do not rotate."""
        if self.is_varied(name, ids):
            w, x, y, z = (self.get(name, ids, k) for k in range(4))
            return quaternion_axes(w, x, y, z)
        quats = np.asarray(getattr(self.model, name)[ids], float)
        if np.array_equal(quats, np.tile([1.0, 0, 0, 0], (len(quats), 1))):
            return None
        matrices = np.stack([rotation_matrix(quat) for quat in quats])

        def column(k: int) -> Vector:
            return Vector(*(Scalar(matrices[:, i, k] if len(ids) > 1 else matrices[0, i, k]) for i in range(3)))

        return column(0), column(1), column(2)


def raise_to_power(base: Scalar, exponent: float) -> Scalar:
    """Return a number of the kernel's program raised to a constant power."""
    if exponent == int(exponent):
        found = base
        for _ in range(int(exponent) - 1):
            found = found * base
        return found
    if base.is_constant:
        return Scalar(np.power(base.value, exponent))
    return Scalar(largest(base, 1e-30).value ** exponent)
