"""Whether outcomes hang on the time step: `python bench/steps.py [ENGINE-SCENARIO ...]`, such as 'native-pole_*' (all).

Every scenario on both engines as `study=any_step` draws it: some minutes of a core each. Folders below results/steps
that have all their rows are taken as they are, those of another machine too, so that parts may be run anywhere. It
writes docs/data/steps.json, which docs/judge.md cites.
"""

import fnmatch
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from sweep.analysis.intervals import wilson
from sweep.core.errors import InputError
from sweep.core.files import write_whole
from sweep.runs import store

ROOT = Path(__file__).parents[1]
FOLDERS, DATA = ROOT / "results" / "steps", ROOT / "docs" / "data" / "steps.json"
STEPS = {"mjx": ("engine.time_step", (2e-3, 1e-3, 5e-4)), "native": ("engine.native_time_step", (1e-3, 5e-4))}
DRAWS, DRAWN = 16, "robot.body_mass"  # how many, and a column that tells them apart


def every() -> Iterator[tuple[str, str]]:
    """Engines and scenarios."""
    names = sorted(file.stem for file in (ROOT / "conf" / "scenario").glob("*.yaml"))
    yield from ((engine, name) for engine in STEPS for name in names)


def rows_of(folder: Path, engine: str) -> pd.DataFrame | None:
    """All rows of a study, or None where some are missing."""
    try:
        rows = store.read_rows(folder)
    except InputError:
        return None
    return rows if len(rows) == DRAWS * len(STEPS[engine][1]) else None


def simulate(engine: str, name: str) -> None:
    """Run the study of a scenario, or what is missing of it."""
    path, steps = STEPS[engine]
    given = [f"engine={engine}", f"study.axes.step.path={path}", f"study.axes.step.values={[*steps]}"]
    free = ["scenario.expect=[]", "study.invalid_max=1", f"out={FOLDERS / f'{engine}-{name}'}"]
    command = [sys.executable, "-m", "sweep.cli", "run", f"scenario={name}", "study=any_step", *given, *free]
    subprocess.run(command, cwd=ROOT, check=True)


def line(name: str, found: dict[str, pd.DataFrame]) -> list[str]:
    """Successes of the draws at each step, and what came of the others; a blank where nothing was run."""
    cells, others = [], []
    for engine, (path, steps) in STEPS.items():
        for step in steps:
            if engine not in found:
                cells.append("")
                continue
            rows = found[engine][found[engine][path].round(9) == step]
            cells.append(f"{(rows['outcome'] == 'success').sum()}")
            causes = rows.loc[rows["outcome"] != "success", "cause"].value_counts()
            others += [f"{number} `{cause}` ({engine}, {step * 1e3:g} ms)" for cause, number in causes.items()]
    return [f"`{name}`", *cells, ", ".join(others)]


def table(found: dict[tuple[str, str], pd.DataFrame]) -> list[list[str]]:
    """A line for each scenario that was run."""
    heads = [f"{engine}, {step * 1e3:g} ms" for engine, (_, steps) in STEPS.items() for step in steps]
    names = sorted({name for _, name in found})
    parts = ({engine: rows for (engine, of), rows in found.items() if of == name} for name in names)
    return [["scenario", *heads, "others"], *(line(name, one) for name, one in zip(names, parts, strict=True))]


def flips(found: dict[tuple[str, str], pd.DataFrame]) -> list[list[str]]:
    """Draws that end otherwise at half the step, by engine, with the 95 % Wilson interval of their share."""
    lines = [["engine", "scenarios", "draws at two steps", "end otherwise", "95 %"]]
    for engine, (path, _) in STEPS.items():
        pairs = otherwise = scenarios = 0
        for (of, _), rows in found.items():
            if of != engine:
                continue
            wide = rows.pivot(index=DRAWN, columns=path, values="outcome")
            halves = [wide.iloc[:, k].ne(wide.iloc[:, k + 1]) for k in range(wide.shape[1] - 1)]
            pairs, otherwise = pairs + sum(map(len, halves)), otherwise + int(sum(half.sum() for half in halves))
            scenarios += 1
        if scenarios:
            low, high = wilson(otherwise, pairs)
            share = f"{100 * low:.1f} to {100 * high:.1f} %"
            lines.append([f"`{engine}`", str(scenarios), str(pairs), str(otherwise), share])
    return lines


def told(found: dict[tuple[str, str], pd.DataFrame]) -> dict[str, Any]:
    """What docs/judge.md cites."""
    stored = [store.read_study(FOLDERS / f"{engine}-{name}") for engine, name in found]
    first = stored[0]
    return {
        "command": "python bench/steps.py",
        "engine": " and ".join(f"`{engine}`" for engine in STEPS),
        "devices": sorted({device for one in stored for device in one["devices"]}),
        "code": first["code"] if len({one["code"] for one in stored}) == 1 else "several",
        "commit": ", ".join(sorted({one["commit"] for one in stored})),
        "versions": first["versions"],
        "seconds": "",
        "tables": {"outcomes": table(found), "flips": flips(found)},
    }


def main(patterns: list[str]) -> None:
    """Run what is missing of the chosen, and tell of all that is there."""
    found = {}
    for engine, name in every():
        folder = FOLDERS / f"{engine}-{name}"
        rows = rows_of(folder, engine)
        if rows is None and any(fnmatch.fnmatch(folder.name, one) for one in patterns or ["*"]):
            simulate(engine, name)
            rows = rows_of(folder, engine)
        if rows is not None:
            found[engine, name] = rows
    write_whole(DATA, (json.dumps(told(found), indent=1) + "\n").encode())


if __name__ == "__main__":
    main(sys.argv[1:])
