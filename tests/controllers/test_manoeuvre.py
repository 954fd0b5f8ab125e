"""What engines, metrics and commands ask of a manoeuvre: the fields of its base class."""

import pytest

from sweep.core.parameters import choice, parameters
from sweep.manoeuvres import MANOEUVRES
from sweep.manoeuvres.balancing.ball import BallDrive
from sweep.models.case import Manoeuvre, complete_manoeuvre_class

IN_STAGES = {"ball_climb", "ball_descend", "ball_ledges", "ball_over", "ball_to_ball", "raft_cross"}
DRIVES = {"ball_drive", "ball_turn"}
GUIDED = IN_STAGES | DRIVES | {"ball_aside", "ball_balance"}
POLE = {"pole_climb", "pole_ledge", "pole_top"}
CLIMBS = POLE | {"corner_climb", "corner_full", "corner_roof", "follow", "ladder_climb"}
FIELDS = {
    "is_guided": GUIDED,
    "ends_stages": IN_STAGES,
    "drives_body": DRIVES,
    "observer": GUIDED | {"follow", "ladder_climb", "raft_stand"},
    "default_plan_name": CLIMBS | IN_STAGES | {"pole_round"},
    "two_way": CLIMBS,
    "plans_forces": CLIMBS | {"pole_round"},
}


@pytest.mark.parametrize("name", FIELDS)
def test_fields_of_manoeuvres(name):
    default = getattr(Manoeuvre, name)
    assert {kind for kind, cls in MANOEUVRES.items() if getattr(cls(), name) != default} == FIELDS[name]


def test_a_class_of_its_own_gets_the_fields_that_it_lacks():
    """A user's manoeuvre need not inherit: it is guided if it has `guide`."""

    @parameters
    class Borrowed:
        kind: str = choice("borrowed", "borrowed")
        needs, goal, plan = BallDrive.needs, {}, BallDrive.plan
        init_memory, guide = BallDrive.init_memory, BallDrive.guide

    complete_manoeuvre_class(Borrowed)
    fields = "is_guided", "ends_stages", "drives_body", "observer", "default_plan_name"
    assert [getattr(Borrowed(), name) for name in fields] == [True, False, False, None, None]
