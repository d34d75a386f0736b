"""The networks in torch. Importing this module needs the `train` extra."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from foreglow.classifier.inputs import FEATURES, NUMS_FEATURES, InputSpec
from foreglow.lab.learning.recipes import Recipe


class ArtifactNetwork(nn.Module):
    """The paper's classifier: is the light artifact in this crop the light of an oncoming vehicle?

    Reads crops (N, 1, 64, 64) in [0, 1], writes logits (N, 1). No convolution is padded. Batch normalisation follows
    ReLU and pooling, as in the published code, and parameters have the names of that code.

    Source: Ewecker et al., arXiv 2107.11302, figure of the network; the published code for what it leaves open.
    """

    SIZE_PX = 64
    """Side of its crops."""

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

    SIZE_PX = 32
    """Side of its crops."""

    def __init__(self, num_channels: int, num_features: int, num_outputs: int = 1) -> None:
        super().__init__()
        self.body = nn.Sequential(
            *_block(num_channels, 16, 5, stride=2),  # 32 -> 16
            *_block(16, 32, 3, stride=2),  # 8
            *_block(32, 32, 3),
            *_block(32, 32, 3, stride=2),  # 4
        )
        self.num_features = num_features
        self.hidden = nn.Linear(32 * 4 * 4 + num_features, 48)
        self.dropout = nn.Dropout(0.2)
        self.last = nn.Linear(48, num_outputs)

    def forward(self, crops: Tensor, features: Tensor) -> Tensor:
        """The logits of each crop."""
        x = torch.cat([self.body(crops).flatten(1), features], dim=1)
        logits: Tensor = self.last(self.dropout(torch.relu(self.hidden(x))))
        return logits


class RelatedNetwork(CompactNetwork):
    """The compact network, whose boxes know of one another: lamps come in pairs, street lamps in rows.

    Boxes of a frame exchange messages, twice. What box j tells box i depends on what both are like, and on how their
    places, sizes and levels differ. A box hears the mean and the maximum of what it is told:

        m_ij = relu(A h_i + B h_j + C g_ij),    h_i <- h_i + relu(D [h_i, mean_j m_ij, max_j m_ij])

    Reads crops (N, C, 32, 32) and all ten features (N, 10); writes logits (N, 1) or (N, 5).

    Source: message passing, Gilmer et al., arXiv 1704.01212.
    """

    NUM_ROUNDS = 2
    NUM_TOLD = 32
    COMPARED = tuple(FEATURES.index(name) for name in ("side", "row", "width", "height", "darkest", "brightest"))
    """The features whose differences are in g_ij, beside three functions of the distance."""
    SCALES = (0.5, 0.5, 1.0, 1.0, 1.0, 1.0)
    """Places are compared in half widths of the frame."""
    LEAST_SQUARE = 1e-5
    """Added to the square of the distance, so that its logarithm is finite."""

    def __init__(self, num_channels: int, num_features: int, num_outputs: int = 1) -> None:
        super().__init__(num_channels, num_features, num_outputs)
        size = self.hidden.out_features
        self.place = nn.Linear(num_features, size)
        self.rounds = nn.ModuleList(Round(size, self.NUM_TOLD, len(self.COMPARED) + 3) for _ in range(self.NUM_ROUNDS))
        self.hearing = Hearing()

    def forward(self, crops: Tensor, features: Tensor, sizes: Sequence[int] | None = None) -> Tensor:
        """The logits of each crop.

        Args:
            crops: Shape (N, C, 32, 32).
            features: Shape (N, 10).
            sizes: Numbers of boxes of each frame, which sum to N; None if all are of one.
        """
        if not len(crops):
            return features.new_zeros(0, self.last.out_features)
        x = torch.cat([self.body(crops).flatten(1), features], dim=1)
        hidden = torch.relu(self.hidden(x)) + self.place(features)
        is_there = _is_there([len(crops)] if sizes is None else sizes, crops.device)
        compared = _padded(features[:, list(self.COMPARED)] * features.new_tensor(self.SCALES), is_there)
        relations = self._relations(compared)
        is_heard = self.hearing(is_there).to(features.dtype)[..., None]
        hidden = _padded(hidden, is_there)
        for each in self.rounds:
            hidden = each(hidden, relations, is_heard)
        logits: Tensor = self.last(self.dropout(hidden[is_there]))
        return logits

    def _relations(self, compared: Tensor) -> Tensor:
        """g_ij of what is compared, shape (B, N, 6): shape (B, N, N, 9)."""
        differences = compared[:, None] - compared[:, :, None]
        across, along = differences[..., :1], differences[..., 1:2]
        distances = (across**2 + along**2 + self.LEAST_SQUARE).sqrt()
        return torch.cat([differences, across.abs(), torch.log2(distances) / 8, torch.exp(-8 * distances)], dim=-1)


class BothNetwork(nn.Module):
    """The mean of the logits of two networks: one judges each box alone, the other those of a frame together.

    Either is wrong where the other is not: a light alone on a dark road, or one street lamp of a row. In training
    each learns for itself, since networks that learnt their mean would no longer differ.

    Many boxes hold no light of a vehicle, as the first network alone can tell. In use the second neither judges nor
    hears those whose logit is below `LEAST_LOGIT`, which saves some of its time; each frame has one that it judges.

    Reads crops (N, C, 32, 32) and all ten features (N, 10), of which the first reads nine; writes logits (N, 1) or
    (N, 5).
    """

    NUM_FEATURES_ALONE = NUMS_FEATURES[-2]
    LEAST_LOGIT = -5.0
    """Of being light: a score of .007. Were the second network's as high as .97, the mean would be .3."""

    def __init__(self, num_channels: int, num_features: int, num_outputs: int = 1) -> None:
        super().__init__()
        self.alone = CompactNetwork(num_channels, self.NUM_FEATURES_ALONE, num_outputs)
        self.related = RelatedNetwork(num_channels, num_features, num_outputs)

    @property
    def members(self) -> tuple[CompactNetwork, RelatedNetwork]:
        """The two networks."""
        return self.alone, self.related

    def forward(self, crops: Tensor, features: Tensor, sizes: Sequence[int] | None = None) -> Tensor:
        """The logits of each crop; arguments are those of `RelatedNetwork`."""
        logits: Tensor = self.alone(crops, features[:, : self.NUM_FEATURES_ALONE]).clone()
        frames = [size for size in ([len(crops)] if sizes is None else sizes) if size]
        if not frames:
            return logits
        lights = torch.split(light_of(logits.detach()), frames)
        are_shown = [light >= light.max().clamp(max=self.LEAST_LOGIT) for light in lights]
        is_shown = torch.cat(are_shown)
        related = self.related(crops[is_shown], features[is_shown], [int(each.sum()) for each in are_shown])
        logits[is_shown] = (logits[is_shown] + related) / 2
        return logits

    def learnt(self, crops: Tensor, features: Tensor, sizes: Sequence[int] | None = None) -> tuple[Tensor, ...]:
        """The logits of which each has a loss in training: those of either network."""
        alone: Tensor = self.alone(crops, features[:, : self.NUM_FEATURES_ALONE])
        related: Tensor = self.related(crops, features, sizes)
        return alone, related


