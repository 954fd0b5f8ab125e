"""Reading of untrusted Parquet files: their expanded size is checked before memory is allocated.

A few kB of Parquet can stand for any number of rows, as repeated values take no room, and for any amount of text.
"""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq

from sweep.core.errors import InputError
from sweep.runs.parquet_pages import iterate_page_sizes
from sweep.study.columns import ID_COLUMNS, SPREADSHEET_FORMULA_SIGNS, WORD_COLUMNS

arrow_compute: Any = pyarrow.compute  # whose functions exist only once it is imported
# a file may expand to ALWAYS_ALLOWED bytes; to more only up to MAX_RATIO times its size, and never beyond MAX_EXPANSION
ALWAYS_ALLOWED, MAX_EXPANSION, MAX_RATIO = 256 * 2**20, 64 * 2**30, 1000
FEW_PAGES, LEAST_PAGE = 10_000, 256  # a file may have FEW_PAGES pages; more only of LEAST_PAGE bytes on average
MAX_COLUMNS = 10_000  # columns of a table
FEW_ROWS = 1_000_000  # a table of rollouts may have as many rows; more only with a byte for each, as ids take 8
BYTES_BY_TYPE = {
    "BOOLEAN": 1,
    "INT32": 4,
    "FLOAT": 4,
    "INT64": 8,
    "DOUBLE": 8,
    "BYTE_ARRAY": 4,
}  # bytes; of text its number
TEXT_TYPE = "BYTE_ARRAY"
HEX_NAME = "^[0-9a-f]{1,64}$"  # of `NAMES`
PRINTABLE = (
    rf"^([^{re.escape(SPREADSHEET_FORMULA_SIGNS)}\pC]\PC*)?$"  # of other words: no control characters, and no formula
)


def read_parquet(
    path: Path, columns: Sequence[str] | None = None, has_row_names: bool = False, max_rows: int | None = None
) -> pa.Table:
    """Read a Parquet file with columns of numbers and words as an Arrow table.

    Args:
        path: The file. Columns that are not asked for are not read.
        columns: Names of the columns to read, in this order; None for all. Those that the file lacks are left out.
        has_row_names: Whether each row has an id of its own, as rollouts do and samples of a rollout do not.
        max_rows: Largest number of rows; None for any.

    Returns:
        The table, with words as Arrow strings.

    Raises:
        InputError: The file is no such table, or expands to more than its size warrants.
    """
    try:
        with pa.OSFile(os.fsencode(path)) as source:
            metadata, size = pq.read_metadata(source), source.size()
            if has_row_names and metadata.num_rows > max(FEW_ROWS, size):
                raise InputError(
                    f"{path} is not allowed: its {size:,} bytes do not name {metadata.num_rows:,} rollouts"
                )
            if max_rows is not None and metadata.num_rows > max_rows:
                raise InputError(
                    f"{path} is not allowed: it has {metadata.num_rows:,} rows; the study's plan allows {max_rows:,}"
                )
            names = column_names(path, metadata)
            chosen = names if columns is None else [name for name in dict.fromkeys(columns) if name in names]
            words = _check_sizes(path, source, metadata, [names.index(name) for name in chosen])
            # as dictionaries, so that repeated words take no memory until their size is known; this also refuses
            # encodings that repeat words in another way
            file = pq.ParquetFile(source, metadata=metadata, read_dictionary=words)
            # of the columns that are read each is selected, as `b` is also taken for the column `b.c`
            numbers = [name for name in chosen if name not in words]
            table = file.read(columns=numbers).select(numbers)
            for name in words:  # one by one, as they take the most memory
                column = file.read(columns=[name])[name]
                check_decompressed_size(path, table.nbytes + _count_bytes(column), size)
                table = table.append_column(name, _decode_words(path, name, column))
        _check_types(path, table)
        pa.default_memory_pool().release_unused()
        return table.select(chosen).replace_schema_metadata(None)
    except InputError:
        raise
    except (pa.ArrowException, OSError, KeyError, ValueError) as error:
        raise InputError(f"{path} cannot be read as a table: {str(error).splitlines()[0]}") from None


def column_names(path: Path, metadata: pq.FileMetaData) -> list[str]:
    """Return the column names of a Parquet file.

    Args:
        path: Where the file is from, for messages.
        metadata: The end of the file, which describes it.

    Raises:
        InputError: There are too many, two columns have one name, or a column has parts.
    """
    if metadata.num_columns > MAX_COLUMNS:
        raise InputError(f"{path} is not allowed: it has {metadata.num_columns:,} columns, at most {MAX_COLUMNS:,}")
    names = [metadata.schema.column(k).path for k in range(metadata.num_columns)]
    if list(metadata.schema.names) != names:
        raise InputError(f"{path} is not allowed: it has nested columns")
    if odd := next((name for name in names if not name.isprintable() or name[:1] in SPREADSHEET_FORMULA_SIGNS), None):
        raise InputError(f"{path} is not allowed: it has a column called {odd[:100]!r}")
    if len({*names}) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{path} is not allowed: it has two columns {twice}")
    return names


