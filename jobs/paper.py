"""Makes what docs/ shows: runs the studies of jobs/paper.yaml, draws pictures, writes docs/data/NAME.json of each.

    python jobs/paper.py [NAME ...] [--quick] [--out results/paper]

A study's folder finishes what is missing in it and refuses rows of other code, so each code has folders of its own
below OUT: whatever is interrupted goes on, and rows are taken as they are where their code is this one. That is why no
workflow engine is used, which would ask files for their dates instead. At the end: what changed beyond its interval.
"""

import argparse
import fnmatch
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from sweep.analysis import sensitivity
from sweep.analysis.intervals import wilson
from sweep.analysis.stats import binned, rate, rates
from sweep.core.files import write_whole
from sweep.core.provenance import code_version
from sweep.report import maps
from sweep.report.exhibits import exhibits
from sweep.report.layout import lettering
from sweep.runs import results
from sweep.runs.results import Results

ROOT = Path(__file__).parents[1]
DOCS, TABLE = ROOT / "docs", Path(__file__).with_suffix(".yaml")
FIGURES, DATA = DOCS / "figures", DOCS / "data"
ALLOWED = (0, 3, 4)  # invalid rows and broken expectations are results, too
VALUES, PARTS = 20, 5  # of an axis, each for itself; of a longer one, equal parts
DPI = 110


def main(argv: list[str] | None = None) -> int:
    """Make the chosen targets, or all; 1 where one failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="targets, such as pole_map or 'ball_*' (all)")
    parser.add_argument("--quick", action="store_true", help="coarser studies, for two cores")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "paper", help="folder of the studies")
    given = parser.parse_args(argv)
    targets = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    unknown = [name for name in given.names if not fnmatch.filter(targets, name)]
    if unknown:
        print(f"{unknown[0]} is not a target: {', '.join(targets)}", file=sys.stderr)
        return 2
    chosen = [name for name in targets if not given.names or any(fnmatch.fnmatch(name, one) for one in given.names)]
    changed, failed, start = [], [], time.monotonic()
    for number, name in enumerate(chosen, 1):
        print(f"== {number} of {len(chosen)}, {time.monotonic() - start:.0f} s: {name}", flush=True)
        try:
            changed += made(name, targets[name], given.out / code_version(), given.quick)
        except (subprocess.CalledProcessError, OSError, ValueError) as error:
            failed.append(f"{name}: {error}")
    for line in [*changed, *failed] or ["nothing changed beyond its interval"]:
        print(line)
    return bool(failed)


def made(name: str, target: dict[str, Any], out: Path, quick: bool) -> Iterator[str]:
    """Make one target; what changed beyond its interval since its data were written last."""
    folder = out / ("quick" if quick else "full") / ran_as(target)
    if "run" in target:
        command = [*target["run"], *(target.get("quick", []) if quick else [])]
        seconds = simulate(command, folder)
        if "relabel" in target:
            copy = folder.with_name(f"{folder.name}-relabelled")
            shutil.copytree(folder, copy, dirs_exist_ok=True)
            sweep("relabel", str(copy), *target["relabel"])
            folder = copy
        found = results.read(folder, target.get("only"))
        if "script" not in target and target.get("picture", True):
            picture(found, target, FIGURES / f"{name}.png")
        about = {"command": " ".join(["sweep run", *command]), "quick": quick and "quick" in target}
        yield from told(name, about | summary(found) | {"seconds": round(seconds)})
    if script := target.get("script"):
        words = [f"{word}{folder}" if word.endswith("=") else word for word in script[1:]]
        subprocess.run([sys.executable, str(DOCS / script[0]), *words], cwd=ROOT, check=True)


def ran_as(target: dict[str, Any]) -> str:
    """The folder of a target's study: targets of one study share it."""
    return "-".join(word.partition("=")[2] for word in target.get("run", ["=none"]))


