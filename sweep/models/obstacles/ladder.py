"""A ladder that leans on the wall of a ledge and is held by friction alone (monograph 2.5).

World axes: the wall is the plane y = 0, the ledge behind it, and the ladder's plane is parallel to x. The ladder's own
axes: x as the world's, y down along its rails, z out of its plane, away from the wall; they are the world's where it
lies flat on the floor. The book's xi, eta, zeta are x, y, z; its e_l is -y and its e_n is z of the ladder.
"""

from typing import TYPE_CHECKING, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import matrix
from sweep.models.frames import body_frame_number
from sweep.models.obstacles.base import ObstacleDefaults
from sweep.models.obstacles.charts import ALONG_Y, Chart, Number, approach_charts, level_ground_charts, stack_components
from sweep.models.obstacles.geoms import add_contact_pair, add_solids, hidden_geom_options
from sweep.models.obstacles.surface import FOOT_RADIUS, BodyPoses, FreeBodyState, Surface, identity_poses
from sweep.models.solids import SOIL, Box, HalfSpace, Solid

if TYPE_CHECKING:
    import mujoco

FLOOR, WALL, LEDGE, BARS = range(4)  # faces; each bar has six from BARS on
LEDGE_HALF_DEPTH_M = 1.5  # m, half of how far the ledge reaches back
SIDES = (-1.0, 1.0)
LEDGE_HEIGHT_RUNGS = 6.47  # rungs, of the ledge along the nominal ladder
EXTRA_BASE_COORDINATES = ("more_ahead", "more_out", "more_pitch")
LEDGE_CHART, _ = level_ground_charts(lambda obstacle: (0.0, obstacle.ledge_height), ALONG_Y)


def rung_point(
    obstacle: "Ladder", side: float, unit: Number, depth: Number, rung: Number, aside: Number, out: Number
) -> Float[Array, " 3"]:
    """Return a foothold on a rung (m), from the rung's number and distances `aside` and `out` of the ladder's plane."""
    return stack_components(side * aside * unit, obstacle.y_at_rung(rung) + depth, out * obstacle.rung_depth)


def base_position_along_ladder(
    obstacle: "Ladder", side: float, unit: Number, depth: Number, up: Number, out: Number, pitch: Number,
    more_ahead: Number = 0.0, more_out: Number = 0.0, more_pitch: Number = 0.0,
) -> Float[Array, " 3"]:  # fmt: skip
    """Return a base position (m) `up` along the ladder (in rungs) and `out` of the ladder's plane.

    `more_ahead`, `more_out` and `more_pitch` move the base with the ladder's `ledge_extra_height`: shares of it along
    the ladder and out of its plane, and shares of the lean for every unit of it.
    """
    return stack_components(
        0.0,
        obstacle.y_at_rung(up) - more_ahead * obstacle.ledge_extra_height,
        out * unit + more_out * obstacle.ledge_extra_height,
    )


def base_position_over_ledge(
    obstacle: "Ladder", side: float, unit: Number, depth: Number, ahead: Number, above: Number, pitch: Number,
    more_ahead: Number = 0.0, more_out: Number = 0.0, more_pitch: Number = 0.0,
) -> Float[Array, " 3"]:  # fmt: skip
    """Return a base position (m) `ahead` of the ledge's edge and `above` it; `more_...` adapt it to a higher ledge."""
    out, back = more_out * obstacle.ledge_extra_height, (1 - more_ahead) * obstacle.ledge_extra_height
    angle = jnp.asarray(base_pitch(obstacle, unit, ahead, above, pitch, more_ahead, more_out, more_pitch))
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    y, z = back * cos + out * sin - ahead * unit, out * cos - back * sin + above * unit
    return stack_components(0.0, y, obstacle.ledge_height + z)


def base_pitch(
    obstacle: "Ladder", unit: Number, one: Number, other: Number, pitch: Number,
    more_ahead: Number = 0.0, more_out: Number = 0.0, more_pitch: Number = 0.0,
) -> Number:  # fmt: skip
    """Return the pitch (rad, nose up) of a base along the ladder or over the ledge; `pitch` is a share of the lean."""
    return (pitch + more_pitch * obstacle.ledge_extra_height / unit) * obstacle.lean


