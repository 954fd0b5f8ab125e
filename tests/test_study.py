import numpy as np
import pandas as pd
import pytest

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core.expressions import condition_mask
from sweep.core.parameters import InputError
from sweep.runs.batches import allocate_delay_buffers, assign_batches, make_batch, make_nominal_batch
from sweep.runs.runner import select_points_to_simulate
from sweep.study.designs import parse_axes
from sweep.study.study import make_points

pytestmark = pytest.mark.usefixtures("fake_engine")
FRICTION = "+study.axes.f={path: contact.friction, side: world, values: [0.5, 1.0, 1.5]}"


def table_of(*overrides):
    exp = compose(list(overrides))
    return exp, make_points(exp.study, exp.system, exp.settings)


def test_a_world_axis_never_reaches_the_belief():
    exp, table = table_of(FRICTION, "+study.axes.b={path: contact.friction, values: [0.7]}", "engine.width=4")
    table = assign_batches(exp, pd.DataFrame(), table)
    task = make_batch(exp, table)
    np.testing.assert_array_equal(task.world.contact.friction, [0.5, 1.0, 1.5, 1.5])  # the last row is repeated
    np.testing.assert_array_equal(task.belief.contact.friction, [0.7] * 4)
    assert task.world.contact.stiffness == exp.case.contact.stiffness
    assert make_nominal_batch(exp, table, 4).world == exp.case


def test_point_id_is_the_physics_and_the_replicate():
    _, by_axis = table_of("+study.axes.f={path: contact.friction, values: [0.5, 1.0]}", "study.replicates=2")
    _, by_nominal = table_of("contact.friction=0.5", "study.replicates=2", "engine=native")
    assert by_axis["point_id"].is_unique
    assert by_axis["point_id"][:2].tolist() == by_nominal["point_id"].tolist()
    _, in_world = table_of("+study.axes.f={path: contact.friction, side: world, values: [0.5, 1.0]}")
    assert in_world["point_id"][1] == by_axis["point_id"][2]  # 1.0 is the nominal value: the same physics
    assert in_world["point_id"][0] not in set(by_axis["point_id"])


def test_replicates_share_their_noise_across_the_axes():
    _, table = table_of(FRICTION, "study.replicates=2", "study.seed=3")
    assert (table.groupby("replicate")["stream"].nunique() == 1).all()
    assert table["stream"].nunique() == 2
    assert not set(table["stream"]) & set(table_of(FRICTION, "study.replicates=2")[1]["stream"])


def test_static_axes_make_groups_and_batches_belong_to_one():
    engine = "+study.axes.e={path: engine.name, values: [mjx, native]}"
    exp, table = table_of(FRICTION, engine, "study.replicates=5")
    table = assign_batches(exp, pd.DataFrame(), table)
    assert table.groupby("engine.name")["group"].nunique().eq(1).all()
    assert table.groupby("batch")["group"].nunique().eq(1).all()
    assert table["width"].unique().tolist() == [8]  # 15 rows of either engine, at most 8 wide: two even batches
    assert table.groupby("batch").size().tolist() == [8, 7, 8, 7]
    assert make_batch(exp, table[table["batch"] == 2]).settings.name == "native"


def test_points_that_are_left_out_are_counted(tmp_path, capsys):
    values = "+study.axes.f={path: contact.friction, values: [1.0, 1.00000000000001, 1.0, 2.0, 1e-300, 2e-300]}"
    said = []
    exp = compose([values, "study.name=x"])
    table = make_points(exp.study, exp.system, exp.settings, on_message=said.append)
    assert table["contact.friction"].tolist() == [1.0, 2.0, 1e-300, 2e-300]
    assert said == ["2 of 6 rollouts are left out: they equal others in 12 digits"]
    (tmp_path / "p.csv").write_text("contact.friction\n1.0\n1.0\n2.0\n")
    assert main(["run", "--points", str(tmp_path / "p.csv"), f"out={tmp_path / 'out'}", "--dry-run"]) == 0
    assert "1 of 3 rollouts are left out" in capsys.readouterr().err
    arms = [f"+study.axes.{name}={{path: robot.{name}, values: [0.3, 0.4]}}" for name in ("shin", "thigh")]
    exp = compose([*arms, "study.design.grid=one_at_a_time", "study.name=x"])
    make_points(exp.study, exp.system, exp.settings, on_message=pytest.fail)


ABSURD = [
    "1/0 > friction", f"friction > {'9' * 400}", "not " * 2000 + "friction > 1", "[0]*400000000 == friction",
    "'a'*400000000 == friction", "(" * 3000 + "friction > 1", "friction > " + "1+" * 3000 + "1",
    "friction == [[1],[2,3]]", "outcome in 5",
]  # fmt: skip


