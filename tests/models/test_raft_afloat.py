"""A raft on the water: it floats, tilts, swings, coasts and meets a bank as chapter 4 says."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from raft_laws import energy, vertical_momentum
from scipy.linalg import expm
from validity.simulation import simulate

from sweep.config.experiment import compose
from sweep.controllers.plan import Plan, Stage
from sweep.core.constants import GRAVITY
from sweep.core.parameters import parameters, quantity
from sweep.core.rotations import exponential, matrix
from sweep.engines import make_engine
from sweep.formulas import evaluate
from sweep.formulas.raft_dynamics import RaftBody as Formula
from sweep.formulas.raft_dynamics import raft_linear, raft_modes
from sweep.formulas.raft_statics import hydro_thick
from sweep.manoeuvres.walking.walk import Stand, level_stance
from sweep.models.case import Case
from sweep.models.obstacles.raft import CORNER_SIGNS, Raft
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import joint_targets, mass_centre
from sweep.models.robot import total_mass
from sweep.planning.compile_plan import compile_plan

GAMMA, STEP, SECONDS, SPEED = 9810.0, 2e-3, 21.0, 0.1
OPEN = 100.0  # m, far from both banks
PLACE, QUAT, MOVES, TURNS = slice(25, 28), slice(28, 32), slice(24, 27), slice(27, 30)
UNDAMPED = {"drag": 0.0, "viscosity": 0.0}
BANK = {"gap": 0.01, "water_width": 5.46}
HEAVES, SWINGS, TUMBLES, SLOWS, BOUNCES, STOPS, CARRIES = range(7)
TURN, OFFSETS = np.array([1e-3, 1.5e-3, 0.0]), np.array([0.05, 0.15, 0.3])
COASTS, BOXES = slice(7, 10), slice(10, 26)


def load() -> float:
    """Of the robot (kg)."""
    return float(total_mass(compose([]).case.robot))


def coasting() -> dict[str, float]:
    """The push of 4.3.3, and the raft that is as heavy as raft and robot together."""
    raft = Raft()
    mass = float(raft.mass) + load()
    a, b, _ = np.asarray(raft.half_size, float)
    al2 = raft.drag * raft.width * float(raft.draught(load()))
    push = evaluate("crossing", {"S": raft.water_width, "sigma": raft.length, "v_eps": 0.1, "mt": mass,
                                 "al2": al2,                                  "J": mass * (a * a + b * b) / 3,
                                 "h": 0.1})  # fmt: skip
    return {"density": mass / (raft.length * raft.width * raft.thickness), "v0": push["v0"], "w0": push["w0"] / 0.1}


def boxes() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Sizes and densities from raft to post, and how they are tilted at the start."""
    rng, n = np.random.default_rng(3), BOXES.stop - BOXES.start
    sizes = {"length": rng.uniform(0.6, 1.5, n), "width": rng.uniform(0.3, 1.0, n),
             "thickness": rng.uniform(0.2, 0.8, n), "density": rng.uniform(300.0, 700.0, n)}  # fmt: skip
    return sizes, np.concatenate([rng.uniform(-0.01, 0.01, (n, 2)), np.zeros((n, 1))], axis=1)


@pytest.fixture(scope="module")
def nominal():
    return dataclasses.replace(compose([]).case, obstacle=Raft())


