"""Makes what research/ shows: runs the studies of jobs/paper.yaml and jobs/robustness.yaml, draws pictures, writes
research/data/NAME.json of each.

    python jobs/paper.py [NAME ...] [--quick] [--jobs 1] [--studies] [--out results/paper]

A study's folder finishes what is missing in it and refuses rows of other code, so each code has folders of its own
below OUT: whatever is interrupted goes on, and rows are taken as they are where their code is this one. That is why no
workflow engine is used, which would ask files for their dates instead. What changed beyond its interval is written
with the data that it is about, and told at the end. Coarser studies go into a copy of research/,
OUT/quick/research. Of the N that are made at the same time each has one GPU.
"""

import argparse
import fnmatch
import json
import multiprocessing
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from functools import partial
from hashlib import sha256
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from sweep.analysis import sensitivity
from sweep.analysis.intervals import wilson
from sweep.analysis.stats import bin_values, success_rate, success_rates
from sweep.core.expressions import evaluate_expression, find_column
from sweep.core.files import write_atomically
from sweep.core.outcomes import SUCCESS
from sweep.core.plot_style import plot_style
from sweep.core.provenance import code_version
from sweep.report import maps
from sweep.report.figures import list_figures, metrics_with_threshold_first
from sweep.runs import results
from sweep.runs.results import Results

ROOT = Path(__file__).parents[1]
JOBS, RESEARCH = ROOT / "jobs", ROOT / "research"
ALLOWED = (0, 3, 4)  # exit codes: invalid rows and unmet expectations are results, too
VALUES, PARTS = 20, 5  # most values of an axis that are listed one by one, and equal parts of a longer one
DPI = 110
PAUSE = 60  # s, in which other processes on a GPU may end
COUNTS = ("success", "valid")


def main(argv: list[str] | None = None) -> int:
    """Make the chosen targets, or all; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="targets, such as pole_map or 'ball_*' (all)")
    parser.add_argument("--quick", action="store_true", help="coarser studies, and fewer, for two cores")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="studies made at the same time (1)")
    parser.add_argument("--studies", action="store_true", help="leave out the pictures of single runs")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "paper", help="folder of the studies")
    given = parser.parse_args(argv)
    every = targets()
    unknown = [name for name in given.names if not fnmatch.filter(every, name)]
    if unknown:
        print(f"{unknown[0]} is not a target: {', '.join(every)}", file=sys.stderr)
        return 2
    if given.jobs < 1:
        print(f"--jobs {given.jobs}: allowed are 1 and more", file=sys.stderr)
        return 2
    wanted = given.names or [name for name in every if "alone" not in every[name]]
    chosen = {name: one for name, one in every.items() if any(fnmatch.fnmatch(name, word) for word in wanted)}
    chosen = {name: one for name, one in chosen.items() if "run" in one or not given.studies}
    chosen = {name: one for name, one in chosen.items() if len(one["budget"]) > 1 or not given.quick}
    out, research = given.out / code_version(), copy_research(given.out / "quick") if given.quick else RESEARCH
    for folder in ("data", "figures"):
        (research / folder).mkdir(exist_ok=True)
    changed, failed, start, number = [], [], time.monotonic(), 0
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # else the first process takes the GPU's memory
    context = multiprocessing.get_context("spawn")  # fresh processes: a fork would share what JAX has started
    every_card, own = cards(), context.SimpleQueue()
    for place in range(given.jobs):
        own.put(every_card[place % len(every_card)])
    with ProcessPoolExecutor(given.jobs, context, reserve_gpu, (own,)) as processes:
        for name, lines, fault, seconds in finish_targets(processes, chosen, out, research, given.quick):
            number += 1
            state = "failed" if fault else "made"
            print(f"{number} of {len(chosen)}, {time.monotonic() - start:.0f} s: {name} {state} in {seconds:.0f} s")
            changed += lines
            failed += [f"{name} failed: {fault}"] if fault else []
            sys.stdout.flush()
    for line in [*changed, *failed] or ["nothing changed beyond its interval"]:
        print(line)
    return bool(failed)


def targets() -> dict[str, dict[str, Any]]:
    """Return all targets by name."""
    table, manoeuvres = (yaml.safe_load((JOBS / f"{name}.yaml").read_text("utf-8")) for name in ("paper", "robustness"))
    return table | dict(robustness(manoeuvres))


def robustness(manoeuvres: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield targets with errors of one kind at a time: two studies for each robot of each manoeuvre."""
    for scenario, one in manoeuvres.items():
        for robot, words in one["robots"].items():
            for name, study, few in (("", one["ground"], "design.num"), ("_seen", one["seen"], "replicates")):
                run = [f"study={study}", f"scenario={scenario}", "study.seed=41", *words]
                target = {"run": run, "quick": [f"study.{few}=1"], "picture": False, "budget": one["budget"]}
                yield f"rates_{scenario}_{robot}{name}", target


