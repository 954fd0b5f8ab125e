"""An own model on both engines: the same physics, what MJX cannot do, how it is simulated, and the audit."""

import os
import subprocess
import sys
import warnings
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pandas as pd
import pytest

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.contract.engine_settings import EngineSettings
from sweep.runs import audit, batches, results, store
from sweep.runs.runner import select_points_to_simulate
from sweep.systems.mujoco_model import MujocoModel, fields, mjx
from sweep.systems.mujoco_model.engine import print_note_once

HOPPER = """<mujoco><option timestep="0.002" integrator="Euler"/>
<worldbody>
  <geom name="floor" type="plane" size="0 0 1" friction="0.6" conaffinity="0"/>
  <body name="trunk" pos="0 0 0.5"><freejoint/>
    <geom name="trunk" type="sphere" size="0.1" mass="2" contype="0"/>
    <body name="leg" pos="0 0 -0.1"><joint name="hip" axis="0 1 0" range="-60 60" damping="0.1"/>
      <geom name="leg" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.3" contype="0" conaffinity="0"/>
      <geom name="foot" type="sphere" size="0.03" pos="0 0 -0.3" mass="0.1" friction="0.2" contype="0"/>
      <site name="foot" pos="0 0 -0.3" size="0.035"/>
    </body>
  </body>
</worldbody>
<actuator><position name="hip" joint="hip" kp="40" kv="1" forcerange="-3 3"/></actuator>
<sensor><framequat name="turn" objtype="body" objname="trunk"/><jointpos name="hip" joint="hip"/>
<touch name="foot" site="foot"/></sensor></mujoco>"""
SWING = """import jax.numpy as jnp
PARAMETERS = {"reach": 0.4}
BELIEVES = {"load": "model.body.trunk.mass"}
def begin(belief, key):
    return None, {"time": jnp.zeros(())}, None
def policy(belief, seen, state, key):
    lean = 2 * seen[2]
    aim = belief["reach"] * jnp.sin(8 * state["time"]) - lean + 0.01 * belief["load"]
    return jnp.array([aim]), {"time": state["time"] + 0.02}
"""
STUDY = """system: own
model: {mjcf: hopper.xml, controller: "swing:policy", duration: 1, feet: [foot]}
outcome: {far: travelled_m > 0.42}
study:
  axes:
    load: {path: model.body.trunk.mass, side: world, from: 1, to: 4, num: 3}
    grip: {path: model.geom.floor.friction.slide, side: world, values: [0.3, 0.9]}
    rub: {path: model.joint.hip.frictionloss, side: world, values: [0, 0.2]}
"""


STILL = "import jax.numpy as jnp\ndef policy(belief, seen, state, key): return jnp.zeros({}), state\n"
needs_warp = pytest.mark.skipif(find_spec("warp") is None, reason="needs the extra warp")
CONSTANT = (
    "duration_s",
    "not_finite",
    "buffer_full",
    "joint_limit_share",
    "unsolved_share",
    "torque_max_nm",
)  # of its rows; the motor is at its limit in each


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hopper")
    for name, text in {
        "hopper.xml": HOPPER,
        "swing.py": SWING,
        "study.yaml": STUDY,
        "sweep.yaml": "modules: []",
    }.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def figures(exp, table, **engine):
    """Those of a study's points, in one batch of an engine."""
    rows = batches.assign_batches(exp, pd.DataFrame(), table).assign(width=len(table))
    task = batches.make_batch(exp, rows)
    made = exp.system.make_engine(replace(task.settings, **engine), task.world, task.belief, None)
    return made.run(task.world, task.belief, task.streams)