COMPARING = (RelatedNetwork, BothNetwork)
"""The networks that compare the boxes of a frame."""


class Hearing(nn.Module):
    """Which boxes are heard by the others: all; in training, some are not, in each frame another share of them.

    So what is learnt does not depend on how many boxes a camera's images have, or on all of them being there.
    """

    LARGEST_SHARE = 0.9

    def forward(self, is_there: Tensor) -> Tensor:
        """Shape (B, N), bool, of where there is a box."""
        if not self.training:
            return is_there
        shares = self.LARGEST_SHARE * torch.rand(len(is_there), 1, device=is_there.device)
        return is_there & (torch.rand(is_there.shape, device=is_there.device) >= shares)


class Round(nn.Module):
    """Each box is told something by each, itself included."""

    def __init__(self, size: int, num_told: int, num_relations: int) -> None:
        super().__init__()
        self.hearer = nn.Linear(size, num_told)
        self.teller = nn.Linear(size, num_told, bias=False)
        self.relation = nn.Linear(num_relations, num_told, bias=False)
        self.update = nn.Linear(size + 2 * num_told, size)

    def forward(self, hidden: Tensor, relations: Tensor, is_heard: Tensor) -> Tensor:
        """The new values of shape (B, N, size), of these, relations (B, N, N, 9), and 1 or 0 of shape (B, N, 1)."""
        told = torch.relu(self.hearer(hidden)[:, :, None] + self.teller(hidden)[:, None] + self.relation(relations))
        told = told * is_heard[:, None]
        mean = told.sum(dim=2) / is_heard.sum(dim=1, keepdim=True).clamp_min(1)
        return hidden + torch.relu(self.update(torch.cat([hidden, mean, told.amax(dim=2)], dim=-1)))