@pytest.fixture(scope="module")
def history(nominal):
    """Rafts side by side; on one a robot stands, beside the others it falls and never lands."""
    push, (sizes, tilts) = coasting(), boxes()
    rows = [UNDAMPED, {"drag": 0.0, "viscosity": 500.0}, UNDAMPED, {"drag": 500.0, "viscosity": 20.0},
            {**BANK, "impact_damping": 0.0}, BANK, {"drag": 5e4, "viscosity": 5e4}]  # fmt: skip
    rows += [{"density": push["density"], "viscosity": 0.0}] * len(OFFSETS)
    rows += [{name: float(x[k]) for name, x in sizes.items()} | {"viscosity": 5.0} for k in range(len(tilts))]
    rows = [Raft(**{"water_width": 1e3, "gap": OPEN} | row) for row in rows]
    q, v = np.zeros((len(rows), 32)), np.zeros((len(rows), 30))
    stance, _ = level_stance(nominal, 0.3, 0.525)
    joints = np.asarray(joint_targets(nominal.robot, stance)[0])
    q[:, PLACE] = [raft.start().position[0] for raft in rows]
    q[:, 2], q[:, 3], q[:, 28], q[:, 7:25] = 1e6, 1.0, 1.0, joints.ravel()
    q[HEAVES, 27] += 0.02
    q[SWINGS, QUAT] = exponential(jnp.asarray(TURN))
    q[[TUMBLES, SLOWS], 27] += 0.01
    q[[TUMBLES, SLOWS], QUAT] = exponential(jnp.array([0.05, -0.04, 0.3]))
    v[[TUMBLES, SLOWS], MOVES], v[[TUMBLES, SLOWS], TURNS] = [0.3, -0.2, 0.1], [0.1, -0.08, 0.4]
    v[[BOUNCES, STOPS], 24] = -SPEED
    q[CARRIES, 27] -= 2.4e-3
    q[CARRIES, :3] = q[CARRIES, PLACE] + [0.6, 0.3, 0.525 + Raft().thickness / 2 - 2e-5]
    v[COASTS, 24], v[COASTS, 29] = push["v0"], push["w0"] * OFFSETS
    q[BOXES, QUAT] = exponential(jnp.asarray(tilts))
    raft = Raft(**{f.name: np.array([getattr(raft, f.name) for raft in rows])
                   for f in dataclasses.fields(Raft) if f.name != "kind"})  # fmt: skip
    case = dataclasses.replace(nominal, obstacle=raft)
    return simulate(case, nominal, q, np.broadcast_to(joints, (round(SECONDS / STEP), 6, 3)), STEP, v, iterations=3)


def formula(raft: Raft, load: float = 0.0) -> Formula:
    """The same raft in chapter 4's words."""
    mass = float(raft.mass) + load
    a, b, d = np.asarray(raft.half_size, float)
    inertia = mass / 3 * np.array([b * b + d * d, a * a + d * d, a * a + b * b])
    values = {"a": a, "b": b, "d": d, "gamma": GAMMA, "zeta0": float(raft.draught(load)) - d, "k_lin": raft.viscosity,
              "k_quad": raft.drag, "P": GRAVITY * mass, "M": mass, "J": jnp.asarray(inertia)}  # fmt: skip
    return Formula(**values, rs=jnp.zeros(3))


def as_state(history, raft: Raft, row: int = 0):
    """A history in the words of `raft_ode`, height from the water plane."""
    place = history.q[:, row, PLACE] + np.array([0.0, 0.0, raft.bank_height])
    turned = np.asarray(matrix(jnp.asarray(history.q[:, row, QUAT], float)))
    return np.concatenate([place, turned.reshape(-1, 9), history.v[:, row, 24:30]], axis=1)


def test_buoyancy_is_that_of_four_columns():
    """Columns of water on a quarter of the bottom each, at (+-a, +-b) / sqrt 3: Gauss's points, which are exact."""
    with jax.enable_x64(True):
        raft = Raft(drag=0.0, viscosity=0.0)
        quat = exponential(jnp.array([0.03, -0.05, 0.4]))
        place, still = jnp.array([[1.0, 0.2, -0.06]]), jnp.zeros((1, 3))
        wrench = np.asarray(raft.external_wrench(FreeBodyState(place, quat[None], still, still))[0])
        turned, (a, b, d) = np.asarray(matrix(quat)), np.asarray(raft.half_size)
        a3, depth, total = turned[2], -raft.bank_height + 0.06, np.zeros(6)
        for x, y in CORNER_SIGNS:
            at = np.array([x * a, y * b]) / np.sqrt(3)
            top = (depth - a3[:2] @ at) / a3[2]
            force = GAMMA * a * b * (top + d) * a3
            arm = np.array([*at, (top - d) / 2])
            total += np.concatenate([turned @ force, turned @ np.cross(arm, force)])
    np.testing.assert_allclose(wrench, total, rtol=2e-12, atol=2e-12 * np.abs(total).max())


