"""Writes the reference pages, docs/reference, from the code.

python docs/reference_pages.py
"""

import argparse
import dataclasses
import inspect
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import sweep
from sweep import api, metrics
from sweep.cli import commands, exits
from sweep.config import reference
from sweep.core import conditions, shared_metrics
from sweep.core.groups import GROUPS
from sweep.core.metric import Cause, Metric, merge_columns
from sweep.core.outcomes import GOAL_MISSED
from sweep.core.parameters import UNIT_BY_SUFFIX, format_unit
from sweep.formulas import FORMULAS
from sweep.replay import replay
from sweep.report import crate, replays
from sweep.runs import manifest, store
from sweep.study import columns, design_kinds, designs, distributions
from sweep.study.analytic_limits import LIMIT_KEYS as THEORY_KEYS
from sweep.study.design_kinds.base import GRIDS, Design
from sweep.study.study import RateExpectation, StudySchema
from sweep.systems.mujoco_model import (
    disturbances,
    fields,
    motors,
    onnx_operators,
    payloads,
    policy_spec,
    terrain_heights,
    tracking,
)
from sweep.systems.mujoco_model import metrics as own_metrics

FOLDER = Path(__file__).parent / "reference"
NOTE = "<!-- written by `python docs/reference_pages.py` -->"
WHEN = {"start": "before the first tick", "tick": "in the tick that crosses it", "end": "at the end"}
EXITS = {  # what a reader of an exit code needs besides its meaning
    exits.DONE: "",
    exits.BAD_INPUT: "One line names the key, its value and what is allowed. Nothing was simulated.",
    exits.INVALID: "The share of invalid rows is above `study.invalid_max`. The rows are stored.",
    exits.UNEXPECTED: "`expect` does not hold, or `compare`, `reproduce` or `verify` found too many differences.",
    exits.FAULT: "Finished batches stay on disk; the same command computes the rest.",
    exits.INTERRUPTED: "By Ctrl-C. Finished batches stay on disk; the same command computes the rest.",
}
STABLE, OPEN = "stable", "may change"


def pages() -> dict[str, str]:
    """Return the text of each page by its file name."""
    return {
        "parameters.md": reference.parameters_page().replace("\n\n", f"\n\n{NOTE}\n\n", 1),
        "columns.md": columns_page(),
        "causes.md": causes_page(),
        "cli.md": cli_page(),
        "exit_codes.md": exit_codes_page(),
        "study_file.md": study_file_page(),
        "policy_file.md": policy_file_page(),
        "python.md": python_page(),
        "formulas.md": formulas_page(),
        "model_paths.md": model_paths_page(),
        "formats.md": formats_page(),
    }


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format rows as a Markdown table; bars within cells are escaped."""
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    lines += ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def join_parts(*parts: str) -> str:
    """Join the title of a page, the note and the other parts with blank lines."""
    title, *rest = parts
    return "\n\n".join([title, NOTE, *(part for part in rest if part)]) + "\n"


def code(text: object) -> str:
    """Format a name as code; nothing stays nothing."""
    return f"`{text}`" if str(text) else ""


def unit_of(column: str) -> str:
    """Return the unit that the end of a column's name says, such as `m` of `slip_max_m`."""
    suffix = column.rpartition("_")[2]
    return {"ns": "N·s"}.get(suffix, format_unit(UNIT_BY_SUFFIX.get(suffix, "-")))


def fields_table(cls: Any, head: str) -> str:
    """Return the fields of a dataclass with the comments beside them as a table."""
    said = reference.member_comments(cls)
    return table((head, "meaning"), ((code(field.name), said[field.name]) for field in dataclasses.fields(cls)))


