"""The networks in torch. Importing this module needs the `train` extra."""

from __future__ import annotations

import copy
from collections.abc import Callable

import torch
from torch import Tensor, nn

from foreglow.classifier.inputs import InputSpec
from foreglow.lab.learning.recipes import Recipe


class ArtifactNetwork(nn.Module):
    """The paper's classifier: is the light artifact in this crop the light of an oncoming vehicle?

    Reads crops (N, 1, 64, 64) in [0, 1], writes logits (N, 1). No convolution is padded. Batch normalisation follows
    ReLU and pooling, as in the published code, and parameters have the names of that code.

    Source: Ewecker et al., arXiv 2107.11302, figure of the network; the published code for what it leaves open.
    """

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(1, 32, 5)
        self.conv2 = nn.Conv2d(32, 64, 3, bias=False)
        self.batch2 = nn.BatchNorm2d(64)
        self.conv3 = nn.Conv2d(64, 64, 5)
        self.conv4 = nn.Conv2d(64, 128, 3, bias=False)
        self.batch4 = nn.BatchNorm2d(128)
        self.conv5 = nn.Conv2d(128, 128, 5)
        self.conv6 = nn.Conv2d(128, 256, 3, bias=False)
        self.batch6 = nn.BatchNorm2d(256)
        self.int_out = nn.ModuleDict(
            {"afc1": nn.Linear(256, 128), "afc2": nn.Linear(128, 64), "afc3": nn.Linear(64, 1)}
        )
        self.dropout = nn.Dropout(0.2)

    def forward(self, crops: Tensor, features: Tensor | None = None) -> Tensor:  # noqa: ARG002
        """One logit for each crop; features are not used."""
        x = torch.relu(self.conv1(crops))  # 60
        # ReLU after the pooling gives the same values and gradients as before it, from a quarter of the pixels.
        x = self.batch2(torch.relu(nn.functional.max_pool2d(self.conv2(x), 2)))  # 58 -> 29
        x = torch.relu(self.conv3(x))  # 25
        x = self.batch4(torch.relu(nn.functional.max_pool2d(self.conv4(x), 2)))  # 23 -> 11
        x = torch.relu(self.conv5(x))  # 7
        x = self.batch6(nn.functional.avg_pool2d(torch.relu(self.conv6(x)), 5))  # 5 -> 1
        x = self.dropout(torch.relu(self.int_out["afc1"](x.flatten(1))))
        x = torch.relu(self.int_out["afc2"](x))
        logits: Tensor = self.int_out["afc3"](x)
        return logits


class CompactNetwork(nn.Module):
    """Our classifier for one processor core: 1.3 million multiply-adds for each crop.

    Reads crops (N, C, 32, 32) in [0, 1] and features (N, F), see `classifier.inputs`; writes logits (N, 1) of being
    light, or (N, 5) of the kinds of light. Instead of global pooling, the last layer keeps the
    position in the crop, since the box is always in its middle.
    """

    def __init__(self, num_channels: int, num_features: int, num_outputs: int = 1) -> None:
        super().__init__()
        self.body = nn.Sequential(
            *_block(num_channels, 16, 5, stride=2),  # 32 -> 16
            *_block(16, 32, 3, stride=2),  # 8
            *_block(32, 32, 3),
            *_block(32, 32, 3, stride=2),  # 4
        )
        self.hidden = nn.Linear(32 * 4 * 4 + num_features, 48)
        self.dropout = nn.Dropout(0.2)
        self.last = nn.Linear(48, num_outputs)

    def forward(self, crops: Tensor, features: Tensor) -> Tensor:
        """The logits of each crop."""
        x = torch.cat([self.body(crops).flatten(1), features], dim=1)
        logits: Tensor = self.last(self.dropout(torch.relu(self.hidden(x))))
        return logits


def _block(inputs: int, outputs: int, side: int, stride: int = 1) -> list[nn.Module]:
    convolution = nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False)
    return [convolution, nn.BatchNorm2d(outputs), nn.ReLU()]


NETWORKS: dict[str, Callable[[InputSpec, int], nn.Module]] = {
    "paper": lambda spec, num_outputs: ArtifactNetwork(),  # noqa: ARG005
    "compact": lambda spec, num_outputs: CompactNetwork(spec.num_channels, spec.num_features, num_outputs),
}
"""Untrained networks by name, for given inputs and a given number of logits."""


def recipe_network(recipe: Recipe) -> nn.Module:
    """The untrained network that the recipe names.

    Raises:
        ValueError: If there is no such network, or it cannot read the recipe's inputs.
    """
    if recipe.network not in NETWORKS:
        raise ValueError(f"recipe: network: expected one of {', '.join(NETWORKS)}, got {recipe.network!r}")
    spec, network = recipe.inputs, NETWORKS[recipe.network](recipe.inputs, recipe.num_outputs)
    try:
        with torch.inference_mode():
            crops = torch.zeros(2, spec.num_channels, spec.size_px, spec.size_px)
            logits = copy.deepcopy(network).eval()(crops, torch.zeros(2, spec.num_features))
    except RuntimeError as error:
        raise ValueError(f"recipe: inputs: the network {recipe.network} cannot read {spec}: {error}") from error
    if logits.shape[1] != recipe.num_outputs:
        raise ValueError(f"recipe: kinds: expected false, the network {recipe.network} does not tell kinds, got true")
    return network
