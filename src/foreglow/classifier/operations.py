"""What an ONNX model consists of: only operations on tensors of numbers, whose memory ONNX Runtime bounds.

Texts, sequences and maps take memory from elsewhere, so a few hundred bytes may ask for any amount, and so do the
places that `NonZero` finds, instead of which `Compress` takes what it finds; loops take any time; functions may call
each other.
"""

from __future__ import annotations

from collections.abc import Iterator

from foreglow.protobuf import protobuf_fields
from foreglow.wording import shortened

MAX_NODES = 10_000
"""Operations of a model; ours has some 100, and ResNet-152 some 500."""

_NAMES = (
    "Abs Acos Acosh Add AffineGrid And ArgMax ArgMin Asin Asinh Atan Atanh Attention AveragePool "
    "BatchNormalization BitShift BitwiseAnd BitwiseNot BitwiseOr BitwiseXor Cast CastLike Ceil Celu CenterCropPad "
    "Clip Col2Im Compress Concat Constant ConstantOfShape Conv ConvInteger ConvTranspose Cos Cosh CumSum DFT "
    "DeformConv DepthToSpace DequantizeLinear Det Div Dropout DynamicQuantizeLinear Einsum Elu Equal Erf Exp "
    "Expand EyeLike Flatten Floor GRU Gather GatherElements GatherND Gelu Gemm GlobalAveragePool GlobalLpPool "
    "GlobalMaxPool Greater GreaterOrEqual GridSample GroupNormalization HardSigmoid HardSwish Hardmax Identity If "
    "InstanceNormalization IsInf IsNaN LRN LSTM LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax "
    "LpNormalization LpPool MatMul MatMulInteger Max MaxPool MaxRoiPool MaxUnpool Mean MeanVarianceNormalization "
    "Min Mish Mod Mul Neg Not OneHot Or PRelu Pad Pow QLinearConv QLinearMatMul QuantizeLinear RMSNormalization "
    "RNN Range Reciprocal ReduceL1 ReduceL2 ReduceLogSum ReduceLogSumExp ReduceMax ReduceMean ReduceMin "
    "ReduceProd ReduceSum ReduceSumSquare Relu Reshape Resize ReverseSequence RoiAlign RotaryEmbedding Round "
    "Scatter ScatterElements ScatterND Selu Shape Shrink Sigmoid Sign Sin Sinh Size Slice Softmax Softplus "
    "Softsign SpaceToDepth Split Sqrt Squeeze Sub Sum Swish Tan Tanh ThresholdedRelu Tile TopK Transpose Trilu "
    "Unsqueeze Upsample Where Xor"
)

OPERATIONS = frozenset(_NAMES.split())
"""Those of ONNX's own domain that a network may need and that neither repeat others nor make anything but numbers."""

DOMAINS = ("", "ai.onnx")
"""Names of ONNX's own domain."""

# Numbers of fields. Source: onnx.proto of ONNX.
_GRAPH, _FUNCTIONS = 7, 25  # of a model
_NODE, _INITIALIZER, _SPARSE_INITIALIZER = 1, 5, 15  # of a graph
_VALUES = (11, 12, 13)  # of a graph: inputs, outputs and others
_OPERATION, _ATTRIBUTE, _DOMAIN = 4, 5, 7  # of a node
_NAME, _INTEGER = 1, 3  # of an attribute
_TENSORS, _BRANCHES, _SPARSE, _TYPES = (5, 10), (6, 11), (22, 23), (14, 15)  # of an attribute
_DATA_TYPE = 2  # of a tensor
_TYPE = 2  # of a value
_TENSOR_TYPE, _DENOTATION = 1, 6  # of a type
_ELEMENT = 1  # of a type of a tensor
_STRING = 8  # a type of elements


def check_operations(model: memoryview) -> None:
    """Passes a model of few operations, all on tensors of numbers.

    Raises:
        ValueError: If the file is malformed, or the model has too many operations, others than `OPERATIONS`, functions
            of its own, or values other than dense tensors of numbers; the message has no path.
    """
    graphs = []
    for number, content in _parts(model):
        if number == _FUNCTIONS:
            raise ValueError("expected a model without functions of its own, which onnx.inliner resolves")
        if number == _GRAPH:
            graphs.append(content)
    num_nodes = 0
    while graphs:
        for number, content in _parts(graphs.pop()):
            if number == _NODE:
                num_nodes += 1
                if num_nodes > MAX_NODES:
                    raise ValueError(f"expected a model of at most {MAX_NODES} operations, got more")
                graphs += _checked_node(content)
            elif number == _INITIALIZER:
                _check_tensor(content)
            elif number == _SPARSE_INITIALIZER:
                raise _unexpected("a sparse tensor")
            elif number in _VALUES:
                for inner, kind in _parts(content):
                    if inner == _TYPE:
                        _check_type(kind)


def _checked_node(node: memoryview) -> list[memoryview]:
    """The graphs within a node."""
    names, attributes = [], []
    for number, content in _parts(node):
        if number == _OPERATION:
            names.append(_text(content))
        elif number == _DOMAIN and _text(content) not in DOMAINS:
            raise _unexpected(f"an operation of the domain {shortened(_text(content))}")
        elif number == _ATTRIBUTE:
            attributes.append(content)
    for name in names:
        if name not in OPERATIONS:
            raise ValueError(
                f"expected a model of operations on numbers, without loops, got the operation {shortened(name)}"
            )
    branches = []
    for attribute in attributes:
        for number, value in _fields(attribute):
            if isinstance(value, int):
                if number == _INTEGER and "Cast" in names and _is_string(value):
                    raise _unexpected("a Cast to texts")
            elif number == _NAME:
                if "Constant" in names and _text(value) in ("value_string", "value_strings"):
                    raise _unexpected("a Constant of texts")
            elif number in _BRANCHES:
                branches.append(value)
            elif number in _TENSORS:
                _check_tensor(value)
            elif number in _SPARSE:
                raise _unexpected("a sparse tensor")
            elif number in _TYPES:
                _check_type(value)
    return branches


def _check_tensor(tensor: memoryview) -> None:
    for number, value in _fields(tensor):
        if number == _DATA_TYPE and isinstance(value, int) and _is_string(value):
            raise _unexpected("a tensor of texts")


def _check_type(kind: memoryview) -> None:
    for number, content in _parts(kind):
        if number == _TENSOR_TYPE:
            for inner, value in _fields(content):
                if inner == _ELEMENT and isinstance(value, int) and _is_string(value):
                    raise _unexpected("a tensor of texts")
        elif number != _DENOTATION:
            raise _unexpected("a value that is a sequence, a map, optional or sparse")


def _is_string(element: int) -> bool:
    """Whether a type of elements is that of texts, in the 32 bits that protobuf reads of it."""
    return element & 0xFFFFFFFF == _STRING


def _unexpected(found: str) -> ValueError:
    return ValueError(f"expected a model of dense tensors of numbers and ONNX's own operations, got {found}")


def _text(content: memoryview) -> str:
    return str(content, "utf-8", "replace")


def _parts(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """The fields of a message but for its numbers."""
    return ((number, value) for number, value in _fields(message) if isinstance(value, memoryview))


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    try:
        yield from protobuf_fields(message)
    except ValueError as error:
        raise ValueError(f"expected an ONNX model that can be run: {error}") from error