def test_both_engines_simulate_the_same_physics(here):
    """In double precision what is left are last digits; falls, slips and joints without friction are among the rows."""
    lift = "study.axes.lift={path: model.body.trunk.gravcomp, side: world, values: [0, 0.3]}"  # none nominally
    near = "study.axes.near={path: model.geom.foot.margin, side: world, values: [0, 0.01]}"
    exp = compose(["study=study.yaml", lift, near, "engine.precision=float64", "noise.white=0.01", "noise.delay=1"])
    exp = batches.allocate_delay_buffers(exp, table := select_points_to_simulate(exp))
    native, again = (figures(exp, table, name=name) for name in ("native", "mjx"))
    assert native["slip_max_m"].max() > 0.005
    assert native["tilt_max_deg"].max() > 90
    assert native["saturated_share"].max() > 0
    for name, values in native.items():
        assert len(np.unique(values)) > 1 or name in CONSTANT
        np.testing.assert_allclose(again[name], values, rtol=1e-6, atol=1e-7, err_msg=name)
    single = figures(exp, table, name="mjx", precision="float32")
    assert not single["unsolved_share"].any()
    apart = np.abs(single["travelled_m"] - native["travelled_m"])
    assert 1e-9 < apart[np.asarray(table["world.model.body.trunk.gravcomp"]) == 0].max() < 1e-2  # others tumble


@pytest.mark.slow
@needs_warp
def test_warp_simulates_the_same_physics(here):
    """In single precision, on Warp's CPU where there is no GPU; each rollout has fields of its own."""
    exp = compose(["study=study.yaml", "noise.white=0.01", "noise.delay=1"])
    exp = batches.allocate_delay_buffers(exp, table := select_points_to_simulate(exp))
    native, again = (figures(exp, table, name=name) for name in ("native", "warp"))
    for name in ("base_height_min_m", "tilt_max_deg", "travelled_m", "slip_max_m", "energy_j", "load_max_n"):
        assert len(np.unique(native[name])) > 6
        np.testing.assert_allclose(again[name], native[name], rtol=0.02, atol=2e-3, err_msg=name)
    assert not again["buffer_full"].any()


@pytest.mark.slow
@needs_warp
def test_a_limit_of_warps_solver_is_no_lack_of_room(here):
    """Its line search is at its limit in every step with contacts."""
    exp = compose(["study=study.yaml", "model.duration=0.4", "model.option.ls_iterations=1"])
    assert not figures(exp, select_points_to_simulate(exp), name="warp")["buffer_full"].any()


@pytest.mark.skipif(find_spec("warp") is not None, reason="the extra warp is installed")
def test_warp_needs_its_extra(here, capsys):
    assert main(["run", "study=study.yaml", "engine=warp", "out=none"]) == 2
    assert "it needs NVIDIA Warp: pip install 'insect-sweep[warp]'" in capsys.readouterr().err
    assert main(["run", "scenario=walk_tripod", "engine=warp", "out=none"]) == 2
    assert "engine.name = 'warp' is not allowed: one of mjx, native" in capsys.readouterr().err
    assert not Path("none").exists()


@pytest.mark.slow
def test_how_it_is_simulated_is_an_axis(here):
    how = ["timestep: {path: model.option.timestep, values: [0.002, 0.001]}",
           "cone: {path: model.option.cone, values: [pyramidal, elliptic]}",
           "solver: {path: model.option.solver, values: [Newton, CG]}",
           "integrator: {path: model.option.integrator, values: [Euler, implicitfast]}",
           "steps: {path: model.option.iterations, values: [1, 100]}",
           "stop: {path: model.option.tolerance, values: [1e-8, 1e-2]}",
           "ratio: {path: model.option.impratio, values: [1, 10]}"]  # fmt: skip
    head = STUDY.split("  axes:")[0].replace("duration: 1", "duration: 0.6")
    for line in how:
        Path("how.yaml").write_text(f"{head}  axes:\n    {line}\n")
        extra = ["model.option.cone=elliptic"] if "ratio" in line else []
        name = line.partition(":")[0]
        assert main(["run", "study=how.yaml", f"out={name}", *extra]) == 0
        rows = store.read_rows(Path(name))
        assert rows["base_height_min_m"].nunique() == 2, line
    model = mujoco.MjModel.from_xml_path("hopper.xml")
    model.opt.timestep, model.opt.cone = 0.001, int(mujoco.mjtCone.mjCONE_ELLIPTIC)
    for name, kinds in (("cone", mujoco.mjtCone), ("integrator", mujoco.mjtIntegrator), ("solver", mujoco.mjtSolver)):
        assert [one.partition("_")[2] for one in kinds.__members__] == [
            word.upper() for word in fields.ENUM_OPTIONS[name]
        ]
    changed = fields.replace_scalar_options(model, {"model.option.cone": "pyramidal", "model.option.timestep": 0.004})
    assert (changed.opt.cone, changed.opt.timestep, model.opt.timestep) == (0, 0.004, 0.001)


