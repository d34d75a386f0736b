"""`sensor_msgs/PointCloud2` as a table: named fields of known types, and a row for each item.

An item may be anything, not only a point, and a field may have several numbers in each row. A message is not trusted:
names, types, counts, offsets and lengths are checked before an array is made of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from foreglow.runtime.ros2.header import Header, byte_array, header_message, read_header

Columns: TypeAlias = Mapping[str, NDArray[Any]]
"""Arrays by the name of the field: shape (N,), or (N, K) with K numbers a row."""

MAX_ROWS = 100_000
MAX_ROW_BYTES = 65_536

DATATYPES: Mapping[int, np.dtype[Any]] = {
    PointField.INT8: np.dtype("i1"),
    PointField.UINT8: np.dtype("u1"),
    PointField.INT16: np.dtype("<i2"),
    PointField.UINT16: np.dtype("<u2"),
    PointField.INT32: np.dtype("<i4"),
    PointField.UINT32: np.dtype("<u4"),
    PointField.FLOAT32: np.dtype("<f4"),
    PointField.FLOAT64: np.dtype("<f8"),
}
_NUMBERS = {dtype: number for number, dtype in DATATYPES.items()}


@dataclass(frozen=True, slots=True)
class Field:
    """The expected form of one field.

    Attributes:
        dtype: Type of its numbers.
        count: Numbers in each row; None for any.
        is_optional: Whether it may be missing.
        is_finite: Whether every number has to be finite.
    """

    dtype: str
    count: int | None = 1
    is_optional: bool = False
    is_finite: bool = False


Layout: TypeAlias = Mapping[str, Field]


def table_message(header: Header, columns: Columns) -> PointCloud2:
    """The table as a message; a column of shape (N, 0) is left out, since a field has at least one number.

    >>> message = table_message(Header(5), {"range_m": np.array([1.5, np.nan])})
    >>> (message.fields[0].name, message.width, message.point_step)
    ('range_m', 2, 8)
    """
    kept = {name: array for name, array in columns.items() if array.shape[1:] != (0,)}
    formats = [(name, array.dtype.newbyteorder("<"), array.shape[1:]) for name, array in kept.items()]
    row = np.dtype(formats)
    num_rows = len(next(iter(kept.values()))) if kept else 0
    rows = np.empty(num_rows, row)
    for name, array in kept.items():
        rows[name] = array
    fields = [
        PointField(name=name, offset=int(row.fields[name][1]), datatype=_NUMBERS[dtype], count=int(np.prod(shape)))
        for name, dtype, shape in formats
        if row.fields is not None
    ]
    return PointCloud2(
        header=header_message(header),
        height=1,
        width=num_rows,
        fields=fields,
        is_bigendian=False,
        point_step=row.itemsize,
        row_step=row.itemsize * num_rows,
        data=byte_array(rows),
        is_dense=False,
    )


def read_table(
    message: PointCloud2, topic: str, layout: Layout, *, num_rows: int | None = None
) -> tuple[Header, dict[str, NDArray[Any]]]:
    """Header and columns of a table, in machine order and each an array of its own.

    Args:
        message: The message.
        topic: Where it was received, for errors.
        layout: The expected fields; any other one is an error.
        num_rows: The expected number of rows; None for any up to `MAX_ROWS`.

    Raises:
        ValueError: If the message is not such a table; the error names topic and field.
    """
    header = read_header(message.header, topic)
    row = _row_type(message, topic, layout)
    if message.is_bigendian:
        raise ValueError(f"{topic}: is_bigendian: expected false")
    if message.height != 1 or message.width > MAX_ROWS:
        raise ValueError(
            f"{topic}: height, width: expected 1 and at most {MAX_ROWS}, got {message.height} and {message.width}"
        )
    if num_rows is not None and message.width != num_rows:
        raise ValueError(f"{topic}: width: expected {num_rows} rows, got {message.width}")
    if message.row_step != message.width * message.point_step or len(message.data) != message.row_step:
        raise ValueError(
            f"{topic}: row_step, data: expected {message.width} x {message.point_step} bytes, got {message.row_step} "
            f"and {len(message.data)}"
        )
    rows = np.frombuffer(message.data, row) if message.width else np.zeros(0, row)
    columns: dict[str, NDArray[Any]] = {}
    for name, field in layout.items():
        if name not in (row.names or ()):
            continue
        column = np.ascontiguousarray(rows[name], rows[name].dtype.newbyteorder("="))
        if field.is_finite and not np.isfinite(column).all():
            raise ValueError(f"{topic}: {name}: expected finite numbers, got NaN or infinity")
        columns[name] = column
    return header, columns


def _row_type(message: PointCloud2, topic: str, layout: Layout) -> np.dtype[Any]:
    """The type of a row; every field has been checked to be known and to lie within the row."""
    if len(message.fields) > len(layout):
        raise ValueError(f"{topic}: fields: expected at most {len(layout)}, got {len(message.fields)}")
    if not 0 < message.point_step <= MAX_ROW_BYTES:
        raise ValueError(f"{topic}: point_step: expected 1 to {MAX_ROW_BYTES} bytes, got {message.point_step}")
    known = dict(_known(message, topic, layout))
    for name, field in layout.items():
        if name not in known and not field.is_optional:
            raise ValueError(f"{topic}: {name}: missing, expected {field.dtype}")
    formats = [form for form, _ in known.values()]
    offsets = [offset for _, offset in known.values()]
    return np.dtype({"names": list(known), "formats": formats, "offsets": offsets, "itemsize": int(message.point_step)})


def _known(message: PointCloud2, topic: str, layout: Layout) -> Iterator[tuple[str, tuple[Any, int]]]:
    """Name, type with shape, and offset of each field."""
    seen = set()
    for found in message.fields:
        field = layout.get(found.name)
        if field is None or found.name in seen:
            raise ValueError(f"{topic}: {found.name[:40]!r}: expected the fields {', '.join(layout)}, each once")
        seen.add(found.name)
        dtype = DATATYPES.get(found.datatype)
        if dtype is None or dtype != np.dtype(field.dtype):
            raise ValueError(f"{topic}: {found.name}: expected {field.dtype}, got datatype {found.datatype}")
        if found.count < 1 or (field.count is not None and found.count != field.count):
            raise ValueError(
                f"{topic}: {found.name}: expected {field.count or 'some'} numbers a row, got {found.count}"
            )
        if found.offset + found.count * dtype.itemsize > message.point_step:
            raise ValueError(
                f"{topic}: {found.name}: expected to end within {message.point_step} bytes, begins at {found.offset} "
                f"and has {found.count} numbers"
            )
        shape = (found.count,) if field.count != 1 else ()
        yield found.name, ((dtype, shape), found.offset)
