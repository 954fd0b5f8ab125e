import numpy as np
import pytest
from scipy import stats
from scipy.stats import kstest, norm, truncnorm

from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.study import designs
from sweep.study.study import Study, make_points


@pytest.fixture(scope="module")
def nominal():
    return compose([])


@pytest.fixture
def table_of(nominal):
    """The points of axes, in the way of `study.axes`, and other keys of a study."""

    def build(axes, **keys):
        study = parse(nominal, axes, **keys)
        return make_points(study, nominal.system, nominal.settings)

    return build


def parse(nominal, axes, **keys):
    return Study.parse({**nominal.values["study"], "axes": axes, **keys}, single=False)


def monte_carlo(num, **keys):
    return {"design": {"kind": "monte_carlo", "num": num, **keys}}


def listed(path, *values, **keys):
    return {"path": path, "values": list(values), **keys}


def drawn(path, kind="uniform", side="both", **numbers):
    numbers = {key.removesuffix("_"): value for key, value in numbers.items()}
    return {"path": path, "side": side, "distribution": {"kind": kind, **numbers}}


FRICTION = drawn("contact.friction", side="world", from_=0.5, to=1.5)
SHIN = {"path": "robot.shin", "relative": 0.02}


@pytest.mark.parametrize(
    ("given", "cdf"),
    [
        ({"kind": "uniform", "from": 0.5, "to": 1.5}, lambda v: np.clip(v - 0.5, 0, 1)),
        ({"kind": "log_uniform", "from": 0.1, "to": 10}, lambda v: (np.log10(v) + 1) / 2),
        ({"kind": "normal", "mean": 20, "std": 2}, norm(20, 2).cdf),
        ({"kind": "normal", "mean": 1, "std": 1, "from": 0.5, "to": 4}, truncnorm(-0.5, 3, 1, 1).cdf),
        ({"kind": "discrete", "values": [1, 2], "weights": [1, 3]}, None),
    ],
)
@pytest.mark.parametrize("kind", ["monte_carlo", "latin_hypercube", "sobol", "saltelli"])
def test_every_design_draws_the_declared_distribution(table_of, kind, given, cdf):
    axes = {"f": {"path": "contact.friction", "distribution": given}, "shin": SHIN}
    values = table_of(axes, design={"kind": kind, "num": 512})["contact.friction"]
    if cdf is None:
        assert (values == 2).mean() == pytest.approx(0.75, abs=0.06)  # 3 standard errors of 512 draws
        return
    values = values.unique() if kind == "saltelli" else values  # whose rows repeat the columns of two samples
    assert kstest(values, cdf).pvalue > 1e-3
    if kind == "latin_hypercube":  # one draw in each of 512 equally likely strata
        assert np.array_equal(np.sort(np.floor(512 * cdf(values)).astype(int)), np.arange(512))


def test_sobol_fills_every_elementary_box_and_scrambles_are_independent(table_of):
    axes = {"f": FRICTION, "s": drawn("robot.shin", from_=0.2, to=0.3)}
    table = table_of(axes, design={"kind": "sobol", "num": 64, "scrambles": 2})
    x, y = table["world.contact.friction"] - 0.5, (table["robot.shin"] - 0.2) / 0.1
    for scramble in (0, 1):
        rows = table["replicate"] % 2 == scramble
        boxes = np.floor(x[rows] * 8).astype(int) * 8 + np.floor(y[rows] * 8).astype(int)
        assert sorted(boxes) == list(range(64))
    assert not set(x[table["replicate"] % 2 == 0]) & set(x[table["replicate"] % 2 == 1])


