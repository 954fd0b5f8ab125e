"""What every typed function promises: it batches and its derivatives are finite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.core.parameters import InputError
from sweep.formulas import FORMULAS, evaluate, find_by_equation

# Whole systems, not functions of numbers to broadcast; their derivatives are tested where they live.
SYSTEMS = ("raft_linear", "raft_modes", "raft_ode", "mounts", "ball_jacobian")
BATCHED = [name for name in FORMULAS if name not in SYSTEMS]


def call(formula, vector):
    """The formula's outputs in one row, as a function of its inputs in one row."""
    values, at = {}, 0
    for entry in formula.inputs:
        if entry.options:
            values[entry.name] = entry.default
        else:
            size = len(entry.default) if isinstance(entry.default, tuple) else 1
            part = vector[at : at + size]
            values[entry.name] = part if isinstance(entry.default, tuple) else part[0]
            at += size
    return jnp.concatenate([jnp.ravel(1.0 * output) for output in formula.function(**values)])


def defaults(formula):
    return jnp.array(np.concatenate([np.ravel(entry.default) for entry in formula.inputs if not entry.options]), float)


@pytest.mark.parametrize("name", BATCHED)
def test_batches_and_differentiates(name):
    formula = FORMULAS[name]
    with jax.enable_x64(True):
        point = defaults(formula)
        # Along all inputs at once: a derivative that is not finite shows in the sum.
        along = jax.vmap(lambda x: jax.jvp(lambda y: call(formula, y), (x,), (jnp.ones_like(x),)))
        values, slopes = jax.jit(along)(jnp.stack([point, point]))
    assert np.isfinite(slopes).all()
    single = np.concatenate([np.ravel(value) for value in evaluate(name, {}).values()]).astype(float)
    np.testing.assert_allclose(values, np.stack([single, single]), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", ["corner_balanced", "ball_turn", "max_ball", "crossing", "drag_integrals"])
def test_broadcasts(name):
    formula = FORMULAS[name]
    columns = {entry.name: jnp.asarray(entry.default) for entry in formula.inputs}
    first = formula.inputs[0].name
    function = jax.jit(formula.function)
    shaped = function(**{**columns, first: jnp.full((2, 1, 3), columns[first])})
    plain = function(**columns)
    assert all(output.shape == (2, 1, 3) for output in jax.tree.leaves(shaped._replace(**_constant(shaped))))
    for output, expected in zip(shaped, plain, strict=True):
        np.testing.assert_allclose(output, np.broadcast_to(expected, output.shape), rtol=1e-5)


def _constant(result):
    """Outputs that do not depend on the first input, in the batch's shape."""
    return {name: jnp.broadcast_to(value, (2, 1, 3)) for name, value in result._asdict().items() if value.ndim == 0}


@pytest.mark.parametrize(
    ("name", "inputs", "message"),
    [
        ("corner", {}, r"formula corner is unknown.*corner_balanced"),
        ("ladder", {"f3": 1}, r"ladder\.f3 is unknown.*allowed: f1, f2, phi"),
        ("ladder", {"f1": -1}, r"ladder\.f1 = -1 is not allowed: greater than 0"),
        ("ladder", {"f1": float("nan")}, r"ladder\.f1 = nan is not allowed"),
        ("ladder", {"f1": "1"}, r"ladder\.f1 = '1' is not allowed: a number"),
        ("leg_fk", {"leg": 0}, r"leg_fk\.leg = 0 is not allowed: one of 1, 2, 3, 4, 5, 6"),
        ("leg_fk", {"angles": [0, 1]}, r"leg_fk\.angles = \[0, 1\] is not allowed: a list of 3 numbers"),
        ("leg_fk", {"angles": [0, 1, "x"]}, r"leg_fk\.angles\[2\] = 'x' is not allowed: a number"),
        ("raft_ode", {"prm": {"a": 0}}, r"raft_ode\.prm\.a = 0 is not allowed: greater than 0 m"),
        ("leg_ik", {"q": [2, 0, 0]}, r"the foot must be in reach"),
    ],
)
def test_bad_input_is_one_line(name, inputs, message):
    with pytest.raises(InputError, match=message) as error:
        evaluate(name, inputs)
    assert "\n" not in str(error.value)


def test_formulas_are_found_by_equation():
    assert [formula.name for formula in find_by_equation("3.1.20")] == ["max_ball"]
    assert "thesis_fk" in [formula.name for formula in find_by_equation("14")]
    assert find_by_equation("9.9.9") == []


@pytest.mark.parametrize(("share", "grows"), [(0.95, False), (1.05, True)])
def test_a_drive_swings_by_itself_where_its_feedback_is_later_than_told(share, grows):
    inertia, stiffness, damping, back_emf, step = 0.12, 4.5e4, 514.26, 10.0, 1e-6
    drive = {"J": inertia, "stiffness": stiffness, "damping": damping, "c_e": back_emf}
    late = round(share * evaluate("servo_delay", drive)["delay"] / step)
    angle, rate = np.zeros((2, 50_000))
    angle[: late + 1] = 1e-3
    for k in range(late, len(angle) - 1):
        torque = -stiffness * angle[k - late] - damping * rate[k - late] - back_emf * rate[k]
        rate[k + 1] = rate[k] + step * torque / inertia
        angle[k + 1] = angle[k] + step * rate[k + 1]
    half = len(angle) // 2
    assert (np.abs(rate[half:]).max() > np.abs(rate[half // 2 : half]).max()) == grows
