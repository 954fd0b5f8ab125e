"""Rigid bodies whose points touch planes, and what must come of them. SI units, world axes with z up."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sweep.core.constants import GRAVITY
from sweep.models.contact import Contact

BODIES, TOUCHES = 3, 4  # room of a scene: bodies, and points of each
LAW = Contact()
Numbers = tuple[float, ...]
ORIGIN, UP = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class Body(NamedTuple):
    """A rigid body at the start; its axes are principal, from the mass centre."""

    mass: float
    inertia: Numbers
    position: Numbers
    quat: Numbers = (1.0, 0.0, 0.0, 0.0)
    velocity: Numbers = ORIGIN
    turn: Numbers = ORIGIN  # rad/s, own axes
    force: Numbers = ORIGIN  # N, constant, at the mass centre


class Touch(NamedTuple):
    """A point of a body, or the centre of a sphere, that may touch the plane normal . x = offset."""

    body: int
    at: Numbers  # m, own axes
    friction: float
    normal: Numbers = UP  # axes of what it touches, as the offset
    offset: float = 0.0
    on: int = -1  # the body whose face the plane is, -1 for the world
    radius: float = 0.0


class History(NamedTuple):
    """What became of a scene: t times, k bodies."""

    time: np.ndarray  # (t,) s
    position: np.ndarray  # (t, k, 3)
    quat: np.ndarray  # (t, k, 4)
    velocity: np.ndarray  # (t, k, 3), world axes
    turn: np.ndarray  # (t, k, 3), own axes
    load: np.ndarray  # (n,) N, normal forces of the touches at the end
    residual: float = float("nan")  # N, the largest force that the step left unexplained


class Figure(NamedTuple):
    """A number of a history."""

    name: str
    unit: str
    of: Callable[[Any], float]
    exact: float | None  # of rigid bodies with Coulomb's friction; None: what the contact law gives, see `reference`
    scale: float  # by which errors are divided; of an exact one usually itself
    bound: float | None  # on the error of the step at its default settings; None: 2 ms are too long for it


class Scene(NamedTuple):
    """Bodies, what they touch, and for how long."""

    name: str
    bodies: tuple[Body, ...]
    touches: tuple[Touch, ...]
    seconds: float
    figures: tuple[Figure, ...]


def rotate_vectors(quat: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) in world axes, from the axes of bodies."""
    w, u = quat[..., :1], quat[..., 1:]
    return v + 2 * np.cross(u, np.cross(u, v) + w * v)


def box(mass: float, half: Numbers, **where) -> Body:
    """A homogeneous one."""
    squares = np.square(half)
    return Body(mass, tuple(mass / 3 * (squares.sum() - squares)), **where)


def corners(body: int, half: Numbers, friction: float, **plane) -> tuple[Touch, ...]:
    """The four lower ones of a box."""
    x, y, z = half
    return tuple(Touch(body, (i * x, j * y, -z), friction, **plane) for i in (1, -1) for j in (1, -1))


def _after(h: History, when: float) -> int:
    return int(np.searchsorted(h.time, when - 1e-9))


def _line(h: History, start: float, end: float, along: Numbers) -> float:
    """Mean acceleration along a direction between two times."""
    i, j = _after(h, start), _after(h, end)
    speed = h.velocity[:, 0] @ np.asarray(along)
    return float((speed[j] - speed[i]) / (h.time[j] - h.time[i]))


def _creep(body: int, start: float, end: float) -> Callable[[History], float]:
    """Mean speed (mm/s) between two times."""

    def of(h: History) -> float:
        i, j = _after(h, start), _after(h, end)
        gone = np.linalg.norm(h.position[j, body] - h.position[i, body])
        return float(1e3 * gone / (h.time[j] - h.time[i]))

    return of


def _falls_below(level: float, x: np.ndarray, time: np.ndarray) -> float:
    """When `x` does first, between two samples; no number where it never does."""
    late = int(np.argmax(x < level))
    if late == 0:
        return float("nan")
    share = (x[late - 1] - level) / (x[late - 1] - x[late])
    return float(time[late - 1] + share * (time[late] - time[late - 1]))


BLOCK = (0.2, 0.15, 0.1)


