"""`sweep policy check`: what a policy observes and commands in its first tick, number by number."""

import argparse
from typing import TYPE_CHECKING, cast

from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments, is_positional
from sweep.core.errors import InputError

NUMBERS_PER_ROW = 12  # of a long term, so that rows fit on a screen

if TYPE_CHECKING:
    import numpy as np

    from sweep.systems.mujoco_model.engine import ModelEngine

COMMAND = Command(
    Section.LOOK_UP, "print the first observation of a policy, term by term, and its action", "sweep policy check own"
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep policy`: the scenario that selects the policy to check, and overrides."""
    parser.others = is_positional
    parser.add_argument("what", choices=["check"], help="evaluate the policy once, at the nominal start")
    parser.add_argument("scenario", help="scenario of the project, whose model has the policy")


def run(args: argparse.Namespace) -> int:
    """Print the first observation and action of a policy. Raises `InputError`."""
    from tabulate import tabulate

    from sweep.config.experiment import compose

    exp = compose([f"scenario={args.scenario}", *args.overrides])
    if why := exp.system.unsupported_commands.get("policy"):
        raise InputError(f"policy is not allowed: {why}")
    engine = exp.system.make_engine(exp.settings, exp.system.case, exp.system.case, None)
    found = cast("ModelEngine", engine).evaluate_first_tick()
    summary = exp.system.settings_summary(exp.settings)
    print(f"{summary['controller']} on {summary['model']}, a call every {1000 * exp.settings.control_period:g} ms")
    for name, terms in found.inputs.items():
        print(f"\n{name}: {sum(len(numbers) for _, _, numbers in terms)} numbers in this tick\n")
        rows = [row for term in terms for row in split_term_into_rows(*term)]
        print(tabulate(rows, headers=("term", "unit", "numbers"), tablefmt="github", disable_numparse=True))
    commands: list[tuple[str, ...]]
    if found.is_learned:
        headers, order = ("joint", "network", "command", "unit"), "joints, in the order of the network"
        commands = [(name, f"{output:.4g}", f"{one:.4g}", unit) for name, output, one, unit in found.commands]
    else:
        headers, order = ("actuator", "command"), "commands"
        commands = [(name, f"{one:.4g}") for name, _, one, _ in found.commands]
    print(f"\naction: {len(commands)} {order}\n")
    print(tabulate(commands, headers=headers, tablefmt="github", disable_numparse=True))
    return DONE


def split_term_into_rows(term: str, unit: str, numbers: "np.ndarray") -> list[tuple[str, str, str]]:
    """Return the rows of a table for an observation term; rows of a long term have a slice such as `[0:12]`.

    Args:
        term: Name of the term.
        unit: Its unit.
        numbers: Its numbers (k,).

    Returns:
        Name, unit and numbers of each row.
    """
    words = [f"{one:.4g}" for one in numbers]
    if len(words) <= NUMBERS_PER_ROW:
        return [(term, unit, " ".join(words))]
    parts = [(start, words[start : start + NUMBERS_PER_ROW]) for start in range(0, len(words), NUMBERS_PER_ROW)]
    return [(f"{term}[{start}:{start + len(part)}]", unit, " ".join(part)) for start, part in parts]
