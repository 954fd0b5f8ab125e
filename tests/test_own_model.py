"""An own model and controller: the pages of the guide as they stand, bits, fields, outcomes, and mistakes."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest
from mujoco.batch import Batch
from small_study import content, one_line, wait_for

from sweep.backends import devices
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core.conditions import parse_conditions
from sweep.runs import batches, results, store
from sweep.runs.runner import select_points_to_simulate
from sweep.systems.mujoco_model import batch, fields, label_rollouts

PAGE = (Path(__file__).parents[1] / "docs/own_model.md").read_text(encoding="utf-8")
POLICY = (Path(__file__).parents[1] / "docs/howto/write_a_policy.md").read_text(encoding="utf-8")
CODE = re.findall(r"```python\n(.*?)```", POLICY, re.DOTALL)
AXES = "  axes: {bad: {path: controller.bad, values: [0, 1]}}\n"
SHORT = ["study=grip", "model.duration=0.3", "study.expect=[]"]


@pytest.fixture(scope="module")
def quad(tmp_path_factory):
    """A new project."""
    folder = tmp_path_factory.mktemp("own") / "quad"
    assert main(["init", "--model", str(folder)]) == 0
    return folder


@pytest.fixture
def here(quad, monkeypatch):
    monkeypatch.chdir(quad)
    return quad


def figures(exp, rows):
    """Those of some rows of a study's points, in a batch of their own."""
    rows = batches.assign_batches(exp, pd.DataFrame(), rows.reset_index(drop=True)).assign(width=len(rows))
    exp = batches.allocate_delay_buffers(exp, rows)
    task, start = batches.make_batch(exp, rows), batches.make_nominal_batch(exp, rows, len(rows))
    return batches.make_engine(exp, start).run(task.world, task.belief, task.streams)


def test_the_page_as_it_stands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    block = re.search(r"(?:^    .*\n)+", PAGE, re.MULTILINE)
    assert block
    for line in block[0].splitlines():
        words = shlex.split(line)
        if words[0] == "cd":
            monkeypatch.chdir(words[1])
        else:
            assert main(words[1:]) == 0, line
    scenario, study = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    Path("scenarios/own.yaml").write_text(scenario)
    Path("studies/page.yaml").write_text(study)
    assert main(["run", "scenario=own"]) == 0
    assert len(select_points_to_simulate(compose(["study=page"]))) == 3 * 3 * 2 * 2
    Path("page.py").write_text(f"import jax.numpy as jnp\n{CODE[0]}{CODE[1]}")
    page = ["study=page", "model.controller=page:policy", "model.duration=0.1", "model.observe=[]", "out=page"]
    assert main(["run", *page]) == 0
    assert store.read_rows(Path("page"))["sway_m"].between(1e-9, 0.1).all()
    rows = results.read_results(Path("results/grip")).rows
    success = rows["outcome"] == "success"
    slide = rows["world.model.geom.floor.friction.slide"]
    assert success[(slide > 0.7) & (rows["world.model.body.trunk.mass"] > 5)].all()
    assert not success[slide < 0.15].any()  # feet have 0.1 themselves
    assert "quadruped.xml" in Path("results/grip/report.html").read_text()
    assert "load (world) [kg]" in Path("results/grip/report.html").read_text()


