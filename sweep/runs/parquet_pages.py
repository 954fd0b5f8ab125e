"""Uncompressed sizes that the pages of a Parquet file declare, read without decompressing them.

The end of a Parquet file repeats these sizes for each column, and Arrow neither compares the two nor limits a page: 50
kB may declare 1 kB there and unpack to 2 GB. The headers of pages are Thrift structs in the compact protocol
(https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md), of which this reads as much as is
needed to find the next page.
"""

from collections.abc import Iterator
from typing import Any

UNCOMPRESSED_SIZE, COMPRESSED_SIZE = 2, 3  # numbers of a header's fields
TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, MAP, STRUCT = range(1, 13)  # types of Thrift's fields
FIRST_READ, LONGEST_HEADER = 512, 2**16  # bytes; Arrow writes statistics of up to 4 kB
LARGEST_PAGE = 2**26  # bytes; Arrow begins a new page after 1 MB
DEEPEST = 8  # structs and lists in each other; those of a page have 3


def iterate_page_sizes(source: Any, start: int, length: int) -> Iterator[int]:
    """Yield the uncompressed size (bytes, header included) that each page of a column chunk declares.

    Args:
        source: The open file, an Arrow file with `read_at`.
        start: Offset of the first page (bytes).
        length: Length of all pages (bytes).

    Raises:
        ValueError: The chunk is not made of pages.
    """
    place, end = start, start + length
    while place < end:
        fields, header = _read_header(source, place, end)
        packed, unpacked = fields.get(COMPRESSED_SIZE, -1), fields.get(UNCOMPRESSED_SIZE, -1)
        if packed < 0 or unpacked < 0:
            raise ValueError("a page without a size")
        if unpacked > LARGEST_PAGE:
            raise ValueError(f"a page of {unpacked:,} bytes, at most {LARGEST_PAGE:,}")
        yield header + unpacked
        place += header + packed
    if place != end:
        raise ValueError("its pages are longer than declared")


def _read_header(source: Any, place: int, end: int) -> tuple[dict[int, int], int]:
    """Return the whole numbers among a header's fields by their number, and the length of the header (bytes)."""
    wanted = FIRST_READ
    while True:
        content = source.read_at(min(wanted, end - place), place)
        try:
            return _parse_struct(content, 0, 0)
        except IndexError:  # it goes on behind what was read
            if wanted >= min(LONGEST_HEADER, end - place):
                raise ValueError("a page's header is damaged") from None
        wanted *= 8


def _parse_struct(content: bytes, place: int, depth: int) -> tuple[dict[int, int], int]:
    """Return the whole numbers among a struct's fields by their number, and the place behind it."""
    fields: dict[int, int] = {}
    number = 0
    while kind := content[place]:
        place += 1
        if step := kind >> 4:
            number += step
        else:
            number, place = _parse_integer(content, place)
        if kind & 15 in (I16, I32, I64):
            fields[number], place = _parse_integer(content, place)
        elif kind & 15 not in (TRUE, FALSE):  # whose value is their type
            place = _skip(content, place, kind & 15, depth + 1)
    return fields, place + 1


def _skip(content: bytes, place: int, kind: int, depth: int) -> int:
    """Return the place behind a value of any type."""
    if depth > DEEPEST:
        raise ValueError("a page's header is nested too deeply")
    if kind in (TRUE, FALSE, BYTE):
        return place + 1
    if kind in (I16, I32, I64):
        return _parse_integer(content, place)[1]
    if kind == DOUBLE:
        return place + 8
    if kind == BINARY:
        size, place = _parse_unsigned(content, place)
        return place + size
    if kind in (LIST, SET):
        size, kind, place = content[place] >> 4, content[place] & 15, place + 1
        if size == 15:
            size, place = _parse_unsigned(content, place)
        for _ in range(size):
            place = _skip(content, place, kind, depth + 1)
            content[place - 1]  # a size that is too large ends here
        return place
    if kind == STRUCT:
        return _parse_struct(content, place, depth)[1]
    raise ValueError("a page's header is damaged")


def _parse_integer(content: bytes, place: int) -> tuple[int, int]:
    """Return a whole number that may be negative (zigzag), and the place behind it."""
    value, place = _parse_unsigned(content, place)
    return (value >> 1) ^ -(value & 1), place


def _parse_unsigned(content: bytes, place: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[place]
        place += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, place
        if shift > 63:
            raise ValueError("a page's header is damaged")
