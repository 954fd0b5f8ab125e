"""Analysis of which inputs of a JAX function can change its outputs, from its trace, without compiling or computing."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Jaxpr, Literal

from sweep.fused.jaxprs import ScanOperands, count_carry_results, inner_jaxprs, open_jaxpr, split_scan_operands

UsedFlags = list[bool]


def find_used_inputs(function: Callable[..., Any], *args: Any) -> Any:
    """Find out which leaves of the arguments can change a result of `function`.

    An input counts as used unless the trace excludes it, so an unused one changes no bit of any result. Arrays without
    elements pass nothing on.

    Args:
        function: any that JAX can trace.
        *args: its arguments, as arrays or numbers.

    Returns:
        A tuple like `args`, with a flag for each leaf.
    """
    traced = jax.make_jaxpr(function)(*args)
    used = _used_of_jaxpr(traced.jaxpr, [True] * len(traced.jaxpr.outvars))
    return jax.tree.unflatten(jax.tree.structure(args), used)


def find_inactive_parameters(
    outputs: Callable[[Any, Any, jax.Array], Any],
    sides: Callable[[Mapping[str, Any]], tuple[Any, Any]],
    ends: Mapping[str, tuple[float, float]],
) -> set[str]:
    """Find the parameters, by column, that cannot change any result of a rollout's program.

    Args:
        outputs: from world, belief and a random key to all that metrics are made of.
        sides: world and belief with values of parameters, by column.
        ends: lowest and highest value of each parameter, by column.
    """
    values = {column: jnp.asarray(low, float) for column, (low, _) in ends.items()}
    used, _ = find_used_inputs(lambda values, key: outputs(*sides(values), key), values, jax.random.key(0))
    return {column for column, is_used in used.items() if not is_used}


def _used_of_jaxpr(jaxpr: Jaxpr, results: Sequence[bool]) -> UsedFlags:
    """Inputs of a program that its used `results` depend on."""
    used = {v for v, is_used in zip(jaxpr.outvars, results, strict=True) if is_used and _carries_numbers(v)}
    for equation in reversed(jaxpr.eqns):
        wanted = [v in used for v in equation.outvars]
        if any(wanted):
            needed = _used_of_equation(equation, wanted)
            used |= {v for v, is_used in zip(equation.invars, needed, strict=True) if is_used and _carries_numbers(v)}
    return [v in used for v in jaxpr.invars]


def _carries_numbers(variable: Any) -> bool:
    return not isinstance(variable, Literal) and getattr(variable.aval, "size", 1) > 0


def _used_of_equation(equation: Any, wanted: UsedFlags) -> UsedFlags:
    """Inputs of one operation that its `wanted` results depend on; all of them where it has no rule here."""
    match equation.primitive.name:
        case "scan":
            return _used_of_scan(equation, wanted)
        case "while":
            return _used_of_while(equation, wanted)
        case "cond":
            each = [_used_of_jaxpr(branch, wanted) for branch in inner_jaxprs(equation)]
            return [True, *map(any, zip(*each, strict=True))]
        case _:
            inner = inner_jaxprs(equation)
            shape = len(equation.invars), len(equation.outvars)
            if len(inner) == 1 and (len(inner[0].invars), len(inner[0].outvars)) == shape:  # a call
                return _used_of_jaxpr(inner[0], wanted)
            return [True] * len(equation.invars)


def _used_of_scan(equation: Any, wanted: UsedFlags) -> UsedFlags:
    """Inputs of a scan: a carried number counts where a later turn or the result makes use of it."""
    body, carried = open_jaxpr(equation.params["jaxpr"]), count_carry_results(equation)

    def used(carry: UsedFlags) -> ScanOperands[bool]:
        return split_scan_operands(equation, _used_of_jaxpr(body, [*carry, *wanted[carried:]]))

    carry = _used_of_carry(wanted[:carried], lambda carry: used(carry).carry)
    last = used(carry)
    return [*last.consts, *carry, *last.xs]


def _used_of_while(equation: Any, wanted: UsedFlags) -> UsedFlags:
    """Inputs of a loop: what its condition looks at counts, too."""
    test, body = (open_jaxpr(equation.params[name]) for name in ("cond_jaxpr", "body_jaxpr"))
    of_test, of_body = equation.params["cond_nconsts"], equation.params["body_nconsts"]
    asked = _used_of_jaxpr(test, [True])
    carry = [a or b for a, b in zip(wanted, asked[of_test:], strict=True)]
    carry = _used_of_carry(carry, lambda carry: _used_of_jaxpr(body, carry)[of_body:])
    return [*asked[:of_test], *_used_of_jaxpr(body, carry)[:of_body], *carry]


def _used_of_carry(carry: UsedFlags, used_by_turn: Callable[[UsedFlags], Sequence[bool]]) -> UsedFlags:
    """What a loop carries that any of its turns makes use of, from what is used after the last turn."""
    while (more := [a or b for a, b in zip(carry, used_by_turn(carry), strict=True)]) != carry:
        carry = more
    return carry
