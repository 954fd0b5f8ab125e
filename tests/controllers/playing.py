"""What a plan asks for without physics: every stage played through by inverse kinematics."""

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers.plan import Plan, reference
from sweep.controllers.tracker import joint_targets
from sweep.core.rotations import rotate
from sweep.formulas.leg import SIDE, fk
from sweep.metrics.geometry import leg_gap, link_points
from sweep.models.case import Case
from sweep.models.obstacles.surface import fixed_surface
from sweep.models.scene import mounts

U = np.linspace(0, 1, 41)


@jax.jit
def play(case: Case, plan: Plan) -> dict[str, jax.Array]:
    """For `U` of every stage (S, U): reach shortfall, clearance of the links, gap of legs, base, feet, joints."""
    robot = case.robot

    def at(k, u, begin):
        stance = reference(plan, k, u, *begin)
        joints, shortfall = joint_targets(robot, stance)
        knee = fk(SIDE, joints.at[:, 2].set(0.0), 0.0, robot.thigh, 0.0)
        foot = fk(SIDE, joints, 0.0, robot.thigh, robot.shin)
        legs = mounts(robot)[:, None] + jnp.stack([jnp.zeros((6, 3)), knee, foot], axis=1)
        legs = rotate(stance.quat[None, None], legs) + stance.position
        points = link_points(legs)
        depth = fixed_surface(case.obstacle, points).depth
        return stance, {
            "shortfall": shortfall.max(), "clearance": -depth.max() - robot.link_radius,
            "gap": leg_gap(legs) - 2 * robot.link_radius, "position": stance.position, "quat": stance.quat,
            "feet": stance.feet, "joints": joints,
        }  # fmt: skip

    def stage(begin, k):
        stance, seen = jax.vmap(lambda u: at(k, u, begin))(jnp.asarray(U, float))
        return (stance.feet[-1], stance.position[-1]), seen

    return jax.lax.scan(stage, (plan.start.feet, plan.start.position), jnp.arange(len(plan.names)))[1]


def played(case: Case) -> tuple[Plan, dict[str, jax.Array]]:
    """The case's own plan, and what it asks for."""
    plan = jax.jit(lambda case: case.manoeuvre.plan(case))(case)
    return plan, play(case, plan)