def slope(share: float, friction: float = 0.7, seconds: float = 1.0) -> Scene:
    """A block on a slope whose tangent is a `share` of the friction coefficient."""
    angle = float(np.arctan(share * friction))
    normal, down = _slope(angle)
    resting = _on_slope(10.0, angle)
    if share < 1:
        figure = Figure("creep", "mm/s", _creep(0, seconds / 2, seconds), 0.0, 1.0, 0.01)
    else:
        slides = GRAVITY * (np.sin(angle) - friction * np.cos(angle))
        figure = Figure("acceleration", "m/s²", lambda h: _line(h, seconds / 2, seconds, down), slides, slides, 0.002)
    touches = corners(0, BLOCK, friction, normal=normal)
    return Scene(f"slope at {share:g} of friction", (resting,), touches, seconds, (figure,))


def _slope(angle: float) -> tuple[Numbers, Numbers]:
    """Normal and downhill direction of ground that rises towards x."""
    sin, cos = np.sin(angle), np.cos(angle)
    return (-sin, 0.0, cos), (-cos, 0.0, -sin)


def _on_slope(mass: float, angle: float, **more) -> Body:
    normal = np.array(_slope(angle)[0])
    height = BLOCK[2] - mass * GRAVITY * np.cos(angle) / (4 * LAW.stiffness)
    quat = (float(np.cos(angle / 2)), 0.0, float(-np.sin(angle / 2)), 0.0)
    return box(mass, BLOCK, position=tuple(height * normal), quat=quat, **more)


def slide(speed: float = 1.0, friction: float = 0.4) -> Scene:
    """A block that slides to rest on level ground."""
    way, time = speed**2 / (2 * friction * GRAVITY), speed / (friction * GRAVITY)

    def stops(h: History) -> float:
        return _falls_below(0.05 * speed, h.velocity[:, 0, 0], h.time) / 0.95

    figures = (
        Figure("way", "m", lambda h: float(h.position[-1, 0, 0]), way, way, 0.01),
        Figure("time", "s", stops, time, time, 0.001),
    )
    return Scene("block slides to rest", (_on_slope(10.0, 0.0, velocity=(speed, 0.0, 0.0)),),
                 corners(0, BLOCK, friction), 0.5, figures)  # fmt: skip


def kick_on_slope(speed: float = 0.5, friction: float = 0.5) -> Scene:
    """A block kicked sideways on a slope as steep as friction bears.

    What it loses along its way it gains downhill: in the end it slides straight down, half as fast. A friction pyramid,
    which is weaker between its edges, gives another speed.
    """
    angle = float(np.arctan(friction))
    normal, down = _slope(angle)
    figures = (
        Figure("downhill at last", "m/s", lambda h: float(h.velocity[-1, 0] @ down), speed / 2, speed / 2, 0.01),
        Figure("aside at last", "m/s", lambda h: float(h.velocity[-1, 0, 1]), 0.0, speed, 0.001),
    )
    return Scene("block kicked aside on a slope", (_on_slope(10.0, angle, velocity=(0.0, speed, 0.0)),),
                 corners(0, BLOCK, friction, normal=normal), 1.2, figures)  # fmt: skip


def push_on_slope(over: float = 1.1, friction: float = 0.7, share: float = 0.7) -> Scene:
    """Return a block pushed sideways on a slope: weight and push together are `over` times what friction bears."""
    mass, angle = 10.0, float(np.arctan(share * friction))
    normal, down = _slope(angle)
    most, weight = mass * GRAVITY * np.cos(angle) * friction, mass * GRAVITY * np.sin(angle)
    push = float(np.sqrt((over * most) ** 2 - weight**2))
    slides = (over - 1) * most / mass

    def direction(h: History) -> float:
        return float(np.degrees(np.arctan2(h.velocity[-1, 0, 1], h.velocity[-1, 0] @ down)))

    def acceleration(h: History) -> float:
        i = _after(h, 0.25)
        return float(np.linalg.norm(h.velocity[-1, 0] - h.velocity[i, 0]) / (h.time[-1] - h.time[i]))

    figures = (
        Figure("direction", "°", direction, float(np.degrees(np.arctan2(push, weight))), 90.0, 0.001),
        Figure("acceleration", "m/s²", acceleration, slides, slides, 0.001),
    )
    body = _on_slope(mass, angle, force=(0.0, push, 0.0))
    return Scene("block pushed aside on a slope", (body,), corners(0, BLOCK, friction, normal=normal), 0.5, figures)


def ball(mass: float, radius: float, **where) -> Body:
    """A homogeneous one."""
    return Body(mass, (0.4 * mass * radius**2,) * 3, **where)


