"""The engines on walking and standing: right speeds, no creeping slip, and the two agree.

Cases that share a compiled program are rows of one batch.
"""

import dataclasses

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.engines.mjx import MjxEngine
from sweep.engines.native import NativeEngine
from sweep.formulas import stepping
from sweep.metrics import accumulator
from sweep.metrics.outcome import OutcomeThresholds, classify, least_margins
from sweep.models.legs import JOINT_KINDS

STEPS, WIDTH = 3, 12
WALK = ["scenario=walk_tripod", f"manoeuvre.steps={STEPS}"]
MU = 0.5
LIMIT = float(np.arctan(MU))
NOMINAL, BROKEN, BELOW, ABOVE, NOISY, SAME, OTHER, WEAK, NUDGED, FELLED, DEAD, TWIN = range(12)
FINITE_LATER = ("_time_s", "_stage")  # of causes that did not come about


def replace(case, **groups):
    """`case` with some quantities of some groups changed."""
    changed = {name: dataclasses.replace(getattr(case, name), **values) for name, values in groups.items()}
    return dataclasses.replace(case, **changed)


def differing(a, b, i, j=None):
    """Names of the figures in which row i of `a` and row j of `b` are not the same bits."""
    j = i if j is None else j
    return [name for name in a if not np.array_equal(a[name][i], b[name][j], equal_nan=True)]


def speed(case) -> float:
    """v_o = k' x*/t* of the tripod, k' = 2 (m/s)."""
    walk = case.manoeuvre
    x = walk.half_step_ratio * case.robot.body_length * stepping.LANDING_RATIO
    return 2 * x / stepping.swing_time(walk.rate)


@pytest.fixture(scope="module")
def nominal():
    return compose(WALK).case


@pytest.fixture(scope="module")
def world(nominal):
    """A dozen worlds for the tripod, which believes in level ground, and in the slope where there is one."""

    def rows(**values):
        out = np.full(WIDTH, values.pop("default"), float)
        for name, value in values.items():
            out[globals()[name]] = value
        return out

    noise = rows(default=0.0, NOISY=2e-3, SAME=2e-3, OTHER=2e-3)
    return replace(
        nominal,
        contact={"friction": rows(default=1.0, BROKEN=np.nan, BELOW=MU, ABOVE=MU)},
        obstacle={"slope": rows(default=0.0, BELOW=LIMIT - np.radians(8), ABOVE=LIMIT + np.radians(3))},
        execution={
            "torque_scale": rows(default=1.0, WEAK=0.03),
            "dead_joint": rows(default=-1, DEAD=7),  # beta of leg 3, which holds up the middle
            "push_impulse": rows(default=0.0, NUDGED=5.0, FELLED=80.0),
            "push_direction": rows(default=0.0, NUDGED=np.pi / 2, FELLED=np.pi / 2),
            "push_time": rows(default=0.2),
        },
        noise={"position_noise": noise, "orientation_noise": noise, "delay": 1000 * noise, "delay_buffer": 3},
    )


@pytest.fixture(scope="module")
def mjx(nominal, world):
    return MjxEngine(
        dataclasses.replace(compose(WALK).settings, width=WIDTH),
        world_structure(world, nominal),
        nominal,
        OutcomeThresholds(),
    )


def world_structure(world, nominal):
    """Plain numbers with the batch's static parts."""
    return replace(nominal, noise={"delay_buffer": world.noise.delay_buffer})


STREAMS = np.array([0, 0, 0, 0, 5, 5, 6, 0, 0, 0, 0, 9])


@pytest.fixture(scope="module")
def figures(mjx, world, nominal):
    belief = replace(nominal, obstacle={"slope": world.obstacle.slope})
    return mjx.run(world, belief, STREAMS)


