"""The engine `kernel`: MuJoCo's step written out over limbs equals C MuJoCo's, and what it lacks is refused or seen."""

import re
from pathlib import Path

import jax
import mujoco
import numpy as np
import pandas as pd
import pytest

import sweep
from sweep.cli.main import main
from sweep.core.errors import InputError
from sweep.fused import eager
from sweep.systems.mujoco_model import build_nominal_system, kernel_engine
from sweep.systems.mujoco_model.kernel import agreement, guard
from sweep.systems.mujoco_model.kernel.layout import find_layout
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.pairs import find_simulated_pairs
from sweep.systems.mujoco_model.kernel.scalars import stack_scalars
from sweep.systems.mujoco_model.kernel.sensors import compute_sensors, find_unsupported_sensors
from sweep.systems.mujoco_model.kernel.smooth import compute_smooth_terms
from sweep.systems.mujoco_model.kernel.step import compute_forward_dynamics, read_state
from sweep.systems.mujoco_model.model_spec import ParameterOverrides

TEMPLATE = Path(sweep.__file__).parent / "cli" / "template_model"
DATA = Path(__file__).parent / "data"
QUADRUPED = (TEMPLATE / "quadruped.xml").read_text()
LEG = [("1 0 0", "-40 40"), ("0 1 0", "-60 60"), ("0 1 .1", "-90 20")]
ARM = [("0 1 0", "-90 90"), ("1 0 0", "-90 90")]
TOUCHES = 'conaffinity="1" contype="0"'
FOOT = f'<geom type="sphere" size="0.03" pos="0 0 -0.2" mass="0.1" friction="0.7" margin="0.003" {TOUCHES}/>'
BALL, BAR_SHAPE = (
    'type="sphere" size="0.03" pos="0 0 -0.2"',
    'type="capsule" size="0.02" fromto="-.05 0 -.2 0.09 0 -.2"',
)
ROLL = f'<geom {{}} mass="0.1" condim="6" friction="0.8 0.05 0.02" {TOUCHES}/>'
EYE = '<site name="eye" pos="0.02 0 -0.1" euler="20 30 40"/>'
BAR = f'<geom type="capsule" size="0.02" fromto="-.05 0 -.2 0.09 0 -.2" mass="0.1" condim="1" {TOUCHES}/>'
PAIRED = '<geom name="tip_{}" type="sphere" size="0.03" pos="0 0 -0.2" mass="0.1" contype="0" conaffinity="0"/>'
TIP = '<geom {} mass="0.1" friction="0.7"/>'
ROUND = f'<geom {{}} pos="0 0 -0.2" mass="0.1" {TOUCHES}/>'
WEDGE = (
    '<mesh name="wedge" vertex="-.06 -.03 -.02 .08 -.03 -.02 .08 .03 -.02 -.06 .03 -.02 -.05 -.02 .03 .05 .02 .03"/>'
)
GROUND = "".join(  # five steps, of which a row of contacts has three; the others are of other laws
    f'<geom type="box" size="0.05 1 0.2" pos="{0.08 * k} 0 {0.01 * (k % 3) - 0.21}" euler="0 {3 * k} 5"/>'
    for k in range(5)
) + (
    '<geom type="capsule" size="0.1 0.3" pos="0.22 0.12 -0.08" euler="90 5 5" friction="0.4"/>'
    '<geom type="sphere" size="0.1" pos="0.25 -0.12 -0.08" solref="0.03 1"/>'
)
COUPLED = (  # in some limbs; b's is of another form
    '<equality><joint joint1="a1" joint2="a0" polycoef="0.02 0.7 0.2 -0.1 .05"/>'
    '<joint joint1="b1" joint2="b0" polycoef="0.02 -0.5 0.2 0 0" solref=".03 1" solimp=".8 .95 .01"/>'
    '<joint joint1="c1" polycoef="0.1 0 0 0 0"/></equality>'
)
TENDONS = "".join(  # the third links limbs of two sides
    f'<fixed name="{name}" limited="true" range="-0.1 0.1" margin=".01" stiffness="30" springlength="-0.02 0.03" '
    f'damping="2" frictionloss="0.3" armature="0.05"><joint joint="{one}" coef="0.3"/>'
    f'<joint joint="{other}" coef="-0.8"/></fixed>'
    for name, one, other in (("left", "a0", "a1"), ("right", "b0", "b1"), ("both", "a0", "b1"))
)
TENDONS = (
    f'<tendon>{TENDONS}<fixed name="knee"><joint joint="a1" coef="1"/></fixed></tendon>'
    '<equality><tendon tendon1="knee" tendon2="both" polycoef="0.05 0.5 0.1 0 0"/></equality>'
    '<actuator><position tendon="left" kp="20" kv="1.5"/><motor tendon="both" gear="2"/></actuator>'
)
LOOP = (
    '<worldbody><site name="post" pos="0 -.1 .4"/></worldbody>'
    '<equality><connect body1="shank" body2="trunk" anchor="0.02 0.01 -0.1"/>'
    '<connect site1="eye" site2="post" solref="0.1 1"/></equality>'
)
HEIGHTS = " ".join(f"{x:.3f}" for x in np.random.default_rng(1).random(17 * 21))
HILLS = f'<hfield name="hills" nrow="17" ncol="21" size="1 0.8 0.04 0.1" elevation="{HEIGHTS}"/>'
SLIDE = (
    '<body pos="0 0 -.2"><joint type="slide" axis="0 0.1 1" range="-.05 .05" stiffness="300" springref="0.01"/>'
    f'<geom type="sphere" size=".03" mass=".2" {TOUCHES} solmix="2" solref="-2000 -60"/></body>'
)


