"""Agreement of engines over whole studies: `python bench/engine_agreement.py`.

It writes research/data/engine_agreement.json and research/figures/engine_agreement.png, which research/decisions.md
cites: random draws of the quadruped of `sweep init --model`, simulated by C MuJoCo and by this package's kernel, and of
the built-in robot's walk, simulated by both of its engines.
"""

import contextlib
import tempfile
import time
from pathlib import Path

import shared

from sweep.analysis.stats import format_percent
from sweep.cli.main import main as run_command
from sweep.core.plot_style import plot_style, save_figure
from sweep.report.engine_agreement import engine_figure
from sweep.runs import engine_audit
from sweep.runs.results import read_results

FIGURE = shared.FIGURES / "engine_agreement.png"
STUDIES = {  # by what is simulated: file of the study, and engines
    "quadruped that trots": ("quad", """scenario: own
study:
  replays: 0
  invalid_max: 1
  design: {kind: monte_carlo, num: 400}
  axes:
    load: {path: model.body.trunk.mass, side: world, distribution: {kind: uniform, from: 4, to: 20}}
    grip: {path: model.geom.floor.friction.slide, side: world, distribution: {kind: uniform, from: 0.1, to: 0.8}}
""", "native,kernel"),
    "built-in robot that walks": ("walk", """scenario: walk_tripod
study:
  replays: 0
  invalid_max: 1
  design: {kind: monte_carlo, num: 96}
  axes:
    friction: {path: contact.friction, side: world, distribution: {kind: uniform, from: 0.05, to: 0.6}}
    step: {path: manoeuvre.half_step_ratio, distribution: {kind: uniform, from: 0.02, to: 0.19}}
""", "mjx,native"),
}  # fmt: skip


def audit_study(what: str) -> list[str]:
    """Simulate a study on its engines, and return a line of the table."""
    name, text, engines = STUDIES[what]
    Path(f"{name}.yaml").write_text(text)
    run_command(["run", f"study={name}.yaml", f"engine={engines.partition(',')[0]}", f"out={name}"])
    run_command(["audit", name, "--engines", engines])
    results = read_results(Path(name))
    rate = engine_audit.agreement_rate(results)
    counts = engine_audit.engine_outcome_table(engine_audit.read_engine_outcomes(results))
    differ = counts[counts[engine_audit.AGREE] == engine_audit.NO]
    told = [
        f"{line['rollouts']} {', '.join(line[c] for c in engine_audit.outcome_columns(counts))}"
        for line in differ.to_dict("records")
    ]
    interval = f"{format_percent(rate.low)} to {format_percent(rate.high)}"
    if name == "quad":
        (figure,) = engine_figure(results)
        with plot_style():
            save_figure(figure.draw(), FIGURE)
    agree = f"{rate.successes} of {rate.total}, {format_percent(rate.share)} ({interval})"
    return [what, engines.replace(",", ", "), agree, "; ".join(told) or "none"]


def main() -> None:
    """Compute and write the table and the picture."""
    start, table = time.perf_counter(), [["study", "engines", "all agree", "the others: outcomes on each"]]
    with tempfile.TemporaryDirectory() as folder:
        run_command(["init", "--model", f"{folder}/project"])
        with contextlib.chdir(f"{folder}/project"):
            for what in STUDIES:
                table.append(audit_study(what))
                print(table[-1], flush=True)
    shared.write_tables("engine_agreement", ("mjx", "native"), start, {"studies": table})


if __name__ == "__main__":
    main()