def test_draws_are_repeated_at_every_grid_point_with_noise_of_their_own(table_of):
    believed = listed("contact.friction", 0.5, 1.0, side="belief")
    table = table_of({"b": believed, "f": FRICTION, "shin": SHIN}, **monte_carlo(8), replicates=2)
    assert len(table) == 32
    halves = [part.reset_index(drop=True) for _, part in table.groupby("belief.contact.friction")]
    for column in ("world.contact.friction", "robot.shin", "replicate", "stream"):
        assert halves[0][column].equals(halves[1][column])
    assert halves[0]["stream"].nunique() == 16
    assert table["point_id"].is_unique
    assert not table["world.contact.friction"].equals(table["robot.shin"])


def test_more_draws_or_axes_leave_the_first_ones_as_they_are(table_of):
    few = table_of({"f": FRICTION}, **monte_carlo(8))
    more = table_of({"f": FRICTION, "shin": SHIN}, **monte_carlo(16))
    other = table_of({"f": FRICTION}, **monte_carlo(8), seed=1)
    assert few["world.contact.friction"].equals(more["world.contact.friction"][:8])
    assert few["stream"].equals(more["stream"][:8])
    assert not set(few["world.contact.friction"]) & set(other["world.contact.friction"])
    axes = {"f": FRICTION, "shin": SHIN}
    few, more = (table_of(axes, design={"kind": "sobol", "num": n, "scrambles": 2}) for n in (8, 16))
    assert few["point_id"].equals(more["point_id"][:16])


def test_axes_go_along_with_each_other_and_scale_others(table_of):
    table = table_of({
        "f": listed("contact.friction", 0.5, 1.0),
        "gait": listed("manoeuvre.gait", "tripod", "gallop", **{"with": "f"}),
        "length": listed("robot.body_length", 1.0, 2.0),
        "ratio": listed("robot.body_width", 0.4, 0.5, 0.6, times="robot.body_length"),
    })  # fmt: skip
    assert len(table) == 2 * 2 * 3
    pairs = set(zip(table["contact.friction"], table["manoeuvre.gait"], strict=True))
    assert pairs == {(0.5, "tripod"), (1.0, "gallop")}
    np.testing.assert_allclose(table["robot.body_width"], table["axis.ratio"] * table["robot.body_length"])
    assert set(table["axis.ratio"]) == {0.4, 0.5, 0.6}


def test_errors_grow_with_an_axis_of_their_size(table_of):
    shin = {"path": "robot.shin", "side": "belief", "relative": "error"}
    mass = {"path": "robot.body_mass", "side": "world", "relative": "error"}
    table = table_of({"error": {"values": [0.0, 0.01, 0.05]}, "shin": shin, "mass": mass}, **monte_carlo(200))
    assert len(table) == 600
    for size, rows in table.groupby("axis.error"):
        for column, value in (("belief.robot.shin", 0.335), ("world.robot.body_mass", 10.0)):
            error = np.abs(rows[column] / value - 1)
            assert 0.95 * size <= error.max() <= size + 1e-12


def test_one_axis_at_a_time_leaves_the_others_nominal(table_of):
    axes = {
        "error": {"values": [0.0, 0.02], "nominal": 0.01},
        "shin": {"path": "robot.shin", "side": "belief", "relative": "error"},
        "f": listed("contact.friction", 0.5, 1.0, side="world"),
        "gait": listed("manoeuvre.gait", "tripod", "gallop"),
        "width": listed("robot.body_width", -0.1, 0.1, relative=1),
    }
    table = table_of(axes, design={"grid": "one_at_a_time", "num": 3})
    arms = table.drop_duplicates(["axis.error", "world.contact.friction", "manoeuvre.gait", "axis.width"])
    off = [arms["axis.error"] != 0.01, arms["world.contact.friction"] != 1, arms["manoeuvre.gait"] != "tripod",
           arms["axis.width"] != 0]  # fmt: skip
    assert sorted(np.sum(off, axis=0)) == [0, 1, 1, 1, 1, 1, 1]  # the nominal point once, though two arms have it
    assert len(table) == 7 * 3
    assert (np.abs(table["belief.robot.shin"] / 0.335 - 1) <= table["axis.error"]).all()