def limb(name, place, joints, tip):
    """Bodies of a limb with a hinge each, off their body's origin, and turned."""
    text = ""
    for k, (axis, limits) in enumerate(joints):
        at = place if not k else "0 0.01 -0.2"
        text += (
            f'<body pos="{at}" euler="{5 * k} {10 * k} 0"><joint name="{name}{k}" axis="{axis}" range="{limits}" '
            f'pos="0.01 0 0.005"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" mass="{0.5 + 0.1 * k}" '
            'contype="0" conaffinity="0"/>'
        )
    return text + tip + "</body>" * len(joints)


def robot(limbs, option="", joint="", plane="", base="<freejoint/>"):
    names = re.findall(r'<joint name="(\w+)"', limbs)
    drives = "".join(
        f'<position joint="{one}" kp="{60 + k}" kv="2" forcerange="-30 30"/>'
        if k % 3
        else f'<motor joint="{one}" gear="8" ctrlrange="-1 1"/>'
        for k, one in enumerate(names)
    )
    return (
        f'<mujoco><compiler angle="degree"/><option timestep="0.002" {option}/>'
        f'<default><joint damping="0.3" armature="0.02" {joint}/></default><worldbody>'
        f'<geom name="floor" type="plane" size="0 0 .1" friction="0.6" {plane}/><body name="trunk" pos="0 0 .5">{base}'
        f'<geom type="box" size=".2 .1 .05" mass="5" {TOUCHES}/>{limbs}</body></worldbody>'
        f"<actuator>{drives}</actuator></mujoco>"
    )


def limbs(joints, tip, places="ab"):
    at = dict(zip("abcdef", ("0 .1 0", "0 -.1 0", ".2 .1 0", ".2 -.1 0", "-.2 .1 0", "-.2 -.1 0"), strict=True))
    return "".join(limb(name, at[name], joints, tip) for name in places)