def test_a_number_that_others_are_made_from_is_no_parameter(here):
    axes = "load: {path: model.body.trunk.mass, times: model.body.leg.mass, values: [2, 4]}"
    Path("made.yaml").write_text(f"{STUDY.split('  axes:')[0]}  axes:\n    {axes}\n")
    assert main(["run", "study=made.yaml", "out=made", "model.duration=0.1"]) == 0
    np.testing.assert_allclose(store.read_rows(Path("made"))["model.body.trunk.mass"], [0.8, 1.6])


@pytest.mark.slow
def test_an_audit_tells_robot_from_simulator(here, capsys):
    assert main(["run", "study=study.yaml", "out=whole", "study.axes.rub.values=[0.1]"]) == 0
    assert main(["audit", "whole", "--points", "3"]) == 0
    found = audit.outcome_flip_table(results.read_results(Path("whole")))
    assert list(found["simulated"].unique()) == [
        way.description for way in results.read_results(Path("whole")).exp.system.audit_variants.values()
    ]
    before = store.read_rows(Path("whole")).set_index("point_id")["travelled_m"]
    moved = {}
    for way in ("again", "half_step", "float64", "other_engine", "other_cone"):
        rows = store.read_rows(Path("whole/audit") / way)
        moved[way] = (rows.set_index("point_id")["travelled_m"] - before).abs().max()
    assert moved["again"] == 0
    assert 0 < moved["other_engine"] < 0.01
    assert 0 < moved["float64"] < 0.01
    assert moved["half_step"] > 1e-5
    assert moved["other_cone"] > 1e-5
    assert set(store.read_rows(Path("whole/audit/half_step"))["model.option.timestep"]) == {0.001}


BALL = '<body pos="0 0 1"><freejoint/><geom size=".1"/></body>'
WHEEL = '<body pos="0 0 1"><joint name="a"/><geom size=".1"/></body>'
ON_BOX = '<geom type="box" size="1 1 1"/><body pos="0 0 3"><freejoint/><geom type="{}" size=".1 .2 .3"/></body>'


