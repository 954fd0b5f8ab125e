"""Disturbances of user models: pushes on bodies, and delayed commands."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sweep.contract.system import Parameter
from sweep.core.errors import require_choice
from sweep.core.parameters import quantity
from sweep.systems.mujoco_model.motors import MotorLimits
from sweep.systems.mujoco_model.named_groups import iterate_named_entries

PUSH_PARAMETERS: Mapping[str, Parameter] = {  # numbers of a push
    "impulse": quantity(0.0, "N*s"),  # delivered evenly within `length`
    "force": quantity(0.0, "N"),  # constant force during `length`, in addition to the impulse
    "direction": quantity(0.0, "rad"),  # in the horizontal plane, from the world's x axis
    "elevation": quantity(0.0, "rad"),  # above the horizontal plane
    "start": quantity(1.0, "s", at_least=0),  # from the start of the rollout
    "length": quantity(0.05, "s", above=0),  # duration of the push
    "spread": quantity(0.0, "s", at_least=0),  # the push begins at a random time from `start` to `start + spread`
}


class PushedBody(NamedTuple):
    """A push of a scenario: its name, and the body at whose centre of mass it acts."""

    name: str
    body: str


class Disturbances(NamedTuple):
    """Pushes, command delays and motor limits of n rollouts."""

    delay: Any  # (n,) physics steps by which commands are late, whole
    force: Any  # (n, p, 3) N, of each push
    start: Any  # (n, p) s
    end: Any  # (n, p) s
    motors: MotorLimits | None = None  # None where no joint has a motor

    def mean_push_forces(self, first: Any, count: int, step: float) -> Any:
        """Return the mean force (N) of each push over each physics step, so that its impulse is exact.

        Args:
            first: Number of the first step: one, or one for each rollout (n,).
            count: Number of steps s.
            step: Length of a step, s.

        Returns:
            Forces (n, s, p, 3) in N, in world axes.
        """
        xp = self.force.__array_namespace__()
        begin = step * (xp.asarray(first)[..., None] + xp.arange(count))[..., None]
        start, end = self.start[:, None], self.end[:, None]
        share = xp.clip(xp.minimum(end, begin + step) - xp.maximum(start, begin), 0, step) / step
        return share[..., None] * self.force[:, None]


def parse_pushes(config: Any, bodies: list[str]) -> tuple[tuple[PushedBody, ...], dict[str, Any]]:
    """Return the pushes in a configuration, and their numeric parameters by path. Raises `InputError`.

    Args:
        config: For each name a mapping with `body` and keys of `PUSH_PARAMETERS`.
        bodies: Bodies of the model.
    """
    pushes, numbers = [], {}
    such = "pushes by name, such as {kick: {body: trunk}}"
    for name, said in iterate_named_entries("push", config, such, ("body", *PUSH_PARAMETERS), ("body",)):
        require_choice(said["body"], bodies, f"push.{name}.body: {said['body']}")
        pushes.append(PushedBody(name, str(said["body"])))
        numbers |= {f"push.{name}.{key}": value for key, value in said.items() if key != "body"}
    return tuple(pushes), numbers


def make_disturbances(pushes: tuple[PushedBody, ...], values: Mapping[str, Any], uniform: np.ndarray) -> Disturbances:
    """Make the pushes and command delays that act on n rollouts.

    Args:
        pushes: The pushes of the scenario.
        values: `noise.action_delay`, and the numbers of the pushes by path; numbers, or arrays (n,).
        uniform: Even random numbers (n, p) from 0 to 1.
    """
    n = len(uniform)

    def rows(name: str) -> np.ndarray:  # (n, p)
        every = [np.broadcast_to(values[f"push.{one.name}.{name}"], (n,)) for one in pushes]
        return np.stack(every, axis=1).astype(float) if every else np.zeros((n, 0))

    turn, rise, start = rows("direction"), rows("elevation"), rows("start") + rows("spread") * uniform
    size = rows("force") + rows("impulse") / rows("length")
    along = np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], axis=-1)
    delay = np.broadcast_to(np.rint(values["noise.action_delay"]).astype(np.int32), (n,))
    return Disturbances(delay, size[..., None] * along, start, start + rows("length"))


def delay_commands(past: Any, commands: Any, delay: Any) -> tuple[Any, Any]:
    """Return the delayed commands for the physics steps of a tick, and the commands to keep for the next tick.

    Args:
        past: Commands (n, d, nu) of the d steps before, the last one last.
        commands: Commands (n, s, nu) of the tick.
        delay: Whole steps (n,), at most d.
    """
    xp = commands.__array_namespace__()
    every, room, steps = xp.concatenate([past, commands], axis=1), past.shape[1], commands.shape[1]
    index = room + xp.arange(steps)[None] - delay[:, None]
    return xp.take_along_axis(every, index[..., None], axis=1), every[:, steps:]
