"""A folder holds the rows that were simulated, judged by the thresholds it names, or says that it does not."""

import os
import random
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pandas as pd
import pytest
from small_study import BATCHES, STUDY, content, one_line

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core import provenance
from sweep.core.errors import Fault, InputError
from sweep.runs import manifest, repair, runner, store

pytestmark = pytest.mark.usefixtures("fake_engine")
FLIPS = int(os.environ.get("SWEEP_FLIPS", "150"))


@pytest.fixture
def folder(tmp_path):
    """A finished study."""
    assert main(["run", *STUDY, f"out={tmp_path / 'out'}"]) == 0
    return tmp_path / "out"


def again(folder, *overrides: str) -> int:
    return main(["run", *STUDY, f"out={folder}", *overrides])


def test_what_a_worker_of_a_dead_command_writes_counts_for_nothing(tmp_path, whole):
    """It has read its plan and thresholds, its command dies, another one judges by others, then it finishes."""
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0
    for entry in store.list_current_parts(tmp_path)[5:]:
        (tmp_path / entry.file).unlink()
    known = runner._read_job(tmp_path.resolve(), "a plan of the dead command")
    assert again(tmp_path, "--limit", "48", "outcome.slip_max_m=0.01") == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "_read_job", lambda *_: known)
        runner.simulate_on_worker(tmp_path.resolve(), "a plan of the dead command", provenance.code_version(), 6)
    assert again(tmp_path, "outcome.slip_max_m=0.01") == 0
    rows = content(tmp_path)
    assert (rows["outcome"] == "success").equals(rows["slip_max_m"] <= 0.01)
    assert rows["point_id"].is_unique
    assert again(tmp_path) == 0
    pd.testing.assert_frame_equal(content(tmp_path), whole)


def test_a_part_that_was_judged_by_other_thresholds_is_not_taken(folder):
    exp = compose([*STUDY, f"out={folder}"])
    job = runner.prepare_job(exp, folder, runner.select_points_to_simulate(exp))
    entry = replace(store.list_current_parts(folder)[0], labels="others")
    with pytest.raises(Fault, match="other thresholds"):
        runner.add_batch_to_manifest(job, runner.FinishedBatch(0, "host", "cpu", 1, entry), entry)