def _is_there(sizes: Sequence[int], device: torch.device) -> Tensor:
    """Shape (B, N), bool: where there is a box in rows of the largest of `sizes`."""
    return torch.arange(max(sizes), device=device)[None] < torch.tensor(list(sizes), device=device)[:, None]


def _padded(values: Tensor, is_there: Tensor) -> Tensor:
    """Shape (B, N, F): the rows of `values` where there is a box, zeros elsewhere."""
    padded = values.new_zeros(*is_there.shape, values.shape[1])
    padded[is_there] = values
    return padded


def logits_of(network: nn.Module, crops: Tensor, features: Tensor, sizes: Sequence[int]) -> Tensor:
    """The logits of crops; networks that compare the boxes of a frame are told how many each frame has."""
    logits: Tensor = network(crops, features, sizes) if isinstance(network, COMPARING) else network(crops, features)
    return logits


def light_of(logits: Tensor) -> Tensor:
    """Logits of being light of a vehicle, shape (N,), of logits of it alone, (N, 1), or of all kinds, (N, 5)."""
    if logits.shape[1] == 1:
        return logits[:, 0]
    return torch.logsumexp(logits[:, :-1], dim=1) - logits[:, -1]


def members_of(network: nn.Module) -> tuple[nn.Module, ...]:
    """The networks whose mean a network is; itself alone if it is none."""
    return network.members if isinstance(network, BothNetwork) else (network,)


def learnt_logits(network: nn.Module, crops: Tensor, features: Tensor, sizes: Sequence[int]) -> tuple[Tensor, ...]:
    """The same, but of a network of several those of each, which learn for themselves."""
    if isinstance(network, BothNetwork):
        return network.learnt(crops, features, sizes)
    return (logits_of(network, crops, features, sizes),)


def _block(inputs: int, outputs: int, side: int, stride: int = 1) -> list[nn.Module]:
    convolution = nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False)
    return [convolution, nn.BatchNorm2d(outputs), nn.ReLU()]


NETWORKS: dict[str, Callable[[InputSpec, int], nn.Module]] = {
    "paper": lambda spec, num_outputs: ArtifactNetwork(),  # noqa: ARG005
    "compact": lambda spec, num_outputs: CompactNetwork(spec.num_channels, spec.num_features, num_outputs),
    "related": lambda spec, num_outputs: RelatedNetwork(spec.num_channels, spec.num_features, num_outputs),
    "both": lambda spec, num_outputs: BothNetwork(spec.num_channels, spec.num_features, num_outputs),
}
"""Untrained networks by name, for given inputs and a given number of logits."""


def recipe_network(recipe: Recipe, origin: str = "recipe") -> nn.Module:
    """The untrained network that the recipe names.

    Raises:
        ValueError: If there is no such network, or it cannot read the recipe's inputs; the message begins with the
            `origin` of the recipe.
    """
    if recipe.network not in NETWORKS:
        raise ValueError(f"{origin}: network: expected one of {', '.join(NETWORKS)}, got {recipe.network!r}")
    spec, network = recipe.inputs, NETWORKS[recipe.network](recipe.inputs, recipe.num_outputs)
    try:
        with torch.inference_mode():
            crops = torch.zeros(2, spec.num_channels, spec.size_px, spec.size_px)
            logits = copy.deepcopy(network).eval()(crops, torch.zeros(2, spec.num_features))
    except RuntimeError as error:
        side_px = ArtifactNetwork.SIZE_PX if recipe.network == "paper" else CompactNetwork.SIZE_PX
        expected = f"expected crops of {side_px} px, and what else the network {recipe.network} reads"
        raise ValueError(f"{origin}: inputs: {expected}, got {spec}") from error
    if logits.shape[1] != recipe.num_outputs:
        raise ValueError(f"{origin}: kinds: expected false, the network {recipe.network} does not tell kinds, got true")
    return network
