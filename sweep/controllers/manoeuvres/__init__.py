"""Manoeuvres: parameters and the plan that follows from them and from what is believed of the world."""

from sweep.controllers.manoeuvres.ball import BallBalance, BallDrive
from sweep.controllers.manoeuvres.beam import BeamCross, BeamWalk
from sweep.controllers.manoeuvres.corner import CornerClimb
from sweep.controllers.manoeuvres.corner_roof import CornerFull, CornerRoof
from sweep.controllers.manoeuvres.pole import PoleClimb
from sweep.controllers.manoeuvres.pole_descent import PoleDescent
from sweep.controllers.manoeuvres.pole_ledge import PoleLedge
from sweep.controllers.manoeuvres.pole_return import PoleReturn
from sweep.controllers.manoeuvres.pole_round import PoleRound
from sweep.controllers.manoeuvres.pole_top import PoleTop
from sweep.controllers.manoeuvres.walk import Stand, Walk
from sweep.controllers.manoeuvres.waypoints import Waypoints

MANOEUVRES = {
    "walk": Walk,
    "stand": Stand,
    "waypoints": Waypoints,
    "pole_climb": PoleClimb,
    "pole_top": PoleTop,
    "pole_ledge": PoleLedge,
    "pole_descent": PoleDescent,
    "pole_return": PoleReturn,
    "pole_round": PoleRound,
    "beam_walk": BeamWalk,
    "beam_cross": BeamCross,
    "corner_climb": CornerClimb,
    "corner_roof": CornerRoof,
    "corner_full": CornerFull,
    "ball_balance": BallBalance,
    "ball_drive": BallDrive,
}
