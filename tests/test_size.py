"""What commands read of a folder: the columns and parts that they need, so that a million rows take little memory."""

import shutil
import tracemalloc
from pathlib import Path

import jax
import pandas as pd
import pyarrow.parquet as pq
import pytest

import sweep
from sweep.analysis.axis_effects import check_axis_effects
from sweep.cli.commands import report
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.report import page, tables
from sweep.runs import manifest, parquet, results, runner, store
from sweep.study import study
from sweep.study.columns import metric_columns
from sweep.study.study import make_points
from sweep.systems import hexapod

FOLDER = Path(__file__).parent / "data" / "ci_smoke"
PLACE = {"batch", "slot"}


@pytest.fixture
def read(monkeypatch):
    """The columns that were decoded of any file."""
    decoded, real = set(), parquet.pq.ParquetFile.read

    def recorded(self, columns, **options):
        decoded.update(columns)
        return real(self, columns=columns, **options)

    monkeypatch.setattr(parquet.pq.ParquetFile, "read", recorded)
    return decoded


def test_load_reads_the_columns_that_are_asked_for(read):
    rows = sweep.load(FOLDER, where="tilt_max_deg < 5", columns=["friction", "outcome"])
    assert read == PLACE | {"world.contact.friction", "outcome", "tilt_max_deg"}
    every = sweep.load(FOLDER, where="tilt_max_deg < 5")
    pd.testing.assert_frame_equal(rows, every[["friction", "outcome"]], check_like=True)
    assert not hasattr(rows, "sweep")
    for odd in ("outcome", [], ["nothing"]):
        with pytest.raises(sweep.InputError, match=r"columns = .* is not allowed|column nothing is unknown"):
            sweep.load(FOLDER, columns=odd)


def test_commands_read_the_columns_that_they_need(read, capsys):
    for command, columns in (
        (["status", str(FOLDER)], PLACE | {"outcome", "cause"}),
        (["list", str(FOLDER)], PLACE | {"outcome"}),
        (["table", str(FOLDER), "--format", "csv", "--columns", "slip_max_m"], PLACE | {"slip_max_m"}),
    ):
        read.clear()
        assert main(command) == 0
        assert read == columns
    read.clear()
    assert main(["stats", str(FOLDER), "--where", "slip_max_m < 1"]) == 0
    assert [*filter(read.__contains__, metric_columns(pd.DataFrame(columns=store.list_columns(FOLDER))))] == [
        "slip_max_m"
    ]


def test_a_page_reads_the_metrics_that_it_may_show(read, monkeypatch, tmp_path):
    monkeypatch.setattr(page, "write_page", lambda found, path, **options: path)  # other tests write pages
    monkeypatch.setattr(report, "save_pictures", lambda *args: [])
    bookkeeping = {*compose(["scenario=walk_tripod"]).system.bookkeeping_metrics} & {*store.list_columns(FOLDER)}
    assert bookkeeping > {"finished", "slipped_time_s"}
    assert main(["report", str(FOLDER), "-o", str(tmp_path), "--where", "slipped_time_s > 0 or finished == 1"]) == 0
    assert bookkeeping & read == {"finished", "slipped_time_s"}


def test_an_axis_that_changes_bookkeeping_alone_has_an_effect(tmp_path):
    folder = shutil.copytree(FOLDER, tmp_path / "out")
    parts = store.list_current_parts(folder)
    rows = pd.concat([store.read_part(folder, part) for part in parts])
    labels = ["outcome", "cause", "stage", "t_cause_s", "limit", "margin", "margin_of"]
    constant = [name for name in (*metric_columns(rows), *labels) if name != "end_stage"]
    rows[constant] = rows[constant].iloc[0].to_numpy()
    rows["end_stage"] = rows["manoeuvre.half_step_ratio"]
    judged = [(rows[rows["batch"].isin(part.batches)], part) for part in parts]
    entries = [store.write_part(folder, table, part.study, part.labels) for table, part in judged]
    manifest.rewrite_manifest(folder, [*(one for one in manifest.read_manifest(folder) if one not in parts), *entries])
    found = results.read_results(folder, with_bookkeeping=False)
    effects = {name: not pairs.are_equal for name, pairs in check_axis_effects(found.rows, found.exp).items()}
    assert effects == {"friction": False, "step": True, "engine": False}


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_table_is_written_part_by_part(form, monkeypatch, tmp_path):
    steps = []

    def record(owner, name, step):
        real = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *args, **options: steps.append(step) or real(*args, **options))

    record(store, "read_table", "read")
    record(tables, "write_csv", "write")
    record(tables.pq.ParquetWriter, "write_table", "write")
    monkeypatch.setattr(tables, "GROUP_ROWS", 1)
    path = tmp_path / f"rows.{form}"
    assert main(["table", str(FOLDER), "--format", form, "-o", str(path)]) == 0
    assert steps == ["read", "write"] * 2
    rows = store.read_rows(FOLDER)
    if form == "csv":
        assert path.read_bytes() == tables.csv_bytes(rows)
    else:
        assert pq.ParquetFile(path).num_row_groups == 2
        pd.testing.assert_frame_equal(pd.read_parquet(path), rows)


