"""Base of manoeuvres between the floor and a free ball: climbing it and coming down.

World axes as in `ball`: the robot faces x. Places in their plan files are relative to the ball's centre, in its Koenig
frame and in units of its radius R.
"""

import math
from collections.abc import Mapping

from sweep.controllers.tracker import FeedbackLaw
from sweep.core.parameters import count, parameters, quantity
from sweep.manoeuvres.balancing.ball import BallDrive, OnBallManoeuvre
from sweep.manoeuvres.balancing.parts import FeedbackLawManoeuvre, SettleBallLaw

CALM = "calm"  # law of steps that stop the ball


@parameters
class BesideBallManoeuvre(OnBallManoeuvre, FeedbackLawManoeuvre):
    """Base class of manoeuvres between floor and ball top: how feet grip the ball, and the law that stops it.

    These steps are tripods of `ball_drive` at v_d = 0, at most `calm` of them.
    """

    calm: int = count(15, at_least=1, at_most=100)  # largest number of steps that stop the ball
    # speed below which the ball needs no further step; 0: all steps are made
    calm_speed: float = quantity(0.01, "m/s", at_least=0)
    step_time: float = quantity(0.9, "s", above=0, at_most=20)  # time of these steps
    speed_gain: float = quantity(0.6, "s", at_least=0)  # k_v, gain of pushes that stop the ball
    aside_gain: float = quantity(0.4, "-", at_least=0)  # k_1, gain on the ball's distance from its path now
    aside_gain_before: float = quantity(0.3, "-", at_least=0)  # k_2, gain on that distance a step before
    # depth of feet on the ball below where they are measured
    press: float = quantity(1.6e-3, "m", at_least=0, at_most=0.05)
    squeeze: float = quantity(3.8e-3, "m", at_least=0, at_most=0.05)  # the same towards the middle plane
    ease: float = quantity(0.15, "s", above=0)  # time in which feet move over to new footholds
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    @property
    def stopping_drive(self) -> BallDrive:
        """The feedback law that stops the ball by steps on it."""
        return self.make_ball_drive(steps=self.calm, speed=0.0, step_time=self.step_time, speed_gain=self.speed_gain,
                           aside_gain=self.aside_gain, aside_gain_before=self.aside_gain_before)  # fmt: skip

    @property
    def feedback_laws(self) -> Mapping[str, FeedbackLaw]:
        """Feedback laws by name: the one that stops the ball."""
        return {CALM: SettleBallLaw(self.stopping_drive, self.calm_speed, math.inf)}
