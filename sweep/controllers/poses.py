"""Going through the poses of a calibration, where a manoeuvre starts."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from sweep.controllers import calibration
from sweep.controllers.assembly import assemble
from sweep.controllers.manoeuvres.goals import ON_ITS_FEET
from sweep.controllers.plan import KEEP, SMOOTH, Plan, Stage
from sweep.core.parameters import choice, parameters
from sweep.core.rotations import conjugate, logarithm, multiply
from sweep.models.case import Case, Manoeuvre

MOVE, HOLD = 1.0, 0.6  # s, from pose to pose, and in each: soft drives are 0.14 s late


@parameters
class Poses:
    """Each pose is reached smoothly, and held; at the end the robot stands as at the start."""

    goal: ClassVar = ON_ITS_FEET
    needs: ClassVar = ()
    before: Manoeuvre  # which the robot does after it
    kind: str = choice("poses", "poses")

    def plan(self, belief: Case) -> Plan:
        """The poses one after the other, from all feet on the ground."""
        start = self.before.plan(replace(belief, manoeuvre=self.before)).start
        position, quat = calibration.poses(belief.control, start)
        turn = logarithm(multiply(jnp.roll(quat, -1, axis=0), conjugate(quat)))
        stages = []
        for k in range(len(position)):
            stages.append(Stage(f"calibrate.hold{k}", HOLD, onset=KEEP))
            to = (k + 1) % len(position)
            way = {"position": position[to], "turn": turn[k], "pace": SMOOTH}
            stages.append(Stage(f"calibrate.to{to}", MOVE, onset=KEEP, **way))
        stages.append(Stage("calibrate.rest", HOLD, onset=KEEP))
        return assemble(start, stages, 0.0)


def held(time: float) -> int:
    """Which pose is in the second half of being held at `time` (s); -1 for none."""
    pose, since = divmod(time, MOVE + HOLD)
    return int(pose) if HOLD / 2 < since <= HOLD else -1
