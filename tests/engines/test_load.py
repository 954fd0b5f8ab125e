"""An obstacle's load in both engines: a buoy that heaves on its spring, beside a standing robot."""

import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jaxtyping import Array, Float

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.core.parameters import parameters, quantity
from sweep.engines import make_engine
from sweep.models.obstacles.plane import Plane
from sweep.models.obstacles.surface import FreeBodyState

HEAVE = 0.1


@parameters
class Buoy(Plane):
    """A body that a spring carries at z = 1 m, over ground that it does not touch."""

    mass: float = quantity(50.0, "kg", above=0)
    stiffness: float = quantity(2e4, "N/m", at_least=0)

    free_bodies = ("buoy",)
    contact_sites = ()

    def add_to(self, spec: mujoco.MjSpec, friction: float) -> None:
        """Ground and body."""
        super().add_to(spec, friction)
        body = spec.worldbody.add_body(name="buoy", explicitinertial=True, mass=self.mass, inertia=[1, 1, 1])
        body.ipos = [0, 0, 0]
        body.add_freejoint(name="buoy")

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Mass and inertia."""
        return {"body_mass": {"buoy": jnp.asarray(self.mass)}, "body_inertia": {"buoy": jnp.ones(3)}}

    def start(self) -> FreeBodyState:
        """Lifted."""
        still = jnp.zeros((1, 3))
        return FreeBodyState(jnp.array([[3.0, 0.0, 1.0 + HEAVE]]), jnp.array([[1.0, 0, 0, 0]]), still, still)

    def external_wrench(self, free: FreeBodyState) -> Float[Array, "1 6"]:
        """Spring, and what carries the weight."""
        lift = self.mass * GRAVITY - self.stiffness * (free.position[0, 2] - 1)
        return jnp.zeros((1, 6)).at[0, 2].set(lift)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mjx", "native"])
def test_buoy_heaves_and_its_work_is_counted(name):
    """At the frequency of spring and mass, as far at the end as at the start; all energy that it has is the load's."""
    exp = compose(["manoeuvre=stand"])
    case = dataclasses.replace(exp.case, obstacle=Buoy())
    engine = make_engine(dataclasses.replace(exp.settings, name=name, width=1), case, case, exp.thresholds)
    trace = engine.trace(case, case, np.zeros(1, int), 0)
    heave, t = trace.qpos[:, 27] - 1, trace.time
    begins = t < 1.0
    np.testing.assert_allclose(heave[begins], HEAVE * np.cos(20 * t[begins]), atol=0.03 * HEAVE)
    assert np.ptp(heave[t > t[-1] - 1.0]) == pytest.approx(2 * HEAVE, rel=0.01)
    assert trace.metrics["energy_gain_max_j"] < 0.02 * 0.5 * 2e4 * HEAVE**2