def columns_page() -> str:
    """Every column of a row with its unit and meaning."""

    def of(meanings: Mapping[str, str]) -> str:
        return table(
            ("column", "unit", "meaning"), ((code(name), unit_of(name), text) for name, text in meanings.items())
        )

    def by_module(found: Mapping[str, Metric[Any]], known: Collection[str]) -> Iterator[str]:
        for name, metric in found.items():
            if new := {column: text for column, text in metric.columns.items() if column not in known}:
                yield from (f"### {name.replace('_', ' ')}", of(new))

    shared = merge_columns(shared_metrics.METRICS.values())
    left_out = [column for name in metrics.OMITTED_SHARED_METRICS for column in shared_metrics.METRICS[name].columns]
    labels = {name: columns.COLUMN_MEANINGS[name] for name in columns.LABEL_COLUMNS}
    places = {name: columns.COLUMN_MEANINGS[name] for name in (*columns.PLACEMENT_COLUMNS, *columns.TIMING_COLUMNS)}
    return join_parts(
        "# Columns of a row",
        "A row is one rollout. `sweep describe COLUMN` prints one entry of this page. The end of a name is the unit.",
        "## Axes",
        "A column with a dot in its name is a parameter that varies: `contact.friction` in the simulated "
        "world and in the "
        "planner's belief, `world.contact.friction` in the world alone, `belief.contact.friction` in the belief alone. "
        "`axis.NAME` is the number of an axis that has no parameter of its own. [Parameters](parameters.md) "
        "has units and "
        "meanings.",
        "## Labels",
        of(labels),
        "## Place in the study",
        of(places),
        "## Metrics of every system",
        "The built-in robot has all of them, but for "
        f"{', '.join(map(code, left_out))}. A model of your own has those whose parts it has: a free "
        "joint (its first one is the base), hinge joints, drives of hinge joints, and touch sensors that `model.feet` "
        "lists.",
        *by_module(shared_metrics.METRICS, ()),
        "## Metrics of the built-in robot",
        "A scenario has the metrics that apply to its manoeuvre and obstacle.",
        *by_module(metrics.HEXAPOD_METRICS, shared),
        "### When causes occurred",
        "Each [cause](causes.md) that is known during a rollout has a column `CAUSE_time_s`, the time at "
        "which it first held "
        "(infinite if never), and a column `CAUSE_stage`, the number of the stage.",
        "## Metrics of a model of your own",
        "A controller adds columns by `FIGURES`.",
        of(merge_columns(own_metrics.MODEL_METRICS.values()) | tracking.COLUMNS),
    )


def causes_page() -> str:
    """Every cause with its threshold, its default and what it means."""

    def row(cause: Cause) -> tuple[str, ...]:
        default = (
            "the manoeuvre's goal" if cause.default is None else f"{cause.default:g} {unit_of(cause.metric)}".strip()
        )
        sign = "below" if cause.below else "above"
        limit = code(f"outcome.{cause.threshold}") if cause.threshold else ""
        return (
            code(cause.name), limit, default if cause.threshold else "", f"{code(cause.metric)} {sign} it"
            if cause.threshold else "", WHEN[cause.known_at], cause.sentence,
        )  # fmt: skip

    heads = ("cause", "threshold", "default", "holds for", "known", "meaning")
    return join_parts(
        "# Causes and thresholds",
        "A rollout is a `success` if no cause holds. The cause that occurred first is the row's `cause`. If "
        "several causes "
        "occur in the same tick, those of `invalid` take precedence. Causes that are known only at the end come last. "
        "`sweep relabel` applies other thresholds to stored rows.",
        "## Causes of `invalid`",
        "The simulation cannot vouch for such a rollout. It counts neither as success nor as failure.",
        table(heads, (row(cause) for cause in metrics.CAUSES if cause.invalid)),
        "## Causes of `failure`",
        "A threshold whose default is the manoeuvre's goal is judged only for manoeuvres that set it.",
        table(heads, (row(cause) for cause in metrics.CAUSES if not cause.invalid)),
        "## Causes of a model of your own",
        f"Conditions under `outcome:` of the scenario name the causes of failure. `{conditions.GOAL}` must "
        "hold at the end; "
        f"if it does not, the cause is `{GOAL_MISSED}`. A row for which the condition `invalid` holds "
        "has the cause "
        f"`{conditions.UNTRUSTED}`. Two causes of `invalid` are always there:",
        table(("cause", "meaning"), ((code(cause.name), cause.sentence) for cause in own_metrics.CAUSES)),
    )


def cli_page() -> str:
    """Every subcommand with its arguments."""
    parts = []
    for name in commands.shipped_command_names():
        parser, text = commands.make_parser(name), commands.load_command(name).COMMAND.help
        parts += [
            f"## sweep {name}",
            f"{text[0].upper()}{text[1:]}.",
            usage(name, parser),
            arguments(parser),
            epilog(parser),
        ]
    return join_parts(
        "# Command line",
        "`sweep COMMAND --help` prints one section of this page. [Exit codes](exit_codes.md) are the same "
        "for all commands.",
        *parts,
    )


