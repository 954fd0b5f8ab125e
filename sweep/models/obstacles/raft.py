"""A raft on still water between two banks: monograph 4.1 to 4.3.

World axes: x across the water from the near bank, which ends at x = 0, to the far one; z = 0 is the level of the banks.
The water acts on the raft only, by the exact buoyancy of 4.1.1 and the drag of 4.1.2: it is no surface to stand on.
"""

from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.constants import GRAVITY
from sweep.core.parameters import choice, parameters, quantity
from sweep.core.rotations import logarithm, matrix
from sweep.formulas.drag import raft_drag
from sweep.formulas.raft_statics import buoyancy
from sweep.models.frames import body_frame_number
from sweep.models.obstacles.base import ObstacleDefaults
from sweep.models.obstacles.charts import ALONG_X, level_ground_charts, stack_components
from sweep.models.obstacles.geoms import RENDER_GROUP, add_contact_pair, add_solids
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, Surface, critical_damping, identity_poses
from sweep.models.solids import SOIL, Box, Solid

if TYPE_CHECKING:
    import mujoco

NEAR_BANK_FACE, FAR_BANK_FACE = range(2)
RAFT_FACE = 8  # the numbers of its faces are around this, those of the banks below
WATER_DENSITY = 1000.0  # kg/m^3
BANK_LENGTH_M = 4.0  # m, of each bank that is drawn; its surface has no end
CORNER_SIGNS = tuple((x, y) for x in (-1, 1) for y in (-1, 1))
WATER_DEPTH_M = 6.0  # m, that is drawn: what is translucent is drawn from far to near, by its middle
WATER_RGBA = (0.25, 0.5, 0.75, 0.45)
BANK_CHART, BANK_BASE_CHART = level_ground_charts(lambda obstacle: (0.0, 0.0))
DECK_CHART, DECK_BASE_CHART = level_ground_charts(
    lambda obstacle: (-obstacle.length / 2, obstacle.thickness / 2), frame=body_frame_number(0)
)
FAR_BANK_CHART, FAR_BANK_BASE_CHART = level_ground_charts(lambda obstacle: (obstacle.water_width, 0.0))