@pytest.fixture(scope="module")
def again(mjx, world, nominal):
    """The same batch with a whole number where one was broken, and nothing else changed."""
    belief = replace(nominal, obstacle={"slope": world.obstacle.slope})
    friction = np.where(np.isnan(world.contact.friction), 0.02, world.contact.friction)
    return mjx.run(replace(world, contact={"friction": friction}), belief, STREAMS)


@pytest.fixture(scope="module")
def native(nominal):
    engine = NativeEngine(
        dataclasses.replace(compose(WALK).settings, name="native", width=1), nominal, nominal, OutcomeThresholds()
    )
    return engine.run(nominal, nominal, np.zeros(1, int))


def test_figures_are_there_and_finite(figures):
    for name, values in figures.items():
        assert values.shape == (WIDTH,)
        if not name.endswith(FINITE_LATER):
            assert np.isfinite(values[NOMINAL]), name
    assert len(figures) > 30


def test_tripod_walks_at_v_o(figures, nominal):
    assert figures["speed_mps"][NOMINAL] == pytest.approx(speed(nominal), rel=0.02)
    assert classify(figures, OutcomeThresholds(), ("",) * 20)["outcome"][NOMINAL] == "success"


def test_standing_feet_do_not_slip(figures):
    assert figures["slip_max_m"][NOMINAL] <= 2e-3


def test_engines_agree(figures, native, nominal):
    """Where nothing slides, on the way and the heading; the tolerance is that of the project's definition of done."""
    path = STEPS * speed(nominal) * stepping.swing_time(nominal.manoeuvre.rate)
    a, b = figures["distance_m"][NOMINAL], native["distance_m"][0]
    assert abs(a - b) < max(10e-3, 0.005 * path)
    assert abs(figures["heading_error_max_deg"][NOMINAL] - native["heading_error_max_deg"][0]) < 1
    assert native["speed_mps"][0] == pytest.approx(speed(nominal), rel=0.02)
    assert native.keys() == figures.keys()


def test_a_nan_touches_no_other_row(figures, again):
    outcome = classify(figures, OutcomeThresholds(), ("",) * 20)["outcome"]
    assert outcome[BROKEN] == "invalid"
    assert differing(figures, again, BROKEN)
    for row in set(range(WIDTH)) - {BROKEN}:
        assert differing(figures, again, row) == [], row  # also: the same input twice gives the same bits


def test_slides_above_the_friction_angle(figures):
    assert figures["slip_max_m"][BELOW] < 0.02
    assert figures["slip_max_m"][ABOVE] > 0.1
    assert figures["progress"][BELOW] > 0.9 > figures["progress"][ABOVE]


def test_reserves_shrink_before_anything_breaks(figures):
    # on a slope the feet together take its tangent, and what legs and gait take beside that
    reserve = figures["friction_reserve_min"]
    assert 0 < reserve[BELOW] < 1 - np.tan(LIMIT - np.radians(8)) / MU
    assert reserve[ABOVE] < reserve[BELOW] < reserve[NOMINAL] < 1
    assert figures["torque_reserve_min"][WEAK] < 0.05 < 0.8 < figures["torque_reserve_min"][NOMINAL]
    assert figures["reach_reserve_min_m"][NOMINAL] > 0.1
    finite = np.isfinite(figures["foot_gap_max_m"])
    assert ((figures["foot_gap_max_m"] < 0.02) == (figures["feet_on_target"] == 6))[finite].all()
    assert ((figures["time_use"] <= 1) == (figures["finished"] == 1))[finite].all()


def test_noise_depends_on_its_stream_alone(figures):
    assert differing(figures, figures, NOISY, SAME) == []
    for name in ("tilt_max_deg", "position_error_max_m", "distance_m"):
        assert figures[name][NOISY] != figures[name][OTHER]
        assert figures[name][NOISY] != figures[name][NOMINAL]


def test_without_noise_the_stream_does_not_matter(figures):
    assert differing(figures, figures, NOMINAL, TWIN) == []