def simulate(overrides: list[str], folder: Path) -> float:
    """Run a study, or what is missing of it; seconds that all of its batches took."""
    start = time.monotonic()
    sweep("run", *overrides, "study.expect=[]", "study.invalid_max=1", f"out={folder}")
    kept = folder / "seconds.json"  # of the command that simulated, not of one that found all there
    spent = json.loads(kept.read_text()) if kept.exists() else 0.0
    if not spent:
        kept.write_text(json.dumps(spent := time.monotonic() - start))
    return spent


def sweep(*words: str) -> None:
    """A command in a process of its own, so that each has a device to itself."""
    done = subprocess.run([sys.executable, "-m", "sweep.cli", *words], cwd=ROOT, stdout=subprocess.DEVNULL, check=False)
    if done.returncode not in ALLOWED:
        raise subprocess.CalledProcessError(done.returncode, f"sweep {' '.join(words)}")


def picture(found: Results, target: dict[str, Any], path: Path) -> None:
    """The map of a study, or another figure of its page."""
    if key := target.get("exhibit"):
        with lettering():
            next(one for one in exhibits(found) if one.key == key).draw().savefig(path, dpi=DPI)
    else:
        with lettering():
            axes = maps.map_axes(found.rows, tuple(target.get("map", ())))
            maps.success_map(found.rows, found.stored, axes).savefig(path, dpi=DPI)


def summary(found: Results) -> dict[str, Any]:
    """What the rows of a study say, by cell and along each axis, and what they are of."""
    rows, stored = found.rows, found.stored
    whole = rate(rows["outcome"])
    cause = rows["cause"][rows["outcome"] != "success"].value_counts()
    return {
        "scenario": found.exp.scenario,
        "engine": found.exp.settings.name,
        "seed": found.exp.study.seed,
        "rollouts": whole.total,
        "invalid": whole.invalid,
        "valid": whole.valid,
        "success": whole.success,
        "causes": {str(name): int(number) for name, number in cause.items()},
        "along": {axis: along(found, axis) for axis in (found.listed if found.one_at_a_time else found.axes)},
        "commit": stored["commit"],
        "code": stored["code"],
        "devices": stored["devices"],
        "versions": stored["versions"],
    }


def along(found: Results, axis: str) -> list[list[Any]]:
    """Value, successes, valid and invalid rollouts at each value of an axis, or in equal parts of it.

    Of errors one at a time the others are nominal.
    """
    if found.one_at_a_time:
        every = sensitivity.along(found.rows, found.exp)
        table = every[every["axis"] == axis]
    else:
        values = binned(found.rows[axis], PARTS if found.rows[axis].nunique() > VALUES else VALUES)
        table = rates(found.rows.assign(value=values), ["value"])
    counts = table[["success", "valid", "invalid"]].astype(int).to_numpy().tolist()
    values = [float(f"{value:.6g}") if isinstance(value, float) else value for value in table["value"]]
    return [[value, *count] for value, count in zip(values, counts, strict=True)]


def told(name: str, new: dict[str, Any]) -> Iterator[str]:
    """Write the data of a target; a line for each of its counts that is beyond the interval of the one before."""
    path = DATA / f"{name}.json"
    old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    DATA.mkdir(exist_ok=True)
    lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in new.items())
    write_whole(path, f"{{\n{lines}\n}}\n".encode())
    if not old:
        return
    before = dict(cells(old))
    for where, now in cells(new):
        was = before.get(where)
        if was and apart(was, now):
            yield f"{name}, {where}: {now[0]} of {now[1]} succeed, before {was[0]} of {was[1]} (commit {old['commit']})"


def cells(data: dict[str, Any]) -> Iterator[tuple[str, tuple[int, int]]]:
    """Successes and valid rollouts of the whole, and along each axis."""
    yield "all", (data["success"], data["valid"])
    for axis, lines in data["along"].items():
        for value, success, valid, _ in lines:
            yield f"{axis} = {value}", (success, valid)


def apart(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether the 95 % Wilson intervals of two counts do not meet."""
    (low, high), (low_b, high_b) = wilson(*a), wilson(*b)
    return bool(high < low_b or high_b < low)


if __name__ == "__main__":
    sys.exit(main())
