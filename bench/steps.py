"""Whether outcomes hang on the time step: `python bench/steps.py [ENGINE-SCENARIO ...]`, such as 'native-pole_*' (all).

Every scenario on both engines as `study=any_step` draws it: some minutes of a core each. Folders below results/steps
that have all their rows are taken as they are, those of another machine too, so that parts may be run anywhere. It
writes research/data/steps.json, which docs/judge.md cites; scenarios without a folder stay there as they were
told last,
and the table says what code each is of.
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
FOLDERS, DATA = ROOT / "results" / "steps", ROOT / "research" / "data" / "steps.json"
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


def counted(engine: str, name: str, rows: pd.DataFrame) -> dict[str, Any]:
    """What is kept of a scenario on an engine: outcomes by step, flips over them, and what made them."""
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


def line(name: str, found: dict[str, dict[str, Any]]) -> list[str]:
    """Successes of the draws at each step, what came of the others, and their code; a blank where nothing was run."""
    cells, others = [], []
    for engine, (_, steps) in STEPS.items():
        for k, step in enumerate(steps):
            cells.append(str(found[engine]["success"][k]) if engine in found else "")
            causes = found[engine]["others"][k] if engine in found else {}
            others += [f"{number} `{cause}` ({engine}, {step * 1e3:g} ms)" for cause, number in causes.items()]
    commits = {engine: one["commit"] for engine, one in found.items()}
    code = {*commits.values()}
    told = code.pop() if len(code) == 1 else "; ".join(f"{commit} ({engine})" for engine, commit in commits.items())
    return [f"`{name}`", *cells, ", ".join(others), told]


def table(found: dict[tuple[str, str], dict[str, Any]]) -> list[list[str]]:
    """A line for each scenario that was run."""
    heads = [f"{engine}, {step * 1e3:g} ms" for engine, (_, steps) in STEPS.items() for step in steps]
    names = sorted({name for _, name in found})
    parts = ({engine: one for (engine, of), one in found.items() if of == name} for name in names)
    return [["scenario", *heads, "others", "code"], *(line(name, one) for name, one in zip(names, parts, strict=True))]


def flips(found: dict[tuple[str, str], dict[str, Any]]) -> list[list[str]]:
    """Draws that end otherwise at half the step, by engine, with the 95 % Wilson interval of their share."""
    lines = [["engine", "scenarios", "draws at two steps", "end otherwise", "95 %"]]
    for engine in STEPS:
        ones = [one for (of, _), one in found.items() if of == engine]
        pairs, otherwise = (sum(one[key] for one in ones) for key in ("pairs", "otherwise"))
        if ones:
            low, high = wilson(otherwise, pairs)
            share = f"{100 * low:.1f} to {100 * high:.1f} %"
            lines.append([f"`{engine}`", str(len(ones)), str(pairs), str(otherwise), share])
    return lines


def told(found: dict[tuple[str, str], dict[str, Any]]) -> dict[str, Any]:
    """What docs/judge.md cites, and each scenario's counts, by which those without a folder are told again."""
    ones = [*found.values()]
    return {
        "command": "python bench/steps.py",
        "engine": " and ".join(f"`{engine}`" for engine in STEPS),
        "devices": sorted({device for one in ones for device in one["devices"]}),
        "code": ones[0]["code"] if len({one["code"] for one in ones}) == 1 else "several",
        "commit": "see its table" if len({one["commit"] for one in ones}) > 1 else ones[0]["commit"],
        "seconds": "",
        "tables": {"outcomes": table(found), "flips": flips(found)},
        "counts": {f"{engine}-{name}": one for (engine, name), one in found.items()},
    }


def main(patterns: list[str]) -> None:
    """Run what is missing of the chosen, and tell of all that is there or was told before."""
    before = json.loads(DATA.read_text(encoding="utf-8"))["counts"] if DATA.exists() else {}
    found = {(engine, name): one for engine, name in every() if (one := before.get(f"{engine}-{name}"))}
    for engine, name in every():
        folder = FOLDERS / f"{engine}-{name}"
        rows = rows_of(folder, engine)
        if rows is None and any(fnmatch.fnmatch(folder.name, one) for one in patterns or ["*"]):
            simulate(engine, name)
            rows = rows_of(folder, engine)
        if rows is not None:
            found[engine, name] = counted(engine, name, rows)
    found = {key: found[key] for key in every() if key in found}
    write_whole(DATA, (json.dumps(told(found), indent=1) + "\n").encode())


if __name__ == "__main__":
    main(sys.argv[1:])