def test_rows_say_which_whole_delays_and_joints_were_drawn(table_of):
    axes = {
        "delay": drawn("noise.delay", from_=0, to=3),
        "joint": drawn("execution.dead_joint", side="world", from_=0, to=17),
        "friction": FRICTION,
    }
    table = table_of(axes, **monte_carlo(64))
    assert sorted(table["noise.delay"].unique()) == [0, 1, 2, 3]
    assert (table["world.execution.dead_joint"] % 1 == 0).all()
    assert (table["world.contact.friction"] % 1 != 0).all()
    assert table["point_id"].is_unique  # each has noise of its own


@pytest.mark.parametrize(
    ("axes", "design", "message"),
    [
        ({"f": FRICTION}, {}, "study.design.num = 0 is not allowed: at least 1 for f"),
        ({}, {"num": 4}, "no axis has a distribution"),
        ({"f": FRICTION}, {"num": 4, "kind": "sobl"}, "did you mean sobol?"),
        ({"f": FRICTION}, {"num": 4, "grid": "star"}, "study.design.grid = 'star' is unknown"),
        ({"f": listed("contact.friction", 1, nominal=1)}, {}, "has a nominal value in the configuration"),
        ({"f": FRICTION}, {"num": 4, "kind": "sobol", "scrambles": 0}, "scrambles = 0 is not allowed: at least 1"),
        ({"f": drawn("contact.friction", "unifrm")}, {}, "did you mean uniform?"),
        ({"f": drawn("contact.friction", from_=1)}, {}, "f.distribution.to is missing"),
        ({"f": drawn("contact.friction", from_=1, to=1)}, {}, "greater than from"),
        ({"f": drawn("contact.friction", "normal", mean=1, std=0)}, {}, "f.distribution.std = 0"),
        ({"f": drawn("contact.friction", "log_uniform", from_=0, to=1)}, {}, "greater than 0"),
        ({"f": drawn("contact.friction", "discrete", values=[1], weights=[0])}, {}, "not all zero"),
        ({"f": drawn("contact.friction", "normal", mean=0, std=1)}, {"num": 64}, "contact.friction = -"),
        ({"f": {"path": "contact.friction", "relative": "size"}}, {}, "an axis without a path"),
        ({"f": {"values": [1]}}, {}, "f.path is missing"),
        ({"f": listed("contact.friction", 8, "9")}, {}, "[8, '9'] is not allowed: all numbers, or all names"),
        ({"p": {"path": "noise.delay", "relative": 0.1}}, {"num": 1}, "noise.delay is nominally 0"),
        ({"f": listed("contact.friction", 1, times="robot.bdy_mass")}, {}, "did you mean body_mass?"),
        ({"f": listed("contact.friction", 1, **{"with": "g"})}, {}, "both axes need listed values"),
        ({"f": listed("contact.friction", 1, **{"with": "g"}), "g": listed("robot.shin", 1, 2)}, {}, "g has 2"),
        ({"f": listed("robot.shin", 1, times="robot.thigh"), "g": listed("robot.thigh", 1, times="robot.shin")}, {},
         "refers to itself"),
    ],
)  # fmt: skip
def test_a_bad_design_is_refused(table_of, axes, design, message):
    with pytest.raises(InputError) as error:
        table_of(axes, design=design)
    assert message in str(error.value)


def test_a_sobol_design_that_loses_its_balance_is_doubted(nominal):
    def doubt(**design):
        return parse(nominal, {"f": FRICTION}, design=design).design.precision_warning

    assert doubt(kind="sobol", num=64) is None
    assert "not a power of 2" in str(doubt(kind="sobol", num=65))
    assert doubt(num=65) is None


def test_many_points_are_built_at_once_and_told_apart(table_of):
    table = table_of({"f": FRICTION, "shin": SHIN, "b": listed("robot.thigh", 0.4, 0.5)}, **monte_carlo(250_000))
    assert len(table) == 500_000
    assert table["point_id"].is_unique