def test_no_flipped_bit_is_silent_and_none_ends_in_a_traceback(folder, whole):
    files = [folder / name for name in (store.STUDY_FILE, store.POINTS_FILE, manifest.MANIFEST_FILE)]
    files += [folder / entry.file for entry in store.list_current_parts(folder)]
    chance = random.Random(1)
    for _ in range(FLIPS):
        path = chance.choice(files)
        sound = path.read_bytes()
        bit = chance.randrange(8 * len(sound))
        path.write_bytes(sound[: bit // 8] + bytes([sound[bit // 8] ^ 1 << bit % 8]) + sound[bit // 8 + 1 :])
        with pytest.raises(InputError, match=path.name):  # noqa: PT012
            content(folder)
            store.read_points(folder)
        path.write_bytes(sound)
    pd.testing.assert_frame_equal(content(folder), whole)
    assert main(["verify", str(folder)]) == 0


@pytest.mark.parametrize("there", [0, 100])
def test_a_line_that_is_being_written_is_no_damage(folder, there):
    """Who reads a folder takes no lock, and may come between the file and its line, or within the line."""
    path = folder / manifest.MANIFEST_FILE
    lines = path.read_bytes()
    path.write_bytes(lines[:there])
    with ThreadPoolExecutor() as others:
        found = others.submit(store.finished_batches, folder)
        time.sleep(0.03)  # longer than the first look, shorter than any patience
        path.write_bytes(lines)
        assert found.result() == set(range(BATCHES))


@pytest.mark.parametrize("name", [store.STUDY_FILE, store.POINTS_FILE, manifest.MANIFEST_FILE])
@pytest.mark.parametrize("how", ["lost", "damaged"])
def test_what_the_rest_of_a_folder_tells_is_rebuilt(folder, whole, capsys, name, how):
    path = folder / name
    before, parts = path.read_bytes(), {p: p.stat().st_mtime_ns for p in (folder / store.PARTS_FOLDER).iterdir()}
    path.unlink() if how == "lost" else path.write_bytes(before.replace(b"a", b"b", 1).replace(b"6", b"7", 1))
    capsys.readouterr()
    assert main(["verify", str(folder)]) == 4
    if name != store.POINTS_FILE:
        assert main(["table", str(folder)]) == 2
        one_line(capsys.readouterr().err, name)
    assert again(folder) == 0
    assert "no rollouts left to run" in capsys.readouterr().err
    pd.testing.assert_frame_equal(content(folder), whole)
    assert parts == {p: p.stat().st_mtime_ns for p in (folder / store.PARTS_FOLDER).iterdir()}
    assert main(["verify", str(folder)]) == 0
    if how == "lost" and name == store.STUDY_FILE:
        path.unlink()
        assert again(folder, "contact.stiffness=5e5") == 2
        assert again(folder, "outcome.slip_max_m=0.01") == 2
        one_line(capsys.readouterr().err.splitlines(keepends=True)[-1], "give the same")


def test_strangers_are_named_and_do_not_count(folder, tmp_path, whole, capsys):
    first = folder / store.list_current_parts(folder)[0].file
    other = tmp_path / "other"
    assert main(["run", *STUDY, f"out={other}", "engine.time_step=1e-3"]) == 0
    shutil.copy(first, first.with_name("part-000000 (copy).parquet"))
    shutil.copy(first, first.with_name("part-000099.parquet"))
    foreign = other / store.list_current_parts(other)[3].file
    shutil.copy(foreign, first.with_name(foreign.name))
    (folder / store.PARTS_FOLDER / "notes").mkdir()
    for command in ("table", "stats", "status", "verify"):
        assert main([command, str(folder)]) == 0
    pd.testing.assert_frame_equal(content(folder), whole)
    (folder / store.list_current_parts(folder)[3].file).unlink()
    capsys.readouterr()
    assert main(["table", str(folder)]) == 2
    one_line(capsys.readouterr().err, "part-000003")
    assert again(folder) == 0
    error = capsys.readouterr().err
    assert all(name in error for name in ("(copy)", "part-000099", foreign.name, "notes"))
    assert "8 rollouts in" in error
    pd.testing.assert_frame_equal(content(folder), whole)


@pytest.mark.parametrize("step", [0, 1, 4, 8, 9, 10])
def test_a_killed_relabelling_changes_all_rows_or_none(folder, whole, monkeypatch, step):
    steps = iter(range(100))

    def killed(real):
        def write(*args):
            if next(steps) == step:
                raise KeyboardInterrupt
            return real(*args)

        return write

    with monkeypatch.context() as patch:
        for module, name in (
            (store, "write_part"),
            (store, "write_study"),
            (repair, "remove_parts"),
            (runner, "build_experiment"),
        ):
            patch.setattr(module, name, killed(getattr(module, name)))
        done = main(["relabel", str(folder), "slip_max_m<0.01"]) == 0
    rows, stored = content(folder), store.read_study(folder)
    limit = stored["config"]["outcome"]["slip_max_m"]
    if limit == 0.01:
        assert (rows["outcome"] == "success").equals(rows["slip_max_m"] <= 0.01)
    else:
        assert not done
        pd.testing.assert_frame_equal(rows, whole)
    assert main(["relabel", str(folder), "slip_max_m<0.01"]) == 0
    rows = content(folder)
    assert (rows["outcome"] == "success").equals(rows["slip_max_m"] <= 0.01)
    assert again(folder) == 0
    pd.testing.assert_frame_equal(content(folder), whole)
    assert len(list((folder / store.PARTS_FOLDER).iterdir())) == BATCHES


def test_a_folder_of_another_format_is_refused_by_its_version(folder, capsys):
    import yaml

    stored = yaml.safe_load((folder / store.STUDY_FILE).read_bytes())
    del stored["format"]
    (folder / store.STUDY_FILE).write_text(yaml.safe_dump({**stored, "labelled": True, "commit": "abc1234"}))
    for command in (["table", str(folder)], ["run", *STUDY, f"out={folder}"], ["verify", str(folder)]):
        capsys.readouterr()
        assert main(command) == 2
        one_line(capsys.readouterr().err, "format 1", "abc1234", "this one reads 2")


def test_many_small_parts_become_few_when_a_run_ends(tmp_path, whole, monkeypatch):
    """Their rows are the same, killed at whatever moment in between."""
    many = [*STUDY, "engine.width=2", f"out={tmp_path}"]
    compact = repair.merge_small_parts

    def killed(*_, **__):
        raise KeyboardInterrupt

    for module, name in ((store, "write_table"), (manifest, "rewrite_manifest"), (repair.Path, "unlink")):

        def dies(*args, module=module, name=name):
            with monkeypatch.context() as patch:
                patch.setattr(module, name, killed)
                compact(*args)

        with monkeypatch.context() as patch:
            patch.setattr(repair, "merge_small_parts", dies)
            assert main(["run", *many]) == 130
        assert content(tmp_path)["point_id"].equals(whole["point_id"])
    rows = content(tmp_path)
    assert main(["run", *many]) == 0
    pd.testing.assert_frame_equal(content(tmp_path), rows)
    assert len(list((tmp_path / store.PARTS_FOLDER).iterdir())) == len(store.list_current_parts(tmp_path)) == 1
    (tmp_path / store.list_current_parts(tmp_path)[0].file).unlink()
    assert main(["run", *many]) == 0
    pd.testing.assert_frame_equal(content(tmp_path), rows)


def test_parts_that_are_put_together_while_they_are_read_are_no_damage(folder, whole, monkeypatch):
    monkeypatch.setattr(repair, "MIN_MERGED_PARTS", 2)
    read = store.read_table

    def late(*given):
        monkeypatch.setattr(store, "read_table", read)
        repair.merge_small_parts(folder, store.read_points(folder))
        return read(*given)

    monkeypatch.setattr(store, "read_table", late)
    pd.testing.assert_frame_equal(content(folder), whole)
    assert len(store.list_current_parts(folder)) == 1


@pytest.mark.slow
def test_parts_are_put_together_without_changing_the_order_of_rows(tmp_path, monkeypatch):
    """Two engines, parts of a later extension, and gaps that are still to be run."""
    monkeypatch.setattr(repair, "MIN_MERGED_PARTS", 2)
    both = [
        *STUDY,
        "study.axes.friction.num=4",
        "+study.axes.engine={path: engine.name, values: [mjx, native]}",
        "engine.width=2",
    ]
    for part in (["--where", "friction > 1"], ["--limit", "20"], [], ["study.axes.step.num=13"]):
        with monkeypatch.context() as patch:
            patch.setattr(repair, "merge_small_parts", lambda *_: None)
            assert main(["run", *both, *part, f"out={tmp_path / 'apart'}"]) == 0
        assert main(["run", *both, *part, f"out={tmp_path / 'together'}"]) == 0
        pd.testing.assert_frame_equal(content(tmp_path / "together"), content(tmp_path / "apart"))
    apart, together = (len(store.list_current_parts(tmp_path / name)) for name in ("apart", "together"))
    assert together * 5 < apart
