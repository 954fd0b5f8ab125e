"""Tables and pictures of research/validity.md, from what `python bench/validity` has measured; see `cited`.

python research/validity_figures.py      # research/figures/validity_*.png
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from sweep.core.plot_style import add_legend_below, new_figure, plot_style
from sweep.report.outcome_style import OUTCOME_STYLES

RESEARCH = Path(__file__).parent
ENGINES = (
    "mjx", "mjx on a GPU", "mjx by XLA", "mjx, double", "native", "C elliptic", "C pyramidal", "MJX elliptic",
    "Warp elliptic", "Warp as native",
)  # fmt: skip
DRAWN = {  # whose colours, and marks
    "mjx": ("success", "o"), "C MuJoCo": ("fell", "s"), "MJX": ("slipped", "^"), "Warp": ("fell_off", "D"),
}  # fmt: skip
FEWEST = {"mjx": 1, "C MuJoCo": 5}  # iterations, whose marks are hollow
ERRORS = {  # of each motion: of what, and the unit
    "standing": ("of the feet's loads", "weights"), "walking": ("of the base's path", "m"),
    "block kicked aside on a slope": ("of the speed downhill", "of it"),
    "ball slides, then rolls": ("of the speed at last", "of it"),
}  # fmt: skip
FELL = 0.2  # error from which on a robot has fallen
STEEPEST = 3.0  # order beyond which a figure has come right in between
SEEN = 1e-3  # error at 2 ms from which on a figure's order is told
Row = dict[str, Any]


def scenes(data: Row, on_gpu: Row) -> str:
    """What must come out, and by engine how far it is off, a line for each figure."""
    rows = _joined(data, on_gpu, values=True)
    engines = [name for name in ENGINES if any(name in row["errors"] for row in rows)]
    lines = ["| scene | what | answer | " + " | ".join(engines) + " |", "|:--|:--|--:|" + "--:|" * len(engines)]
    before = None
    for row in rows:
        name = row["scene"] if row["scene"] != before else ""
        before = row["scene"]
        cells = [_off(row, engine) for engine in engines]
        lines.append(f"| {name} | {row['figure']} | {_answer(row)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _joined(data: Row, on_gpu: Row, values: bool) -> list[Row]:
    """Rows of scenes, whose figures have values, or of the robot's feet, whose forces have errors alone."""
    found: dict[tuple[str, str], Row] = {}
    for row in (*data["rows"], *on_gpu["rows"]):
        if bool(row["values"]) == values:
            first = found.setdefault((row["scene"], row["figure"]), row)
            joined = {kind: {**row[kind], **first[kind]} for kind in ("errors", "values")}
            found[row["scene"], row["figure"]] = first | joined
    return list(found.values())