@pytest.mark.parametrize(
    ("option", "world", "motor", "line"),
    [
        ('integrator="implicit"', BALL, "", "no mjtIntegrator.mjINT_IMPLICIT (model.option.integrator=implicitfast"),
        ('solver="PGS"', BALL, "", "no mjtSolver.mjSOL_PGS (model.option.solver=Newton or CG, or engine=native)"),
        ('noslip_iterations="3"', BALL, "", "MJX leaves out option.noslip_iterations"),
        ('integrator="implicitfast" density="1.2"', BALL, "", "fluid drag (model.option.integrator=Euler, or"),
        ("", ON_BOX.format("ellipsoid"), "", "collisions not implemented (other shapes, or geoms that do not collide"),
        ("", ON_BOX.format("cylinder"), "", "collisions not implemented"),
        ("", WHEEL, 'damping="0.3"', "MJX leaves out actuator.damping"),
        ("", WHEEL, 'armature="0.3"', "MJX leaves out actuator.armature"),
        ("", WHEEL.replace('name="a"', 'name="a" stiffness="0 1"'), "", "MJX leaves out joint.stiffnesspoly"),
        ("", WHEEL.replace('name="a"', 'name="a" damping="0 1"'), "", "MJX leaves out joint.dampingpoly"),
        ('density="1"', BALL.replace("size", 'fluidshape="ellipsoid" size'), "", "MJX leaves out geom.fluid"),
    ],
)
def test_what_mjx_cannot_do_is_said_before_anything_runs(here, tmp_path, capsys, option, world, motor, line):
    rest = f'<actuator><motor joint="a" {motor}/></actuator>' if motor else ""
    Path("odd.xml").write_text(f"<mujoco><option {option}/><worldbody>{world}</worldbody>{rest}</mujoco>")
    nu = 1 if motor else 0
    Path(f"still{nu}.py").write_text(STILL.format(nu))
    odd = ["model.mjcf=odd.xml", f"model.controller=still{nu}:policy", "model.feet=[]", "outcome.far='energy_j < -1'"]
    odd += [
        "study.axes={g: {path: model.option.gravity.z, values: [-9, -8]}}",
        f"out={tmp_path}/odd",
        "model.duration=0.1",
    ]
    Path("odd.yaml").write_text(STUDY.split("  axes:")[0])
    assert main(["run", "study=odd.yaml", *odd, "engine=mjx"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert told[0].startswith("sweep: engine.name = mjx is not allowed: ")
    assert line in told[0]
    assert not (tmp_path / "odd").exists()
    assert main(["run", "study=odd.yaml", *odd]) == 0  # which C MuJoCo does
    assert main(["audit", f"{tmp_path}/odd"]) == 0
    assert "audit: other_engine is left out: engine.name = mjx is not allowed" in capsys.readouterr().err
    assert not (tmp_path / "odd/audit/other_engine").exists()


SWUNG = """<body><joint name="a" axis="0 1 0" stiffness="0 9" damping="0 0.3"/>
<geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.05"/></body>"""


@pytest.mark.slow
@needs_warp
@pytest.mark.parametrize(
    ("option", "world", "figure"),
    [
        ("", SWUNG, "energy_gained_j"),
        ('density="900"', BALL.replace("size", 'fluidshape="ellipsoid" size'), "energy_gained_j"),
        ("", ON_BOX.format("ellipsoid"), "base_height_min_m"),
        ("", ON_BOX.format("cylinder"), "base_height_min_m"),
    ],
)
def test_warp_does_some_of_what_mjx_does_not(here, tmp_path, option, world, figure):
    """As C MuJoCo does: springs and dampers that are no lines, drag by shape, and shapes on a box."""
    Path("more.xml").write_text(f"<mujoco><option {option}/><worldbody>{world}</worldbody></mujoco>")
    Path("still0.py").write_text(STILL.format(0))
    Path("more.yaml").write_text(
        "system: own\nmodel: {mjcf: more.xml, controller: 'still0:policy', duration: 0.8}\n"
        "outcome: {goal: duration_s > 0}\nstudy: {name: more}\n"
    )
    found = []
    for name in ("native", "warp"):
        assert main(["run", "study=more.yaml", f"engine={name}", f"out={tmp_path}/{name}"]) == 0
        found.append(store.read_rows(tmp_path / name)[figure].item())
    np.testing.assert_allclose(found[1], found[0], rtol=0.02)


@needs_warp
def test_what_warp_cannot_do_is_said_before_anything_runs(here, capsys):
    rail("push", PUSH)
    assert main(["run", "study=rail.yaml", "engine=warp", "engine.precision=float64", "out=refused"]) == 2
    assert "engine.precision = float64 is not allowed: warp computes in float32" in capsys.readouterr().err
    axis = "study.axes.stick={path: model.geom.floor.adhesion, side: world, values: [0, 9]}"
    assert main(["run", "study=study.yaml", "engine=warp", axis, "out=refused"]) == 2
    assert "MJX has no geom_adhesion, which model.geom.floor.adhesion varies" in capsys.readouterr().err
    for what, words in (('damping="1"', "damping"), ('delay="0.02" nsample="4"', "delay")):
        Path("rail.xml").write_text(RAIL.replace('joint="x"/></act', f'joint="x" {what}/></act'))
        assert main(["run", "study=rail.yaml", "engine=warp", "out=refused"]) == 2
        assert f"MJX leaves out actuator.{words} (a model without, or" in capsys.readouterr().err
    assert not Path("refused").exists()


def test_what_mjx_has_no_field_for_is_no_axis_of_its(here, capsys):
    """Every other field is an array of JAX's, not a constant."""
    template = mjx.mjx.put_model(mujoco.MjModel.from_xml_path("hopper.xml"))
    varied = [one.field for kind in [*fields.VARIABLE_NUMBERS.values(), fields.OPTION_NUMBERS] for one in kind.values()]
    owners = {name: template.opt if name.startswith("opt.") else template for name in varied}
    lacking = {n for n, owner in owners.items() if not hasattr(getattr(owner, n.removeprefix("opt."), None), "at")}
    assert lacking == {
        *("actuator_damping", "actuator_dampingpoly", "actuator_armature", "opt.noslip_tolerance", "opt.ccd_tolerance"),
        *("geom_adhesion", "geom_surfacevel", "geom_fluid", "pair_adhesion", "site_size", "sensor_cutoff"),
    }
    axis = "study.axes.rub={path: model.actuator.hip.armature, side: world, values: [0, 0.1]}"
    assert main(["run", "study=study.yaml", axis, "engine=mjx", "out=lacking"]) == 2
    (told,) = capsys.readouterr().err.splitlines()
    assert "MJX has no actuator_armature, which model.actuator.hip.armature varies (other axes, or engine=nat" in told
    axis = "study.axes.rub={path: model.joint.hip.dampingpoly.0, side: world, values: [0, 0.1]}"
    assert main(["run", "study=study.yaml", axis, "engine=mjx", "out=lacking"]) == 2
    assert "MJX has no dof_dampingpoly, which model.joint.hip.dampingpoly.0 varies" in capsys.readouterr().err
    axis = "study.axes.rub={path: model.option.density, side: world, values: [0, 1]}"
    assert (
        main(["run", "study=study.yaml", axis, "engine=mjx", "model.option.integrator=implicitfast", "out=lacking"])
        == 2
    )
    told = capsys.readouterr().err.splitlines()[-1]
    assert "fluid drag (model.option.integrator=Euler, or engine=native)" in told
    assert not Path("lacking").exists()


def test_what_mjx_warns_of_is_one_note(here, monkeypatch, capsys, recwarn):
    put = mjx.mjx.put_model

    def put_with_warnings(*args, **options):
        for text in ("the solver is\n  slow", "the solver is\n  slow", "another"):
            warnings.warn(text, stacklevel=1)
        return put(*args, **options)

    monkeypatch.setattr(mjx.mjx, "put_model", put_with_warnings)
    print_note_once.cache_clear()
    for _ in range(2):
        _engine("Euler")
    notes = [line for line in capsys.readouterr().err.splitlines() if "warns" in line]
    assert notes == ["sweep: note: mjx warns of hopper.xml: the solver is slow (and 1 more)"]
    assert not [one for one in recwarn if "slow" in str(one.message)]


def test_where_mjx_parts_from_c_is_told(here, capsys):
    assert not [*_engine("Euler").describe_differences_from_mujoco()]
    (line,) = _engine("implicitfast").describe_differences_from_mujoco()
    assert "model.option.integrator=Euler" in line
    tail = '<body><joint name="tail" axis="0 1 0"/><geom size="0.02" mass="0.1" contype="0"/></body>'
    joints = '<joint joint="hip" coef="1"/><joint joint="tail" coef="1"/>'
    tendon = f'<tendon><fixed name="t" armature="0.1">{joints}</fixed></tendon>'
    model = HOPPER.replace('<body name="leg"', f'{tail}<body name="leg"')
    Path("coupled.xml").write_text(model.replace("<actuator>", f"{tendon}<actuator>"))
    (line,) = _engine("Euler", "model.mjcf=coupled.xml").describe_differences_from_mujoco()
    assert "armature of tendons" in line


def _engine(integrator, *more):
    system = compose(["study=study.yaml", f"model.option.integrator={integrator}", *more]).system
    assert isinstance(system, MujocoModel)
    return system.make_engine(EngineSettings(name="mjx"), *system.make_world_and_belief({}), None)


RAIL = """<mujoco><option timestep="0.005" gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"/>
<geom size="0.1" mass="2"/></body></worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
PUSH = """import jax.numpy as jnp
FIGURES = {"speed_mps": "speed that the last tick began with"}
def begin(belief, key): return None, {"tick": jnp.zeros(()), "speed": jnp.zeros(())}, None
def policy(belief, seen, state, key):
    return state["tick"][None], {"tick": state["tick"] + 1, "speed": seen[1]}
def figures(belief, state): return {"speed_mps": state["speed"]}
"""


def rail(name, code):
    """A study of a push on it, by a controller."""
    Path("rail.xml").write_text(RAIL)
    Path(f"{name}.py").write_text(code)
    Path("rail.yaml").write_text(
        f"system: own\nmodel: {{mjcf: rail.xml, controller: '{name}:policy', duration: 0.2}}\n"
        "outcome: {fast: speed_mps > 9}\nstudy: {name: rail}\n"
    )


@pytest.mark.parametrize(
    ("engine", "precision", "error"),
    [
        ("native", "float64", 1e-9),
        ("mjx", "float64", 1e-9),
        pytest.param("warp", "float32", 1e-5, marks=[pytest.mark.slow, needs_warp]),
    ],
)
def test_commands_are_held_or_ramped_and_figures_of_ones_own_see_the_state(here, engine, precision, error):
    """A force of k newtons in tick k, of four steps of 5 ms: the speed is the impulse over 2 kg."""
    rail("push", PUSH)
    held = sum(range(9)) * 0.02 / 2
    ramped = sum(max(k - 1, 0) + (k - max(k - 1, 0)) * (1 + 2 + 3 + 4) / 16 for k in range(9)) * 0.02 / 2
    for command, speed in (("held", held), ("ramped", ramped)):
        how = [f"engine={engine}", f"engine.precision={precision}", f"out={engine}_{command}"]
        assert main(["run", "study=rail.yaml", f"model.command={command}", *how]) == 0
        np.testing.assert_allclose(store.read_rows(Path(f"{engine}_{command}"))["speed_mps"], speed, rtol=error)


def test_mjx_traces_once(here, caplog):
    """What is traced and compiled of a batch is not, of the next one."""
    rail("push", PUSH)
    exp = compose(["study=rail.yaml", "engine=mjx"])
    task = (*exp.system.make_world_and_belief({}), np.zeros(4, np.int64))
    made = exp.system.make_engine(exp.settings, *task[:2], None)
    with jax.log_compiles():
        first = made.run(*task)
        assert "begin_controller" in caplog.text
        caplog.clear()
        again = made.run(*task)
    assert not caplog.messages
    for name, values in first.items():
        np.testing.assert_array_equal(again[name], values, err_msg=name)


WHERE = """import jax
FIGURES = {"speed_mps": "none"}
PLACES = set()
def figures(belief, state): return {"speed_mps": jax.numpy.zeros(())}
def policy(seen):
    PLACES.update(device.id for array in jax.live_arrays() for device in array.devices())
    return 0 * seen[:, :1]
"""
ELSEWHERE = """import jax, numpy as np
jax.config.update("jax_default_device", jax.devices()[1])
from sweep.config.experiment import compose
exp = compose(["study=rail.yaml"])
task = *exp.system.make_world_and_belief({}), np.zeros(4, np.int64)
exp.system.make_engine(exp.settings, *task[:2], None).run(*task)
import where
print(where.PLACES)
"""


def test_native_is_on_the_cpu_beside_other_devices(here):
    """Whose programs run on the first device, another one being the default."""
    rail("where", WHERE)
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    found = subprocess.run([sys.executable, "-c", ELSEWHERE], env=os.environ | flags, capture_output=True, text=True)
    assert found.stdout.split() == ["{0}"], found.stderr


GLIDE = """import jax.numpy as jnp
PARAMETERS = {"long": 0.2}
FIGURES = {"way_m": "sum of the speeds that ticks begin and end with", "told_mps": "what the last tick was told"}
def begin(belief, key): return None, jnp.zeros(()), belief["long"]
def observe(told): return 2 * told["qvel"]
def policy(belief, seen, state, key): return jnp.ones(1), seen[0]
def measure(sofar, told): return (0.0 if sofar is None else sofar) + told["qvel"][0]
def figures(belief, state, sofar): return {"way_m": sofar, "told_mps": state}
"""
GLIDES = {  # of NumPy, which has neither a state nor parameters
    "jax": GLIDE,
    "numpy": GLIDE.replace(
        "policy(belief, seen, state, key): return jnp.ones(1), seen[0]", "policy(seen): return 1 + 0 * seen"
    ).replace('"told_mps": state', '"told_mps": 0.0 * sofar'),
}


@pytest.mark.parametrize(("engine", "kind"), [("native", "jax"), ("mjx", "jax"), ("native", "numpy")])
def test_what_is_observed_and_measured_may_be_functions(here, engine, kind):
    """A newton on 2 kg: 0, 0.01, 0.02 m/s and so on at the ends of ticks, to a rollout's own end."""
    Path("rail.xml").write_text(RAIL)
    Path(f"glide_{kind}.py").write_text(GLIDES[kind])
    Path("glide.yaml").write_text(
        f"system: own\nmodel: {{mjcf: rail.xml, controller: 'glide_{kind}:policy', duration: 0.2}}\n"
        "outcome: {fast: way_m > 9}\nstudy:\n  axes:\n"
        + ("    long: {path: controller.long, values: [0.1, 0.2]}\n" if kind == "jax" else "    pull: {path: "
           "model.option.gravity.z, side: world, values: [0, -1]}\n")
    )  # fmt: skip
    asked = ["study.expect=[]", f"engine={engine}", "engine.precision=float64", f"out=glide_{engine}_{kind}"]
    assert main(["run", "study=glide.yaml", *asked]) == 0
    rows = store.read_rows(Path(f"glide_{engine}_{kind}"))
    ticks = np.array([5, 10] if kind == "jax" else [10, 10])
    np.testing.assert_allclose(rows["way_m"], 0.01 * ticks * (ticks + 1) / 2, rtol=1e-9)
    if kind == "jax":
        np.testing.assert_allclose(rows["told_mps"], 2 * 0.01 * (ticks - 1), rtol=1e-9)
    assert main(["run", "study=glide.yaml", "model.observe=[qpos]", "out=both"]) == 2


def test_figures_have_names(here, capsys):
    rail("nameless", PUSH.replace('{"speed_mps": state', '{"speed": state'))
    assert main(["run", "study=rail.yaml", "out=nameless"]) == 2
    assert "has figures speed float32 (): numbers are wanted, named in FIGURES" in capsys.readouterr().err


def test_a_row_says_on_what_it_was_simulated(here, monkeypatch):
    """Two GPUs are told apart, by MuJoCo Warp's kernels, too."""
    system, found = compose(["study=study.yaml"]).system, {}
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    for kind in ("H100", "A100"):
        monkeypatch.setattr(jax, "devices", lambda kind=kind: [SimpleNamespace(device_kind=kind)])
        for name in ("native", "mjx", "warp"):
            found[kind, name] = system.device(EngineSettings(name=name))
    for name in ("mjx", "warp"):
        assert "A100" in found["A100", name]
        assert "H100" in found["H100", name]
    assert found["A100", "native"] == found["H100", "native"]