MODELS = {
    "the template": QUADRUPED,
    "biped with waist, arms, box feet and friction of joints": (DATA / "biped" / "biped.xml").read_text(),
    "elliptic cones, an arm beside four legs, a tilted floor": robot(
        limbs(LEG, FOOT, "cdef") + limb("arm", "0.2 0 .05", ARM, ""),
        'cone="elliptic" impratio="10" gravity="1 0.5 -9"',
        plane='euler="8 5 0" priority="1" condim="3" margin="0.002" solref="0.01 0.8" solimp="0.8 0.97 0.003 0.4 3"',
    ),
    "torsional friction by pyramids": robot(limbs(LEG, FOOT.replace('0.7"', '0.7 0.05 0" condim="4"'), "cdef")),
    "rolling friction by elliptic cones, bars and balls": robot(
        limbs(LEG, ROLL.format(BALL), "cd") + limbs(LEG, ROLL.format(BAR_SHAPE), "ef"),
        'cone="elliptic" impratio="100"',
        'frictionloss="0.2"',
        'euler="8 5 0"',
    ),
    "six sliding feet, explicit damping, coupled joints": robot(
        limbs(LEG[:2], SLIDE, "abcdef"), '><flag eulerdamp="disable" refsafe="disable"/></option><option'
    ).replace("</mujoco>", COUPLED + "</mujoco>"),
    "damping, armature and friction of the free joint, limbs held at the trunk and at a post": robot(
        limbs(LEG, FOOT + EYE, "ab").replace("eye", "other", 1),
        base='<joint type="free" damping="2" armature="0.3" frictionloss="1.5"/>',
    )
    .replace('euler="10 20 0"', 'name="shank" euler="10 20 0"', 1)
    .replace("</mujoco>", LOOP + "</mujoco>"),
    "explicit contact pairs, tendons": robot(
        limbs(LEG[:2], PAIRED.format("a"), "a") + limbs(LEG[:2], PAIRED.format("b"), "b"), 'integrator="implicitfast"'
    )
    .replace('pos="0 .1 0"', 'pos="0 .03 0"')
    .replace('pos="0 -.1 0"', 'pos="0 -.01 0"')
    .replace(
        "</mujoco>",
        '<contact><pair geom1="tip_a" geom2="floor" condim="4" friction="0.9 0.4 0.03 0 0" solref="0.015 0.9"/>'
        '<pair geom1="floor" geom2="tip_b" condim="4" margin="0.003" solimp="0.8 0.97 0.003 0.4 3"/>'
        f'<pair geom1="tip_a" geom2="tip_b"/></contact>{TENDONS}</mujoco>',
    ),
    "two bars and a ball on limbs that touch one another": robot(
        limbs(LEG[:2], TIP.format('type="capsule" size="0.03" fromto="0 0 0 .02 .01 -.2"'), "ab")
        + limbs(LEG[:1], TIP.format('type="sphere" size="0.06" pos="0 0 -.2"'), "c"),
        'cone="elliptic" impratio="10"',
    )
    .replace('pos="0 .1 0"', 'pos="0.02 .04 0"')
    .replace('pos="0 -.1 0"', 'pos="0 -.04 0"')
    .replace('pos=".2 .1 0"', 'pos="0.08 0 -.15"'),
    "balls, a drum and an egg on a floor, steps, a rail and a stone": robot(
        limbs(LEG[:2], FOOT, "cd")
        + limbs(LEG[:2], ROUND.format('type="cylinder" size="0.04 0.03" euler="70 20 0"'), "e")
        + limbs(LEG[:1], ROUND.format('type="ellipsoid" size="0.04 0.03 0.06" euler="10 20 0"'), "f"),
        'cone="elliptic"',
    )
    .replace(TOUCHES, 'conaffinity="0" contype="0"', 1)
    .replace('<body name="trunk"', GROUND + '<body name="trunk"'),
    "feet that are meshes": robot(limbs(LEG[:1], ROUND.format('type="mesh" mesh="wedge" euler="5 3 0"'), "ab")).replace(
        "<worldbody>", f"<asset>{WEDGE}</asset><worldbody>"
    ),
    "balls on hills": robot(limbs(LEG[:1], FOOT.replace('margin="0.003"', ""), "ab"), 'cone="elliptic"')
    .replace(TOUCHES, 'conaffinity="0" contype="0"', 1)
    .replace("<worldbody>", f"<asset>{HILLS}</asset><worldbody>")
    .replace('type="plane" size="0 0 .1"', 'type="hfield" hfield="hills" pos="0.01 0.02 0" euler="2 1 5"'),
    "fixed base, frictionless bars": robot(limbs(LEG, BAR), base="", plane='condim="1"'),
}


def test_a_humanoid_of_others_and_the_exported_robot_agree(tmp_path):
    """Trees with a waist and branching limbs; elliptic cones with a large ratio of impedances, deep in the ground."""
    suite = Path(pytest.importorskip("dm_control").__file__).parent / "suite"
    main(["export-model", "scenario=walk_tripod", f"out={tmp_path / 'walk'}"])
    for file in (suite / "humanoid.xml", tmp_path / "walk" / "robot.xml"):
        model = mujoco.MjModel.from_xml_path(str(file))
        found = agreement.compare_accelerations(find_layout(model), model, -1, 96)
        assert found.in_contact > 60
        assert found.largest < 1e-11


