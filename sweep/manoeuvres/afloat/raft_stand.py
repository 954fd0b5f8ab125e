"""Standing and walking about on a raft: how far from its middle a robot may go (monograph 4.1.25-4.1.28)."""

from typing import ClassVar

import jax.numpy as jnp

from sweep.controllers.plan import CYCLE_B_SMOOTH, REGRIP, Plan, Stage
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.manoeuvres.afloat.statics import require_floating
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.manoeuvres.walking.walk import level_stance
from sweep.models.case import Case, Manoeuvre
from sweep.models.frames import body_frame_number
from sweep.models.obstacles.charts import stack_components
from sweep.models.obstacles.raft import Raft
from sweep.models.posture import Stance
from sweep.planning.compile_plan import compile_plan
from sweep.planning.gaits import TRIPOD

DECK = (body_frame_number(0),) * 6


@parameters
class RaftStand(Manoeuvre):
    """Walk by tripods from the raft's middle to another place on its deck, and stand there.

    Ratios are to the body length a_r.
    """

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("raft_stand", "raft_stand")
    ahead: float = quantity(0.5, "m")  # final place of the robot ahead of the raft's middle
    aside: float = quantity(0.0, "m")  # final place to the left of it
    steps: int = count(6, at_least=2, at_most=40)  # number of swings of a tripod to that place
    rest: float = quantity(4.0, "s", above=0)  # time of standing there
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, height of the hips above the deck
    spread_ratio: float = quantity(0.3, "a_r", at_least=0, at_most=2)  # distance of feet outward from their hips
    lift_ratio: float = quantity(0.06, "a_r", above=0, at_most=0.5)  # height of a swing
    swing: float = quantity(1.3, "s", above=0, at_most=10)  # time of a swing
    deepening: float = quantity(1e-3, "m", at_least=0, at_most=0.05)  # depth of footholds below the deck
    observer: float = quantity(0.0, "s", at_least=0)  # time constant of the filter of the raft's measured pose
    ease: float = quantity(0.15, "s", above=0)  # time in which feet move over to new footholds
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (Raft,)

    def plan(self, belief: Case) -> Plan:
        """Return the plan: stand on the raft, walk to the given place on its deck, stand.

        Raises:
            InputError: the raft would capsize or sink under the robot in its middle, all plain numbers.
        """
        raft, length = belief.obstacle_of_type(Raft), belief.robot.body_length
        require_floating(belief, (0.0, 0.0))
        free = raft.start()
        stance, centres = level_stance(belief, self.spread_ratio * length, self.height_ratio * length)
        deck = free.position[0] + jnp.array([0.0, 0.0, 1.0]) * raft.half_size[2]
        start = Stance(deck + stance.feet, deck + stance.position, stance.quat)
        displacement = stack_components(self.ahead, self.aside, 0.0)
        up, down = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.0, 0.0, -1.0]) * self.deepening
        base = stance.position + raft.half_size[2] * up
        stages = [Stage("stand", 1.0, position=base, onset=REGRIP, foot_frames=DECK, base_frame=body_frame_number(0))]
        for k in range(self.steps + 1):
            base = base + displacement / self.steps if k < self.steps else base
            ahead = displacement / self.steps / 2 if k < self.steps - 1 else jnp.zeros(3)
            swing = {leg: base + centres[leg - 1] + ahead + down for leg in TRIPOD[k % 2]}
            stages.append(
                Stage(f"walk.{k + 1}", self.swing, swing, CYCLE_B_SMOOTH, self.lift_ratio * length, position=base,
                      rates=(0.0, 0.0), onset=REGRIP, foot_frames=DECK, base_frame=body_frame_number(0))
            )  # fmt: skip
        stages.append(Stage("rest", self.rest, onset=REGRIP, foot_frames=DECK, base_frame=body_frame_number(0)))
        return compile_plan(start, stages, self.patience, ease=self.ease, free=free, afloat=True)
