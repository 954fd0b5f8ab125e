"""Errors of execution of own models against mechanics: pushes of bodies, and commands that come late."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from own_rollouts import prepare_batch, write_texts
from small_study import one_line

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.runs import store
from sweep.runs.axis_effects import find_inactive_parameters
from sweep.runs.runner import select_points_to_simulate

STEP, PERIOD, MASS = 0.002, 0.02, 2.0
MODEL = f"""<mujoco><option timestep="{STEP}" gravity="0 0 0" integrator="Euler"/>
<worldbody>
  <body name="ball" pos="0 0 1"><freejoint/><geom size="0.1" mass="{MASS}"/></body>
  <body name="cart" pos="0 2 1"><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
</worldbody>
<actuator><motor name="pull" joint="rail"/></actuator>
</mujoco>"""
SINE = """import jax.numpy as jnp
def begin(belief, key): return None, jnp.zeros(()), None
def policy(belief, seen, state, key): return jnp.sin(9 * state)[None] + 0.5, state + 0.02
"""
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "sine:policy", duration: 0.5}
push: {kick: {body: ball, start: 0.101, length: 0.05}}
outcome: {far: travelled_m > 9}
study: {axes: {size: {path: push.kick.impulse, values: [0.0, 3.0]}}}
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_texts({"model.xml": MODEL, "sine.py": SINE, "one.yaml": STUDY})
    return tmp_path


def simulate(engine, *more):
    """Velocities (rollouts, ticks, nv) and metrics of a study on an engine, in double precision."""
    made, batch = prepare_batch(f"engine={engine}", "engine.precision=float64", *more)
    found = made.run(*batch)
    return np.stack([one.qvel for one in made.traces(*batch, 1)]), found


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_a_push_changes_momentum_by_its_impulse_and_energy_by_its_work(here, engine):
    more = ["+push.kick.direction=0.3", "+push.kick.elevation=0.2", "+push.kick.force=4.0"]
    speeds, found = simulate(engine, *more)
    along = np.array([np.cos(0.2) * np.cos(0.3), np.cos(0.2) * np.sin(0.3), np.sin(0.2)])
    for k, impulse in enumerate((0.0, 3.0)):
        gained = (impulse + 4.0 * 0.05) / MASS * along
        np.testing.assert_allclose(speeds[k, -1, :3], gained, atol=1e-9)
        time = PERIOD * np.arange(1, 26)
        share = np.clip((time - 0.101) / 0.05, 0, 1)
        np.testing.assert_allclose(speeds[k, :, :3], share[:, None] * gained, atol=1e-9)
    assert np.abs(found["energy_gained_j"]).max() < 1e-3  # of 2.6 J


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_a_delayed_command_is_that_of_earlier_steps(here, engine):
    speeds, _ = simulate(engine, "study.axes.size={path: noise.action_delay, values: [0, 7, 25]}")
    commands = np.repeat(np.sin(9 * PERIOD * np.arange(25)) + 0.5, 10)
    for k, delay in enumerate((0, 7, 25)):
        late = np.concatenate([np.full(delay, commands[0]), commands])[: len(commands)]
        np.testing.assert_allclose(speeds[k, :, -1], STEP * np.cumsum(late)[9::10], atol=1e-9)


def test_random_times_of_pushes_are_those_of_the_row_whatever_runs_beside_it(here):
    more = ["+push.kick.spread=0.2", "+push.kick.force=1.0", "study.replicates=20"]
    speeds, _ = simulate("native", *more)
    _, alone = simulate("native", *more)
    begins = (speeds[:, :, 0] > 1e-12).argmax(axis=1)
    assert len(set(begins)) > 4
    assert begins.min() >= 5
    assert begins.max() <= 15
    assert main(["run", "study=one.yaml", *more, "engine.width=7", "out=seven"]) == 0
    assert main(["run", "study=one.yaml", *more, "engine.width=40", "out=all"]) == 0
    assert main(["compare", "seven", "all", "--tolerance", "0"]) == 0
    assert set(alone) >= {"energy_gained_j"}


def test_a_run_with_pushes_and_random_starts_goes_on_as_if_it_was_never_stopped(here):
    more = ["+push.kick.spread=0.2", "+start.random.velocity_x=0.5", "study.replicates=8", "engine.width=5"]
    assert main(["run", "study=one.yaml", *more, "out=whole"]) == 0
    assert main(["run", "study=one.yaml", *more, "out=parts", "--limit", "5"]) == 0
    assert len(store.read_rows(Path("parts"))) < 16
    assert main(["run", "study=one.yaml", *more, "out=parts"]) == 0
    whole, parts = (store.read_rows(Path(name)).set_index("point_id").sort_index() for name in ("whole", "parts"))
    columns = ["travelled_m", "energy_gained_j", "distance_m", "outcome"]
    pd.testing.assert_frame_equal(whole[columns], parts[columns], check_exact=True)
    assert whole["travelled_m"].nunique() == 16


@pytest.mark.parametrize("axis", ["push.kick.impulse", "noise.action_delay", "start.x", "start.random.x"])
def test_an_axis_that_reaches_the_physics_counts_as_read(here, axis):
    exp = compose(["study=one.yaml", f"study.axes.size.path={axis}"])
    assert not find_inactive_parameters(exp, select_points_to_simulate(exp).assign(width=1))


@pytest.mark.parametrize(("push", "line"), [
    ("kick: {body: bal}", "push.kick.body: bal is unknown: did you mean ball?"),
    ("kick: {impulse: 3}", "push.kick needs the key body"),
    ("kick: {body: ball, size: 3}", "push.kick: size is unknown"),
    ("kick: {body: ball, length: 0}", "push.kick.length = 0 is not allowed: greater than 0 s"),
    ("k-k: {body: ball}", "push.k-k is not allowed: a name has letters, digits and _"),
])  # fmt: skip
def test_a_push_that_cannot_be_is_one_line(here, capsys, push, line):
    Path("one.yaml").write_text(STUDY.replace("{kick: {body: ball, start: 0.101, length: 0.05}}", f"{{{push}}}"))
    assert main(["run", "study=one.yaml", "study.axes.size.path=noise.white", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)