@pytest.mark.parametrize("name", MODELS)
def test_accelerations_equal_those_of_c_mujoco(name):
    model = mujoco.MjModel.from_xml_string(MODELS[name])
    layout, keyframe = find_layout(model), 0 if model.nkey else -1
    found = agreement.compare_accelerations(layout, model, keyframe, 48)
    assert found.in_contact > 40
    if pairs := {frozenset(pair) for pair in find_simulated_pairs(layout, model)}:
        drawn = agreement.draw_states(model, keyframe, 48)
        touching = sum(any({c.geom1, c.geom2} in pairs for c in one.contact[: one.ncon]) for one in drawn)
        assert touching > 8
    assert found.largest < 1e-11  # 1e-9 is allowed in studies; measured: 3e-13


SENSORS = (
    '<sensor><framequat objtype="body" objname="{0}"/><framequat objtype="site" objname="eye"/>'
    '<accelerometer site="eye"/><velocimeter site="eye"/><gyro site="eye"/><framexaxis objtype="site" objname="eye"/>'
    '<framepos objtype="xbody" objname="{0}"/><frameangvel objtype="body" objname="{0}"/>'
    '<subtreecom body="{0}"/>'
    '<jointactuatorfrc joint="a1"/><jointactuatorfrc joint="b0"/><jointpos joint="a2"/><jointvel joint="b1"/></sensor>'
)


@pytest.mark.parametrize("base", ["<freejoint/>", ""])
def test_sensors_equal_those_of_c_mujoco(base):
    """On a shank that is turned against its thigh, of a free and of a fixed base."""
    text = robot(limbs(LEG, FOOT + EYE, "ab").replace("eye", "other", 1), joint='actuatorfrcrange="-20 20"', base=base)
    text = text.replace('euler="10 20 0"', 'name="shank" euler="10 20 0"', 1)
    model = mujoco.MjModel.from_xml_string(text.replace("</mujoco>", SENSORS.format("shank") + "</mujoco>"))
    layout, drawn = find_layout(model), agreement.draw_states(model, -1, 24)
    assert not find_unsupported_sensors(layout, model)

    def read(qpos, qvel, ctrl):
        state, numbers = read_state(layout, model, qpos, qvel, qvel), ModelFieldValues(model, {}, {})
        result, _ = compute_forward_dynamics(layout, numbers, state, ctrl, (), 60)
        return stack_scalars(compute_sensors(layout, numbers, state, result), qpos.dtype)

    with jax.enable_x64(True):
        rows = [np.stack([getattr(one, name) for one in drawn]) for name in ("qpos", "qvel", "ctrl")]
        shapes = [jax.ShapeDtypeStruct(one.shape[1:], np.float64) for one in rows]
        found = np.asarray(eager.trace_numpy_program(read, *shapes)(len(drawn), *rows))
    np.testing.assert_allclose(found, np.stack([one.sensordata for one in drawn]), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('<joint name="lf_roll" class="roll"/>', '<joint name="lf_roll" type="ball"/>', "ball joints"),
        ('integrator="implicitfast"', 'integrator="RK4"', "the integrator mjINT_RK4"),
        (
            "</worldbody>",
            '</worldbody><equality><weld body1="trunk"/></equality>',
            "equality constraints of type mjEQ_WELD",
        ),
    ],
)
def test_what_it_does_not_simulate_is_refused_by_name(old, new, what):
    assert old in QUADRUPED
    text = QUADRUPED.replace(old, new)
    if "ball" in what:
        text = re.sub(r'\s*<position name="lf_roll".*?/>', "", text)
        text = re.sub(r"<keyframe>.*</keyframe>", "", text, flags=re.DOTALL)
    with pytest.raises(InputError, match=f"^engine.name = kernel is not allowed: it does not simulate {what}"):
        find_layout(mujoco.MjModel.from_xml_string(text))


