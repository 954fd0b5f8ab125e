"""Plays a plan without physics: every stage by inverse kinematics."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers.plan import Plan
from sweep.models.case import Case
from sweep.planning.kinematic_margins import planned_margins, planned_stance

U = np.linspace(0, 1, 41)


@jax.jit
def play_plan(case: Case, plan: Plan) -> dict[str, jax.Array]:
    """Return margins, stance and joints of a plan at phases `U` of every stage, (S, U)."""

    def at(k, u):
        stance, joints, _ = planned_stance(case, plan, k, u)
        return planned_margins(case, plan, k, u)._asdict() | stance._asdict() | {"joints": joints}

    stages, moments = jnp.arange(len(plan.names)), jnp.asarray(U, float)
    return jax.lax.map(lambda k: jax.vmap(lambda u: at(k, u))(moments), stages)


def play_case(case: Case) -> tuple[Plan, dict[str, jax.Array]]:
    """Return a case's plan, and what `play_plan` returns for it."""
    plan = jax.jit(lambda case: case.manoeuvre.plan(case))(case)
    return plan, play_plan(case, plan)


def vary_lengths(case: Case, share: float, seed: int, heights: float = 0.0) -> Case:
    """Return the case with lengths of robot and obstacle off by up to `share`, and heights by up to `heights`."""
    random = np.random.default_rng(seed)

    def scaled(part, names, most):
        given = {name: getattr(part, name) for name in names if hasattr(part, name)}
        return replace(part, **{name: value * random.uniform(1 - most, 1 + most) for name, value in given.items()})

    robot = scaled(case.robot, ("body_length", "body_width", "body_height", "thigh", "shin"), share)
    obstacle = scaled(scaled(case.obstacle, ("radius",), share), ("height", "ledge_height"), heights)
    return replace(case, robot=robot, obstacle=obstacle)