class LadderBars(NamedTuple):
    """Boxes of a ladder's two rails, then of its rungs from the lowest up, in the ladder's axes."""

    centre: Float[Array, "n 3"]  # m, from the mass centre
    half: Float[Array, "n 3"]  # m


@parameters
class Ladder(ObstacleDefaults):
    """A ladder of 25 kg with six rungs that leans at 75 degrees on a ledge 2.625 m high, free to slide and to turn.

    Its lower ends touch the floor and its upper ends the wall. At the start it hangs free of both and falls."""

    kind: str = choice("ladder", "ladder")
    ledge_height: float = quantity(2.625, "m", above=0)  # h1, of the ledge above the floor
    length: float = quantity(2.625, "m", above=0)  # l, of the rails
    lean: float = quantity(1.3089969389957472, "rad", at_least=0.5, at_most=1.55)  # phi, of the ladder and the floor
    mass: float = quantity(25.0, "kg", above=0)  # of rails and rungs together
    rungs: int = count(6, at_least=1, at_most=30)  # between the two rails
    # from the top of one rung to the next one's, and from the rails' lower ends to the first
    rung_step: float = quantity(0.42, "m", above=0)
    width: float = quantity(1.6, "m", above=0)  # between the rails
    rail_breadth: float = quantity(0.04, "m", above=0)  # of a rail, across the ladder
    rail_depth: float = quantity(0.08, "m", above=0)  # of a rail, out of the ladder's plane
    rung_height: float = quantity(0.04, "m", above=0)  # of a rung, along the rails
    rung_depth: float = quantity(0.06, "m", above=0)  # of a rung, out of the ladder's plane
    floor_grip: float = quantity(1.0, "-", at_least=0)  # multiplies the friction coefficient of ladder and floor
    wall_grip: float = quantity(1.0, "-", at_least=0)  # the same of ladder and wall
    gap: float = quantity(4e-3, "m", at_least=0, at_most=0.1)  # to floor and wall at the start

    # of feet, then of bases; feet on rungs, and the base along it, go with the ladder
    charts: ClassVar = {
        "rung": Chart(("rung", "aside", "out"), rung_point, body_frame_number(0)),
        **approach_charts(lambda obstacle: -obstacle.lower_end_wall_distance),
        "ledge": LEDGE_CHART,
        "along": Chart(
            ("up", "out", "pitch", *EXTRA_BASE_COORDINATES),
            base_position_along_ladder,
            body_frame_number(0),
            pitch=base_pitch,
            optional_count=3,
        ),
        "over": Chart(
            ("ahead", "above", "pitch", *EXTRA_BASE_COORDINATES),
            base_position_over_ledge,
            pitch=base_pitch,
            optional_count=3,
        ),
    }
    free_bodies = ("ladder",)
    sizes_learnable_from_feet = ("rung_step", "length", "ledge_height")
    contact_sites = (("lower_right", 0), ("lower_left", 0), ("upper_right", 0), ("upper_left", 0))

    @property
    def mass_centre_along_rails(self) -> Array | float:
        """Distance (m) of the ladder's mass centre from the lower ends of its rails, along the rails."""
        rails, rungs = self._volumes()
        middle = (0.5 + 0.5 * self.rungs) * self.rung_step - self.rung_height / 2
        return (rails * self.length / 2 + rungs * middle) / (rails + rungs)

    @property
    def lower_end_wall_distance(self) -> Array:
        """Distance (m) of the ladder's lower end from the wall at the start."""
        return self.start().position[0, 1] + self.mass_centre_along_rails * jnp.cos(jnp.asarray(self.lean))

    @property
    def ledge_extra_height(self) -> Array | float:
        """How much higher than nominal (`LEDGE_HEIGHT_RUNGS` rungs) the ledge is, in m along the ladder."""
        return self.ledge_height / jnp.sin(jnp.asarray(self.lean)) - LEDGE_HEIGHT_RUNGS * self.rung_step

    def y_at_rung(self, rungs: Array | float) -> Array | float:
        """Return the coordinate y (m, ladder axes) of a height given in rungs; whole numbers are tops of rungs."""
        return self.mass_centre_along_rails - rungs * self.rung_step

    @property
    def landmarks(self) -> Float[Array, "1 3"]:
        """Point of the ladder that the robot observes: the middle between the rails' lower ends (m, ladder axes)."""
        return stack_components(0.0, self.mass_centre_along_rails, 0.0)[None]

    def _volumes(self) -> tuple[Array | float, Array | float]:
        """Volume of both rails, and of all rungs (m^3)."""
        rails = 2 * self.length * self.rail_breadth * self.rail_depth
        return rails, self.rungs * self.width * self.rung_height * self.rung_depth

    def bars(self) -> LadderBars:
        """Return the boxes of the ladder's rails and rungs, in the ladder's axes."""
        aside = (self.width + self.rail_breadth) / 2
        rail = stack_components(self.rail_breadth / 2, self.length / 2, self.rail_depth / 2)
        rung = stack_components(self.width / 2, self.rung_height / 2, self.rung_depth / 2)
        middles = [
            stack_components(side * aside, self.mass_centre_along_rails - self.length / 2, 0.0) for side in SIDES
        ]
        tops = [
            self.mass_centre_along_rails - k * self.rung_step + self.rung_height / 2 for k in range(1, self.rungs + 1)
        ]
        return LadderBars(
            jnp.stack([*middles, *(stack_components(0.0, top, 0.0) for top in tops)]),
            jnp.stack([rail] * 2 + [rung] * self.rungs),
        )

    def add_to(self, spec: "mujoco.MjSpec", friction: float) -> None:
        """Add floor, ledge and ladder to a MuJoCo spec; small spheres at the ladder's corners touch floor and wall."""
        import mujoco

        values = self.batched_model_fields()
        body = spec.worldbody.add_body(name="ladder", explicitinertial=True, mass=float(self.mass), ipos=[0, 0, 0],
                                       inertia=np.asarray(values["body_inertia"]["ladder"], float))  # fmt: skip
        body.add_freejoint(name="ladder")
        add_solids(spec, self.solids(identity_poses(1)), friction, self.free_bodies)
        for name, _ in self.contact_sites:
            place = np.asarray(values["site_pos"][name], float)
            body.add_site(name=name, pos=place)
            body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=place, size=[FOOT_RADIUS, 0, 0],
                          contype=0, conaffinity=0, **hidden_geom_options())  # fmt: skip
            for other, grip in (("floor", self.floor_grip), ("ledge", self.wall_grip)):
                add_contact_pair(spec, name, f"{other}_contact", float(friction * grip), 1.0)

    def check(self) -> None:
        """Raise `InputError` if the upper ends do not meet the wall, or the rungs do not fit (plain numbers)."""
        reach = self.length * np.sin(self.lean)
        if reach >= self.ledge_height:
            raise InputError(
                f"obstacle.length = {self.length:g} is not allowed: leaning it reaches {reach:.3f} m up, and the wall "
                f"obstacle.ledge_height = {self.ledge_height:g}"
            )
        if self.rungs * self.rung_step > self.length:
            raise InputError(
                f"obstacle.rungs = {self.rungs} is not allowed: with obstacle.rung_step = {self.rung_step:g} at most "
                f"{int(self.length / self.rung_step)}, which obstacle.length = {self.length:g} has room for"
            )

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Return mass, inertia of homogeneous bars, and contact sites at the rail ends, as MuJoCo model fields."""
        bars = self.bars()
        volume = jnp.prod(bars.half, axis=-1)
        mass = self.mass * volume / jnp.sum(volume)
        squares = bars.half**2 / 3 + bars.centre**2
        inertia = jnp.sum(mass[:, None] * (jnp.sum(squares, axis=-1, keepdims=True) - squares), axis=0)
        ends = {"lower": self.mass_centre_along_rails, "upper": self.mass_centre_along_rails - self.length}
        aside, inner = (self.width + self.rail_breadth) / 2, -self.rail_depth / 2
        sites = {f"{end}_{side}": stack_components(sign * aside, y, inner)
                 for end, y in ends.items() for side, sign in zip(("right", "left"), SIDES, strict=True)}  # fmt: skip
        return {
            "body_mass": {"ladder": jnp.asarray(self.mass)},
            "body_inertia": {"ladder": inertia},
            "site_pos": sites,
        }

    def start(self) -> FreeBodyState:
        """Return the ladder's state at the start: at rest, at a distance `gap` from floor and wall."""
        lean, edge = jnp.asarray(self.lean), self.rail_depth / 2
        sin, cos, zero = jnp.sin(lean), jnp.cos(lean), jnp.zeros_like(lean)
        y = self.gap + (self.length - self.mass_centre_along_rails) * cos + edge * sin
        z = self.gap + self.mass_centre_along_rails * sin + edge * cos
        quat = jnp.stack([jnp.cos(lean / 2), -jnp.sin(lean / 2), zero, zero])
        return FreeBodyState(stack_components(0.0, y, z)[None], quat[None], jnp.zeros((1, 3)), jnp.zeros((1, 3)))

    def start_poses(self) -> BodyPoses:
        """Pose of the ladder at the start of a rollout."""
        start = self.start()
        return BodyPoses(start.position, matrix(start.quat))

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return floor, ledge and the ladder's bars as solids; the ledge ends where no robot reaches."""
        bars, ledge = self.bars(), self.ledge_height / 2
        place = bodies.position[0] + bars.centre @ bodies.rotation[0].T
        names = ("rail_right", "rail_left", *(f"rung{k}" for k in range(1, self.rungs + 1)))
        boxes = (
            Box(name=name, position=place[k], rotation=bodies.rotation[0], half=bars.half[k], body=0)
            for k, name in enumerate(names)
        )
        return (
            HalfSpace(name="floor", normal=(0.0, 0.0, 1.0)),
            Box(
                name="ledge",
                position=(0.0, -LEDGE_HALF_DEPTH_M, ledge),
                half=(2.0, LEDGE_HALF_DEPTH_M, ledge),
                colour=SOIL,
            ),
            *boxes,
        )

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: that of floor, ledge or bar, whichever contains the point most deeply.

        The ladder's own corners touch floor and wall only.
        """
        own, dtype = np.array(owner) >= 0, points.dtype
        bars = LadderBars(*(x.astype(dtype) for x in self.bars()))
        _, y, z = points.T
        up, out = jnp.array([0.0, 0.0, 1.0], dtype), jnp.array([0.0, 1.0, 0.0], dtype)
        above = self.ledge_height - z
        ledge = jnp.where(own, -y, jnp.minimum(-y, above))
        turned = (points - bodies.position[0]) @ bodies.rotation[0]
        offset = turned[:, None] - bars.centre
        inside = bars.half - jnp.abs(offset)  # (n, bars, axes)
        bar = jnp.argmax(jnp.min(inside, axis=-1), axis=-1)
        offset, inside = (jnp.take_along_axis(x, bar[:, None, None], axis=1)[:, 0] for x in (offset, inside))
        axis = jnp.argmin(inside, axis=-1)
        side = jnp.where(jnp.take_along_axis(offset, axis[:, None], axis=-1)[:, 0] < 0, -1.0, 1.0).astype(dtype)
        solids = jnp.stack([-z, ledge, jnp.where(own, -jnp.inf, jnp.min(inside, axis=-1))])
        solid = jnp.argmax(solids, axis=0)
        on_wall = own | (-y <= above)
        face = jnp.select(
            [solid == 0, (solid == 1) & on_wall, solid == 1], [FLOOR, WALL, LEDGE],
            BARS + 6 * bar + 2 * axis + (side > 0),
        )  # fmt: skip
        of_bar = side[:, None] * bodies.rotation[0].T[axis]
        pick = face[:, None]
        normal = jnp.where(pick >= BARS, of_bar, jnp.where(pick == WALL, out, up))
        grip = jnp.where(face == WALL, self.wall_grip, self.floor_grip)
        return Surface(
            depth=jnp.max(solids, axis=0),
            normal=normal,
            face=face.astype(jnp.int32),
            body=jnp.where(face >= BARS, 0, -1).astype(jnp.int32),
            friction_scale=jnp.where(own, grip, 1.0).astype(dtype),
        )