@pytest.mark.slow
def test_it_heaves_for_ever_without_drag(history):
    last = history.q[-round(2 / STEP) :, HEAVES, 27] - float(Raft().start().position[0, 2])
    assert np.abs(last).max() == pytest.approx(0.02, abs=1e-4)


def test_small_motions_are_those_of_the_linear_raft(history):
    """Periods and damping, over five periods of pitch: a period off by 1 % would show twenty times as much.

    What there is to see is the half step by which velocities of the explicit load are early.
    """
    words = formula(Raft(drag=0.0, viscosity=500.0))
    mass = np.concatenate([np.full(3, words.M), np.asarray(words.J)])
    motion = np.zeros((12, 12))
    motion[:6, 6:], motion[6:] = np.eye(6), np.asarray(raft_linear(words).matrix) / mass[:, None]
    per_step, state, wanted = expm(STEP * motion), np.concatenate([np.zeros(3), TURN, np.zeros(6)]), []
    for _ in range(round(2.5 / STEP)):
        state = per_step @ state
        wanted.append(state[3:5])
    seen = 2 * history.q[: len(wanted), SWINGS, 29:31]
    assert np.abs(seen - wanted).max() < 0.015 * TURN.max()
    assert np.abs(seen[-round(0.5 / STEP) :]).max() < 0.95 * TURN.max()  # damping had its say


def test_first_integral_and_decay_of_energy(history):
    """Without drag both are kept, though the raft tumbles and drifts; with drag energy only falls."""
    with jax.enable_x64(True):
        words = formula(Raft(**UNDAMPED))
        free, wet = (jnp.asarray(as_state(history, Raft(), row)[:3000:10]) for row in (TUMBLES, SLOWS))
        momentum, kept = (np.asarray(jax.vmap(lambda s, f=f: f(words, s))(free)) for f in (vertical_momentum, energy))
        falls = np.asarray(jax.vmap(lambda s: energy(words, s))(wet))
    moving = 0.5 * words.M * (0.3**2 + 0.2**2 + 0.1**2)
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-3)
    assert kept[:100].mean() == pytest.approx(kept[-100:].mean(), abs=0.02 * moving)
    assert np.diff(falls).max() < 1e-3 * moving
    assert falls[-1] < falls[0] - 0.5 * moving


def test_stability_is_as_the_modes_say(history):
    """Let go a little tilted, the unstable boxes fall over and the others do not."""
    sizes, tilts = boxes()
    verdicts, firm = [], []
    for k in range(len(tilts)):
        words = formula(Raft(**{name: float(values[k]) for name, values in sizes.items()}, viscosity=5.0))
        verdicts.append(bool(raft_modes(words).stable))
        firm.append(min(float(k) for k in hydro_thick(words.a, words.b, words.d, words.zeta0, GAMMA)) / words.P)
    falls = ~(np.max(np.abs(2 * history.q[: round(8 / STEP), BOXES, 29:31]), axis=(0, 2)) < 0.1)
    clear = np.abs(firm) > 0.01  # m, of metacentric height: nearer to 0, falling takes longer than this
    assert clear.sum() >= 12
    assert 3 <= falls.sum() <= len(falls) - 3
    assert (falls == ~np.array(verdicts))[clear].all()


def test_it_turns_while_it_coasts(history):
    """Pushed along a line h beside its centre, over the way between the banks: with the drag of its sides."""
    raft = Raft()
    gone = history.q[:, COASTS, 25] - OPEN - raft.length / 2
    there = np.argmax(gone >= raft.water_width - raft.length, axis=0)
    turned = np.degrees(2 * np.arcsin(history.q[there, np.arange(COASTS.start, COASTS.stop), 31]))
    assert coasting()["v0"] == pytest.approx(0.1443, abs=1e-4)
    np.testing.assert_allclose(turned, [5.85, 16.98, 32.57], atol=0.02)
    assert history.v[there[0], COASTS.start, 24] == pytest.approx(0.1, abs=2e-3)