def rolling(angle: float = 0.2, radius: float = 0.1) -> Scene:
    """A ball that rolls down a slope."""
    normal, down = _slope(angle)
    wanted = 5 / 7 * GRAVITY * np.sin(angle)
    height = radius - GRAVITY * np.cos(angle) / LAW.stiffness
    figure = Figure("acceleration", "m/s²", lambda h: _line(h, 0.25, 0.5, down), wanted, wanted, 0.001)
    return Scene("ball rolls down", (ball(1.0, radius, position=tuple(height * np.array(normal))),),
                 (Touch(0, ORIGIN, 1.0, normal, radius=radius),), 0.5, (figure,))  # fmt: skip


def slides_then_rolls(speed: float = 0.5, friction: float = 0.1, radius: float = 0.1) -> Scene:
    """A ball thrown without spin: friction makes it roll."""
    last, time = 5 / 7 * speed, 2 * speed / (7 * friction * GRAVITY)

    def comes(h: History) -> float:
        return _falls_below(0.1 * speed, h.velocity[:, 0, 0] - radius * h.turn[:, 0, 1], h.time) / 0.9

    figures = (
        Figure("speed at last", "m/s", lambda h: float(h.velocity[-1, 0, 0]), last, last, 0.002),
        Figure("time until it rolls", "s", comes, time, time, 0.001),
    )
    body = ball(1.0, radius, position=(0.0, 0.0, radius - GRAVITY / LAW.stiffness), velocity=(speed, 0.0, 0.0))
    return Scene("ball slides, then rolls", (body,), (Touch(0, ORIGIN, friction, radius=radius),), 0.4, figures)


def bounce(mass: float, bound: float, fall: float = 0.01, radius: float = 0.1) -> Scene:
    """A ball that falls; how fast it leaves is for the contact law to say."""

    def rebound(h: History) -> float:
        return float(h.velocity[:, 0, 2].max() / np.sqrt(2 * GRAVITY * fall))

    figure = Figure("rebound", "of its speed", rebound, None, 1.0, bound)
    return Scene(f"ball of {mass:g} kg bounces", (ball(mass, radius, position=(0.0, 0.0, radius + fall)),),
                 (Touch(0, ORIGIN, 1.0, radius=radius),), 0.12, (figure,))  # fmt: skip


def painleve(friction: float = 2.0, speed: float = 1.0, length: float = 1.0) -> Scene:
    """A rod dragged over the ground, its mass centre behind its lower end, where rigid contact has no solution.

    For a slender rod at an angle of tangent 2 that is so where friction exceeds 4/3 (Painlevé). A law with depth has
    one: the end digs in, stops within a few ms and is thrown up.
    """
    half, angle = length / 2, float(np.arctan(2.0))
    across = 1.0 * length**2 / 12
    quat = (float(np.cos(angle / 2)), 0.0, float(-np.sin(angle / 2)), 0.0)
    rod = Body(1.0, (0.01 * across, across, across), (half * np.cos(angle), 0.0, half * np.sin(angle)), quat,
               velocity=(-speed, 0.0, 0.0))  # fmt: skip
    figures = (
        Figure("turning after 50 ms", "rad/s", lambda h: float(h.turn[-1, 0, 1]), None, 1.0, None),
        Figure("forward after 50 ms", "m/s", lambda h: float(h.velocity[-1, 0, 0]), None, speed, None),
    )
    return Scene("rod digs in (Painlevé)", (rod,), (Touch(0, (-half, 0.0, 0.0), friction),), 0.05, figures)


def stack(masses: Numbers = (1.0, 10.0, 100.0), half: float = 0.1) -> Scene:
    """Boxes on each other, the lightest lowest."""
    bodies, touches, height, size = [], [], 0.0, (half,) * 3
    for k, mass in enumerate(masses):
        height += half - sum(masses[k:]) * GRAVITY / (4 * LAW.stiffness)
        bodies.append(box(mass, size, position=(0.0, 0.0, height)))
        height += half
        touches += corners(k, size, 1.0, offset=half if k else 0.0, on=k - 1)
    weight = GRAVITY * sum(masses)
    figures = (
        Figure("load of the lowest", "N", lambda h: float(h.load[:4].sum()), weight, weight, 0.001),
        Figure("load of the highest", "N", lambda h: float(h.load[8:].sum()), 100 * GRAVITY, 100 * GRAVITY, 0.001),
        Figure("creep of the highest", "mm/s", _creep(2, 0.25, 0.5), 0.0, 1.0, 0.01),
    )
    return Scene("stack of 1, 10, 100 kg", tuple(bodies), tuple(touches), 0.5, figures)


