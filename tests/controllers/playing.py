"""What a plan asks for without physics: every stage played through by inverse kinematics."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers.plan import Plan
from sweep.models.case import Case
from sweep.tune.planned import margins, posed

U = np.linspace(0, 1, 41)


@jax.jit
def play(case: Case, plan: Plan) -> dict[str, jax.Array]:
    """For `U` of every stage (S, U): the plan's margins, its stance and its joints."""

    def at(k, u):
        stance, joints, _ = posed(case, plan, k, u)
        return margins(case, plan, k, u)._asdict() | stance._asdict() | {"joints": joints}

    stages, moments = jnp.arange(len(plan.names)), jnp.asarray(U, float)
    return jax.lax.map(lambda k: jax.vmap(lambda u: at(k, u))(moments), stages)


def played(case: Case) -> tuple[Plan, dict[str, jax.Array]]:
    """The case's own plan, and what it asks for."""
    plan = jax.jit(lambda case: case.manoeuvre.plan(case))(case)
    return plan, play(case, plan)


def varied(case: Case, share: float, seed: int, heights: float = 0.0) -> Case:
    """`case` with the lengths of robot and obstacle off by up to `share`, the obstacle's heights by `heights`."""
    random = np.random.default_rng(seed)

    def scaled(part, names, most):
        given = {name: getattr(part, name) for name in names if hasattr(part, name)}
        return replace(part, **{name: value * random.uniform(1 - most, 1 + most) for name, value in given.items()})

    robot = scaled(case.robot, ("body_length", "body_width", "body_height", "thigh", "shin"), share)
    obstacle = scaled(scaled(case.obstacle, ("radius",), share), ("height", "ledge_height"), heights)
    return replace(case, robot=robot, obstacle=obstacle)
