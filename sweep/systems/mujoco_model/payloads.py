"""Payloads of user models: masses at a place of a body, whose inertia MuJoCo adds by the parallel-axis theorem.

A payload is a body of its own that is welded to the body that carries it, so that its mass and place are numbers of the
compiled model like others.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch

from sweep.contract.system import Parameter
from sweep.core.errors import InputError, require_choice
from sweep.core.parameters import quantity
from sweep.systems.mujoco_model.named_groups import iterate_named_entries

PAYLOAD: Mapping[str, Parameter] = {  # numbers of a payload
    "mass": quantity(0.0, "kg", at_least=0),  # of the payload
    "x": quantity(0.0, "m"),  # of its centre of mass, in the body's frame
    "y": quantity(0.0, "m"),  # likewise
    "z": quantity(0.0, "m"),  # likewise
    "radius": quantity(0.0, "m", at_least=0),  # of a solid ball; 0: a point
}
PREFIX = "payload_"  # of the bodies' names


class Payload(NamedTuple):
    """A payload of a scenario: its name, and the robot's body that carries it."""

    name: str
    body: str


def parse_payloads(given: Any, bodies: list[str]) -> tuple[tuple[Payload, ...], dict[str, Any]]:
    """Return the payloads in a configuration, and their numeric parameters by path. Raises `InputError`.

    Args:
        given: For each name a mapping with `body` and keys of `PAYLOAD`.
        bodies: Bodies of the model.
    """
    payloads, numbers = [], {}
    such = "payloads by name, such as {box: {body: trunk, mass: 2}}"
    for name, said in iterate_named_entries("payload", given, such, ("body", *PAYLOAD), ("body",)):
        require_choice(said["body"], bodies, f"payload.{name}.body: {said['body']}")
        if f"{PREFIX}{name}" in bodies:
            raise InputError(f"payload.{name} is not allowed: the model has a body {PREFIX}{name}")
        payloads.append(Payload(name, str(said["body"])))
        numbers |= {f"payload.{name}.{key}": value for key, value in said.items() if key != "body"}
    return tuple(payloads), numbers


def add_payloads(source: mujoco.MjSpec, payloads: tuple[Payload, ...]) -> mujoco.MjSpec:
    """Return a copy of a model's source in which each payload is a massless body."""
    changed = source.copy()
    for one in payloads:
        changed.body(one.body).add_body(name=f"{PREFIX}{one.name}")
        # MuJoCo would fuse a static body that nothing refers to with its parent
        changed.add_exclude(bodyname1=one.body, bodyname2=f"{PREFIX}{one.name}")
    return changed


def write_payloads(batch: Batch, payloads: tuple[Payload, ...], values: Mapping[str, Any]) -> frozenset[str]:
    """Write masses and positions of payloads into the models of a batch, and recompute derived fields.

    Args:
        batch: The batch of n models.
        payloads: The payloads of the scenario.
        values: Numbers by path; each a number, or an array (n,).

    Returns:
        Names of the fields that were written.
    """
    if not payloads:
        return frozenset()
    mass, inertia, pos = (batch.expand(name) for name in ("body_mass", "body_inertia", "body_pos"))
    for one in payloads:
        body = batch.model.body(f"{PREFIX}{one.name}").id
        number = {key: np.asarray(values[f"payload.{one.name}.{key}"], float) for key in PAYLOAD}
        mass[:, body] = number["mass"]
        inertia[:, body] = np.broadcast_to(0.4 * number["mass"] * number["radius"] ** 2, len(mass))[:, None]
        for k, axis in enumerate("xyz"):
            pos[:, body, k] = number[axis]
    batch.set_const()
    return frozenset({"body_mass", "body_inertia", "body_pos"})
