"""How many functions of the package a control tick passes through: a reader has to know all of them."""

import sys

import jax
import jax.numpy as jnp

from sweep.config.experiment import compose
from sweep.engines import closed_loop
from sweep.estimation.belief_update import LearnedState

MOST_FUNCTIONS, MOST_MODULES = 25, 8


def test_a_control_tick_of_a_walk_passes_through_few_functions():
    """Of a walk with exact sensors: functions with a name, from the engine's call of the controller on."""
    case = jax.tree.map(lambda x: jnp.asarray(x, float), compose(["scenario=walk_tripod"]).case)
    plan = case.manoeuvre.plan(case)
    arguments = jnp.zeros(()), jax.random.key(0), LearnedState(), "exact"
    loop = closed_loop.init_loop(case, case, plan, closed_loop.start_state(case, case, plan), *arguments)
    calls = set()

    def record(frame, event, argument):
        module, name = frame.f_globals.get("__name__", ""), frame.f_code.co_qualname
        if event == "call" and module.startswith("sweep.") and "<" not in name:
            calls.add((module, name))

    def tick(loop):
        sys.setprofile(record)
        try:
            return closed_loop.run_controller(case, case, plan, loop, jnp.int32(3), 0.01)
        finally:
            sys.setprofile(None)

    jax.make_jaxpr(tick)(loop)
    assert ("sweep.controllers.tracker", "step") in calls
    assert len(calls) <= MOST_FUNCTIONS
    assert len({module for module, _ in calls}) <= MOST_MODULES