def decoded_schema(schema: pa.Schema) -> pa.Schema:
    """Return the names and types that `read_parquet` gives to the columns of a file.

    Args:
        schema: Arrow schema of the file.
    """
    words = (pa.types.is_string, pa.types.is_large_string, pa.types.is_dictionary)
    types = [pa.large_string() if any(is_kind(one.type) for is_kind in words) else one.type for one in schema]
    return pa.schema([*zip(schema.names, types, strict=True)])


def check_decompressed_size(path: Path, total: int, size: int) -> None:
    """Raise an error if a file expands to more memory than its size warrants.

    Args:
        path: The file, or the folder of several, for messages.
        total: What they expand to (bytes).
        size: What they take on disk (bytes).

    Raises:
        InputError: `total` is too large.
    """
    if total > (room := max(ALWAYS_ALLOWED, min(MAX_EXPANSION, MAX_RATIO * size))):
        raise InputError(
            f"{path} is not allowed: its {size:,} bytes expand to {total:,} or more; at most {room:,}, or {MAX_RATIO} "
            "times its size"
        )


def _check_sizes(path: Path, source: pa.OSFile, metadata: pq.FileMetaData, chosen: Sequence[int]) -> list[str]:
    """Refuse columns that expand too far by what their pages declare; return the names of those with words."""
    words, total, pages, size = [], 0, 0, source.size()
    for k in chosen:
        column = metadata.schema.column(k)
        if column.max_repetition_level or column.max_definition_level > 1 or column.physical_type not in BYTES_BY_TYPE:
            raise InputError(f"{path} is not allowed: column {column.name} holds neither numbers nor words")
        if column.physical_type == TEXT_TYPE:
            words.append(column.name)
    groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
    numbers = [group.num_rows for group in groups]
    if min(numbers, default=0) < 0 or sum(numbers) != metadata.num_rows:
        raise InputError(f"{path} is damaged: its numbers of rows contradict each other")
    for group in groups:
        for k in chosen:
            column = group.column(k)
            if column.num_values != group.num_rows:
                raise InputError(f"{path} is damaged: its columns differ in length")
            total += column.num_values * BYTES_BY_TYPE[column.physical_type]
            starts = (column.data_page_offset, column.dictionary_page_offset or column.data_page_offset)
            for page in iterate_page_sizes(source, min(starts), column.total_compressed_size):
                total, pages = total + page, pages + 1
                if pages > FEW_PAGES + size // LEAST_PAGE:
                    raise InputError(f"{path} is not allowed: its {size:,} bytes have more than {pages - 1:,} pages")
    check_decompressed_size(path, total, size)
    return words


def _count_bytes(column: pa.ChunkedArray) -> int:
    """Return what a column of dictionaries takes once it holds its words (bytes)."""
    total = column.nbytes
    for chunk in column.chunks:
        sizes = arrow_compute.fill_null(arrow_compute.binary_length(chunk.dictionary), 0)
        total += arrow_compute.sum(arrow_compute.take(sizes, chunk.indices)).as_py() or 0
    return total


def _decode_words(path: Path, name: str, column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Replace dictionaries by their words, which are UTF-8 that a terminal can print."""
    for chunk in column.chunks:
        chunk.dictionary.validate(full=True)
        allowed = arrow_compute.match_substring_regex(chunk.dictionary, HEX_NAME if name in ID_COLUMNS else PRINTABLE)
        odd = chunk.dictionary.filter(arrow_compute.invert(arrow_compute.fill_null(allowed, True)))
        if len(odd):
            raise InputError(f"{path} is not allowed: column {name} holds {str(odd[0])[:100]!r}")
    return column.cast(pa.large_string())


def _check_types(path: Path, table: pa.Table) -> None:
    """Refuse words where numbers belong, the other way round, and rows without a name."""
    for field in table.schema:
        words = field.name in (*ID_COLUMNS, *WORD_COLUMNS) or ("." in field.name and not _is_number(field.type))
        fits = pa.types.is_large_string(field.type) if words else _is_number(field.type)
        if not fits and not (pa.types.is_null(field.type) and field.name not in ID_COLUMNS):
            raise InputError(f"{path} is not allowed: column {field.name} holds no {'words' if words else 'numbers'}")
        if field.name in ID_COLUMNS and table[field.name].null_count:
            raise InputError(f"{path} is not allowed: column {field.name} lacks values")


def _is_number(kind: pa.DataType) -> bool:
    return pa.types.is_boolean(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind)