@parameters
class Raft(ObstacleDefaults):
    """A floating box on still water between two banks, by default 3.15 by 2.1 by 0.21 m, its deck level with the banks.

    At the start it rests, `gap` from the near bank.
    """

    kind: str = choice("raft", "raft")
    length: float = quantity(3.15, "m", above=0)  # 2 a, across the water
    width: float = quantity(2.1, "m", above=0)  # 2 b, along the banks
    thickness: float = quantity(0.21, "m", above=0)  # 2 d, of the box that floats
    density: float = quantity(300.0, "kg/m^3", above=0)  # of the raft; that of water is 1000
    water_width: float = quantity(5.46, "m", above=0)  # S, between the banks
    bank_height: float = quantity(0.1445, "m")  # of the banks over the water
    drag: float = quantity(500.0, "N*s^2/m^4", at_least=0)  # kappa_1, of water against a side's normal velocity
    viscosity: float = quantity(0.25, "N*s/m^3", at_least=0)  # kappa, of water along the bottom
    current: float = quantity(0.0, "m/s")  # of the water along the banks
    bank_grip: float = quantity(1.0, "-", at_least=0)  # multiplies the friction coefficient of feet on the banks
    side_grip: float = quantity(0.3, "-", at_least=0)  # the same of the raft's sides and the banks
    impact_damping: float = quantity(1.0, "-", at_least=0)  # of raft and bank, over the critical
    gap: float = quantity(0.003, "m", at_least=0)  # of the raft to the near bank at the start
    laden: float = quantity(0.0, "kg", at_least=0)  # under which it floats at the start: of what is put on it then
    mooring: float = quantity(0.0, "N/m", at_least=0)  # of ropes that hold the raft where it starts; 0: none

    # for feet, and for bases, from the edge of the near bank, of the deck, with which they go, and of the far bank
    charts: ClassVar = {
        "near": BANK_CHART, "deck": DECK_CHART, "far": FAR_BANK_CHART,
        "by_near": BANK_BASE_CHART, "on_deck": DECK_BASE_CHART, "by_far": FAR_BANK_BASE_CHART,
    }  # fmt: skip
    forward = ALONG_X
    free_bodies = ("raft",)
    contact_sites = tuple((f"edge{k}", 0) for k in range(4))

    @property
    def half_size(self) -> Float[Array, " 3"]:
        """Half length, half width and half thickness a, b, d (m)."""
        return 0.5 * stack_components(self.length, self.width, self.thickness)

    @property
    def mass(self) -> Array | float:
        """Mass M of the whole raft (kg)."""
        return self.density * self.length * self.width * self.thickness

    @property
    def landmarks(self) -> Float[Array, "1 3"]:
        """Point of the raft that the robot observes: the middle of the deck's corners (m, raft axes)."""
        return self.half_size[None] * jnp.array([0.0, 0.0, 1.0])

    def draught(self, load: Array | float = 0.0) -> Array | float:
        """Return the draught (m) of the level raft under a load (kg)."""
        return (self.mass + load) / (WATER_DENSITY * self.length * self.width)

    def add_to(self, spec: "mujoco.MjSpec", friction: float) -> None:
        """Add banks, raft and a rendered water surface to a MuJoCo spec."""
        import mujoco

        leaves = self.batched_model_fields()
        inertia = np.asarray(leaves["body_inertia"]["raft"], float)
        body = spec.worldbody.add_body(
            name="raft", pos=np.asarray(self.start().position[0]), ipos=[0, 0, 0], explicitinertial=True,
            mass=float(self.mass), inertia=inertia,
        )  # fmt: skip
        body.add_freejoint(name="raft")
        for name, _ in self.contact_sites:
            body.add_site(name=name, pos=np.asarray(leaves["site_pos"][name], float))
        *banks, deck = self.solids(identity_poses(1))
        add_solids(spec, banks, friction * self.bank_grip)
        add_solids(spec, [deck], friction, self.free_bodies)
        for bank in banks:
            add_contact_pair(spec, bank.name, deck.name, friction * self.side_grip, self.impact_damping)
        across, deep = self.water_width / 2, WATER_DEPTH_M / 2
        spec.worldbody.add_geom(
            name="water", type=mujoco.mjtGeom.mjGEOM_BOX, size=[across, BANK_LENGTH_M / 2, deep], rgba=WATER_RGBA,
            pos=[across, 0, -self.bank_height - deep], contype=0, conaffinity=0, group=RENDER_GROUP,
        )  # fmt: skip

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Return mass and inertia of a homogeneous box, and contact sites at its upright edges, as MuJoCo model
        fields."""
        half, mass = self.half_size, jnp.asarray(self.mass)
        sides = half * jnp.array([1.0, 1.0, 0.0])
        sites = zip(self.contact_sites, CORNER_SIGNS, strict=True)
        return {
            "body_mass": {"raft": mass},
            "body_inertia": {"raft": mass / 3 * (jnp.sum(half**2) - half**2)},
            "site_pos": {name: sides * jnp.array([*corner, 0.0]) for (name, _), corner in sites},
        }

    def start(self) -> FreeBodyState:
        """Return the start state of the raft: afloat and at rest."""
        half, still = self.half_size, jnp.zeros((1, 3))
        x, z = half[0] + self.gap, half[2] - self.draught(self.laden) - self.bank_height
        return FreeBodyState(
            jnp.stack([x, jnp.zeros_like(x), z])[None], jnp.array([[1.0, 0.0, 0.0, 0.0]]), still, still
        )

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return banks and raft as solids; the banks end where no robot reaches."""
        bank = {"half": (BANK_LENGTH_M / 2, BANK_LENGTH_M / 2, 0.5), "colour": SOIL}
        return (
            Box(name="near_bank", position=(-BANK_LENGTH_M / 2, 0.0, -0.5), **bank),
            Box(name="far_bank", position=(self.water_width + BANK_LENGTH_M / 2, 0.0, -0.5), **bank),
            Box(name="deck", position=bodies.position[0], rotation=bodies.rotation[0], body=0,
                half=(self.length / 2, self.width / 2, self.thickness / 2)),
        )  # fmt: skip

    def external_wrench(self, free: FreeBodyState) -> Float[Array, "1 6"]:
        """Return the wrench of buoyancy, drag in the current, and mooring ropes on the raft: monograph 4.1.

        It assumes that the whole bottom is wet and the deck is dry.
        """
        a, b, d = self.half_size
        rotation, place = matrix(free.quat[0]), free.position[0]
        depth = -self.bank_height - place[2]
        lift = buoyancy(rotation[2], depth, a, b, d, WATER_DENSITY * GRAVITY)
        flow = free.velocity[0] - self.current * jnp.array([0.0, 1.0, 0.0])
        waterline = jnp.clip(depth, -d, d)
        drag = raft_drag(rotation.T @ flow, rotation.T @ free.turn[0], a, b, d, waterline, self.viscosity, self.drag)
        ropes = self._ropes(free)
        force, torque = rotation @ (lift.F + drag.R), rotation @ (lift.M + drag.N)
        return jnp.concatenate([force, torque])[None] + ropes

    def _ropes(self, free: FreeBodyState) -> Float[Array, " 6"]:
        """Wrench of ropes that hold the raft's position and heading, critically damped."""
        a, b, _ = self.half_size
        start, damping = self.start(), 2 * jnp.sqrt(self.mooring * self.mass)
        heading = jnp.array([0.0, 0.0, 1.0]) * (a**2 + b**2) / 3
        plane = jnp.array([1.0, 1.0, 0.0])
        force = self.mooring * (free.position[0] - start.position[0]) + damping * free.velocity[0]
        torque = self.mooring * logarithm(free.quat[0]) + damping * free.turn[0]
        return -jnp.concatenate([plane * force, heading * torque])

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: of bank or raft, whichever contains the point more deeply."""
        dtype, own = points.dtype, np.array(owner) >= 0
        half = self.half_size.astype(dtype)
        beyond = jnp.stack([-points[:, 0], points[:, 0] - self.water_width], axis=-1)  # of each wall
        bank = jnp.argmax(beyond, axis=-1)  # NEAR or FAR
        wall, over = jnp.max(beyond, axis=-1), -points[:, 2]
        sided = own | (wall <= over)
        inside = jnp.minimum(wall, jnp.where(own, wall, over))
        to_water = jnp.where(bank == NEAR_BANK_FACE, 1.0, -1.0)[:, None] * jnp.array([1.0, 0.0, 0.0], dtype)
        up = jnp.array([0.0, 0.0, 1.0], dtype)

        local = (points - bodies.position[0]) @ bodies.rotation[0]
        within = half - jnp.abs(local)
        side = (jnp.arange(3) == jnp.argmin(within, axis=-1)[:, None]) * jnp.sign(local)  # outward, own axes
        outward, depth = side @ bodies.rotation[0].T, jnp.min(within, axis=-1)
        on_raft = ~own & (depth > inside)
        return Surface(
            depth=jnp.where(on_raft, depth, inside),
            normal=jnp.where(on_raft[:, None], outward, jnp.where(sided[:, None], to_water, up)),
            face=jnp.where(on_raft, RAFT_FACE + side @ jnp.array([2.0, 3.0, 1.0]), 2 * bank + sided).astype(jnp.int32),
            body=jnp.where(on_raft, 0, -1).astype(jnp.int32),
            friction_scale=jnp.where(own, self.side_grip, jnp.where(on_raft, 1.0, self.bank_grip)).astype(dtype),
            damping=jnp.asarray(own, dtype) * self.impact_damping * critical_damping(self.mass / 2),
        )
