"""What commands read of a folder: the columns and parts that they need, so that a million rows take little memory."""

from pathlib import Path

import jax
import pandas as pd
import pytest

import sweep
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.report import tables
from sweep.runs import parquet, store
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


def test_a_csv_is_written_part_by_part(monkeypatch, tmp_path):
    steps, table, text = [], store.read_table, tables.csv_bytes
    monkeypatch.setattr(store, "read_table", lambda *args: steps.append("read") or table(*args))
    monkeypatch.setattr(tables, "csv_bytes", lambda *args, **how: steps.append("write") or text(*args, **how))
    assert main(["table", str(FOLDER), "--format", "csv", "-o", str(tmp_path / "rows.csv")]) == 0
    assert steps == ["read", "write"] * 2
    whole = tables.csv_bytes(store.read_rows(FOLDER))
    assert (tmp_path / "rows.csv").read_bytes() == whole


def test_a_folder_whose_parts_are_merged_while_it_is_read_gives_each_row_once(tmp_path, monkeypatch):
    import shutil

    from sweep.runs import manifest

    folder = shutil.copytree(FOLDER, tmp_path / "out")
    before, parts = store.read_rows(folder), store.current_parts(folder)
    found = store.iterate_parts(folder)
    first = next(found)
    merged = store.pa.concat_tables([store.read_table(folder, part) for part in parts], promote_options="permissive")
    entry = store.write_table(folder, merged, parts[0].study, parts[0].labels)
    manifest.rewrite(folder, [*(one for one in manifest.read(folder) if one not in parts), entry])
    for part in parts:
        (folder / part.file).unlink()
    again = store.pa.concat_tables([first, *found], promote_options="permissive").to_pandas()
    pd.testing.assert_frame_equal(again, before)


def test_the_bodies_of_many_points_are_checked_by_one_compiled_program(monkeypatch, caplog):
    monkeypatch.setattr(hexapod, "CHECKED", 4)
    mass = "+study.axes.mass={path: robot.body_mass, relative: 0.1}"
    exp = compose(["scenario=walk_tripod", "study.design.num=20", mass])
    with jax.log_compiles():
        make_points(exp.study, exp.system, exp.settings)
    assert len([line for line in caplog.messages if line.startswith("Compiling") and "least" in line]) == 1