def seesaw() -> Scene:
    """A plank of 100 kg on an edge; 10 kg on one side outweigh 1 kg far out on the other by a fifth."""
    half, small, edge = (1.2, 0.2, 0.02), (0.05,) * 3, 0.5
    c = LAW.stiffness
    middle = edge + half[2] - 111 * GRAVITY / (2 * c)
    on = middle + half[2] + small[2]
    bodies = (
        box(100.0, half, position=(0.0, 0.0, middle)),
        box(1.0, small, position=(1.0, 0.0, on - 1 * GRAVITY / (4 * c))),
        box(10.0, small, position=(-0.12, 0.0, on - 10 * GRAVITY / (4 * c))),
    )
    line = tuple(Touch(0, (0.0, y, -half[2]), 1.0, offset=edge) for y in (0.2, -0.2))
    loads = (*corners(1, small, 1.0, offset=half[2], on=0), *corners(2, small, 1.0, offset=half[2], on=0))

    def angle(h: History) -> float:
        return float(-2 * np.arcsin(h.quat[-1, 0, 2]))

    lever, inertia = (1.2 - 1.0) * GRAVITY, bodies[0].inertia[1] + 1.0 + 10 * 0.12**2
    return Scene("see-saw of 1, 10, 100 kg", bodies, (*line, *loads), 0.5,
                 (Figure("angle after 0.5 s", "rad", angle, None, lever / inertia / 8, 0.02),))  # fmt: skip


def groove(mass: float = 10.0, radius: float = 0.1) -> Scene:
    """A ball in a groove without friction: two normals at once, at different angles."""
    angles = np.radians([30.0, 50.0])
    normals = [(float(side * np.sin(a)), 0.0, float(np.cos(a))) for side, a in zip((-1, 1), angles, strict=True)]
    loads = mass * GRAVITY * np.sin(angles[::-1]) / np.sin(angles.sum())
    depths = radius - loads / LAW.stiffness  # how far from either plane
    x, z = np.linalg.solve([[n[0], n[2]] for n in normals], depths)
    figures = tuple(
        Figure(f"load at {degrees}°", "N", lambda h, k=k: float(h.load[k]), float(loads[k]), float(loads[k]), 0.002)
        for k, degrees in enumerate((30, 50))
    )
    return Scene("ball in a groove", (ball(mass, radius, position=(float(x), 0.0, float(z))),),
                 tuple(Touch(0, ORIGIN, 0.0, n, radius=radius) for n in normals), 0.3, figures)  # fmt: skip


def tumbling(seconds: float) -> Scene:
    """A body that flies, turning about its middle axis."""
    inertia, turn = np.array([0.1, 0.2, 0.3]), np.array([0.02, 2.0, 0.02])
    body = Body(1.0, tuple(inertia), (0.0, 0.0, 0.0), velocity=(1.0, 0.0, 0.0), turn=tuple(turn))
    energy, momentum = 0.5 * inertia @ turn**2, np.linalg.norm(inertia * turn)

    def gained(h: History) -> float:
        energies = 0.5 * h.turn[:, 0] ** 2 @ inertia
        return float(np.abs(energies - energy).max() / energy)

    def turned(h: History) -> float:
        now = rotate_vectors(h.quat[:, 0], inertia * h.turn[:, 0])
        return float(np.linalg.norm(now - inertia * turn, axis=-1).max() / momentum)

    fall = -GRAVITY * seconds**2 / 2
    figures = (
        Figure("energy of turning, off by", "", gained, 0.0, 1.0, 0.0005),
        Figure("angular momentum, off by", "", turned, 0.0, 1.0, 0.0005),
        Figure("way fallen", "m", lambda h: float(h.position[-1, 0, 2]), fall, -fall, 0.003),
        Figure("speed kept", "m/s", lambda h: float(h.velocity[-1, 0, 0]), 1.0, 1.0, 1e-4),
    )
    return Scene(f"body tumbles freely, {seconds:g} s", (body,), (), seconds, figures)


SCENES = (
    *(slope(share) for share in (0.9, 0.99, 1.01, 1.1)), slide(), kick_on_slope(), push_on_slope(), rolling(),
    slides_then_rolls(), bounce(5.3, 0.12), bounce(100.0, 0.01), painleve(), stack(), seesaw(), groove(), tumbling(1.0),
)  # fmt: skip
LONG = (tumbling(20.0),)  # 10⁴ steps of 2 ms


def error(figure: Figure, value: float, converged: float) -> float:
    """Of a figure's value, as a share; `converged` is what the contact law gives."""
    return abs(value - (converged if figure.exact is None else figure.exact)) / figure.scale