@pytest.mark.slow
def test_what_studies_do_works_on_it(here, capsys, monkeypatch):
    assert main(["run", *SHORT, "--limit", "5", "out=some"]) == 0
    assert main(["run", *SHORT, "out=some", "engine.width=8"]) == 2  # the engine's settings are the folder's
    assert main(["run", *SHORT, "out=some", "study.keep=[]"]) == 0
    assert main(["run", *SHORT, "out=whole", "engine.width=7", "study.keep=[base_z_m,qpos_7,tilt_deg]"]) == 0
    capsys.readouterr()
    assert main(["compare", "some", "whole", "--tolerance", "0"]) == 0
    assert "36 pairs; unpaired: 0 rows of A, 0 of B\n0 of 36 flip" in capsys.readouterr().out
    some, whole = (store.read_rows(Path(name)).set_index("point_id") for name in ("some", "whole"))
    measured = ["base_height_min_m", "tilt_max_deg", "travelled_m", "slip_max_m", "energy_j"]
    pd.testing.assert_frame_equal(some[measured], whole.loc[some.index, measured], check_exact=True)
    for line in ("table some", "stats some", "status some", "verify some", "report some", "export some --paper p"):
        assert main(line.split()) == 0, line
    assert main(["replay", "some", "3"]) == 0
    assert "21 of 21 metrics are equal to the last bit" in capsys.readouterr().out
    assert main(["run", *SHORT, "out=some", "outcome.goal='travelled_m < 1e9'"]) == 0  # judged anew
    assert (store.read_rows(Path("some"))["outcome"] == "success").all()
    assert main(["relabel", "some", "goal=travelled_m >= 1e9", "low=base_height_min_m < 0.1"]) == 0
    rows = store.read_rows(Path("some"))
    assert set(rows["cause"]) <= {"fell", "low", "goal_missed"}
    assert (rows["outcome"] == "failure").all()
    for wrong, line in (
        ("goal", "'goal' is not allowed"),
        ("goal=far > 1", "outcome.goal: far is unknown"),
    ):
        assert main(["relabel", "some", wrong]) == 2
        assert line in capsys.readouterr().err
    assert main(["replay", "some", "3", "--states", "s.parquet"]) == 0
    assert {"time_s", "stage", "base_z_m", "qpos_0", "qvel_0"} <= set(pd.read_parquet("s.parquet"))
    assert main(["replay", "some", "3", "--model", "m.xml"]) == 2
    assert (
        "--model is not allowed: rollouts of this system are shown by --mcap, --png, --states, --video, and"
        in capsys.readouterr().err
    )
    trot = (here / "trot.py").read_text()
    (here / "other").mkdir()
    (here / "other" / "trot2.py").write_text(trot.replace("0.8 *", "0.7 *"))
    monkeypatch.syspath_prepend(here / "other")
    assert main(["run", *SHORT, "out=some", "model.controller=trot2:policy"]) == 2
    assert "holds another study: model.content is" in capsys.readouterr().err


def test_its_boundary_is_refined_and_expectations_are_told(here):
    small = [*SHORT, "study.axes.load.num=3", "study.axes.grip.num=3"]
    assert main(["run", *small, "out=coarse"]) == 0
    low = store.read_rows(Path("coarse"))["base_height_min_m"].median()
    refined = [*small, "study.resolution=0.1", "outcome.goal='travelled_m > -9'"]
    refined += [f"outcome.fell='base_height_min_m < {low}'", "out=refined"]
    assert main(["run", *refined]) == 0
    rows = store.read_rows(Path("refined"))
    assert 9 < len(rows) < 17 * 17 / 2
    apart = np.diff(np.unique(rows["world.model.geom.floor.friction.slide"]))
    assert np.isclose(apart.min(), 0.7 / 16)  # halved three times
    assert main(["run", *refined]) == 0
    assert len(store.read_rows(Path("refined"))) == len(rows)
    for rate, code in ((0, 0), (1, 4)):
        assert main(["run", *refined, f"study.expect=[{{at_least: {rate}}}]"]) == code


@pytest.mark.slow
def test_what_was_killed_goes_on_to_the_same_rows(here):
    asked = ["run", *SHORT, "model.duration=3", "engine.width=4"]
    process = subprocess.Popen([sys.executable, "-m", "sweep.cli", *asked, "out=killed"])
    wait_for(Path("killed"), 2, process)
    process.kill()
    process.wait()
    assert len(store.finished_batches(Path("killed"))) < 9
    assert main([*asked, "out=killed"]) == main([*asked, "out=through"]) == 0
    pd.testing.assert_frame_equal(content(Path("killed")), content(Path("through")))


def test_a_row_has_its_bits_whatever_runs_beside_it(here):
    noisy = ["noise.white=0.02", "noise.bias=0.01", "noise.delay=1"]
    exp = compose(["study=grip", "model.duration=0.5", *noisy])
    rows = select_points_to_simulate(exp)
    rows = pd.concat([rows, rows.assign(stream=rows["stream"] + 1)], ignore_index=True)  # 72: more than one tile
    whole = figures(exp, rows)
    assert np.ptp(whole["travelled_m"]) > 0
    assert (whole["travelled_m"][:36] != whole["travelled_m"][36:]).all()  # other noise
    for part in ([71], range(7), range(60, 72)):
        for name, values in figures(exp, rows.iloc[list(part)]).items():
            np.testing.assert_array_equal(values, whole[name][list(part)], err_msg=name)