def test_small_parts_share_a_row_group_of_a_parquet_table(tmp_path):
    assert main(["table", str(FOLDER), "--format", "parquet", "-o", str(tmp_path / "rows.parquet")]) == 0
    assert pq.ParquetFile(tmp_path / "rows.parquet").num_row_groups == 1


def test_a_parquet_table_has_one_type_where_parts_lack_a_column(tmp_path):
    folder = shutil.copytree(FOLDER, tmp_path / "out")
    parts = store.list_current_parts(folder)
    counted = [store.read_part(folder, part) for part in parts]
    counted[0]["hops"], counted[1]["is_far"] = 3, True
    entries = [
        store.write_part(folder, rows, part.study, part.labels) for rows, part in zip(counted, parts, strict=True)
    ]
    manifest.rewrite_manifest(folder, [*(one for one in manifest.read_manifest(folder) if one not in parts), *entries])
    assert main(["table", str(folder), "--format", "parquet", "-o", str(tmp_path / "rows.parquet")]) == 0
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "rows.parquet"), store.read_rows(folder))


def test_a_folder_whose_parts_are_merged_while_it_is_read_gives_each_row_once(tmp_path, monkeypatch):
    folder = shutil.copytree(FOLDER, tmp_path / "out")
    before, parts = store.read_rows(folder), store.list_current_parts(folder)
    found = store.iterate_parts(folder)
    first = next(found)
    merged = store.pa.concat_tables([store.read_table(folder, part) for part in parts], promote_options="permissive")
    entry = store.write_table(folder, merged, parts[0].study, parts[0].labels)
    manifest.rewrite_manifest(folder, [*(one for one in manifest.read_manifest(folder) if one not in parts), entry])
    for part in parts:
        (folder / part.file).unlink()
    again = store.pa.concat_tables([first, *found], promote_options="permissive").to_pandas()
    pd.testing.assert_frame_equal(again, before)


def test_the_bodies_of_many_points_are_checked_by_one_compiled_program(monkeypatch, caplog):
    monkeypatch.setattr(hexapod, "ROWS_PER_CHECK", 7)  # of which no other test has compiled a program
    mass = "+study.axes.mass={path: robot.body_mass, relative: 0.1}"
    exp = compose(["scenario=walk_tripod", "study.design.num=21", mass])
    with jax.log_compiles():
        make_points(exp.study, exp.system, exp.settings)
    assert len([line for line in caplog.messages if line.startswith("Compiling") and "least" in line]) == 1


DRAWN = [
    "scenario=walk_tripod",
    "engine.width=4096",
    "+study.axes.grip={path: contact.friction, distribution: {kind: uniform, from: 0.2, to: 1.2}}",
    "+study.axes.step={path: manoeuvre.half_step_ratio, distribution: {kind: uniform, from: 0.05, to: 0.1}}",
]


def test_a_dry_run_makes_ids_only_where_points_may_be_equal(fake_engine, monkeypatch, tmp_path, capsys):
    drawn = ["run", *DRAWN, "study.design.num=9", f"out={tmp_path / 'out'}", "--dry-run"]
    assert main([*drawn, "--where", "grip > 0"]) == 0  # a condition may name ids, so that they are made
    whole = capsys.readouterr().out
    listed = [*drawn, "+study.axes.grade={path: robot.coxa, values: [0.0, 0.0]}"]
    assert main(listed) == 0
    assert "9 of 18 rollouts are left out: they equal others in 12 digits" in capsys.readouterr().err
    monkeypatch.setattr(study, "point_ids", None)
    assert main(drawn) == 0
    assert capsys.readouterr().out == whole
    assert "9 of 9 rollouts to run (1 batch of 4096)" in whole


def test_a_plan_is_made_in_few_times_its_own_memory(fake_engine, tmp_path):
    number = 100_000
    exp = compose([*DRAWN, f"study.design.num={number}"])
    tracemalloc.start()
    job = runner.prepare_job(exp, tmp_path / "out", runner.select_points_to_simulate(exp, with_ids=False))
    size, peak = int(job.table.memory_usage(index=False).sum()), tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert size == 7 * 8 * number  # two axes, replicate, group, batch, slot and width
    assert peak < 2 * size
