"""Effect of the time step on outcomes: `python bench/steps.py [ENGINE-SCENARIO ...]`, such as 'native-pole_*' (all).

Every scenario on both engines with the draws of `study=any_step`: some minutes of a core each. Complete folders below
results/steps are used as they are, also from another machine, so that parts may run anywhere. It writes
research/data/steps.json, which research/time_step.md cites. Scenarios without a folder stay there as last measured, and
the table names the code of each.
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
from sweep.core.files import write_atomically
from sweep.runs import store

ROOT = Path(__file__).parents[1]
FOLDERS, DATA = ROOT / "results" / "steps", ROOT / "research" / "data" / "steps.json"
STEPS = {"mjx": ("engine.time_step", (2e-3, 1e-3, 5e-4)), "native": ("engine.native_time_step", (1e-3, 5e-4))}
DRAWS, DRAWN = 16, "robot.body_mass"  # number of draws, and a column that identifies them


def engine_scenarios() -> Iterator[tuple[str, str]]:
    """Yield engines and scenarios."""
    names = sorted(file.stem for file in (ROOT / "conf" / "scenario").glob("*.yaml"))
    yield from ((engine, name) for engine in STEPS for name in names)


def rows_of(folder: Path, engine: str) -> pd.DataFrame | None:
    """Return all rows of a study; None if some are missing."""
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


def count_outcomes(engine: str, name: str, rows: pd.DataFrame) -> dict[str, Any]:
    """Return what is stored of a scenario on an engine: outcomes by step, flips, and versions."""
    path, steps = STEPS[engine]
    wide = rows.pivot(index=DRAWN, columns=path, values="outcome")
    halves = [wide.iloc[:, k].ne(wide.iloc[:, k + 1]) for k in range(wide.shape[1] - 1)]
    at = [rows[rows[path].round(9) == step] for step in steps]
    others = [one.loc[one["outcome"] != "success", "cause"].value_counts() for one in at]
    study = store.read_study(FOLDERS / f"{engine}-{name}")
    return {
        "success": [int((one["outcome"] == "success").sum()) for one in at],
        "others": [{str(cause): int(number) for cause, number in one.items()} for one in others],
        "pairs": sum(map(len, halves)),
        "otherwise": int(sum(half.sum() for half in halves)),
        **{key: study[key] for key in ("code", "commit", "devices")},
    }


def line(name: str, counts: dict[str, dict[str, Any]]) -> list[str]:
    """Return a table line: successes at each step, other outcomes, and versions; blank where nothing was run."""
    cells, others = [], []
    for engine, (_, steps) in STEPS.items():
        for k, step in enumerate(steps):
            cells.append(str(counts[engine]["success"][k]) if engine in counts else "")
            causes = counts[engine]["others"][k] if engine in counts else {}
            others += [f"{number} `{cause}` ({engine}, {step * 1e3:g} ms)" for cause, number in causes.items()]
    commits = {engine: one["commit"] for engine, one in counts.items()}
    code = {*commits.values()}
    told = code.pop() if len(code) == 1 else "; ".join(f"{commit} ({engine})" for engine, commit in commits.items())
    return [f"`{name}`", *cells, ", ".join(others), told]


def table(counts: dict[tuple[str, str], dict[str, Any]]) -> list[list[str]]:
    """Return a line for each scenario that was run."""
    heads = [f"{engine}, {step * 1e3:g} ms" for engine, (_, steps) in STEPS.items() for step in steps]
    names = sorted({name for _, name in counts})
    parts = ({engine: one for (engine, of), one in counts.items() if of == name} for name in names)
    return [["scenario", *heads, "others", "code"], *(line(name, one) for name, one in zip(names, parts, strict=True))]


def flips(counts: dict[tuple[str, str], dict[str, Any]]) -> list[list[str]]:
    """Return the draws with another outcome at half the step, by engine, with a 95 % Wilson interval."""
    lines = [["engine", "scenarios", "draws at two steps", "end otherwise", "95 %"]]
    for engine in STEPS:
        ones = [one for (of, _), one in counts.items() if of == engine]
        pairs, otherwise = (sum(one[key] for one in ones) for key in ("pairs", "otherwise"))
        if ones:
            low, high = wilson(otherwise, pairs)
            share = f"{100 * low:.1f} to {100 * high:.1f} %"
            lines.append([f"`{engine}`", str(len(ones)), str(pairs), str(otherwise), share])
    return lines


def summarize(counts: dict[tuple[str, str], dict[str, Any]]) -> dict[str, Any]:
    """Return what research/time_step.md cites, and the counts of each scenario, to be kept without its folder."""
    ones = [*counts.values()]
    return {
        "command": "python bench/steps.py",
        "engine": " and ".join(f"`{engine}`" for engine in STEPS),
        "devices": sorted({device for one in ones for device in one["devices"]}),
        "code": ones[0]["code"] if len({one["code"] for one in ones}) == 1 else "several",
        "commit": "see its table" if len({one["commit"] for one in ones}) > 1 else ones[0]["commit"],
        "seconds": "",
        "tables": {"outcomes": table(counts), "flips": flips(counts)},
        "counts": {f"{engine}-{name}": one for (engine, name), one in counts.items()},
    }


def main(patterns: list[str]) -> None:
    """Run what is missing, and write all results, earlier ones included."""
    before = json.loads(DATA.read_text(encoding="utf-8"))["counts"] if DATA.exists() else {}
    found = {(engine, name): one for engine, name in engine_scenarios() if (one := before.get(f"{engine}-{name}"))}
    for engine, name in engine_scenarios():
        folder = FOLDERS / f"{engine}-{name}"
        rows = rows_of(folder, engine)
        if rows is None and any(fnmatch.fnmatch(folder.name, one) for one in patterns or ["*"]):
            simulate(engine, name)
            rows = rows_of(folder, engine)
        if rows is not None:
            found[engine, name] = count_outcomes(engine, name, rows)
    found = {key: found[key] for key in engine_scenarios() if key in found}
    write_atomically(DATA, (json.dumps(summarize(found), indent=1) + "\n").encode())


if __name__ == "__main__":
    main(sys.argv[1:])