ONE_CORE = "import os, sys; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); from sweep.cli.main import main; "


@pytest.mark.slow
def test_a_row_has_its_bits_on_any_number_of_threads_and_cores(here, monkeypatch):
    """On more threads than there are cores, too; and in a process of its own that has one core, at another width."""
    few = ["study.axes.load.num=3", "study.axes.grip.num=4"]
    noisy, found, pools = [*SHORT, *few, "noise.white=0.02", "noise.delay=1"], {}, []

    def pool(*given):
        pools.append(Batch(*given))
        return pools[-1]

    monkeypatch.setattr(batch, "Batch", pool)
    for threads in (1, 2, 5):
        monkeypatch.setattr(devices, "count_cores", lambda threads=threads: threads)
        found[threads] = figures(exp := compose(noisy), points := select_points_to_simulate(exp))
    assert {one._b.nthread for one in pools} == {*found}
    asked = ["-c", f"{ONE_CORE}sys.exit(main(sys.argv[1:]))", "run", *noisy, "engine.width=5", "out=one_core"]
    subprocess.run([sys.executable, *asked], check=True)
    found["one core"] = store.read_rows(Path("one_core")).set_index("point_id").loc[points["point_id"]]
    for name, values in found[1].items():
        for other in (2, 5, "one core"):
            np.testing.assert_array_equal(found[other][name], values, err_msg=f"{name}, {other}")


def test_fields_are_what_a_model_that_is_compiled_with_them_has(here):
    spec = mujoco.MjSpec.from_file("quadruped.xml")
    model = spec.compile()
    wanted = {"model.body.trunk.mass": 12.0, "model.geom.floor.friction.slide": 0.3, "model.joint.lf_knee.damping": 0.7,
              "model.actuator.rh_knee.kp": 150.0, "model.option.gravity.z": -3.7}  # fmt: skip
    spec.geom("trunk").mass, spec.geom("floor").friction[0], spec.joint("lf_knee").damping[0] = 12.0, 0.3, 0.7
    spec.actuator("rh_knee").gainprm[0], spec.actuator("rh_knee").biasprm[1] = 150.0, -150.0
    spec.option.gravity[2] = -3.7
    other = spec.compile()
    for path, value in wanted.items():
        assert fields.parameter_field(other, path).default == pytest.approx(value)
        assert fields.parameter_field(model, path).default != pytest.approx(value)
    batch = Batch(model, 2)
    fields.write_batch_parameters(batch, {path: np.full(2, value) for path, value in wanted.items()}, lambda: spec)
    batch.reset(keyframe=0)
    batch.step(nstep=100)
    data = mujoco.MjData(other)
    mujoco.mj_resetDataKeyframe(other, data, 0)
    mujoco.mj_step(other, data, 100)
    # not to the last bit: stat.meaninertia, which scales the solver's tolerance, is the first model's
    np.testing.assert_allclose(batch.bind("qpos")[1], data.qpos, atol=1e-7)


def test_figures_of_a_fall_are_those_of_mechanics(tmp_path, monkeypatch):
    """A free box falls by g t^2 / 2, then tumbles nowhere; half the energy is nobody's work."""
    monkeypatch.chdir(tmp_path)
    Path("box.xml").write_text(
        '<mujoco><option timestep="1e-3"/><worldbody><body name="box" pos="0 0 9"><freejoint/>'
        '<geom size=".1 .1 .1" type="box" mass="2"/><body><joint name="wheel"/><geom size=".1" mass="1"/></body></body>'
        '</worldbody><actuator><motor name="wheel" joint="wheel" ctrlrange="-1 1"/></actuator></mujoco>'
    )
    Path("still.py").write_text(
        "import jax.numpy as jnp\ndef policy(belief, seen, state, key): return jnp.zeros(1), state\n"
    )
    Path("study.yaml").write_text(
        "system: own\nmodel: {mjcf: box.xml, controller: 'still:policy', duration: 1}\n"
        "outcome: {low: base_height_min_m < 4}\n"
        "study:\n  axes:\n    g: {path: model.option.gravity.z, values: [-9.81, -4]}\n"
    )
    assert main(["run", "study=study.yaml", "out=fall"]) == 0
    rows = store.read_rows(Path("fall"))
    np.testing.assert_allclose(rows["base_height_min_m"], 9 - np.array([9.81, 4]) / 2, atol=0.01)  # Euler: g t h / 2
    assert list(rows["outcome"]) == ["success", "success"]
    np.testing.assert_allclose(rows[["energy_j", "tilt_max_deg", "travelled_m"]], 0, atol=1e-9)
    np.testing.assert_allclose(rows["margin"], (rows["base_height_min_m"] - 4) / 4)
    assert set(rows["margin_of"]) == {"low"}


