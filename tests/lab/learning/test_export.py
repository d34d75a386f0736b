"""The ONNX graph computes what the layers say, in every arrangement, and files are written whole or not at all."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

import torch

from foreglow.lab.learning.export import build_onnx, layers_from_state, phase_filters, write_onnx
from foreglow.lab.learning.folding import render_probes
from tests.lab.learning.networks import onnx_logits, random_layers, random_network, torch_logits

pytestmark = pytest.mark.torch


@pytest.mark.parametrize(
    "channels",
    [
        (5, 8, 27, 11, 56, 3, 128, 12),  # conv1, conv2 and conv4 in phases
        (9, 8, 9, 11, 9, 3, 20, 8),  # the same with conv1 in four phases
        (5, 13, 9, 5, 9, 3, 20, 8),  # conv4 in phases alone
        (13, 6, 8, 14, 5, 2, 4, 3),  # conv2 in phases without conv1
        (14, 18, 22, 13, 17, 9, 6, 5),  # no phases
        (1, 1, 1, 1, 1, 1, 1, 1),
    ],
)
def test_onnx_equals_definition(channels: tuple[int, ...]) -> None:
    layers = random_layers(channels)
    crops = render_probes(3, 64, seed=1)
    logits = onnx_logits(build_onnx(layers, {}).SerializeToString(), crops)
    np.testing.assert_allclose(logits, torch_logits(layers, crops), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("reads", "writes"), [((1, 1), (1, 1)), ((1, 1), (2, 2)), ((1, 2), (2, 2)), ((2, 2), (2, 2)), ((1, 1), (1, 3))]
)
def test_filters_in_phases_compute_the_same_convolution(reads: tuple[int, int], writes: tuple[int, int]) -> None:
    generator = np.random.default_rng(4)
    weight, image = generator.normal(size=(3, 2, 3, 3)), generator.normal(size=(1, 2, 14, 14))
    expected = torch.nn.functional.conv2d(torch.from_numpy(image), torch.from_numpy(weight))
    filters = torch.from_numpy(phase_filters(weight, reads, writes))
    stride = (writes[0] // reads[0], writes[1] // reads[1])
    result = torch.nn.functional.conv2d(in_phases(torch.from_numpy(image), reads), filters, stride=stride)
    np.testing.assert_allclose(result.numpy(), in_phases(expected, writes).numpy(), atol=1e-12)


def in_phases(image: torch.Tensor, phases: tuple[int, int]) -> torch.Tensor:
    """Each pixel of a block as channels of its own, phase by phase, rows first."""
    rows, columns = phases
    return torch.cat([image[:, :, row::rows, column::columns] for row in range(rows) for column in range(columns)], 1)


def test_onnx_equals_network_with_batch_normalisation() -> None:
    network = random_network()
    layers = layers_from_state({name: value.numpy() for name, value in network.state_dict().items()})
    crops = render_probes(3, 64, seed=2)
    with torch.no_grad():
        expected = network(torch.from_numpy(crops))[:, 0].numpy()
    logits = onnx_logits(build_onnx(layers, {}).SerializeToString(), crops)
    np.testing.assert_allclose(logits, expected, rtol=1e-5, atol=1e-5)


def test_figures_of_the_paper() -> None:
    """942,209 parameters with batch normalisation, of which 2 x 448 merge into 448 biases; 195.37 M multiply-adds."""
    layers = layers_from_state({name: value.numpy() for name, value in random_network().state_dict().items()})
    assert layers.num_channels == (32, 64, 64, 128, 128, 256, 128, 64)
    assert layers.num_parameters == 942_209 - 2 * 448 + 448
    assert layers.num_multiply_adds == 195_371_584


def test_equal_layers_give_equal_bytes(tmp_path: Path) -> None:
    layers = random_layers((5, 8, 9, 5, 9, 3, 4, 4))
    for name in ("a.onnx", "b.onnx"):
        write_onnx(layers, tmp_path / name, {"source": "x", "another": "y"})
    assert (tmp_path / "a.onnx").read_bytes() == (tmp_path / "b.onnx").read_bytes()


def test_failed_write_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "model.onnx"
    path.write_text("old")

    def refuse(self: Path, target: Path) -> None:  # noqa: ARG001
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OSError, match="No space"):
        write_onnx(random_layers((1,) * 8), path, {})
    assert [file.name for file in tmp_path.iterdir()] == ["model.onnx"]
    assert path.read_text() == "old"
