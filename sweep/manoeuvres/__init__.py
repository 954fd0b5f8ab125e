"""Manoeuvres of the hexapod: parameter classes that turn a belief into a plan, by their kind in the configuration."""

from sweep.manoeuvres.afloat.raft_cross import RaftCross
from sweep.manoeuvres.afloat.raft_stand import RaftStand
from sweep.manoeuvres.balancing.ball import BallBalance, BallDrive
from sweep.manoeuvres.balancing.ball_aside import BallAside
from sweep.manoeuvres.balancing.ball_climb import BallClimb
from sweep.manoeuvres.balancing.ball_descend import BallDescend
from sweep.manoeuvres.balancing.ball_ledges import BallLedges
from sweep.manoeuvres.balancing.ball_over import BallCrossing
from sweep.manoeuvres.balancing.ball_to_ball import BallToBall
from sweep.manoeuvres.balancing.ball_turn import BallTurn
from sweep.manoeuvres.balancing.beam import BeamCross, BeamWalk
from sweep.manoeuvres.climbing.corner import CornerClimb
from sweep.manoeuvres.climbing.corner_roof import CornerFull, CornerRoof
from sweep.manoeuvres.climbing.ladder import LadderClimb
from sweep.manoeuvres.climbing.pole import PoleClimb
from sweep.manoeuvres.climbing.pole_ledge import PoleToLedge
from sweep.manoeuvres.climbing.pole_round import PoleRound
from sweep.manoeuvres.climbing.pole_top import PoleTop
from sweep.manoeuvres.follow import Follow
from sweep.manoeuvres.walking.walk import Stand, Walk
from sweep.manoeuvres.walking.walk_kerb import WalkKerb
from sweep.manoeuvres.walking.waypoints import Waypoints

MANOEUVRES = {cls.kind: cls for cls in (
    Follow, Walk, Stand, Waypoints, WalkKerb, PoleClimb, PoleTop, PoleToLedge, PoleRound, BeamWalk, BeamCross,
    LadderClimb, CornerClimb, CornerRoof, CornerFull, BallBalance, BallDrive, BallTurn, BallAside, BallClimb,
    BallDescend, BallCrossing, BallLedges, BallToBall, RaftCross, RaftStand,
)}  # fmt: skip
