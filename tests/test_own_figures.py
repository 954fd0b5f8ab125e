"""Figures of own models against mechanics on both engines, what is not to be trusted, and fields that are compiled."""

import hashlib
import struct
from fnmatch import fnmatch
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.batch import MODEL_FIELDS, Batch
from slow_cases import mark_slow_cases

from sweep.cli.main import main
from sweep.core.errors import InputError
from sweep.runs import store
from sweep.systems.mujoco_model import fields, files

SLED = """<mujoco><option timestep="1e-3" integrator="Euler" iterations="{}"/>{}<worldbody>
<site name="world"/><geom name="floor" type="plane" size="0 0 1" friction="0.001"/>
<body name="sled" pos="0 0 {}"><freejoint/><geom name="sled" type="box" size=".2 .2 .1" mass="2" friction="0.001"/>
<site name="under" type="box" size=".3 .3 .2"/><site name="push"/>
<body pos="0 0 0.3"><joint name="wheel" axis="0 1 0"/><geom size=".05" mass="0.1"/></body>
</body></worldbody>
<actuator><motor name="push" site="push" refsite="world" gear="0 1 0 0 0 0"/>
<motor name="wheel" joint="wheel"/></actuator>
<sensor><touch name="under" site="under"/></sensor></mujoco>"""
STUDY = """system: mujoco
model: {{mjcf: sled.xml, controller: "shove:policy", duration: 0.5, direction: [0, 2, 0],
        collisions: [under], feet: [under]}}
outcome: {{slow: speed_mps < 0.1{}}}
study: {{name: sled}}
"""
PUSH = "import jax.numpy as jnp\ndef policy(belief, seen, state, key): return jnp.array([4.0, 0.0]), state\n"


ENGINES = pytest.mark.parametrize("engine", mark_slow_cases(["native", "mjx"], ["mjx"]))


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("shove.py").write_text(PUSH)
    return tmp_path


def simulated(engine, iterations="100", custom="", height=0.0999, more=""):
    """The row of one rollout."""
    Path("sled.xml").write_text(SLED.format(iterations, custom, height))
    Path("sled.yaml").write_text(STUDY.format(more))
    asked = [f"engine={engine}", "engine.precision=float64", "study.invalid_max=1", "out=sled"]
    assert main(["run", "study=sled.yaml", *asked]) == 0
    return store.read_rows(Path("sled")).iloc[0]


@ENGINES
def test_figures_are_those_of_a_pushed_sled(here, engine):
    """4 N push 2.1 kg to the left: v = F t / m, work F²t²/2m; the floor carries its weight all the time.

    Of the five contacts that there might be MJX is to have room for four, and there are as many.
    """
    row = simulated(engine, custom='<custom><numeric name="max_contact_points" data="4"/></custom>')
    mass, time = 2.1, 0.5
    np.testing.assert_allclose(row["travelled_m"], 4 * time**2 / 2 / mass, rtol=0.02)
    np.testing.assert_allclose(row["drift_m"], 0, atol=1e-3)
    np.testing.assert_allclose(row["energy_j"], (4 * time) ** 2 / 2 / mass, rtol=0.02)
    np.testing.assert_allclose(row["collision_impulse_ns"], mass * 9.81 * time, rtol=0.02)
    assert row["collision_share"] > 0.99
    np.testing.assert_allclose(row["load_max_n"], mass * 9.81, rtol=0.2)
    assert abs(row["energy_gained_j"]) < 0.02 * row["energy_j"]  # friction of 0.001 takes a hundredth
    assert row["unsolved_share"] == 0
    assert row["cause"] == ("" if engine == "native" else "buffer_full")


@ENGINES
def test_what_is_not_to_be_trusted_is_invalid(here, engine):
    """A sled that begins within the floor is thrown out of it, by energy from nowhere, and by a solver that stops."""
    row = simulated(engine, "3", height=0.05, more=", invalid: unsolved_share > 0")
    assert row["energy_gained_j"] > 0.5
    assert (row["outcome"], row["cause"]) == ("invalid", "untrusted")
    assert row["margin_of"] == "slow"