def test_touches_that_it_does_not_simulate_are_never_missed():
    text = MODELS["elliptic cones, an arm beside four legs, a tilted floor"].replace(
        'contype="0" conaffinity="0"', 'contype="1" conaffinity="1"'
    )
    model = mujoco.MjModel.from_xml_string(text.replace('contype="0"', 'contype="1"'))
    layout, data = find_layout(model), mujoco.MjData(model)
    pairs, numbers, rng = (
        guard.find_unsimulated_geom_pairs(layout, model),
        ModelFieldValues(model, {}, {}),
        np.random.default_rng(0),
    )
    rows, distances = [], []
    for k in range(150):
        mujoco.mj_resetData(model, data)
        data.qpos[7:] += rng.normal(size=model.nq - 7) * (0.1 + 0.4 * (k % 3))
        mujoco.mj_kinematics(model, data)
        distances.append(min(mujoco.mj_geomDistance(model, data, *pair, 1.0, None) for pair in pairs))
        rows.append(data.qpos.copy())

    def look(qpos, qvel):
        state = read_state(layout, model, qpos, qvel, qvel)
        return guard.has_near_pair(layout, numbers, state, compute_smooth_terms(layout, numbers, state), pairs)

    with jax.enable_x64(True):
        shapes = [jax.ShapeDtypeStruct((size,), np.float64) for size in (model.nq, model.nv)]
        seen = np.asarray(
            eager.trace_numpy_program(look, *shapes)(len(rows), np.array(rows), np.zeros((len(rows), model.nv)))
        )
    touch, apart = np.array(distances) <= 0, np.array(distances) > 0.004
    assert touch.sum() > 20
    assert apart.sum() > 20
    assert seen[touch].all()
    assert seen[apart].mean() < 0.2  # boxes and capsules enclose what they stand for


def test_programs_are_stored_by_structure_and_constants_but_not_by_varied_numbers(tmp_path, monkeypatch):
    """A later start compiles nothing, other values of an axis neither; what the program contains makes another."""
    monkeypatch.chdir(tmp_path)
    Path("hold.py").write_text(
        "import jax.numpy as jnp\n\ndef policy(belief, observation, state, key):\n    return jnp.zeros(2), state\n"
    )
    compiled, compared, original = [], [], kernel_engine.kernel.compile_function
    compare = agreement.compare_accelerations
    monkeypatch.setattr(agreement, "compare_accelerations", lambda *args: compared.append(args) or compare(*args, 8))
    monkeypatch.setattr(
        kernel_engine.kernel, "compile_function", lambda *args: compiled.append(args) or original(*args)
    )

    def count(text, *paths, value=0.5):
        Path("robot.xml").write_text(text)
        model = {"mjcf": "robot.xml", "controller": "hold:policy", "period": 0.004, "duration": 0.02}
        values = {
            "model": model,
            "engine": {"name": "kernel"},
            "outcome": {"fell": "energy_j < -1"},
        }
        system, settings, *_ = build_nominal_system(values, {})
        engine = system.make_engine(settings, *system.make_world_and_belief({}), limits=None)
        world = ParameterOverrides(tuple((path, np.full(2, value)) for path in paths))
        engine.run(world, ParameterOverrides(), np.arange(2))
        return len(compiled)

    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "programs"))
    try:
        text, damping = robot(limbs(LEG[:1], BAR), base=""), "model.joint.a0.damping"
        assert count(text, damping) == 1
        assert count(text, damping) == 1
        assert count(text, damping, value=0.7) == 1
        assert count(text, damping, "model.joint.b0.damping") == 2
        assert count(text.replace('mass="0.5"', 'mass="0.6"'), damping) == 3
        assert count(robot(limbs(LEG[:1], BAR), joint='frictionloss="0.1"', base=""), damping) == 4
        assert len(compared) == 3  # with C MuJoCo, each file once
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def project(tmp_path, monkeypatch):
    """The template's project, in which rollouts are short, pushed, late, and of different models."""
    monkeypatch.chdir(tmp_path)
    main(["init", "dog", "--model"])
    monkeypatch.chdir(tmp_path / "dog")
    own = Path("scenarios/own.yaml")
    own.write_text(
        own.read_text().replace("duration: 4", "duration: 0.5")
        + "push: {kick: {body: lf_thigh, impulse: 1, start: 0.2, elevation: 0.3}}\nnoise: {action_delay: 3}\n"
    )
    Path("studies/rows.yaml").write_text(
        "scenario: own\nstudy:\n  axes:\n"
        "    load: {path: model.body.trunk.mass, side: world, values: [6, 12]}\n"
        "    grip: {path: model.geom.floor.friction.slide, side: world, values: [0.3, 0.8]}\n"
        "    gain: {path: model.actuator.*.kp.relative, side: world, values: [0.9, 1.1]}\n"
    )


