"""Obstacles: parameters, geometry for MuJoCo, and the surfaces that feet may stand on."""

from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.beam import Beam
from sweep.models.obstacles.corner import Corner
from sweep.models.obstacles.kerb import Kerb
from sweep.models.obstacles.ladder import Ladder
from sweep.models.obstacles.ledges import Ledges
from sweep.models.obstacles.plane import Plane
from sweep.models.obstacles.pole_ledge import PoleLedge
from sweep.models.obstacles.raft import Raft
from sweep.models.obstacles.two_balls import TwoBalls

OBSTACLES = {cls.kind: cls for cls in (Ball, Beam, Corner, Kerb, Ladder, Ledges, Plane, PoleLedge, Raft, TwoBalls)}