def test_a_lack_of_room_for_contacts_is_invalid(here):
    """Of twelve boxes on a floor, with MuJoCo's memory for the contacts of some."""
    box = '<body pos="{} 0 0.0999"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
    boxes = "".join(box.format(0.3 * k) for k in range(12))
    world = f'<worldbody><geom type="plane" size="0 0 1"/>{boxes}</worldbody>'
    Path("boxes.xml").write_text(f'<mujoco><size memory="50K"/>{world}</mujoco>')
    Path("still.py").write_text(PUSH.replace("[4.0, 0.0]", "[]"))
    Path("boxes.yaml").write_text(
        "system: mujoco\nmodel: {mjcf: boxes.xml, controller: 'still:policy', duration: 0.1}\nstudy: {name: boxes}\n"
        "outcome: {up: energy_gained_j > 1}\n"
    )
    assert main(["run", "study=boxes.yaml", "study.invalid_max=1", "out=boxes"]) == 0
    assert list(store.read_rows(Path("boxes"))["cause"]) == ["buffer_full"]


WIDER = {
    "model.geom.trunk.size.x": 0.3,
    "model.geom.lf_foot.size.radius": 0.03,
    "model.geom.rf_foot.pos.z": -0.21,
    "model.body.trunk.mass": 9.0,
    "model.joint.lf_knee.springref": -1.0,
    "model.joint.lf_knee.stiffness": 20.0,
    "model.joint.lf_hip.solreflimit.timeconst": 0.05,
    "model.pair.knees.friction.slide": 0.2,
    "model.equality.tied.solref.timeconst": 0.1,
    "model.tendon.across.springlength.high": 0.05,
    "model.actuator.rh_hip.armature": 0.1,
}


def test_models_that_are_compiled_anew_are_what_mujoco_makes_of_their_numbers(here):
    """Sizes, places, springs, limits, pairs, equalities, tendons: a batch's model, and one that is compiled so."""
    assert main(["init", "--model", "quad"]) == 0
    text = Path("quad/quadruped.xml").read_text()
    text = text.replace(
        "<actuator>",
        '<contact><pair name="knees" geom1="lf_shank" geom2="floor"/></contact><equality><joint name="tied" '
        'joint1="lh_roll" joint2="rh_roll"/></equality><tendon><spatial name="across" stiffness="500">'
        '<site site="lf_foot"/><site site="rf_foot"/></spatial></tendon><actuator>',
        1,
    )
    spec = mujoco.MjSpec.from_string(text)
    model = spec.copy().compile()
    batch = Batch(model, 3)
    fields.write_batch_parameters(
        batch, {p: np.array([v, v, fields.parameter_field(model, p).default]) for p, v in WIDER.items()}, lambda: spec
    )
    spec = spec.copy()
    spec.geom("trunk").size[0], spec.geom("trunk").mass = 0.3, 9.0
    spec.geom("lf_foot").size[0], spec.geom("rf_foot").pos[2] = 0.03, -0.21
    knee = spec.joint("lf_knee")
    knee.springref, knee.stiffness[0] = np.degrees(-1.0), 20.0
    spec.joint("lf_hip").solref_limit[0] = 0.05
    spec.pairs[0].friction[0], spec.equalities[0].solref[0] = 0.2, 0.1
    spec.tendons[0].springlength = [0.0, 0.05]
    spec.actuator("rh_hip").armature = 0.1
    changed = spec.compile()
    batch.reset(keyframe=0)
    batch.step(nstep=100)
    for other, row in ((changed, 1), (model, 2)):
        data = mujoco.MjData(other)
        mujoco.mj_resetDataKeyframe(other, data, 0)
        mujoco.mj_step(other, data, 100)
        np.testing.assert_allclose(batch.bind("qpos")[row], data.qpos, atol=1e-6)
    for path in WIDER:
        np.testing.assert_allclose(fields.parameter_field(changed, path).default, WIDER[path], rtol=1e-6, err_msg=path)