def test_outcomes_are_told_by_what_holds_first():
    names = ("height_m", "way_m")
    conditions = parse_conditions(
        {"goal": "way_m >= 2", "fell": "height_m < 0.2", "late": "way_m < 1 and height_m > 0"}, names, ()
    )
    figures = {"height_m": np.array([0.3, 0.1, 0.3, 0.1, 0.3]), "way_m": np.array([3.0, 3.0, 1.5, 0.5, 0.5]),
               "not_finite": np.zeros(5), "buffer_full": np.array([0.0, 1, 0, 0, 0])}  # fmt: skip
    labels = label_rollouts(figures, conditions, ["run"])
    assert list(labels["outcome"]) == ["success", "invalid", "failure", "failure", "failure"]
    assert list(labels["cause"]) == ["", "buffer_full", "goal_missed", "fell", "late"]
    np.testing.assert_allclose(labels["margin"], [0.5, -0.5, -0.25, -0.75, -0.75])


BROKEN = {
    "bad.xml": '<mujoco><worldbody><geom sise="1"/></worldbody></mujoco>',
    "still.xml": "<mujoco/>",
    "bad.mjb": "bad",
    "lost.xml": '<mujoco><asset><mesh name="m" file="hul.obj"/></asset></mujoco>',
}


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ("model.mjcf=none.xml", "model.mjcf = 'none.xml' is not a file (allowed: quadruped.xml)"),
        ("model.mjcf=trot.py", "model.mjcf = trot.py does not compile: "),
        (
            "model.mjcf=TMP/bad.xml",
            "model.mjcf = bad.xml does not compile: XML Error: Schema violation: unrecognized attribute: 'sise'",
        ),
        ("model.mjcf=TMP/lost.xml", "model.mjcf = lost.xml does not compile: Error: Error opening file 'hul.obj'"),
        (
            "model.controller=trot",
            "model.controller = 'trot' is not allowed: a module and its function",
        ),
        ("model.controller=trot:polic", "polic is unknown: did you mean policy?"),
        ("model.controller=trit:policy", "model.controller = trit:policy cannot be imported: ModuleNotFoundError"),
        ("model.period=0.003", "model.period = 0.003 is not allowed: a multiple of 0.002 s, the model's time step"),
        ("model.keyframe=hom", "model.keyframe = hom is unknown: did you mean home?"),
        ("model.observe=[turn,spim]", "model.observe: spim is unknown: did you mean spin?"),
        ("model.observe=[turn]", "model.controller = trot:policy fails: "),
        ("model.feet=[turn]", "model.feet: turn is not a touch sensor"),
        ("model.feet=[lf_touch,lf_touch]", "model.feet = ['lf_touch', 'lf_touch'] is not allowed: each name once"),
        ("model.mjcf=[quadruped.xml]", "model.mjcf = ['quadruped.xml'] is not allowed: a word"),
        ("model.mjcf=TMP/still.xml", "model.mjcf = still.xml is not allowed: it has no joints, and nothing moves"),
        ("model.mjcf=TMP/bad.mjb", "model.mjcf = bad.mjb does not compile: "),
        ("model.duration=0.01", "model.duration = 0.01 is not allowed: at least model.period, 0.02 s"),
        ("controller=3", "controller = 3 is not allowed"),
        ("model.durations=3", "model.durations is unknown: did you mean duration?"),
        ("model.option.cone=round", "model.option.cone = 'round' is not allowed: one of pyramidal, elliptic"),
        ("model.option.timestp=0.001", "timestp is unknown: did you mean timestep?"),
        ("study.axes.load.path=engine.compiler", "compiler is unknown"),
        ("engine.time_step=0.001", "engine.time_step is not allowed: the model's file sets it"),
        ("robot.shin=1", "robot is unknown"),
        (
            "outcome.fell='base_hight_min_m<1'",
            "outcome.fell: base_hight_min_m is unknown: did you mean base_height_min_m?",
        ),
        ("outcome.fell='abs(drift_m)>1'", "outcome.fell: 'abs(drift_m)' is not allowed: names, numbers"),
        ("model.observe={turn: 1}", "model.observe = {turn: 1} is not allowed: a list"),
        ("model.content=1", "model.content is not allowed: it is computed from the files"),
        ("outcome.fell=3", "outcome.fell = 3 is not a condition"),
        ("controller.sped=1", "controller.sped is unknown: did you mean controller.speed?"),
        ("study.axes.load.path=model.body.trnk.mass", "no body is called trnk: did you mean trunk?"),
        (
            "study.axes.load.path=model.body.world.mass",
            "the body has no mass in the file, so its inertia cannot be scaled",
        ),
        ("study.axes.load.path=model.body.trunk.mas", "mas is unknown: did you mean mass?"),
        ("study.axes.load.path=model.geom.floor.size", "size is unknown"),
        (
            "study.axes.load.path=model.geom.lf_thigh.size.half_length",
            "axis model.geom.lf_thigh.size.half_length is not allowed: the geom's fromto sets its ends",
        ),
        ("model.direction=[0,0,0]", "model.direction = [0, 0, 0] is not allowed: a vector in world axes"),
        ("model.collisions=[turn]", "model.collisions: turn is not a touch sensor"),
        (
            "study.axes.load.path=model.geom.floor.friction",
            "which of its numbers is unknown (allowed: roll, slide, spin)",
        ),
        ("study.axes.load.path=noise.dely", "noise.dely is unknown: did you mean noise.delay?"),
        ("study.axes.load.from=-1", "world.model.body.trunk.mass = -1 is not allowed: at least 1e-09 kg"),
        ("study.keep=[base_w_m]", "study.keep: base_w_m is unknown"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(here, tmp_path, capsys, change, line):
    for name, text in BROKEN.items():
        (tmp_path / name).write_text(text)
    assert main(["run", "study=grip", "out=wrong", change.replace("TMP", str(tmp_path))]) == 2
    one_line(capsys.readouterr().err, line)
    assert not Path("wrong").exists()


def test_a_model_with_too_little_memory_for_a_step_is_one_line(here, capsys):
    small = Path("quadruped.xml").read_text().replace("<option", '<size memory="10K"/><option', 1)
    Path("small.xml").write_text(small)
    assert main(["run", "study=grip", "model.mjcf=small.xml"]) == 2
    (told,) = capsys.readouterr().err.splitlines()
    assert "model.mjcf = small.xml cannot be simulated: " in told
    assert 'increase <size memory="..."/>' in told


STILL = "def policy(belief, seen, state, key): return jnp.zeros(12), state\n"


@pytest.mark.parametrize(
    ("code", "line"),
    [
        (STILL.replace("12", "11"), "gives controls (11,): (12,) are wanted"),
        (STILL.replace(", state\n", ", (state,)\n"), "returns a state of another shape or type than it receives"),
        (STILL.replace("(12)", "(12) + undefined"), "fails: NameError: name 'undefined' is not defined"),
        (STILL.replace("(12),", "(12) if seen[0] > 0 else 0,"), "fails: TracerBoolConversionError: "),
        (
            STILL.replace("(12)", "(12) / jnp.zeros(12)"),
            "gives controls that are not finite at",
        ),
        (f"{STILL}PARAMETERS = ['a']", "PARAMETERS = ['a'] is not allowed: numbers by name"),
        (f"{STILL}BELIEVES = {{'a': 3}}", "BELIEVES = {'a': 3} is not allowed: paths by name"),
        (f"{STILL}FILES = 3", "FILES = 3 is not allowed: a list of names"),
        (
            f"{STILL}FIGURES = {{'a.b': ''}}\ndef figures(*given): return {{'a.b': 1.0}}",
            "FIGURES has 'a.b': a name has letters, digits and _",
        ),
        (
            f"{STILL}FIGURES = {{'outcome': ''}}\ndef figures(*given): return {{'outcome': 1.0}}",
            "a metric called outcome is not allowed: all rows have a column of this name",
        ),
        ("policy = dict", "fails: TypeError: dict expected at most 1 argument"),
        (
            f"{STILL}def begin(belief, key): return None, (), jnp.nan",
            "lasts nan s: at least a tick of 0.02 s is wanted",
        ),
        (STILL.replace("jnp.zeros", "exit() or jnp.zeros"), "model.controller = NAME:policy fails: SystemExit"),
        (f"{STILL}raise SystemExit('later')", "NAME:policy cannot be imported: SystemExit: later"),
        (f"{STILL}def begin(belief, key): return jnp.zeros(3), (), None", "begins at (3,): (19,) are wanted"),
        (
            f"{STILL}def begin(belief, key): return jnp.full(19, jnp.nan), (), None",
            "begins at positions that are not finite",
        ),
        (f"{STILL}def begin(belief, key): return None, (), jnp.ones(2)", "lasts (2,): one number is wanted"),
        (f"{STILL}def observe(told): return told['turn'][None]", "observes (1, 4): (k,) is wanted"),
        (f"{STILL}def observe(told): return told['trn']", "fails: KeyError: 'trn'"),
        (STILL.replace("(12)", "(12) > 0"), "gives controls bool (12,): numbers are wanted"),
        (STILL.replace("(12)", "(12) * 1j"), "gives controls complex64 (12,): numbers are wanted"),
        (f"{STILL}def begin(belief, key): return None, (), jnp.array(1j)", "lasts complex64 (): numbers are wanted"),
        (
            f"{STILL}FIGURES = {{'a': 'b'}}\ndef figures(*given): return {{'a': jnp.array(1j)}}",
            "has figures a complex64 (): numbers are wanted, named in FIGURES",
        ),
        (f"{STILL}FIGURES = {{'a': 'b'}}", "the function `figures` and the names FIGURES need each other"),
        (f"{STILL}BELIEVES = {{'load': 'model.body.trnk.mass'}}", "no body is called trnk: did you mean trunk?"),
        (f"{STILL}PARAMETERS = {{'speed': 'fast'}}", "controller.speed = 'fast' is not allowed"),
        (
            f"{STILL}PARAMETERS = {{'a': 1.0}}\nBELIEVES = {{'a': 'model.body.trunk.mass'}}",
            "a is both in PARAMETERS and in BELIEVES",
        ),
    ],
)
def test_a_controller_that_cannot_be_is_one_line_and_nothing_is_written(here, capsys, code, line):
    name = f"wrong{abs(hash(code))}"
    Path(f"{name}.py").write_text(f"import jax.numpy as jnp\n{code}\n")
    observe = ["model.observe=[]"] if "def observe" in code else []
    assert main(["run", *SHORT, *observe, f"model.controller={name}:policy", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line.replace("NAME", name))
    assert not Path("wrong").exists()


def test_what_is_not_finite_is_invalid_and_keeps_its_last_states(here):
    Path("lost.py").write_text(
        "import jax.numpy as jnp\nPARAMETERS = {'bad': 0.0}\n"
        "def policy(belief, seen, state, key): return jnp.full(12, 1.0 / (1.0 - belief['bad'])), state\n"
    )
    lost = ["model.controller=lost:policy", "study.invalid_max=1", "out=lost"]
    study = Path("studies/lost.yaml")
    study.write_text(re.sub(r"(?s)  axes:.*", AXES, Path("studies/grip.yaml").read_text()))
    assert main(["run", "study=lost", "model.duration=0.2", *lost]) == 0
    rows = store.read_rows(Path("lost"))
    assert list(rows["cause"] == "not_finite") == [False, True]
    assert list(rows["outcome"])[1] == "invalid"
    assert len(list(Path("lost", store.LAST_STATES_FOLDER).glob("*.parquet"))) == 1


def network(sizes, file, rows="n", **more):
    """A small policy as a file: angles about a stand, of what is observed."""
    from onnx import TensorProto, helper, numpy_helper, save

    rng = np.random.default_rng(1)
    weight = 0.02 * rng.standard_normal(sizes, np.float32)
    stand = np.tile(np.array([0, 0.8, -1.6], np.float32), 20)[: sizes[1]]
    saved = [numpy_helper.from_array(one, name) for one, name in ((weight, "w"), (stand, "b"))]
    node = helper.make_node("Gemm", ["seen", "w", "b"], ["angles"])
    into, out = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [rows, size])
        for name, size in zip(("seen", "angles"), sizes, strict=True)
    )
    graph = helper.make_graph([node], "policy", [into, *more.get("beside", ())], [out], saved)
    save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), file)
    return weight, stand


