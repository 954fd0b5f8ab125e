"""What manoeuvres between a free ball and the floor have in common: climbing it and coming down.

World axes as in `ball`: the robot faces x. Places of their plans are seen from the ball's centre, in its Koenig frame
and in units of its radius R.
"""

import math
from collections.abc import Mapping

from sweep.controllers.manoeuvres.balancing.ball import BallDrive, OnBall
from sweep.controllers.manoeuvres.balancing.parts import ByParts, SettleBall
from sweep.controllers.tracker import Guided
from sweep.core.parameters import count, parameters, quantity

CALM = "calm"  # law of steps that stop the ball


@parameters
class BesideBall(OnBall, ByParts):
    """Their grip, and steps that stop the ball.

    These are tripods of `ball_drive` at v_d = 0, as many of `calm` as the ball needs.
    """

    calm: int = count(15, at_least=1, at_most=100)  # steps at most
    calm_speed: float = quantity(0.01, "m/s", at_least=0)  # of a ball that needs no further step; 0: all are made
    step_time: float = quantity(0.9, "s", above=0, at_most=20)  # of these steps
    speed_gain: float = quantity(0.6, "s", at_least=0)  # k_v, of pushes that stop the ball
    aside_gain: float = quantity(0.4, "-", at_least=0)  # k_1, of how far the ball is aside now
    aside_gain_before: float = quantity(0.3, "-", at_least=0)  # k_2, of how far it was aside a step before
    press: float = quantity(1.6e-3, "m", at_least=0, at_most=0.05)  # feet on the ball deeper than they are measured
    squeeze: float = quantity(3.8e-3, "m", at_least=0, at_most=0.05)  # the same to the middle
    ease: float = quantity(0.15, "s", above=0)  # in which feet go over to where they are measured
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    @property
    def calm_drive(self) -> BallDrive:
        """The steps that stop the ball."""
        return self.make_drive(steps=self.calm, speed=0.0, step_time=self.step_time, speed_gain=self.speed_gain,
                           aside_gain=self.aside_gain, aside_gain_before=self.aside_gain_before)  # fmt: skip

    @property
    def parts(self) -> Mapping[str, Guided]:
        """The calming steps, by their law."""
        return {CALM: SettleBall(self.calm_drive, self.calm_speed, math.inf)}