def copy_research(folder: Path) -> Path:
    """Copy research/ and bench/, whose scripts write to research/, and return the copy of the former."""
    for beside in ("research", "bench"):
        shutil.copytree(ROOT / beside, folder / beside, dirs_exist_ok=True)
    return folder / "research"


def cards() -> list[str]:
    """Return the GPUs of this machine as in CUDA_VISIBLE_DEVICES; one name if there are none."""
    given = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    if given or not shutil.which("nvidia-smi"):
        return given.split(",") if given else ["0"]
    listed = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, check=True).stdout.splitlines()
    return [str(place) for place in range(len(listed))]


def reserve_gpu(own: Any) -> None:
    """Reserve one GPU from a queue for this process."""
    os.environ["CUDA_VISIBLE_DEVICES"] = own.get()


def finish_targets(
    processes: Executor, targets: dict[str, Any], out: Path, research: Path, quick: bool
) -> Iterator[tuple[str, list[str], str, float]]:
    """Yield the results of targets as soon as they are made: longest first, then those drawn from all others."""
    for last in (False, True):
        some = group_targets({name: one for name, one in targets.items() if ("last" in one) == last})
        groups = sorted(some, key=lambda group: -max(one["budget"][quick] for one in group.values()))
        for done in as_completed([processes.submit(make_group, group, out, research, quick) for group in groups]):
            yield from done.result()