@pytest.mark.parametrize("where", ABSURD)
def test_an_absurd_condition_is_one_short_line(where):
    frame = pd.DataFrame({"friction": [1.0, 2.0], "outcome": ["success", "failure"]})
    with pytest.raises(InputError) as error:
        condition_mask(frame, where)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 1000


@pytest.mark.parametrize(
    "overrides",
    [
        [f"+study.axes.{name}={{path: robot.{name}, from: 1, to: 2, num: 5000}}" for name in ("shin", "thigh")],
        ["+study.axes.a={path: robot.shin, relative: 0.1}", "study.design.num=1000000000"],
        ["study.replicates=1000000000"],
    ],
)
def test_a_study_that_is_too_large_is_refused_before_it_is_built(overrides):
    exp = compose([*overrides, "study.name=x"])
    with pytest.raises(InputError, match="rollouts: at most 20000000"):
        make_points(exp.study, exp.system, exp.settings)


def test_extending_a_study_keeps_membership_and_slots():
    exp, few = table_of(FRICTION)
    first = assign_batches(exp, pd.DataFrame(), few)
    exp, more = table_of(FRICTION.replace("1.5", "1.5, 2.0, 0.1"))
    grown = assign_batches(exp, first, more)
    pd.testing.assert_frame_equal(grown.iloc[:3], first)
    assert grown["batch"].tolist() == [0, 0, 0, 1, 1]


def test_the_delay_buffer_has_room_for_the_longest_delay():
    exp, table = table_of("+study.axes.d={path: noise.delay, side: world, values: [0, 3]}")
    assert allocate_delay_buffers(exp, table).case.noise.delay_buffer == 3
    columns = "world.noise.delay", "world.noise.load_delay"
    table = pd.DataFrame([(0.0, 7.0), (5.0, 0.0), (4.0, 4.0)], columns=columns)
    assert allocate_delay_buffers(exp, table).case.noise.delay_buffer == 8


def test_the_delay_buffer_has_room_for_all_that_may_be_drawn():
    axis = "+study.axes.d={path: noise.delay, side: world, distribution: {kind: uniform, from: 0, to: 12}}"
    exp, table = table_of(axis, "study.design.num=2")
    assert table["world.noise.delay"].max() < 11
    assert allocate_delay_buffers(exp, table).case.noise.delay_buffer == 12


def test_rows_of_a_file_have_noise_of_their_own_wherever_they_stand(tmp_path):
    (tmp_path / "a.csv").write_text("contact.friction\n0.3\n0.5\n")
    (tmp_path / "b.csv").write_text("contact.friction\n0.4\n0.5\n0.3\n")
    a, b = (
        table_of("scenario=walk_tripod", f"study.points={tmp_path / name}", "study.replicates=2", *more)[1]
        for name, more in (("a.csv", []), ("b.csv", ["robot.body_mass=12"]))
    )
    assert a["stream"].nunique() == 4
    assert (a["stream"] > 0).all()
    both = a.merge(b, on=["contact.friction", "replicate"])
    assert (both["stream_x"] == both["stream_y"]).all()  # as two runs that are to be compared need
    assert len(both) == 4


def test_points_from_a_file_take_the_place_of_the_grid(tmp_path):
    file = tmp_path / "points.csv"
    file.write_text("world.contact.friction, manoeuvre.gait\n0.3, tripod\n1, gallop\n1, gallop\n")
    exp, table = table_of("study=walk_map", f"study.points={file}", "study.where=null")
    assert table["world.contact.friction"].tolist() == [0.3, 1.0]
    assert assign_batches(exp, pd.DataFrame(), table)["group"].tolist() == [0, 1]
    file.write_text("contact.friction\n-1\n")
    with pytest.raises(InputError, match=r"contact\.friction = -1 is not allowed"):
        table_of(f"study.points={file}")


@pytest.mark.parametrize(
    ("axis", "message"),
    [
        ("{path: contact.frction, values: [1]}", "did you mean friction?"),
        ("{path: contact, values: [1]}", "contact is unknown"),
        ("{path: engine.name, side: world, values: [mjx]}", "engine is unknown"),
        ("{path: contact.friction.x, values: [1]}", "friction has no parts"),
        ("{path: contact.friction, values: [1, -2]}", "contact.friction = -2 is not allowed"),
        (
            "{path: robot.thigh, side: belief, values: [0.5, 520]}",
            "belief.robot.thigh = 520 is not allowed: is it 0.52 m",
        ),
        ("{path: friction, values: [1]}", "friction is unknown: did you mean contact.friction?"),
        ("{path: engine.name, values: [cuda]}", "one of mjx, native"),
    ],
)
def test_an_axis_that_names_nothing_or_leaves_the_bounds_is_refused(axis, message):
    with pytest.raises(InputError) as error:
        table_of(f"+study.axes.a={axis}")
    assert message in str(error.value)


