"""`sweep log`: a study as a run of MLflow, Weights & Biases and TensorBoard."""

import sys
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from sweep.cli.main import main
from sweep.report import trackers
from sweep.runs import results


@contextmanager
def stored_run(stored, **words):
    stored.update(words)
    yield SimpleNamespace(info=SimpleNamespace(run_id="7"), log=stored.update, summary=stored, url="", dir="wandb/7")


def test_a_study_becomes_a_run_of_every_tracker(folder, tmp_path, monkeypatch, capsys):
    pytest.importorskip("tensorboardX", reason="the tensorboard extra is not installed")
    runs = {"mlflow": {"parameters": {}}, "wandb": {}}
    mlflow = SimpleNamespace(
        start_run=lambda run_name, description: stored_run(runs["mlflow"], name=run_name, notes=description),
        log_params=lambda some: runs["mlflow"]["parameters"].update(some),
        log_metrics=lambda metrics: runs["mlflow"].update(metrics),
        log_artifact=lambda path: runs["mlflow"].update(page=Path(path).read_text()),
        get_tracking_uri=lambda: "file:runs",
    )
    wandb = SimpleNamespace(init=lambda **words: stored_run(runs["wandb"], **words), Html=lambda text, inject: text)
    monkeypatch.setitem(sys.modules, "mlflow", mlflow)
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    assert main(["log", str(folder), "--mlflow", "--wandb", "--tensorboard", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "MLflow run 7 at file:runs",
        "W&B run wandb/7",
        f"TensorBoard run {tmp_path}/walk_map",
    ]
    found = results.read_results(folder)
    failures = int((found.rows["outcome"] == "failure").sum())
    for run, parameters in ((runs["mlflow"], runs["mlflow"]["parameters"]), (runs["wandb"], runs["wandb"]["config"])):
        assert parameters["scenario.name"] == "walk_tripod"
        assert parameters["study.axes.friction.values"] == "[0.1, 0.3, 0.5, 0.7, 0.9, 7.0]"
        assert (run["rollouts"], run["failures"]) == (len(found.rows), failures)
        assert sum(count for name, count in run.items() if name.startswith("causes/")) == failures + run["invalid"]
        assert run["median/tilt_max_deg"] == found.rows["tilt_max_deg"].median()
        assert "succeed" in run["notes"]
        assert run["page"] == (tmp_path / "walk_map" / "report.html").read_text()
    stored = b"".join(file.read_bytes() for file in tmp_path.rglob("*tfevents*"))
    for tag in (b"scenario.name", b"walk_tripod", b"median/tilt_max_deg", b"_hparams_/session_start_info"):
        assert tag in stored


def test_what_a_tracker_refuses_is_one_line(folder, monkeypatch, capsys):
    def refuse(run_name, description):
        raise RuntimeError("no such server\nand more")

    monkeypatch.setattr("sweep.report.page.write_page", lambda found, path: path)
    monkeypatch.setitem(sys.modules, "mlflow", SimpleNamespace(start_run=refuse))
    assert main(["log", str(folder), "--mlflow"]) == 2
    assert capsys.readouterr().err == "sweep: --mlflow: no such server\n"


@pytest.mark.parametrize(("flags", "words"), [
    (["--mlflow"], "--mlflow needs mlflow: pip install 'insect-sweep[mlflow]'"),
    (["--wandb"], "--wandb needs wandb: pip install 'insect-sweep[wandb]'"),
    (["--tensorboard", "logs"], "--tensorboard needs tensorboardX: pip install 'insect-sweep[tensorboard]'"),
    ([], "log needs a tracker: --mlflow, --wandb or --tensorboard FOLDER"),
])  # fmt: skip
def test_a_missing_tracker_is_one_line(folder, flags, words, monkeypatch, capsys):
    for name in trackers.MODULES.values():
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["log", str(folder), *flags]) == 2
    assert capsys.readouterr().err == f"sweep: {words}\n"