def group_targets(targets: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield groups of targets that are made one after the other: those of one study, and each picture by itself."""
    yield from ({name: one} for name, one in targets.items() if "run" not in one)
    studies = sorted(
        (item for item in targets.items() if "run" in item[1]), key=lambda item: study_folder_name(item[1])
    )
    yield from (dict(group) for _, group in groupby(studies, key=lambda item: study_folder_name(item[1])))


def make_group(
    targets: dict[str, Any], out: Path, research: Path, quick: bool
) -> list[tuple[str, list[str], str, float]]:
    """Make targets; return name, changes, reason of failure and seconds of each."""
    told = []
    for name, target in targets.items():
        start, lines, fault = time.monotonic(), [], ""
        try:
            lines = make_target(name, target, out, research, quick)
        except Exception as error:  # whatever it is, the other targets are made
            fault = f"{type(error).__name__}: {error}"
        told.append((name, lines, fault, time.monotonic() - start))
    return told


def make_target(name: str, target: dict[str, Any], out: Path, research: Path, quick: bool) -> list[str]:
    """Make one target in `research`; return what changed by more than its interval since it was last written."""
    folder, changed = out / ("quick" if quick else "full") / study_folder_name(target), []
    if "run" in target:
        command = [*target["run"], *(target.get("quick", []) if quick else [])]
        seconds = simulate(command, folder)
        if "relabel" in target:
            copy = folder.with_name(f"{folder.name}-relabelled")
            shutil.copytree(folder, copy, dirs_exist_ok=True)
            sweep("relabel", str(copy), *target["relabel"])
            folder = copy
        found = results.read_results(folder, target.get("only"))
        if "script" not in target and target.get("picture", True):
            picture(found, target, research / "figures" / f"{name}.png")
        about = {"command": f"sweep run {shlex.join(command)}", "quick": quick and "quick" in target}
        changed = told(research / "data" / f"{name}.json", about | summary(found, target) | {"seconds": round(seconds)})
    if script := target.get("script"):
        words = [f"{word}{folder}" if word.endswith("=") else word for word in script[1:]]
        run(str(research / script[0]), *words)
    return changed


def study_folder_name(target: dict[str, Any]) -> str:
    """Return the name of a target's study folder, which targets of one study share."""
    values = (word.partition("=")[2] for word in target.get("run", ["=none"]))
    name = "-".join(Path(value).stem if value.endswith(".yaml") else value for value in values)
    return name if re.fullmatch(r"[\w.-]{1,100}", name) else sha256(name.encode()).hexdigest()[:16]


def simulate(overrides: list[str], folder: Path) -> float:
    """Run a study, or what is missing of it; return the seconds of all of its batches."""
    start = time.monotonic()
    sweep("run", *overrides, "study.expect=[]", "study.invalid_max=1", f"out={folder}")
    kept = folder / "seconds.json"  # of the command that simulated, not of one that found all there
    spent = json.loads(kept.read_text()) if kept.exists() else 0.0
    if not spent:
        kept.write_text(json.dumps(spent := time.monotonic() - start))
    return spent


def sweep(*words: str) -> None:
    """Run a command in a process of its own, so that each has a device to itself."""
    run("-m", "sweep.cli", *words, allowed=ALLOWED)


def run(*words: str, allowed: Sequence[int] = (0,)) -> None:
    """Run Python in a process of its own, a second time if it ran out of memory.

    Raises:
        RuntimeError: it failed; the message has its last lines.
    """
    once = partial(subprocess.run, [sys.executable, *words], cwd=ROOT, capture_output=True, text=True, check=False)
    done = once()
    if done.returncode not in allowed and re.search("resource_exhausted|memory", last_lines(done), re.IGNORECASE):
        time.sleep(PAUSE)
        done = once()
    if done.returncode not in allowed:
        raise RuntimeError(f"{' '.join(words)} ended with {done.returncode}: {last_lines(done)}")


def last_lines(done: subprocess.CompletedProcess[str]) -> str:
    """Return the last lines that a process wrote."""
    return " | ".join(done.stderr.strip().splitlines()[-3:])


def picture(found: Results, target: dict[str, Any], path: Path) -> None:
    """Draw the map of a study, or another plot of its page."""
    if key := target.get("exhibit"):
        with plot_style():
            next(one for one in list_figures(found) if one.key == key).draw().savefig(path, dpi=DPI)
    else:
        with plot_style():
            axes = maps.choose_map_axes(found.rows, tuple(target.get("map", ())))
            maps.success_map(found.rows, found.stored, axes, target["title"]).savefig(path, dpi=DPI)


def summary(found: Results, target: dict[str, Any]) -> dict[str, Any]:
    """Return the results of a study, by cell and along each axis, and where they come from."""
    rows, stored = found.rows, found.stored
    whole = success_rate(rows["outcome"])
    return {
        "scenario": found.exp.scenario,
        "engine": found.exp.settings.name,
        "seed": found.exp.study.seed,
        "rollouts": whole.total,
        "invalid": whole.invalid,
        "valid": whole.valid_count,
        "success": whole.successes,
        "causes": causes(rows),
        "along": {axis: along(found, axis) for axis in (*found.categorical_columns, *found.numeric_grid_columns)},
        "map": cells(found, tuple(target.get("map", ()))),
        "figures": extremes(found),
        **({"groups": groups(found.rows, target)} if "by" in target else {}),
        "commit": stored["commit"],
        "code": stored["code"],
        "devices": stored["devices"],
        "versions": stored["versions"],
    }


def along(found: Results, axis: str) -> list[list[Any]]:
    """Return value, successes, valid and invalid rollouts for each value of an axis, or in equal parts of it.

    In studies of errors one at a time, the other axes are at their nominal values.
    """
    if found.is_one_at_a_time:
        every = sensitivity.one_at_a_time_rates(found.rows, found.exp)
        table = every[every["axis"] == axis]
    else:
        values = bin_values(found.rows[axis], PARTS if found.rows[axis].nunique() > VALUES else VALUES)
        table = success_rates(found.rows.assign(value=values), ["value"])
    counts = table[["success", "valid", "invalid"]].astype(int).to_numpy().tolist()
    values = [float(f"{value:.6g}") if isinstance(value, float) else value for value in table["value"]]
    return [[value, *count] for value, count in zip(values, counts, strict=True)]


def extremes(found: Results) -> dict[str, list[float]]:
    """Return the least and greatest value of every metric that varies, over successful rollouts."""
    rows = found.rows[found.rows["outcome"] == SUCCESS]
    names = [name for name in metrics_with_threshold_first(found) if rows[name].notna().any()]
    return {name: [float(f"{end:.4g}") for end in (rows[name].min(), rows[name].max())] for name in names}


def groups(rows: pd.DataFrame, target: dict[str, Any]) -> list[dict[str, Any]]:
    """Return outcomes for each combination of values of some columns, with `values` of the successful rollouts.

    A value is a column, or an expression of columns.
    """
    found, names = [], [find_column(rows, name) for name in target["by"]]
    for at, part in rows.groupby([rows[name].astype(object) for name in names], sort=False):
        good = part[part["outcome"] == SUCCESS]
        values = {}
        for name, expression in target.get("values", {}).items():
            drawn = np.asarray(
                evaluate_expression(
                    expression or name, lambda name, good=good: good[find_column(good, name)].to_numpy()
                )
            )
            if len(drawn) and np.isfinite(drawn).any():
                ends = drawn[np.isfinite(drawn)]
                told = {"min": ends.min(), "mean": ends.mean(), "rms": np.sqrt(np.mean(ends**2)), "max": ends.max()}
                values[name] = {how: float(f"{value:.4g}") for how, value in told.items()}
        whole = success_rate(part["outcome"])
        found.append(
            {
                "at": dict(zip(names, at, strict=True)),
                "success": whole.successes,
                "valid": whole.valid_count,
                "causes": causes(part),
                "values": values,
            }
        )
    return found


def causes(rows: pd.DataFrame) -> dict[str, int]:
    """Return the causes of rollouts without success, the most frequent first."""
    counts = rows["cause"][rows["outcome"] != SUCCESS].value_counts()
    return {str(name): int(number) for name, number in counts.items()}


def cells(found: Results, chosen: tuple[str, ...]) -> dict[str, Any] | None:
    """Successes and valid rollouts in each cell of a grid over the axes of the map; None where there is no grid."""
    axes = maps.independent_parameters(found.rows, chosen)
    if len(axes) < 2 or found.is_one_at_a_time:
        return None
    x, y = axes
    counted = success_rates(found.rows, [x, y])
    table = [counted.pivot(index=y, columns=x, values=one) for one in COUNTS]
    if table[0].isna().to_numpy().any():
        return None
    values = {axis: [float(f"{value:.6g}") for value in sorted(found.rows[axis].unique())] for axis in axes}
    return {
        "values": values,
        **{one: part.astype(int).to_numpy().tolist() for one, part in zip(COUNTS, table, strict=True)},
    }


def told(path: Path, new: dict[str, Any]) -> list[str]:
    """Write the data of a target, and with them a line for each of its counts beyond the interval of the one before.

    Data of the same code keep the lines that they have; quick and full studies are not compared.
    """
    old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    alike = old.get("quick") == new["quick"]
    if alike and old["code"] == new["code"]:
        changed = old.get("changed")
    else:
        changed = {"before": old["commit"], "counts": list(changes(old, new))} if alike else None
    lines = ",\n".join(
        f" {json.dumps(key)}: {json.dumps(value)}" for key, value in (new | {"changed": changed}).items()
    )
    write_atomically(path, f"{{\n{lines}\n}}\n".encode())
    return [f"{path.stem}, {line} (commit {changed['before']})" for line in changed["counts"]] if changed else []


def changes(old: dict[str, Any], new: dict[str, Any]) -> Iterator[str]:
    """What is beyond its interval: of the whole, at each value of an axis, and how many cells of the map."""
    before = dict(counts(old))
    for where, now in counts(new):
        was = before.get(where)
        if was and apart(was, now):
            yield f"{where}: {now[0]} of {now[1]} succeed, before {was[0]} of {was[1]}"
    was, now = old.get("map"), new["map"]
    if was and now and was["values"] == now["values"]:
        every = [np.array(one[part]).ravel().tolist() for one in (was, now) for part in COUNTS]
        moved = sum(flipped((a, b), (c, d)) for a, b, c, d in zip(*every, strict=True))
        if moved:
            yield f"{' and '.join(now['values'])}: {moved} of {len(every[0])} cells"


def counts(data: dict[str, Any]) -> Iterator[tuple[str, tuple[int, int]]]:
    """Successes and valid rollouts of the whole, and along each axis."""
    yield "all", (data["success"], data["valid"])
    for axis, lines in data["along"].items():
        for value, success, valid, _ in lines:
            yield f"{axis} = {value}", (success, valid)


def flipped(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether a cell is beyond its interval; of a single rollout, whether it ended otherwise."""
    return a != b if max(a[1], b[1]) <= 1 else apart(a, b)


def apart(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether the 95 % Wilson intervals of two counts do not meet."""
    (low, high), (low_b, high_b) = wilson(*a), wilson(*b)
    return bool(high < low_b or high_b < low)


if __name__ == "__main__":
    sys.exit(main())