def stands(data: Row, on_gpu: Row) -> str:
    """How far the forces of the robot's feet are off, and how far the least ones that balance the weight are."""
    rows = _joined(data, on_gpu, values=False)
    engines = [name for name in ENGINES if any(name in row["errors"] for row in rows)]
    lines = [f"| robot | least squares | {' | '.join(engines)} |", "|:--|" + "--:|" * (1 + len(engines))]
    for row in rows:
        cells = [_share(x) for x in (row["least squares"], *(row["errors"][name] for name in engines))]
        lines.append(f"| {row['scene'].removeprefix('robot, ')} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _answer(row: Row) -> str:
    unit = f" {row['unit']}" if row["unit"] else ""
    return f"{row['exact']:g}{unit}" if row["exact"] is not None else f"*{row['law']:g}{unit}*"


def _off(row: Row, engine: str) -> str:
    if engine not in row["errors"]:
        return ""
    error = row["errors"][engine]
    if error is None:
        return "–"
    if row["exact"] == 0:
        return small(abs(row["values"][engine]))
    return f"{small(100 * error)} %"


def small(x: float) -> str:
    """Two digits, or one where there is hardly anything."""
    if x == 0 or 0.01 <= x < 10:
        return f"{x:.2g}"
    return f"{x:.0f}" if x >= 10 else f"{x:.1g}"


def faults(data: Row) -> str:
    """How many bounds each fault breaks, and which farthest."""
    lines = ["| fault | bounds broken | farthest |", "|:--|--:|:--|"]
    for row in data["rows"]:
        worst = "; ".join(f"{name} ({_times(by)})" for name, by in row["worst"])
        lines.append(f"| {row['fault']} | {row['broken']} of {row['of']} | {worst} |")
    return "\n".join(lines)


def _times(by: float | None) -> str:
    return "no number" if by is None else f"{round(by):,} times" if by >= 10 else f"{by:.2g} times"


def order(data: Row) -> str:
    """Errors over the time step of figures that have any, and the order of the last three."""
    rows = data["rows"]
    taken = max({row["iterations"] for row in rows}, key=lambda n: sum(row["iterations"] == n for row in rows))
    steps = sorted({row["time_step"] for row in rows}, reverse=True)
    titles = " | ".join(f"{1e3 * h:g} ms" for h in steps)
    lines = [f"| scene | what | {titles} | order |", "|:--|:--|" + "--:|" * (len(steps) + 1)]
    for name, errors in _over(rows, "time_step", iterations=taken).items():
        if (errors[2e-3] or 0) < SEEN:
            continue
        last = np.log([errors[h] or np.nan for h in steps[-3:]])
        slope = np.polyfit(np.log(steps[-3:]), last, 1)[0]
        cells = " | ".join(_share(errors[h]) for h in steps)
        told = f"{slope:.1f}" if slope < STEEPEST else "–"
        lines.append(f"| {name[0]} | {name[1]} | {cells} | {told} |")
    return "\n".join(lines)


def iterations(data: Row) -> str:
    """The largest force left unexplained, and the largest error's share of one at the most iterations, by scene."""
    rows = [row for row in data["rows"] if row["time_step"] == 2e-3]
    counts = sorted({row["iterations"] for row in rows})
    lines = ["| scene | " + " | ".join(f"{n}" for n in counts) + " |", "|:--|" + "--:|" * len(counts)]
    for scene in dict.fromkeys(row["scene"] for row in rows):
        cells = []
        for n in counts:
            own = [row for row in rows if row["scene"] == scene and row["iterations"] == n]
            off = max(np.inf if row["error"] is None else row["error"] for row in own)
            cells.append(f"{small(100 * off)} % ({_newtons(own[0]['residual'])})")
        lines.append(f"| {scene} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def peers(data: Row) -> str:
    """C MuJoCo's over the time step, either cone in a cell; values themselves where the answer is 0."""
    figures: dict[tuple[str, str], dict[tuple[float, str], Row]] = {}
    for row in data["rows"]:
        figures.setdefault((row["scene"], row["figure"]), {})[row["time_step"], row["engine"]] = row
    steps = sorted({row["time_step"] for row in data["rows"]}, reverse=True)
    engines = list(dict.fromkeys(row["engine"] for row in data["rows"]))
    titles = " | ".join(f"{1e3 * h:g} ms" for h in steps)
    lines = [f"| scene | what | {titles} |", "|:--|:--|" + "--:|" * len(steps)]
    for (scene, figure), rows in figures.items():
        if any((rows[2e-3, name]["error"] or 0) >= SEEN for name in engines):
            cells = ["; ".join(_off_by(rows[h, name]) for name in engines) for h in steps]
            lines.append(f"| {scene} | {figure} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _off_by(row: Row) -> str:
    return f"{small(row['off'])} {row['unit']}" if row.get("off") is not None else _share(row["error"])


def _share(x: float | None) -> str:
    return "–" if x is None else f"{small(100 * x)} %"


def _newtons(x: float | None) -> str:
    return "–" if x is None else f"{small(x)} N"


def _over(rows: list[Row], key: str, **fixed: Any) -> dict[tuple[str, str], dict[Any, float | None]]:
    found: dict[tuple[str, str], dict[Any, float | None]] = {}
    for row in rows:
        if all(row[name] == value for name, value in fixed.items()):
            found.setdefault((row["scene"], row["figure"]), {})[row[key]] = row["error"]
    return found


def manoeuvres(data: Row) -> str:
    """How far whole manoeuvres are from their finest, a line for each step and number of iterations."""
    titles = ("scenario", "step (ms)", "iterations", "base, at most (mm)", "at the end (mm)", "forces (weights)",
              "net force (weights)", "slip (mm)", "left unexplained (weights)", "outcome")  # fmt: skip
    lines = [f"| {' | '.join(titles)} |", "|:--|" + "--:|" * (len(titles) - 2) + ":--|"]
    before = None
    for row in data["rows"]:
        name, before = f"`{row['scenario']}`" if row["scenario"] != before else "", row["scenario"]
        mark = "**" if row["default"] else ""
        keys = ("base_mm", "end_mm", "forces", "net", "slip_mm", "residual")
        cells = " | ".join("–" if row[key] is None else small(row[key]) for key in keys)
        step = f"{mark}{1e3 * row['time_step']:g}{mark} | {mark}{row['iterations']}{mark}"
        lines.append(f"| {name} | {step} | {cells} | {row['outcome']} |")
    return "\n".join(lines)


def chaos(data: Row, names: str = "") -> str:
    """How fast rollouts part, a line for each manoeuvre, or for each of some `names`."""
    engines = ("mjx", "native")
    titles = " | ".join(f"`{engine}`: apart at first, at last; e-fold (s); succeed" for engine in engines)
    measured = sorted({row["scenario"] for row in data["rows"]})
    lines = [f"| scenario | lasts (s) | {titles} |", "|:--|--:|:--|:--|"]
    for name in names.split() or measured:
        own = {row["engine"]: row for row in data["rows"] if row["scenario"] == name}
        cells = " | ".join(_parted(own[engine]) if engine in own else "" for engine in engines)
        lines.append(f"| `{name}` | {next(iter(own.values()))['seconds']:.0f} | {cells} |")
    return "\n".join(lines)


def _parted(row: Row) -> str:
    fold = "–" if row["e_fold_s"] is None else f"{row['e_fold_s']:.2g}"
    late = f", 1 mm after {row['parted_s']:.0f} s" if row["parted_s"] else ""
    return f"{_metres(row['first_m'])}, {_metres(row['last_m'])}{late}; {fold}; {row['success']} of {row['of']}"


def _metres(x: float) -> str:
    unit, size = next((one for one in (("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)) if x >= one[1]), ("pm", 1e-12))
    return f"{float(f'{x / size:.1g}'):g} {unit}"


def precision(data: Row) -> str:
    """Error and speed, a line for each engine, step and number of iterations."""
    titles = ("motion", "engine", "step (ms)", "iterations", "error", "rollouts", "simulated s a second", "steps",
              "of a", "contacts", "iterations taken, or force left")  # fmt: skip
    lines = [f"| {' | '.join(titles)} |", "|:--|:--|" + "--:|" * (len(titles) - 2)]
    order = list(ERRORS), list(DRAWN)
    for row in sorted(data["rows"], key=lambda row: (order[0].index(row["motion"]), order[1].index(row["engine"]))):
        unit = ERRORS[row["motion"]][1]
        taken = f"{row['taken']:.1f}" if "taken" in row else ""
        left = f"{small(row['residual_n'])} N" if "residual_n" in row else ""
        fell = unit == "weights" and (row["error"] or 0) > FELL
        error = "–" if row["error"] is None else "falls" if fell else f"{row['error']:.1e} {unit}"
        told = (f"{row[key]:.3g}" for key in ("per_s", "steps_per_s"))
        cells = (row["motion"], row["engine"], f"{1e3 * row['time_step']:g}", row["iterations"], error, row["width"],
                 *told, row["of"], row.get("contacts", ""), taken + left)  # fmt: skip
        lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    return "\n".join(lines)


TABLES = {
    "scenes": scenes, "stands": stands, "faults": faults, "order": order, "iterations": iterations, "peers": peers,
    "manoeuvres": manoeuvres, "chaos": chaos, "precision": precision,
}  # fmt: skip


def draw_precision(rows: list[Row], path: Path) -> None:
    """Speed over error, a panel for each motion."""
    shown = [motion for motion in ERRORS if any(row["motion"] == motion for row in rows)]
    with plot_style():
        figure = new_figure(1.6 * len(shown))
        panels = figure.subplots(len(shown) // 2, 2, sharey=True).ravel()
        for axes, motion in zip(panels, shown, strict=True):
            of, unit = ERRORS[motion]
            for engine, (look, mark) in DRAWN.items():
                colour = OUTCOME_STYLES[look].colour
                own = [row for row in rows if (row["motion"], row["engine"]) == (motion, engine)]
                own = [row for row in own if row["error"] and (unit != "weights" or row["error"] < FELL)]
                for row in own:
                    filled = colour if row["iterations"] > FEWEST.get(engine, 0) else "none"
                    size = _size(row["time_step"])
                    axes.loglog(row["error"], row["per_s"], mark, ms=size, color=colour, mfc=filled)
            axes.margins(0.25, 0.1)
            axes.set(title=motion, xlabel=f"error {of} ({unit})")
            axes.grid(alpha=0.3, lw=0.5)
            axes.tick_params(axis="x", which="minor", labelsize=5)  # of less than a decade all are labelled
        for axes in panels[::2]:
            axes.set_ylabel("simulated s in a second")
        add_legend_below(figure, [*_legend(rows)])
        figure.savefig(path, dpi=110)


def _size(time_step: float) -> float:
    """Of a mark, in points; its area goes with the step."""
    return 7.0 * (time_step / 2e-3) ** 0.5


def _legend(rows: list[Row]) -> Iterator[Line2D]:
    """Engines by colour and mark, steps by size."""
    for engine, (look, mark) in DRAWN.items():
        if any(row["engine"] == engine for row in rows):
            yield Line2D([], [], ls="", marker=mark, color=OUTCOME_STYLES[look].colour, label=engine)
    for step in sorted({row["time_step"] for row in rows}, reverse=True):
        yield Line2D([], [], ls="", marker="o", ms=_size(step), color="grey", label=f"{1e3 * step:g} ms")
    few = ", ".join(f"{engine} by {n}" for engine, n in FEWEST.items())
    yield Line2D([], [], ls="", marker="o", mfc="none", color="grey", label=f"{few} iterations")


def main() -> None:
    """Draw what there are data of."""
    for machine in ("", "_gpu"):
        path = RESEARCH / "data" / f"validity_precision{machine}.json"
        if path.exists():
            rows = json.loads(path.read_text(encoding="utf-8"))["rows"]
            draw_precision(rows, RESEARCH / "figures" / f"validity_precision{machine}.png")


if __name__ == "__main__":
    main()