ALL = """<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="ball" pos="0 0 1" simple="false"><freejoint name="free"/><geom name="g" size=".1"/>
<site name="s" size=".1"/></body>
<body name="arm" pos="1 0 1"><joint name="a"/><geom name="h" type="box" size=".1 .2 .3"/>
<body name="hand" pos="0 0 1"><joint name="b"/><geom size=".1"/></body></body></worldbody>
<contact><pair name="p" geom1="g" geom2="floor"/></contact>
<equality><joint name="e" joint1="a" joint2="b"/></equality>
<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="2"/></fixed></tendon>
<actuator><motor name="m" joint="a"/></actuator><sensor><touch name="v" site="s"/></sensor></mujoco>"""
THINGS = {"body": "ball", "geom": "h", "joint": "a", "actuator": "m", "site": "s", "sensor": "v", "tendon": "t",
          "pair": "p", "equality": "e"}  # fmt: skip


def test_every_field_of_a_batch_is_a_path_or_has_a_reason_why_not():
    """A path writes the number that it names, of one rollout alone; `FIXED` has patterns for the others."""
    spec = mujoco.MjSpec.from_string(ALL)
    model, paths = (
        spec.copy().compile(),
        {f"opt.{name}" for name in (*fields.ENUM_OPTIONS, *fields.ITERATION_MINIMA, fields.TIMESTEP)},
    )
    things = [(f"model.{kind}.{THINGS[kind]}", numbers) for kind, numbers in fields.VARIABLE_NUMBERS.items()]
    for thing, numbers in [*things, ("model.option", fields.OPTION_NUMBERS)]:
        for name, one in numbers.items():
            usual = fields.field_values(model, one.field)
            size = usual.size if thing == "model.option" else usual[0].size
            names = one.component_names or (fields.XYZ if one.needs_compiler else [*map(str, range(size))])
            path = f"{thing}.{name}" + (f".{names[size - 1]}" if size > 1 else "")
            nominal, batch = fields.parameter_field(model, path).default, Batch(model, 2)
            fields.write_batch_parameters(batch, {path: np.array([nominal, nominal + 0.25])}, lambda: spec)
            same, other = (fields.field_values(batch.get_model(k), one.field) for k in (0, 1))
            np.testing.assert_array_equal(same, usual, err_msg=path)
            assert list(other[other != usual]) == [nominal + 0.25], path
            paths.add(one.field)
    simple = mujoco.MjSpec.from_string(ALL.replace(' simple="false"', "")).compile()
    with pytest.raises(InputError, match="MuJoCo simplified the body"):
        fields.require_variable_parameter(lambda: spec, simple, "model.body.ball.ipos.x")
    told = [pattern for patterns in fields.FIXED for pattern in patterns.split()]
    whole_numbers = {name for name in MODEL_FIELDS if fields.field_values(model, name).dtype.kind != "f"}
    for name in MODEL_FIELDS - whole_numbers:
        assert any(fnmatch(name, pattern) for pattern in told) != (name in paths), name
    known = MODEL_FIELDS | {"jnt_springyield"}  # of MuJoCo 4
    assert not [pattern for pattern in told if not any(fnmatch(name, pattern) for name in known)]


URDF = """<robot name="cart"><link name="base"/><link name="trunk">
<inertial><mass value="3"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>
<collision><geometry><mesh filename="package://cart/meshes/{}.stl"/></geometry></collision></link>
<joint name="rail" type="prismatic"><parent link="base"/><child link="trunk"/><axis xyz="0 0 1"/>
<limit lower="-9" upper="9" effort="5" velocity="3"/></joint></robot>"""
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


def cart():
    """The robot, its mesh in a folder beside it as a ROS package has it, and a study of it."""
    faces = [CORNERS[[0, 2, 1]], CORNERS[[0, 1, 3]], CORNERS[[0, 3, 2]], CORNERS[[1, 2, 3]]]
    stl = b"".join(struct.pack("<12fH", 0, 0, 1, *face.ravel(), 0) for face in faces)
    Path("meshes").mkdir()
    Path("meshes/trunk.stl").write_bytes(bytes(80) + struct.pack("<I", 4) + stl)
    Path("robot.urdf").write_text(URDF.format("trunk"))
    Path("still.py").write_text(PUSH.replace("[4.0, 0.0]", "[]"))
    Path("falls.yaml").write_text(
        "system: mujoco\nmodel: {mjcf: robot.urdf, controller: 'still:policy', duration: 0.5}\nstudy: {name: falls}\n"
        "outcome: {up: energy_gained_j > 1}\n"
    )


