"""How fast scenarios are simulated, free bodies among them: simulated seconds in the middle of a batch.

To run: `python bench/scenarios.py [WIDTH [NAME...]]`, from a checkout. Friction varies over the batch. `two_balls` is
`ball_balance` beside a second ball that the first one may touch. Overrides follow a name's comma:
`walk_tripod,engine.compiler=xla`.
"""

import sys
import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from sweep.core.parameters import parameters
from sweep.engines import devices, program_cache
from sweep.engines.mjx import Mjx
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.surface import Bodies, FreeState, Rolling, Surface
from sweep.study.config import compose

NAMES = ("walk_tripod", "pole_climb", "ball_balance", "two_balls")
SECONDS = 5  # of which the first is left out


@parameters
class TwoBalls(Ball):
    """A second ball like the first, half a radius away from it."""

    free_bodies = ("ball", "second")
    contact_sites = (("ball", 0), ("second", 1), ("touch", 0))

    def add_to(self, spec: mujoco.MjSpec, friction: float) -> None:
        """With the second ball."""
        super().add_to(spec, friction)
        spec.body("ball").add_site(name="touch")
        body = spec.worldbody.add_body(name="second", mass=self.mass, inertia=spec.body("ball").inertia)
        body.explicitinertial, body.ipos = True, [0, 0, 0]
        body.add_freejoint(name="second")
        body.add_site(name="second")

    def leaves(self) -> dict[str, dict[str, Array]]:
        """Of both."""
        return {field: {**values, "second": values["ball"]} for field, values in super().leaves().items()}

    def start(self) -> FreeState:
        """Side by side."""
        both = jax.tree.map(lambda x: jnp.concatenate([x, x]), super().start())
        return both._replace(position=both.position.at[1, 0].add(2.5 * self.radius))

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: Bodies) -> Surface:
        """The last site feels the second ball."""
        felt = super().surface(points, owner, bodies)
        if 1 not in owner or felt.rolling is None:
            return felt
        touch, off = np.arange(len(owner)) == len(owner) - 1, points - bodies.position[1]
        away = jnp.sqrt(jnp.sum(off**2, axis=-1) + 1e-12)
        roll, spin = (jnp.where(touch, 0.0, x) for x in (felt.rolling.roll, felt.rolling.spin))
        return felt._replace(
            depth=jnp.where(touch, 2 * self.radius - away, felt.depth),
            face=jnp.where(touch, 2, felt.face),
            normal=jnp.where(touch[:, None], off / away[:, None], felt.normal),
            body=jnp.where(touch, 1, felt.body),
            rolling=Rolling(felt.rolling.radius, roll, spin),
        )


def speed(name: str, width: int) -> str:
    """Physics steps a second of a batch of `width` rollouts (0: the device's best)."""
    scenario, *overrides = name.split(",")
    exp = compose([f"scenario={'ball_balance' if scenario == 'two_balls' else scenario}", *overrides])
    settings = replace(exp.settings, width=width or devices.default_width())
    case = replace(exp.case, obstacle=TwoBalls()) if scenario == "two_balls" else exp.case
    engine = Mjx(settings, case, case, exp.thresholds)
    world = replace(case, contact=replace(case.contact, friction=np.linspace(0.6, 1.0, settings.width)))
    with program_cache.unused():
        start = time.perf_counter()
        (world, belief, keys), programs, *_ = engine._prepare(world, case, np.zeros(settings.width, int), None, 1, None)
        compiled = time.perf_counter() - start
    plans, carry = programs.start(world, belief, keys)
    walls = []
    for k in range(SECONDS):
        start = time.perf_counter()
        carry, _ = programs.chunk(world, belief, plans, carry, k * engine._chunk_ticks, None)
        jax.block_until_ready(carry)
        walls.append(time.perf_counter() - start)
    rate = settings.width / settings.time_step / np.median(walls[1:])
    return f"{name}: {rate / 1e6:.3g} M env-steps/s, {settings.iterations} iterations, compile {compiled:.0f} s"


def main(width: str = "0", *names: str) -> None:
    """One line for each scenario."""
    devices.configure()
    for name in names or NAMES:
        print(speed(name, int(width)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