def test_a_policy_that_was_trained_elsewhere_runs_as_it_is(here, capsys):
    weight, stand = network((7, 12), "walk.onnx")
    np.savez("walk.npz", weight=weight, stand=stand)
    (sample,) = (code for code in CODE if "FILES" in code)
    Path("layers.py").write_text(sample)
    network((7, 12), "one.onnx", rows=1)
    noisy = [*SHORT, "noise.white=0.05", "noise.delay=1"]
    found = {}
    for name in ("walk.onnx", "layers:policy", "one.onnx"):
        exp = compose([*noisy, f"model.controller={name}"])
        rows = select_points_to_simulate(exp)
        rows = pd.concat([rows, rows.assign(stream=rows["stream"] + 1)], ignore_index=True)  # more than one tile
        found[name] = whole = figures(exp, rows)
        for part in ([71], range(60, 72)):
            for figure, values in figures(exp, rows.iloc[list(part)]).items():
                np.testing.assert_array_equal(values, whole[figure][list(part)], err_msg=figure)
    network((7, 12), "told.onnx")
    Path("told.py").write_text(
        "import jax.numpy as jnp\nFIGURES = {'low_m': 'least height that a tick begins with'}\n"
        "def observe(told): return jnp.concatenate([told['turn'], told['spin']])\n"
        "def measure(sofar, told): return jnp.minimum(9.0 if sofar is None else sofar, told['qpos'][2])\n"
        "def figures(belief, state, sofar): return {'low_m': sofar}\n"
    )
    beside = figures(compose([*noisy, "model.controller=told.onnx", "model.observe=[]"]), rows)
    np.testing.assert_array_equal(beside["travelled_m"], found["walk.onnx"]["travelled_m"])
    assert (beside["low_m"] > beside["base_height_min_m"] - 1e-6).all()  # of single precision
    assert (beside["low_m"] < beside["base_height_min_m"] + 0.05).all()
    for other in ("layers:policy", "one.onnx"):
        np.testing.assert_allclose(found[other]["tilt_max_deg"], found["walk.onnx"]["tilt_max_deg"], rtol=1e-3)
    noisy += ["outcome.goal='travelled_m > -9'"]
    assert main(["run", *noisy, "model.controller=walk.onnx", "out=trained"]) == 0
    assert main(["audit", "trained", "--points", "2", "--ways", "half_step"]) == 0
    capsys.readouterr()
    stored = results.read_results(Path("trained")).exp.values["model"]["content"]
    network((7, 12), "walk.onnx", rows="many")
    assert main(["run", *noisy, "model.controller=walk.onnx", "out=trained"]) == 2  # another file
    assert f"model.content is {stored} there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("write", "controller", "line"),
    [
        (lambda: network((8, 12), "bad.onnx"), "bad.onnx", "takes 8 numbers: 7 are observed (model.observe)"),
        (lambda: network((7, 11), "bad.onnx"), "bad.onnx", "gives controls (11,): (12,) are wanted"),
        (lambda: network((7, 12), "bad.onnx", rows=8), "bad.onnx", "takes 8 rollouts at a time: allowed are"),
        (lambda: Path("bad.onnx").write_text("none"), "bad.onnx", "bad.onnx is not a readable network: "),
        (lambda: None, "bed.onnx", "model.controller = 'bed.onnx' is not a file: did you mean bad.onnx?"),
        (lambda: Path("flat.py").write_text("def policy(seen): return seen[0]"), "flat:policy", "gives float32 (7,)"),
        (lambda: Path("nan.py").write_text("def policy(seen): return seen[:, :1].repeat(12, 1) * float('nan')"),
         "nan:policy", "gives controls that are not finite at the nominal start"),
        (lambda: Path("inf.py").write_text("def policy(belief, told, s, key): return told[0].repeat(12) / 0, s"),
         "inf:policy", "gives controls that are not finite at the nominal start"),
        (lambda: Path("far.py").write_text("def policy(seen): return seen.far"), "far:policy", "fails: AttributeError"),
        (lambda: Path("lost_file.py").write_text("FILES = ['w.pt']\ndef policy(seen): return seen"),
         "lost_file:policy", "FILES has w.pt, which is not a file"),
    ],
)  # fmt: skip
def test_a_policy_of_another_size_is_one_line(here, capsys, write, controller, line):
    write()
    assert main(["run", *SHORT, "out=wrong", f"model.controller={controller}"]) == 2
    one_line(capsys.readouterr().err, line)
    assert not Path("wrong").exists()