def test_distributions_of_scipy_and_a_copula_keep_what_they_promise():
    axes = {
        "mass": {"path": "robot.body_mass", "distribution": {"kind": "gamma", "a": 25, "scale": 0.4}},
        "size": {"path": "robot.body_length", "distribution": {"kind": "normal", "mean": 1.05, "std": 0.02}},
        "grip": {"path": "contact.friction", "distribution": {"kind": "beta", "a": 2, "b": 5, "from": 0.1, "to": 0.4}},
    }
    parsed = designs.parse_axes(axes)
    given = {"num": 4000, "correlation": [["mass", "size", 0.7]]}
    table = designs.make_design_table(parsed, designs.parse_design(given, parsed), 0, lambda path: 1.0)
    mass, size, grip = (table[path] for path in ("robot.body_mass", "robot.body_length", "contact.friction"))
    assert stats.kstest(mass, stats.gamma(25, scale=0.4).cdf).pvalue > 0.01  # each keeps its own
    assert stats.kstest(size, stats.norm(1.05, 0.02).cdf).pvalue > 0.01
    assert (grip.min(), grip.max()) == pytest.approx((0.1, 0.4), abs=0.01)
    normals = stats.gamma(25, scale=0.4).cdf(mass)
    assert np.corrcoef(stats.norm.ppf(normals), size)[0, 1] == pytest.approx(0.7, abs=0.03)
    assert abs(np.corrcoef(mass, grip)[0, 1]) < 0.05


@pytest.mark.parametrize(("key", "value", "named"), [
    ("distribution", {"kind": "gama", "a": 2}, "any of scipy.stats"),
    ("distribution", {"kind": "gamma"}, r"distribution\.a is missing: gamma needs a"),
    ("distribution", {"kind": "gamma", "a": -2}, r"scipy\.stats\.gamma has no such distribution"),
    ("distribution", {"kind": "gamma", "a": 2, "b": 2}, r"distribution\.b is unknown"),
    ("correlation", [["mass", "siez", 0.5]], "siez is not a drawn axis: did you mean size"),
    ("correlation", [["mass", "size", 1.5]], "between -1 and 1"),
    ("correlation", [["mass"]], "two drawn axes and a number"),
])  # fmt: skip
def test_distributions_and_correlations_that_mean_nothing_are_refused(key, value, named):
    drawn = {"kind": "uniform", "from": 0.5, "to": 1.5}
    axes = {"mass": {"path": "robot.body_mass", "distribution": value if key == "distribution" else drawn},
            "size": {"path": "robot.body_length", "distribution": drawn}}  # fmt: skip
    pairs = value if key == "correlation" else []
    with pytest.raises(InputError, match=named):
        designs.parse_design({"num": 4, "correlation": pairs}, designs.parse_axes(axes))


def test_correlations_that_go_with_no_distribution_tell_how_much_smaller_ones_do():
    drawn = {"kind": "uniform", "from": 0.5, "to": 1.5}
    paths = {"mass": "robot.body_mass", "size": "robot.body_length", "grip": "contact.friction"}
    axes = designs.parse_axes({name: {"path": path, "distribution": drawn} for name, path in paths.items()})

    def parsed(factor):
        pairs = [("mass", "size", 0.9), ("size", "grip", 0.9), ("mass", "grip", -0.9)]
        given = [[a, b, factor * share] for a, b, share in pairs]
        return designs.parse_design({"num": 4, "correlation": given}, axes)

    with pytest.raises(InputError, match=r"mass-grip -0\.9: scale them by (0\.55) or less, or drop one") as told:
        parsed(1.0)
    assert parsed(0.55).correlation
    with pytest.raises(InputError):
        parsed(0.56)
    assert "study.design.correlation" in str(told.value)


def test_an_axis_has_a_name():
    with pytest.raises(InputError, match=r"study.axes.' ' is not allowed: a name"):
        designs.refuse_ignored_settings({"axes": {"friction": {}, " ": {}}})