def usage(name: str, parser: argparse.ArgumentParser) -> str:
    """Return the usage of a command as a block of code."""
    if parser.usage:
        return f"    {parser.usage}"
    words = []
    for action in shown_actions(parser):
        word = metavar(action)
        if not action.option_strings:
            words.append(f"[{word} ...]" if action.nargs == "*" else f"[{word}]" if action.nargs == "?" else
                         f"{word} ..." if action.nargs == "+" else word)  # fmt: skip
    return f"    sweep {' '.join([name, *words])}{' [options]' if has_options(parser) else ''}"


def has_options(parser: argparse.ArgumentParser) -> bool:
    """Whether a command has options of its own."""
    return any(action.option_strings for action in shown_actions(parser))


def shown_actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments that the help shows, but help and version."""
    for action in parser._actions:
        if action.help != argparse.SUPPRESS and not isinstance(action, argparse._HelpAction | argparse._VersionAction):
            yield action


def metavar(action: argparse.Action) -> str:
    """Return what stands for the value of an argument."""
    if action.metavar:
        return action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar)
    if action.choices:
        return "{" + ",".join(map(str, action.choices)) + "}"
    return action.dest.upper()


def arguments(parser: argparse.ArgumentParser) -> str:
    """Return the arguments of a command as a table."""
    rows = []
    for action in shown_actions(parser):
        flags = ", ".join(action.option_strings)
        name = f"{flags} {metavar(action)}".strip() if action.nargs != 0 else flags
        rows.append((code(name), (action.help or "").replace("%%", "%")))
    return table(("argument", "meaning"), rows) if rows else ""


def epilog(parser: argparse.ArgumentParser) -> str:
    """Return what the help says at its end as a block of code."""
    return "\n".join(f"    {line}".rstrip() for line in (parser.epilog or "").splitlines())


def exit_codes_page() -> str:
    """Exit codes with their meanings."""
    rows = ((number, text, EXITS[number]) for number, text in exits.MEANINGS.items())
    return join_parts("# Exit codes", "All commands use the same codes.", table(("code", "meaning", "details"), rows))


def design_settings() -> str:
    """Return the keys of `study.design`, those of single kinds included, as a table."""
    said = reference.member_comments(Design)
    counts = [f"of {kind} {cls.num_meaning}" for kind, cls in design_kinds.DESIGN_BY_KIND.items() if cls.num_meaning]
    said["num"] = f"{said['num']}; {', '.join(counts)}"
    for cls in design_kinds.DESIGN_BY_KIND.values():
        own = reference.member_comments(cls)
        said |= {name: own[name] for name in design_kinds.kind_specific_settings(cls)}
    owners = design_kinds.kinds_by_setting().items()
    said |= {name: f"of {' and '.join(kinds)}: {said[name]}" for name, kinds in owners}
    members = [one for one in dataclasses.fields(design_kinds.make_schema()) if one.name != "correlation"]
    return table(("key", "default", "meaning"), ((code(f.name), code(f.default), said[f.name]) for f in members))


def policy_file_page() -> str:
    """Keys of a specification of a learned policy."""

    def keys(cls: type) -> str:
        said = reference.member_comments(cls)
        rows = ((code(f.name), said[f.name]) for f in dataclasses.fields(cls))
        return table(("key", "meaning"), rows)

    aliases = policy_spec.TERM_ALIASES.items()
    terms = ((code(name), format_unit(unit), ", ".join(code(k) for k, v in aliases if v == name))
             for name, unit in policy_spec.TERM_UNITS.items())  # fmt: skip
    presets = ((code(name), ", ".join(one if isinstance(one, str) else one["term"] for one in about["observation"]))
               for name, about in policy_spec.PRESETS.items())  # fmt: skip
    return join_parts(
        "# Policy file",
        "`walk.policy.yaml` beside `walk.onnx`, `walk.pt` or `walk.pt2` says how a learned policy was trained. "
        "[Run a learned policy](../howto/run_a_learned_policy.md) shows how to write one. A key of the file wins over "
        "the network's metadata, and these over the preset.",
        "## Keys",
        keys(policy_spec.PolicySpec),
        "## `observation[]`",
        "A term is its name, or a mapping with these keys. Errors of measurement come first, then `clip`, then "
        "`scale`, then earlier ticks.",
        keys(policy_spec.ObservationTermSpec),
        table(("term", "unit", "also called"), terms),
        "`base_*` and `projected_gravity` are those of the first free joint's body, in its axes. With the key `sensor` "
        "a term is read from a sensor instead, such as a height scan from rangefinders.",
        "## `action`",
        "The command of a joint is `offset + scale * clip(output)`.",
        keys(policy_spec.ActionSpec),
        "## `recurrent[]`",
        keys(policy_spec.RecurrentSpec),
        "## Presets",
        "All have the commands `velocity_x`, `velocity_y`, `yaw_rate` and an action scale of 0.5.",
        table(("preset", "terms in order"), presets),
        "## Metadata of the network",
        "`joint_names`, `default_joint_pos`, `joint_stiffness`, `joint_damping`, `action_scale`, `observation_names` "
        "and `observation_history_lengths` are read, as exporters of mjlab and whole_body_tracking write them: words "
        "or numbers with commas between.",
        "## Operators of the network",
        ", ".join(map(code, sorted([*onnx_operators.OPERATORS, "Constant"]))) + ".",
    )


def study_file_page() -> str:
    """Keys of a study file."""

    def keys(cls: type) -> str:
        said = reference.member_comments(cls)
        plain = [f for f in dataclasses.fields(cls) if isinstance(f.default, str | int | float | None)]
        rows = ((code(f.name), code("null" if f.default is None else f.default), said[f.name]) for f in plain)
        return table(("key", "default", "meaning"), rows)

    def named(meanings: dict[str, str]) -> str:
        return table(("key", "meaning"), ((code(name), text) for name, text in meanings.items()))

    groups = ", ".join(code(name) for name in GROUPS if name not in ("study", "scenario"))
    kinds = ((code(kind), ", ".join(map(code, need)), ", ".join(map(code, more)) or "nothing")
             for kind, (need, more) in distributions.DISTRIBUTIONS.items())  # fmt: skip
    return join_parts(
        "# Study file",
        "A study is a YAML file: `sweep run study=NAME` for a file of the project's `studies/` or a shipped one, "
        "`sweep run study=path/to/file.yaml` for any other. [Studies](../studies.md) explains how to choose "
        "axes and designs.",
        "## Top level",
        named(
            {
                "extends": "another study, of which this file changes what it names: a name, or a path from this file",
                "scenario": "name of the scenario that is varied",
                "study": "what is varied, see below",
            }
        ),
        f"A group of the configuration ({groups}) takes the name of a choice, or parameters, or both: "
        "`robot: {extends: base, shin: 0.36}`. [Parameters](parameters.md) lists them.",
        "## `study`",
        keys(StudySchema),
        "Further keys are described below: "
        + ", ".join(map(code, ("axes", "design", "expect", "theory", "keep")))
        + ".",
        "## `study.axes.NAME`",
        named(designs.AXIS_KEYS),
        "### `distribution`",
        table(("kind", "needs", "may have"), kinds),
        "Every other `kind` is a continuous distribution of scipy.stats by its name there, with its shapes, `loc` and "
        "`scale`. `from` and `to` truncate it.",
        "## `study.design`",
        f"Grids: {', '.join(map(code, GRIDS))}. Kinds:",
        table(("kind", "use it for"), ((code(kind), cls.meaning) for kind, cls in design_kinds.DESIGN_BY_KIND.items())),
        design_settings(),
        "`correlation` is a list of `[axis, axis, coefficient]`: pairs of drawn axes, correlated by a Gaussian copula.",
        "## `study.expect`",
        "A list; exit code 4 says that an entry does not hold. Among the valid rows that match `where`, the "
        "share of those "
        "that match `that` lies within the limits.",
        keys(RateExpectation),
        "## `study.theory`",
        "A list of closed-form limits that maps show as dashed lines.",
        named(
            dict(
                zip(
                    THEORY_KEYS,
                    (
                        "name in the legend; that of the formula unless given",
                        "name of the formula, see `sweep formula`",
                        "which of its outputs is the limit",
                        "path of the parameter that the limit is of",
                        "its inputs: numbers, or expressions of parameters",
                        "column to show beside",
                    ),
                    strict=True,
                )
            )
        ),
        "## `study.keep`",
        "A list of columns over time that are stored for the first `keep_rows` rollouts. An unknown name "
        "prints those that "
        "the system has.",
    )


def python_page() -> str:
    """Public names of the package with signatures and docstrings."""
    objects = [("sweep.run", sweep.run), ("sweep.load", sweep.load)]
    accessor = [
        (f"rows.sweep.{name}", member) for name, member in vars(api.RowsAccessor).items() if not name.startswith("_")
    ]
    errors = [("sweep.InputError", sweep.InputError), ("sweep.Fault", sweep.Fault)]
    return join_parts(
        "# Python API",
        "Names of this page are stable. All other modules may change without notice.",
        "## Functions",
        *(part for name, thing in objects for part in entry(name, thing)),
        "## `rows.sweep`",
        docstring(api.RowsAccessor),
        *(part for name, thing in accessor for part in entry(name, thing)),
        "## `Replay`",
        "What `rows.sweep.replay` returns:",
        fields_table(replay.Replay, "member"),
        "## Errors",
        *(part for name, thing in errors for part in (f"### `{name}`", docstring(thing))),
        "## What a controller defines",
        "A module with the controller of your own model may define `PARAMETERS`, `BELIEVES`, `FIGURES`, "
        "`FILES`, `begin`, "
        "`policy`, `observe`, `measure` and `figures`: see [a model of your own](../howto/write_a_policy.md).",
    )


def entry(name: str, thing: Any) -> tuple[str, str, str]:
    """Return heading, signature and docstring of a function."""
    signature = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(inspect.signature(thing)))
    signature = re.sub(r"\(self(, )?", "(", signature).replace("pandas.DataFrame", "pd.DataFrame")
    return f"### `{name}`", f"    {name}{signature}", docstring(thing)


def docstring(thing: Any) -> str:
    """Return a docstring as Markdown: sections such as `Args:` become lists."""
    found = []
    for line in inspect.cleandoc(thing.__doc__ or "").splitlines():
        if re.fullmatch(r"(Args|Returns|Raises|Yields):", line):
            found += [f"**{line.removesuffix(':')}**", ""]
        elif item := re.fullmatch(r"    (\w+): (.*)", line):
            found.append(f"- `{item[1]}`: {item[2]}")
        else:
            found.append(line.strip())
    return "\n".join(found)


def formulas_page() -> str:
    """Every formula with its inputs, outputs, source and the errors of the printed text."""
    rows = (
        (
            code(formula.name),
            formula.summary,
            ", ".join(f"{code(one.name)} {one.unit}".rstrip() for one in formula.inputs),
            ", ".join(f"{code(name)} {unit}".rstrip() for name, unit in formula.outputs.items()),
            formula.reference,
        )
        for formula in FORMULAS.values()
    )
    corrections = ((code(formula.name), formula.correction) for formula in FORMULAS.values() if formula.correction)
    return join_parts(
        "# Formulas",
        "`sweep formula NAME` evaluates a formula and prints the domain and default of each input. [Formulas of the "
        "sources](../formulas.md) shows how to use them.",
        table(("formula", "gives", "inputs", "outputs", "source"), rows),
        "## Corrections of the printed text",
        "The code differs from the sources where these have errors. All other formulas are as printed.",
        table(("formula", "error of the printed text, or difference from it"), corrections),
    )


def numbers_table(module: ModuleType, numbers: Mapping[str, Any]) -> str:
    """Return the parameters of a mapping of a module as a table, with the comments beside them in its source.

    Args:
        module: The module in which the mapping is written, a line for each parameter.
        numbers: Parameters by name.
    """
    source = inspect.getsource(module)
    rows = []
    for name, number in numbers.items():
        said = re.search(rf'^    "{name}": [^#\n]*#? ?(.*)$', source, re.MULTILINE)
        unit = format_unit(number.metadata["unit"])
        rows.append((code(name), unit, f"{number.default:g}", said[1] if said else ""))
    return table(("number", "unit", "default", "meaning"), rows)


def model_paths_page() -> str:
    """Numbers of a MuJoCo model that can be axes, and why the others cannot."""
    sizes = list(dict.fromkeys(name for names in fields.SIZE_MEANINGS.values() for name in names))
    extra = {"actuator": ("kp", "kv", fields.STRENGTH)}
    rows = []
    for kind, varied in [*fields.VARIABLE_NUMBERS.items(), (fields.OPTION_KIND, fields.OPTION_NUMBERS)]:
        for name, number in varied.items():
            names = sizes if (kind, name) == ("geom", "size") else number.component_names
            rows.append((code(kind), code(name), ", ".join(code(f".{one}") for one in names), format_unit(number.unit)))
        rows += [(code(kind), code(name), "", "") for name in extra.get(kind, ())]
    settings = ", ".join(map(code, fields.SETTING_NUMBERS))
    return join_parts(
        "# Paths of a MuJoCo model",
        "`model.KIND.NAME.FIELD` is a number of the compiled model, and can be an axis of a study. A field of several "
        "numbers needs a component, such as `model.geom.floor.friction.slide`. Components without a name have numbers "
        "from 0. Units that depend on the element, such as those of a joint's range, are left out. "
        "[Models of your own](../own_model_reference.md#paths) explains groups and derived quantities.",
        table(("kind", "field", "components", "unit"), rows),
        "`kp` and `kv` are of a position servo. `strength` is a factor of the forces of an actuator, limits included. "
        f"`model.option` also has settings of the simulation: {settings}.",
        "## Fields that cannot vary",
        table(("field", "reason"), ((", ".join(map(code, names.split())), why) for names, why in fields.FIXED.items())),
        "Addresses, types, groups and flags, which are whole numbers, make another model.",
        "## `model.terrain`",
        "[Vary the terrain](../howto/vary_the_terrain.md) says which kind of terrain uses which number.",
        numbers_table(terrain_heights, terrain_heights.NUMBERS),
        "## `push.NAME`",
        numbers_table(disturbances, disturbances.PUSH_PARAMETERS),
        "`push.NAME.body`, the pushed body, can be an axis, too.",
        "## `payload.NAME`",
        numbers_table(payloads, payloads.PAYLOAD),
        "## `motor.NAME`",
        numbers_table(motors, motors.MOTOR),
    )


def formats_page() -> str:
    """Files that the package writes and reads."""
    folder, json_, parquet = f"format {store.FOLDER_FORMAT} of the folder", "JSON", "Parquet"
    run, places = "`sweep run`", "see [columns](columns.md)"
    rows = [
        ("`study.yaml`", run, f"YAML, {folder}", STABLE, "configuration, code, versions, devices; its own digest"),
        (f"`{manifest.POINTS_FILE}`", run, parquet, STABLE, f"the plan: a row for each rollout, {places}"),
        (f"`{manifest.PARTS_FOLDER}/part-*.parquet`", run, parquet, STABLE, f"finished rows, {places}"),
        (f"`{manifest.HISTORIES_FOLDER}/*.parquet`", run, parquet, STABLE, "columns of `study.keep` over time"),
        (f"`{manifest.LAST_STATES_FOLDER}/*.parquet`", run, parquet, OPEN, "last second of the first ten invalid rows"),
        (f"`{manifest.MANIFEST_FILE}`", run, f"text, {folder}", STABLE, "a line for each file that counts, see below"),
        (f"`{store.LOG_FILE}`, `{store.LOCK_FILE}`", run, "text", OPEN, "progress; the lock of the running command"),
        (f"`{replays.REPLAYS_FOLDER}/*.json`", "`sweep report --replays`", json_, OPEN, "replays of the page"),
        ("`report.html`, `map.*`, `draws.*`", "`sweep report`", "HTML, PNG, SVG", OPEN, "the page and its pictures"),
        ("`numbers.tex`, `data/`", "`sweep export --paper`", "LaTeX, CSV", STABLE, "macros and data of a paper"),
        ("`main.tex`, `tables/`, `figures/`", "`sweep export --paper`", "LaTeX, PDF", OPEN, "text and pictures"),
        (
            "crate",
            "`sweep export --crate`",
            f"RO-Crate 1.1, {crate.CRATE_PROFILE}",
            STABLE,
            "all of a study for archives",
        ),
        ("`certificate.json`", "`sweep certify`", json_, STABLE, "region, guarantee and assumptions"),
        ("pairs", "`sweep compare -o`", "CSV", STABLE, "pairs of rows that differ"),
        ("trace", "`sweep replay --mcap`", "MCAP, schemas of Foxglove", OPEN, "robot, forces, joints, stages"),
        ("states", "`sweep replay --states`", parquet, STABLE, "states, torques and forces by control tick"),
        ("points", "read by `sweep run --points`", "CSV", STABLE, "a column for each parameter path"),
        ("configuration", "written by hand", "YAML", STABLE, "[study](study_file.md), [parameters](parameters.md)"),
    ]
    return join_parts(
        "# File formats",
        f"Version {sweep.__version__} of the package writes and reads format {store.FOLDER_FORMAT} of a study's "
        "folder. A folder of "
        "another format is refused in one line that names its version. A `stable` format changes only with "
        "the version of "
        "the package, and the changelog says how to migrate. [Results](../../results/README.md) describes the folder.",
        table(("file", "written by", "format", "stability", "content"), rows),
        "## A line of the manifest",
        "Sixteen digits of the line's own digest, a space, and JSON:",
        fields_table(manifest.ManifestEntry, "key"),
    )


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(FOLDER / name)