def test_a_crate_has_all_that_an_own_model_is_read_from(here, tmp_path_factory, monkeypatch, capsys):
    """A file that includes another one and attaches a robot with a mesh, and a controller with a file of its own."""
    cart()
    Path("scene.xml").write_text(
        '<mujoco><include file="sky/ground.xml"/><asset><model name="cart" file="robot.urdf"/></asset><worldbody>'
        '<body><attach model="cart" prefix="c_"/></body></worldbody></mujoco>'
    )
    Path("sky").mkdir()
    Path("sky/ground.xml").write_text('<mujoco><worldbody><geom type="plane" size="0 0 1"/></worldbody></mujoco>')
    Path("stand.txt").write_text("0")
    Path("still.py").write_text(f"FILES = ['stand.txt']\nopen(FILES[0]).close()\n{Path('still.py').read_text()}")
    away = tmp_path_factory.mktemp("away")
    asked = [
        "study=falls.yaml",
        "model.mjcf=scene.xml",
        "study.axes={g: {path: model.option.gravity.z, values: [-9, -8]}}",
    ]
    assert main(["run", *asked, "out=falls"]) == 0
    assert main(["export", "falls", "--crate", str(away / "crate")]) == 0
    read = {str(file.relative_to(away / "crate/project")) for file in (away / "crate/project").rglob("*.*")}
    assert read == {
        "sweep.yaml",
        "scene.xml",
        "robot.urdf",
        "meshes/trunk.stl",
        "sky/ground.xml",
        "still.py",
        "stand.txt",
    }
    for file in read - {"sweep.yaml"}:
        Path(file).unlink()
    monkeypatch.chdir(away)
    capsys.readouterr()
    assert main(["reproduce", "crate", "--rows", "2"]) == 2
    told = capsys.readouterr()
    digest = hashlib.sha256(Path("crate/project/still.py").read_bytes()).hexdigest()
    assert told.out.splitlines() == ["controller still:policy", f"project/still.py, SHA-256 {digest}"]
    assert "then give --trust" in told.err
    assert main(["reproduce", "crate", "--rows", "2", "--trust"]) == 0
    assert "2 rollouts simulated again: 2 equal to the last bit" in capsys.readouterr().out
    assert Path.cwd() == away
    Path("crate/project/sky/ground.xml").write_text("<mujoco/>")
    assert main(["export", str(away / "crate/study"), "--crate", "again"]) == 2


def test_rollouts_that_end_before_the_first_frame_are_simulated_again(here, capsys):
    cart()
    axis = "study.axes={g: {path: model.option.gravity.z, values: [-9, -8]}}"
    assert main(["run", "study=falls.yaml", "model.duration=0.02", axis, "out=short"]) == 0
    capsys.readouterr()
    assert main(["verify", "short", "--simulate", "2"]) == 0
    assert "2 rollouts simulated again: 2 equal to the last bit" in capsys.readouterr().out


def test_a_urdf_and_its_meshes_are_read_as_they_are(here, capsys):
    """It falls as it should."""
    cart()
    assert main(["run", "study=falls.yaml", "study.keep=[qpos_0]", "out=falls"]) == 0
    Path("robot.urdf").write_text(URDF.format("trnk"))
    capsys.readouterr()
    assert main(["run", "study=falls.yaml", "out=lost"]) == 2
    (told,) = capsys.readouterr().err.splitlines()
    assert "model.mjcf = robot.urdf does not compile: " in told
    assert "did you mean trunk.stl?" in told
    assert not Path("lost").exists()


def test_a_controller_is_as_its_file_is_now_and_in_this_project(here, monkeypatch):
    """Of a notebook that goes on while a file is edited, or goes on to another project."""
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    for folder, number in ((here, 1), (here, 22), (here / "other", 333), (here, 4444)):
        folder.mkdir(exist_ok=True)
        (folder / "steered.py").write_text(
            f"def policy(belief, observation, state, key):\n    return {number}, state\n"
        )
        monkeypatch.chdir(folder)
        found = files.load_controller("steered:policy", model, -1, 0.02)
        assert found.policy({}, None, (), None) == (number, ())
        assert files.load_controller("steered:policy", model, -1, 0.02).policy is found.policy  # and compiled once
