"""A free ball between two ledges of equal height, leaning on the wall of the near one (monograph 3.2).

World axes: x across the gap between the ledges, whose near wall is x = 0; z = 0 is the floor that the ball lies on.
"""

from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.frames import koenig_frame_number
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.charts import Chart, Number, level_ground_charts, stack_components
from sweep.models.obstacles.geoms import add_contact_pair
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, RollingResistance, Surface, critical_damping
from sweep.models.solids import SOIL, Box, Solid

if TYPE_CHECKING:
    import mujoco

FLOOR, BALL, NEAR_TOP, NEAR_WALL, FAR_TOP, FAR_WALL = range(6)
LEDGE_DEPTH_M, LEDGE_BREADTH_M = 4.0, 4.0  # m, of the ledges that are drawn; their surface has no end
NEAR_LEDGE_CHART, _ = level_ground_charts(lambda obstacle: (0.0, obstacle.height))
FAR_LEDGE_CHART, _ = level_ground_charts(lambda obstacle: (obstacle.width, obstacle.height))


def base_position_between_ledges(
    obstacle: "Ledges", side: float, unit: Number, depth: Number, ahead: Number, above: Number
) -> Float[Array, " 3"]:
    """Return a base position (m) `ahead` of the ball's centre and `above` half the ledges' height."""
    return stack_components(ahead * obstacle.radius, 0.0, 0.5 * obstacle.height + above * unit)


@parameters
class Ledges(Ball):
    """A ball of 100 kg between two ledges that are a tenth lower than its top; it starts at rest at the near wall."""

    charts: ClassVar = {
        **Ball.charts,
        "near": NEAR_LEDGE_CHART,
        "far": FAR_LEDGE_CHART,
        "between": Chart(("ahead", "above"), base_position_between_ledges, koenig_frame_number(0)),
    }
    kind: str = choice("ledges", "ledges")
    radius: float = quantity(0.8, "m", above=0)  # R, of the ball
    height: float = quantity(1.44, "m", above=0)  # of the ledges over the floor
    width: float = quantity(3.6, "m", above=0)  # from wall to wall
    gap: float = quantity(0.0, "m", at_least=0)  # from the ball to the near wall, at the start
    offset: float = quantity(0.0, "m")  # of the ball's centre to the left, at the start
    wall_grip: float = quantity(1.0, "-", at_least=0)  # multiplies the friction coefficient of ball and wall
    impact_damping: float = quantity(1.0, "-", at_least=0)  # of ball and wall, over the critical

    contact_sites = (("ball", 0), ("beside", 0))

    def add_to(self, spec: "mujoco.MjSpec", friction: float) -> None:
        """Add floor, ball and ledges to a MuJoCo spec."""
        super().add_to(spec, friction)
        for name in ("near_ledge", "far_ledge"):
            add_contact_pair(spec, name, "ball", friction * self.wall_grip, self.impact_damping)

    def start(self) -> FreeBodyState:
        """Return the start state: the ball at rest beside the near wall."""
        free = super().start()
        place = stack_components(self.radius + self.gap, self.offset, 0.0)
        return free._replace(position=free.position + place)

    @property
    def far_wall_x(self) -> Array | float:
        """Coordinate x (m) of the ball's centre when it touches the far wall."""
        return self.width - self.radius

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return floor, ball and ledges as solids; the ledges end where no robot reaches."""
        half = (LEDGE_DEPTH_M / 2, LEDGE_BREADTH_M / 2, self.height / 2)
        near = Box(name="near_ledge", position=(-LEDGE_DEPTH_M / 2, 0.0, half[2]), half=half, colour=SOIL)
        far = Box(name="far_ledge", position=(self.width + LEDGE_DEPTH_M / 2, 0.0, half[2]), half=half, colour=SOIL)
        return *super().solids(bodies), near, far

    def depth_behind_walls(self, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
        """Return how deep points (m) lie behind the near wall, and how deep behind the far wall."""
        return jnp.stack([-points[:, 0], points[:, 0] - self.width], axis=-1)

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: of floor, ball or ledge, whichever they are deepest in."""
        lies = super().surface(points, owner, bodies)
        assert lies.rolling is not None
        dtype, own = points.dtype, np.array(owner) >= 0
        beside = np.cumsum(own) == 2
        beyond = self.depth_behind_walls(points)
        far, wall = jnp.argmax(beyond, axis=-1), jnp.max(beyond, axis=-1)
        over = self.height - points[:, 2]
        sided = beside | (wall <= over)
        inside = jnp.where(beside, wall + self.radius, jnp.where(own, -jnp.inf, jnp.minimum(wall, over)))
        ledge = beside | (inside > lies.depth)
        outward = jnp.where(far == 0, 1.0, -1.0)[:, None] * jnp.array([1.0, 0.0, 0.0], dtype)
        normal = jnp.where(sided[:, None], outward, jnp.array([0.0, 0.0, 1.0], dtype))
        face = (NEAR_TOP + 2 * far + sided).astype(jnp.int32)
        rolls = jnp.where(beside, 0.0, 1.0).astype(dtype)
        return Surface(
            depth=jnp.where(ledge, inside, lies.depth),
            normal=jnp.where(ledge[:, None], normal, lies.normal),
            face=jnp.where(ledge, face, lies.face),
            body=jnp.where(ledge, -1, lies.body),
            friction_scale=jnp.where(beside, jnp.asarray(self.wall_grip, dtype), lies.friction_scale),
            rolling=RollingResistance(lies.rolling.radius, rolls * lies.rolling.roll, rolls * lies.rolling.spin),
            damping=jnp.asarray(beside, dtype) * self.impact_damping * critical_damping(self.mass),
        )
