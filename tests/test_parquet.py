"""Parquet files from a stranger: small ones that expand to much, and what no table of results holds."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sweep.core.errors import InputError
from sweep.core.files import deflate_to_base64, inflate_base64
from sweep.runs import store
from sweep.runs.parquet import read_parquet

LONG = "x" * 1_000_000
FILE = "part.parquet"


def written(table, **options):
    """The bytes of a Parquet file."""
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(table), sink, compression="zstd", **options)
    return sink.getvalue()


def lying(content, truths):
    """The bytes of a Parquet file whose end gives other numbers, in as many bytes."""
    content = content.to_pybytes()
    start = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    end = content[start:]
    for true, told in truths.items():
        size = -(-(2 * true).bit_length() // 7)  # of a Thrift integer: 7 bits a byte, the sign in the lowest
        old, new = (
            bytes((2 * n >> 7 * k & 127) | (128 if k < size - 1 else 0) for k in range(size)) for n in (true, told)
        )
        assert old in end
        end = end.replace(old, new)
    return content[:start] + end


def zeros(number, **options):
    """A file of one column of zeros, without a dictionary."""
    return written({"wall_s": np.zeros(number)}, use_dictionary=False, **{"row_group_size": 2**26} | options)


def repeated(words, number):
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(number, np.int32)), words)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda: written({"stage": repeated([LONG], 100_000)}), "expand to 100,0"),  # 100 GB in 1 kB
        (lambda: written({"wall_s": repeated(pa.array([0.5]), 40_000_000)}), "expand to 320,"),
        (
            lambda: written({"stage": [LONG] * 3}, use_dictionary=False, column_encoding={"stage": "DELTA_BYTE_ARRAY"}),
            "cannot be read as a table",
        ),
        (lambda: written({"wall_s": [[1.0] * 10]}), "nested columns"),
        (lambda: written({"wall_s": [{"a": 1}]}), "nested columns"),
        (lambda: written({"wall_s": pa.array([1], pa.timestamp("us"))}), "wall_s holds no numbers"),
        (lambda: written(pa.table([[1.0], [2.0]], names=["wall_s", "wall_s"])), "two columns wall_s"),
        (lambda: written({"slip_max_m": ["much"]}), "slip_max_m holds no numbers"),
        (lambda: written({"outcome": [1.0]}), "outcome holds no words"),
        (lambda: written({"cause": ["\x1b[2Jfell"]}), "column cause holds"),
        (lambda: written({"point_id": ["../../x"]}), "column point_id holds"),
        (lambda: written({"run_id": ["ab", None]}), "column run_id lacks values"),
        (lambda: written({"a\nb": [1.0]}), "a column called"),
        (lambda: lying(zeros(36_000_000), {36_000_000: 10}), "expand to 288,"),
        (lambda: written({"stage": [LONG * 68]}, use_dictionary=False), "a page of 68,"),
        (lambda: zeros(16_000, data_page_size=8, write_batch_size=1), "more than 15,"),
        (lambda: lying(zeros(300, row_group_size=100), {300: 299}), "contradict each other"),
        (lambda: pa.py_buffer(b"PAR1" + bytes(50) + b"PAR1"), "cannot be read as a table"),
    ],
)
def test_a_file_that_is_no_table_of_results_is_refused(tmp_path, content, words):
    (tmp_path / FILE).write_bytes(content())
    taken = pa.total_allocated_bytes()
    with pytest.raises(InputError, match=words) as error:
        read_parquet(tmp_path / FILE)
    assert "\n" not in str(error.value)
    assert pa.total_allocated_bytes() - taken < 2**24


def test_a_table_is_read_as_it_was_written(tmp_path):
    rows = pd.DataFrame({"a.b": [1.0, np.nan], "a.name": ["x", "y"], "a": [1, 2], "point_id": ["0a", "0b"],
                         "outcome": ["success", ""], "limit": [None, None]})  # fmt: skip
    file = tmp_path / FILE
    file.write_bytes(written(pa.Table.from_pandas(rows, preserve_index=False)))
    pd.testing.assert_frame_equal(read_parquet(file).to_pandas(), rows)
    some = read_parquet(file, ["point_id", "a", "lacking"])
    pd.testing.assert_frame_equal(some.to_pandas(), rows[["point_id", "a"]])


def test_a_file_has_bytes_for_the_names_of_its_rows(tmp_path):
    (tmp_path / FILE).write_bytes(written({"slot": repeated(pa.array([0]), 2_000_000)}))
    assert len(read_parquet(tmp_path / FILE)) == 2_000_000  # samples of few rollouts
    with pytest.raises(InputError, match="do not name 2,000,000 rollouts"):
        read_parquet(tmp_path / FILE, has_row_names=True)


def test_all_parts_together_expand_to_no_more_than_their_size_warrants(monkeypatch):
    folder, asked = Path(__file__).parent / "data" / "ci_smoke", []
    monkeypatch.setattr(store, "check_decompressed_size", lambda path, total, size: asked.append((total, size)))
    store.read_rows(folder)
    parts = store.list_current_parts(folder)
    sizes = [store.read_table(folder, part).nbytes for part in parts]
    assert asked == [(sum(sizes[: k + 1]), sum(part.length for part in parts)) for k in range(2)]


def test_a_text_of_a_replay_expands_to_a_bounded_size(monkeypatch):
    text = deflate_to_base64(bytes(1000))
    assert inflate_base64(text) == bytes(1000)
    monkeypatch.setattr("sweep.core.files.MAX_DECODED_BYTES", 999)
    with pytest.raises(ValueError, match="expands to more than 999 bytes"):
        inflate_base64(text)
