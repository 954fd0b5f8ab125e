"""Walking on to a kerb by tripod: the steps of level ground, lifted to the ground's height."""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.plan import STAND, Plan, Stage
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.manoeuvres.walking.walk import Walk
from sweep.models.case import Case
from sweep.models.obstacles.kerb import Kerb
from sweep.planning.compile_plan import compile_plan


@parameters
class WalkKerb(Walk):
    """Walk straight on to a kerb, with a level base that rises as it passes the edge."""

    kind: str = choice("walk_kerb", "walk_kerb")
    steps: int = count(11, at_least=0, at_most=200)  # number of swings, t* each
    lift_ratio: float = quantity(0.12, "a_r", above=0, at_most=0.5)  # d_y, height of a swing, also over the edge
    # from the centres of the front feet's cycles to the edge, at the start
    distance: float = quantity(0.3, "m", above=0)
    margin: float = quantity(0.06, "m", at_least=0)  # least distance of footholds from the edge

    needs = (Kerb,)

    def plan(self, belief: Case) -> Plan:
        """Return the plan: stand, make `steps` swings on to the kerb and on, stand."""
        length, height = belief.robot.body_length, belief.obstacle_of_type(Kerb).height

        def foothold(foot: Float[Array, " 3"]) -> Float[Array, " 3"]:
            x = jnp.where(foot[0] > 0, jnp.maximum(foot[0], self.margin), jnp.minimum(foot[0], -self.margin))
            return jnp.stack([x, foot[1], foot[2] + jnp.where(x > 0, height, 0.0)])

        def lifted(stage: Stage) -> Stage:
            assert stage.position is not None
            share = jnp.clip(stage.position[0] / length + 0.5, 0.0, 1.0)  # front hips over the edge: 0; rear hips: 1
            swing = {leg: foothold(foot) for leg, foot in stage.swing.items()}
            return replace(stage, swing=swing, position=stage.position.at[2].add(share * height))

        start, level = self.swing_stages(belief, lambda centres: jnp.max(centres[:, 0]) + self.distance)
        stages = [Stage("stand", STAND), *map(lifted, level), Stage("halt", 2 * STAND)]
        return compile_plan(start, stages, self.patience)