def test_a_robot_tilts_it_as_statics_say(nominal, history):
    """Beside the middle; the water is thick, and brings raft and robot to rest."""
    raft, robot = Raft(), nominal.robot
    base, joints, deck = np.split(history.q[-400:, CARRIES].mean(axis=0), [7, 25])
    axes = np.asarray(matrix(jnp.asarray(deck[3:])))
    own = np.asarray(mass_centre(robot, jnp.asarray(joints.reshape(6, 3))))
    arm = axes.T @ (base[:3] + np.asarray(matrix(jnp.asarray(base[3:]))) @ own - deck[:3])
    total, (a, b, d) = load() + float(raft.mass), (float(x) for x in raft.half_size)
    rest = evaluate("raft_equilibrium", {"P": GRAVITY * total, "r_s": (arm * load() / total).tolist(), "a": a, "b": b,
                                         "d": d, "gamma": GAMMA})  # fmt: skip
    np.testing.assert_allclose(axes[2, :2], [rest["a31"], rest["a32"]], rtol=1e-3)
    assert -raft.bank_height - deck[2] == pytest.approx(rest["depth"], abs=2e-6)


def test_it_hardly_leaves_a_bank_that_it_meets(history):
    """With the damping of the contact alone it goes back nearly as fast as it came."""
    after = history.v[round(0.5 / STEP), :, 24]
    assert after[BOUNCES] > 0.6 * SPEED
    assert np.abs(after[STOPS]) < 0.02 * SPEED


@parameters
class Ashore(Stand):
    """Standing on the near bank."""

    needs = (Raft,)
    observer = 0.0

    def plan(self, belief: Case) -> Plan:
        """See `Stand`."""
        start, _ = level_stance(belief, 0.3, 0.525)
        back = jnp.array([-1.5, 0.0, 0.0])
        ashore = start._replace(feet=start.feet + back, position=start.position + back)
        return compile_plan(ashore, [Stage("stand", self.duration)], 0.0)


@parameters
class Afloat(Raft):
    """20 mm out of the water at first, or on its way to the near bank."""

    lift: float = quantity(0.0, "m")
    speed: float = quantity(0.0, "m/s")

    def start(self) -> FreeBodyState:
        """See `Raft`."""
        rest, (x, z) = super().start(), np.array([[1.0, 0, 0], [0, 0, 1.0]])
        return rest._replace(position=rest.position + self.lift * z, velocity=-self.speed * x[None])


@pytest.mark.slow
def test_native_heaves_for_ever_and_stops_at_a_bank(nominal):
    """Water acts at poses moved on to each substep; held over a tick it would feed the motion, a hundredfold."""
    exp = compose([])
    world = Afloat(lift=np.array([0.02, 0.0]), speed=np.array([0.0, SPEED]), gap=np.array([OPEN, 0.01]), drag=0.0,
                   viscosity=0.0, water_width=500.0)  # pyright: ignore  # fmt: skip
    case = dataclasses.replace(nominal, obstacle=world, manoeuvre=Ashore(duration=40.0))
    one = dataclasses.replace(case, obstacle=Afloat(drag=0.0, viscosity=0.0, water_width=500.0))
    engine = make_engine(dataclasses.replace(exp.settings, name="native", width=2), one, one, exp.thresholds)
    heaves, stops = engine.traces(case, case, np.arange(2), 5)
    height = heaves.qpos[:, 27] - float(Raft().start().position[0, 2])
    assert np.abs(height[heaves.time > 38.0]).max() == pytest.approx(0.02, abs=1e-4)
    assert heaves.metrics["energy_gain_max_j"] < 0.1 * 0.5 * GAMMA * 3.15 * 2.1 * 0.02**2
    assert np.abs(stops.qvel[stops.time > 0.5, 24]).max() < 0.2 * SPEED