def simulate(*words):
    assert main(["run", "study=rows", "engine.precision=float64", *words]) == 0
    return sweep.load(next(w for w in words if w.startswith("out=")).removeprefix("out="))


def test_rows_equal_those_of_native(project, capsys):
    """All metrics of pushed rollouts with delays of commands, whose models differ; in double precision.

    A tendon's damper is the one force that couples joints in the integrator.
    """
    own = Path("quadruped.xml")
    pull = '<joint joint="lf_hip" coef="1"/><joint joint="lf_knee" coef="-0.5"/>'
    pull = f'<tendon><fixed damping="0.1" stiffness="2">{pull}</fixed></tendon></mujoco>'
    own.write_text(own.read_text().replace("</mujoco>", pull))
    here = simulate("engine=kernel", "out=results/kernel")
    assert "differ from C MuJoCo's by" in capsys.readouterr().err
    there = simulate("engine=native", "out=results/native")
    assert (here["on_native"] == 0).all()
    names = [c for c in there.columns if there[c].dtype.kind == "f" and c != "wall_s"]
    assert len(names) > 20
    for name in names:  # over half a second, before trajectories part
        np.testing.assert_allclose(here[name], there[name], rtol=1e-8, atol=1e-8, err_msg=name)
    alone = simulate("engine=kernel", "out=results/alone", "engine.width=3")
    pd.testing.assert_frame_equal(alone[names], here[names], check_exact=True)  # bits depend on no batch


@pytest.mark.slow
def test_stored_kernels_are_told_apart_by_schedules_and_motors(project):
    """Both are constants of the kernel, which a later run would find stored."""
    fast = simulate("engine=kernel", "out=results/fast", "+schedule.speed=[[0,0.4]]")
    for name, *more in (
        ("slow", "+schedule.speed=[[0,0.1]]"),
        ("weak", "+motor.all={joints: '*', stall_torque: 4, no_load_speed: 20}"),
    ):
        here = simulate("engine=kernel", f"out=results/{name}", *more)
        there = simulate("engine=native", f"out=results/{name}_native", *more)
        # weak robots fall, and trajectories part sooner: 4e-8 m were measured
        np.testing.assert_allclose(here["travelled_m"], there["travelled_m"], rtol=0, atol=1e-6)
        assert np.abs(here["travelled_m"] - fast["travelled_m"]).min() > 1e-4


@pytest.mark.slow
def test_models_are_an_axis(project):
    heavy = Path("quadruped.xml").read_text().replace('mass="8"', 'mass="9"')
    Path("heavy.xml").write_text(heavy)
    more = "+study.axes.world={path: model.mjcf, values: [quadruped.xml, heavy.xml]}", "study.axes.load.values=[6]"
    here, there = (simulate(f"engine={one}", f"out=results/{one}", *more) for one in ("kernel", "native"))
    assert len(here) == 8
    np.testing.assert_allclose(here["travelled_m"], there["travelled_m"], rtol=1e-8, atol=1e-8)


def test_rollouts_with_other_touches_are_simulated_by_native(project, capsys):
    """Shins that may touch the trunk, in a trot with the legs drawn up to it."""
    own = Path("quadruped.xml")
    text = own.read_text().replace('conaffinity="1"/>', 'conaffinity="1" contype="2"/>', 1)
    text = text.replace('fromto="0 0 0 0 0 -0.2" mass="0.15"', 'fromto="0 0 0 0 0 -0.2" mass="0.15" conaffinity="2"')
    own.write_text(text)
    here = simulate("engine=kernel", "out=results/kernel", "controller.height=0.1")
    assert "simulated again by native" in capsys.readouterr().err
    there = simulate("engine=native", "out=results/native", "controller.height=0.1")
    assert (here["on_native"] == 1).all()
    names = [c for c in there.columns if there[c].dtype.kind == "f" and c != "wall_s"]
    pd.testing.assert_frame_equal(here[names], there[names], check_exact=True)
