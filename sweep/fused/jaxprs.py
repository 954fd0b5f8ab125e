"""Access to the jaxprs inside JAX operations: bodies of loops, branches and calls."""

from collections.abc import Sequence
from typing import Any, NamedTuple


class ScanOperands[T](NamedTuple):
    """Operands of `lax.scan`, separated into constants, carry and scanned inputs."""

    consts: Sequence[T]  # the same at every step
    carry: Sequence[T]  # changed by every step
    xs: Sequence[T]  # arrays of which each step takes a row


def split_scan_operands[T](eqn: Any, operands: Sequence[T]) -> ScanOperands[T]:
    """Split a list of a scan's operands by role: constants, carry and scanned inputs.

    Args:
        eqn: The traced scan.
        operands: Something for each of its operands, or of the inputs of its body, which have the same order.
    """
    body = open_jaxpr(eqn.params["jaxpr"])
    rows = sum(x.aval.ndim != y.aval.ndim for x, y in zip(eqn.invars, body.invars, strict=True))
    carried = count_carry_results(eqn)
    consts = len(eqn.invars) - carried - rows
    return ScanOperands(operands[:consts], operands[consts : consts + carried], operands[consts + carried :])


def count_carry_results(eqn: Any) -> int:
    """Return how many results of a scan are carried; the others are stacked, and have one axis less in its body."""
    body = open_jaxpr(eqn.params["jaxpr"])
    stacked = sum(x.aval.ndim != y.aval.ndim for x, y in zip(eqn.outvars, body.outvars, strict=True))
    return len(eqn.outvars) - stacked


def open_jaxpr(program: Any) -> Any:
    """Return the jaxpr of a closed jaxpr, without the values of its constants."""
    return getattr(program, "jaxpr", program)


def inner_jaxprs(eqn: Any) -> list[Any]:
    """Return all jaxprs among the parameters of an operation: of a call, a loop, or branches."""
    programs = [*eqn.params.values(), *eqn.params.get("branches", ())]
    return [open_jaxpr(one) for one in programs if hasattr(one, "eqns") or hasattr(one, "jaxpr")]