def test_errors_of_execution_tell(figures):
    """Too weak drives give way, a big push fells, a nudge and (with five good legs) a dead joint are only felt."""
    # while it tumbles, two iterations leave more of the solver's residual than a trusted rollout may
    outcome = classify(figures, OutcomeThresholds(solver_residual_max=1e9, solver_unsettled_share_max=1), ("",) * 20)
    assert outcome["outcome"][WEAK] == "failure"
    assert (outcome["outcome"][FELLED], outcome["cause"][FELLED]) == ("failure", "fell")
    assert outcome["outcome"][NUDGED] == "success"
    assert figures["saturation_share_beta"][WEAK] > 0.2 > figures["saturation_share_beta"][NOMINAL]
    assert differing(figures, figures, NUDGED, NOMINAL)
    assert figures["tilt_max_deg"][DEAD] > 1 + figures["tilt_max_deg"][NOMINAL]


@pytest.mark.slow
def test_a_trace_is_the_run(mjx, world, nominal, figures):
    """Another compiled program, hence a tolerance: float32 and the contact's stiffness amplify the last bit."""
    belief = replace(nominal, obstacle={"slope": world.obstacle.slope})
    trace = mjx.trace(world, belief, STREAMS, NOISY)
    for name in ("distance_m", "tilt_max_deg", "speed_mps", "duration_s", "progress"):
        assert trace.metrics[name] == pytest.approx(figures[name][NOISY], rel=1e-2, abs=1e-3), name
    moved = np.linalg.norm(trace.qpos[-1, :2] - trace.qpos[0, :2])
    assert moved == pytest.approx(figures["distance_m"][NOISY], abs=5e-3)
    assert len(trace.time) == len(trace.qpos) == round(figures["duration_s"][NOISY] / 4e-3)
    weight = np.sum(trace.foot_force[:, :, 2], axis=1).mean()
    assert weight == pytest.approx(16 * GRAVITY, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mjx", "native"])
def test_all_rollouts_of_a_batch_are_recorded_as_one_is(name, mjx, world, nominal):
    belief = replace(nominal, obstacle={"slope": world.obstacle.slope})
    engine, cases, streams, slot = mjx, (world, belief), STREAMS, NOISY
    if name == "native":
        settings = dataclasses.replace(compose(WALK).settings, name="native", width=2)
        engine = NativeEngine(settings, nominal, nominal, OutcomeThresholds())
        cases, streams, slot = (nominal, nominal), np.zeros(2, int), 1
    one, every = engine.trace(*cases, streams, slot), engine.traces(*cases, streams, 25)
    peaks = one.joint_torque.reshape(-1, 6, 3).max(axis=(0, 1))  # back-EMF taken off, as in the row
    np.testing.assert_allclose(peaks, [one.metrics[f"torque_peak_{joint}_nm"] for joint in JOINT_KINDS], rtol=1e-5)
    assert len(every) == len(streams)
    again = every[slot]
    assert again.time == pytest.approx(one.time[24::25])
    assert one.margin[-1] == pytest.approx(_watched(engine.limits, nominal, one), abs=1e-6)
    assert one.margin[0] > 0.5
    assert one.margin_of[-1] in {c.threshold for c in accumulator.causes_judged_each_tick(nominal)}
    for field in ("qpos", "foot_force", "joint_torque", "stage", "margin"):
        assert np.array_equal(getattr(again, field), getattr(one, field)[24::25]), field
    assert all(np.array_equal(again.metrics[k], one.metrics[k], equal_nan=True) for k in one.metrics)
    assert not len(engine.traces(*cases, streams, 10**6)[slot].time)  # not one sample is due


def _watched(limits, case, trace):
    """Least margin of a rollout's figures to the limits that are watched in every tick."""
    figures = {name: np.asarray(value) for name, value in trace.metrics.items()}
    return least_margins(accumulator.causes_judged_each_tick(case), figures, limits)[0]
