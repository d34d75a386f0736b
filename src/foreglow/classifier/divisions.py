"""What an ONNX model divides whole numbers by: a processor stops a program that divides by 0, or the least by -1.

ONNX Runtime does not look before it divides. So the divisor of whole numbers must be a constant without these. Whether
the others are floats is asked of ONNX Runtime itself, of a copy of the model that subtracts instead.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from foreglow.protobuf import protobuf_fields, whole_numbers
from foreglow.wording import shortened

_DIVISION, _LIKE_IT = b"Div", b"Sub"
"""The operation, and one of as many letters that takes and gives the same types."""

MAX_FIELDS, MAX_PACKED_BYTES = 1000, 1 << 12
"""Fields of a constant divisor of whole numbers, and bytes of one of them; a usual one is a single number."""

MAX_DIVISORS = 1000
"""That are computed, in a model."""

# Numbers of fields. Source: onnx.proto of ONNX.
_GRAPH = 7  # of a model
_NODE, _INITIALIZER, _OUTPUT = 1, 5, 12  # of a graph
_INPUT, _RESULT, _OPERATION, _ATTRIBUTE = 1, 2, 4, 5  # of a node
_NAME, _TENSOR, _BRANCHES = 1, 5, (6, 11)  # of an attribute
_DATA_TYPE, _INTEGERS, _TENSOR_NAME, _RAW = 2, (5, 7, 11), 8, 9  # of a tensor

_WHOLE = {2: "<u1", 3: "<i1", 4: "<u2", 5: "<i2", 6: "<i4", 7: "<i8", 12: "<u4", 13: "<u8"}
"""Types of elements that are whole numbers, as NumPy knows them."""
_FLOATS = frozenset({1, 10, 11, 16})  # float, float16, double, bfloat16
_FLOAT_NAMES = frozenset(f"tensor({name})" for name in ("float", "float16", "double", "bfloat16"))

EXPECTED = "expected a model that divides whole numbers by constants other than 0 and -1"


@dataclass(slots=True)
class _Values:
    """What the graphs of a model say, all together.

    Attributes:
        divisors: Names of divisors in the model's own graph, and of those in branches.
        operations: Where the names of operations that divide lie in the file.
        constants: Their tensors, by name.
        computed: Names of what other nodes than constants give.
    """

    divisors: tuple[set[bytes], set[bytes]] = field(default_factory=lambda: (set(), set()))
    operations: list[memoryview] = field(default_factory=list)
    constants: dict[bytes, list[memoryview]] = field(default_factory=dict)
    computed: set[bytes] = field(default_factory=set)


def computed_divisors(model: memoryview) -> tuple[bytes, list[str]]:
    """What to ask ONNX Runtime for a model that is well-formed otherwise.

    Returns:
        A copy of the model without divisions, whose last outputs are the divisors that are computed, which must be
        floats, and the names of these in the model; both empty if there are none.

    Raises:
        ValueError: If a divisor is a constant with 0 or -1, or is computed in a branch; the message has no path.
    """
    values = _read(model)
    doubtful = []
    for in_branch, names in enumerate(values.divisors):
        for name in sorted(names):
            tensors = values.constants.get(name, [])
            for tensor in tensors:
                _check_divisor(name, tensor)
            if name in values.computed or not tensors:
                if in_branch:
                    raise ValueError(f"{EXPECTED}, got the divisor {_shown(name)}, which is computed, in a branch")
                doubtful.append(name)
    if len(doubtful) > MAX_DIVISORS:
        raise ValueError(f"expected a model of at most {MAX_DIVISORS} divisors that are computed, got more")
    if not doubtful:
        return b"", []
    copy = bytearray(model)
    for operation in _read(memoryview(copy)).operations:
        operation[:] = _LIKE_IT
    return bytes(copy) + _outputs(doubtful), [str(name, "utf-8", "replace") for name in doubtful]


def check_types(names: Sequence[str], types: Sequence[str]) -> None:
    """Passes divisors that are floats, by what ONNX Runtime says of the outputs of `computed_divisors`.

    Raises:
        ValueError: If one is not; the message has no path.
    """
    for name, kind in zip(names, types, strict=True):
        if kind not in _FLOAT_NAMES:
            raise ValueError(f"{EXPECTED}, got the divisor {shortened(name)}, which is computed, of {shortened(kind)}")


def _read(model: memoryview) -> _Values:
    values = _Values()
    graphs = [(content, False) for number, content in _parts(model) if number == _GRAPH]
    while graphs:
        graph, in_branch = graphs.pop()
        for number, content in _parts(graph):
            if number == _NODE:
                graphs += [(branch, True) for branch in _read_node(content, values, in_branch=in_branch)]
            elif number == _INITIALIZER:
                names = [bytes(name) for inner, name in _parts(content) if inner == _TENSOR_NAME]
                for name in names[-1:]:
                    values.constants.setdefault(name, []).append(content)
    return values


def _read_node(node: memoryview, values: _Values, *, in_branch: bool) -> list[memoryview]:
    """The graphs within a node, whose own part goes into `values`."""
    lists: dict[int, list[memoryview]] = {_INPUT: [], _RESULT: [], _OPERATION: [], _ATTRIBUTE: []}
    for number, content in _parts(node):
        if number in lists:
            lists[number].append(content)
    inputs, results, operations, attributes = lists.values()
    for operation in operations:
        if operation == _DIVISION:
            values.operations.append(operation)
            values.divisors[in_branch].update(bytes(name) for name in inputs[1:])
    parts = [part for attribute in attributes for part in _parts(attribute)]
    tensors = [content for number, content in parts if number == _TENSOR]
    is_constant = [bytes(name) for name in operations] == [b"Constant"] and len(tensors) == 1
    for result in results:
        if is_constant:
            values.constants.setdefault(bytes(result), []).append(tensors[0])
        else:
            values.computed.add(bytes(result))
    return [content for number, content in parts if number in _BRANCHES]


def _check_divisor(name: bytes, tensor: memoryview) -> None:
    """ValueError unless a tensor is of floats, or of whole numbers without 0 and -1, which are in the file."""
    fields = list(itertools.islice(protobuf_fields(tensor), MAX_FIELDS))
    kinds = [value & 0xFFFFFFFF for number, value in fields if number == _DATA_TYPE and isinstance(value, int)]
    kind = kinds[-1] if kinds else 0
    if kind in _FLOATS:
        return
    if kind not in _WHOLE or len(fields) == MAX_FIELDS:
        raise ValueError(f"{EXPECTED}, got the divisor {_shown(name)} of another type")
    width, num_found = np.dtype(_WHOLE[kind]).itemsize, 0
    for number, value in fields:
        if number in _INTEGERS:
            if isinstance(value, memoryview) and len(value) > MAX_PACKED_BYTES:
                raise ValueError(f"{EXPECTED}, got more than {MAX_PACKED_BYTES} bytes of them in {_shown(name)}")
            found = np.array([each & 0xFFFFFFFFFFFFFFFF for each in whole_numbers(value)], "<u8").view("<i8")
            found = found.astype(_WHOLE[kind])  # the last bits, as protobuf and ONNX Runtime read them
        elif number == _RAW and isinstance(value, memoryview):
            found = np.frombuffer(value[: len(value) // width * width], _WHOLE[kind])
        else:
            continue
        num_found += len(found)
        if np.isin(found, np.array([0, -1]).astype(found.dtype)).any():
            raise ValueError(f"{EXPECTED}, got the divisor {_shown(name)} with 0 or -1")
    if not num_found:
        raise ValueError(f"{EXPECTED}, got the divisor {_shown(name)} without its numbers in the file")


def _outputs(names: Sequence[bytes]) -> bytes:
    """A part of a model that has these values as further outputs, under names of their own."""
    graph = b""
    for index, name in enumerate(names):
        own = f"foreglow divisor {index}".encode()
        node = _message(_INPUT, name) + _message(_RESULT, own) + _message(_OPERATION, b"Identity")
        graph += _message(_NODE, node) + _message(_OUTPUT, _message(_NAME, own))
    return _message(_GRAPH, graph) if names else b""


def _message(number: int, content: bytes) -> bytes:
    size, rest = b"", len(content)
    while rest > 0x7F:
        size += bytes([rest & 0x7F | 0x80])
        rest >>= 7
    return bytes([number << 3 | 2]) + size + bytes([rest]) + content


def _shown(name: bytes) -> str:
    return shortened(str(name, "utf-8", "replace"))


def _parts(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    return ((number, value) for number, value in protobuf_fields(message) if isinstance(value, memoryview))