@pytest.mark.parametrize(
    "overrides",
    [
        ["contact.damping=100"],
        ["engine.time_step=0.003"],
        ["+study.axes.c={path: contact.stiffness, side: world, values: [1e6, 1.1e6]}"],
    ],
)
def test_a_step_longer_than_contacts_relax_is_refused(overrides):
    """It would damp them by itself, or shake them. C MuJoCo has a contact of its own."""
    with pytest.raises(InputError, match=r"engine.time_step = 0.00\d is not allowed: at most 0.00"):
        table_of(*overrides)
    assert len(table_of(*overrides, "engine=native")[1]) >= 1


def test_conditions_select_rows_and_run_no_code():
    _, table = table_of("study=walk_map")
    assert condition_mask(table, "friction > 1 and not half_step_ratio < 0.1").sum() == 6 * 10
    assert condition_mask(table, "world.contact.friction in [0.05, 1.2] or replicate == 1").sum() == 2 * 17
    assert condition_mask(table, None).all()
    for condition in ("__import__('os').system('x')", "friction.max()", "frction > 1", "friction >", "friction > 'a'"):
        with pytest.raises(InputError):
            condition_mask(table, condition)


def test_limit_and_where_choose_points_of_a_study():
    exp = compose(["study=walk_map"])
    assert len(select_points_to_simulate(exp, "friction > 1", 5)) == 5
    with pytest.raises(InputError, match="no point of walk_map"):
        select_points_to_simulate(exp, "friction > 2")
    assert np.all(select_points_to_simulate(exp, "friction > 1")["world.contact.friction"] > 1)


def test_a_side_by_its_old_name_is_read_and_noted(capsys):
    exp = compose(["+study.axes.f={path: contact.friction, on: world, values: [0.5]}"])
    assert exp.study.axes[0].parameter_column == "world.contact.friction"
    assert exp.values["study"]["axes"]["f"]["side"] == "world"
    assert capsys.readouterr().err == "sweep: note: the key `on` of an axis is now called `side`\n"
    with pytest.raises(InputError, match="on is not allowed together with side"):
        compose(["+study.axes.f={path: contact.friction, on: world, side: world, values: [0.5]}"])
    as_yaml_reads_it = {"f": {"path": "contact.friction", True: "world", "values": [0.5]}}
    assert parse_axes(as_yaml_reads_it) == exp.study.axes


def test_rows_that_use_nothing_of_control_keep_the_ids_of_before_there_was_any():
    axis = "+study.axes.calibrate={path: control.calibrate, values: [none, sizes]}"
    _, plain = table_of("study=ci_smoke")
    _, both = table_of("study=ci_smoke", axis)
    stored = pd.read_parquet("tests/data/ci_smoke/points.parquet")
    assert plain["point_id"].tolist() == stored["point_id"].tolist()
    assert both.loc[both["control.calibrate"] == "none", "point_id"].tolist() == plain["point_id"].tolist()
    assert both["point_id"].nunique() == 2 * plain["point_id"].nunique()


def test_a_path_with_a_star_is_an_axis_for_each_number_below_it():
    exp = compose(["scenario=ball_descend", "study=any_plan_sensitivity", "study.axes.number.path=plan.off.hold.*"])
    table = make_points(exp.study, exp.system, exp.settings)
    held = {f"plan.off.hold.{name}" for name in ("seconds", "base.elevation", "base.distance", "base.ahead")}
    assert {a.parameter_column for a in exp.study.axes} == held
    assert len(table) == 8 * (len(held) + 1)  # Morris' paths
    for path in held:
        assert np.ptp(table[path]) == pytest.approx(
            0.04 * exp.system.nominal_parameter_value(path, exp.settings), rel=0.02
        )
    with pytest.raises(InputError, match=r"study.axes.number.path = plan.of.\* matches no number that is not zero"):
        compose(["scenario=ball_descend", "study=any_plan_sensitivity", "study.axes.number.path=plan.of.*"])
    sizes = compose(["+study.axes.size={path: robot.*, relative: 0.01}", "study.design.num=2"]).study.axes
    assert {"robot.thigh", "robot.body_mass"} < {a.parameter_column for a in sizes}
