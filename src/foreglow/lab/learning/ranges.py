"""Fits the road-surface model to lights whose ranges are known, such as those of simulated drives.

The kinds of the lights need not be known. With the weights w_c and log ranges v_c of the hypotheses of
`distance.hypotheses`, the log range of a light has the density of a mixture,

    p(v) = sum over c of w_c N(v; v_c, 0.1),   w_c = softmax of the log weights                                 (1)

and the fit minimises

    - sum over lights of b_i log(p(log truth_i) + exp(-12)) + sum over parameters of ((x - x0) / sigma)^2 / 2   (2)

by Adam. b_i balances near and far lights; x0 are the assumed values. Spreads are fitted by their logarithms. Offsets
and heights of the kinds stay as assumed. On other drives, all sigmas are then scaled to hold the wanted shares.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import tomli_w

from foreglow.config import PipelineConfig
from foreglow.datasets import open_labelled, split_folder
from foreglow.datasets.simulated import read_truth
from foreglow.distance.hypotheses import (
    Hypotheses,
    Parameters,
    cells_along,
    log_weights,
    parameters_of,
    read_hypotheses,
)
from foreglow.distance.road_surface import RoadSurface, View
from foreglow.distance.weighing import weighed_ranges
from foreglow.geometry import Floats
from foreglow.lab.evaluation.boxes.matching import smallest_box
from foreglow.lab.evaluation.ratios import ratios
from foreglow.lab.learning.apart import check_apart
from foreglow.own_files import with_digest
from foreglow.proposals import make_proposer
from foreglow.types import Detections
from foreglow.whole_files import write_atomic

if TYPE_CHECKING:
    import torch

PRIOR = Path(__file__).with_name("road_surface_prior.toml")
"""The assumed kinds of light, from which every fit starts."""

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the name of the task, how many of its steps are done, and how many there are."""

SIGNED_OF_KINDS = ("log_share", "log_range", "features", "pair_logit")
SPREADS_OF_KINDS = ("offset_sigma_m", "height_sigma_m")
SHARED_SPREADS = ("range_log_sigma", "feature_sigmas", "pixel_sigma_rad", "slope_sigma", "box_shares")
POSITIVE = (*SPREADS_OF_KINDS, *SHARED_SPREADS)
"""Parameters that are fitted by their logarithms."""

FITTED = (*SIGNED_OF_KINDS, "feature_slopes", *POSITIVE)
"""Fields of `Parameters` that are fitted."""

PRIOR_SIGMAS = {"log_share": 2.0, "log_range": 1.0, "features": 3.0, "feature_slopes": 0.7, "pair_logit": 2.0}
POSITIVE_PRIOR_SIGMA = 0.5
"""sigma in (2), by parameter; the second one for all that are fitted by their logarithms."""

TOLERANCE = 0.1
"""Standard deviation in (1); the arc lengths of the hypotheses are 11 % apart."""

FLOOR = math.exp(-12.0)
"""Likelihood of a range that no hypothesis explains, so that no single light dominates the fit."""

BATCH = 64
EPOCHS = 12
LEARNING_RATE = 0.03
NUM_RANGE_BINS = 8
MAX_BALANCE = 4.0
"""Largest b in (2), for lights at rare ranges, since the ranges of encounters differ from drive to drive."""

COVERAGES = (0.68, 0.94)
"""Shares of the lights that one and two sigmas shall hold; the tails are heavier than those of a Gaussian."""


@dataclass(frozen=True, slots=True, eq=False)
class RangedView:
    """What the model needs of one image, and the true ranges of the lights in its boxes, shape (N,), metres."""

    view: View
    truth_m: Floats


def fit_ranges(data: Path, config: PipelineConfig, *, seed: int = 0, progress: Progress | None = None) -> Hypotheses:
    """The model fitted on the train split of `data`, with sigmas scaled on its val split.

    Raises:
        FileNotFoundError: If a file of the data set is missing.
        ValueError: If one is broken, or no light has a box and a known range.
    """
    learnt, judging = split_folder(data, "train"), split_folder(data, "val")
    check_apart([learnt], [judging])
    train, val = (list(ranged_views(root, config, progress)) for root in (learnt, judging))
    if not train or not val:
        raise ValueError(f"{data}: expected lights with a box and a known range in train and val, found none")
    fitted = _fitted(read_hypotheses(PRIOR), train, seed, progress)
    scaled = fitted.model_copy(update={"sigma_scale": _sigma_scale(fitted, val)})
    return scaled.model_copy(
        update={"origin": f"{sum(len(ranged.truth_m) for ranged in train)} lights of {data.name}/train"}
    )


def write_hypotheses(path: Path, model: Hypotheses) -> None:
    """Writes `model` as TOML for `read_hypotheses`, with a first line by which a change by hand is known.

    Raises:
        OSError: If it cannot be written.
    """
    write_atomic(path, with_digest(tomli_w.dumps(model.model_dump())).encode())


def ranged_views(root: Path, config: PipelineConfig, progress: Progress | None = None) -> Iterator[RangedView]:
    """The images of the split in `root` with lights of known range; a light belongs to the smallest box around it."""
    dataset, truth = open_labelled(root, config.guard.white_level), read_truth(root)
    proposer, estimator = make_proposer(config.proposals), RoadSurface(config.distance)
    num_done = 0
    for drive in truth:
        estimator.reset()
        for known in drive.frames:
            frame = dataset.read(known.image_id)
            proposals = proposer.propose(frame.image)
            boxes = Detections(proposals, np.ones(len(proposals), np.float32), 0.0)
            view = estimator.view(frame, boxes)
            lights = [artifact for vehicle in known.vehicles for artifact in vehicle.artifacts]
            found = [
                (box, light.depth_m)
                for light in lights
                if not (light.is_doubtful or math.isnan(light.depth_m))
                and (box := smallest_box(light.position_px, proposals.boxes_xyxy_px)) is not None
            ]
            if found:
                chosen, truth_m = zip(*found, strict=True)
                its_boxes = type(view.boxes)(*(column[list(chosen)] for column in view.boxes))
                yield RangedView(view._replace(boxes=its_boxes), np.array(truth_m))
            num_done += 1
            if progress is not None:
                progress(f"images of {root.name}", num_done, len(dataset))


def _fitted(start: Hypotheses, views: list[RangedView], seed: int, progress: Progress | None) -> Hypotheses:
    import torch

    rng = np.random.default_rng(seed)
    initial = _as_tensors(parameters_of(start))
    free = {name: _raw(name, getattr(initial, name)).clone().requires_grad_() for name in FITTED}
    balance = _balance(views)
    tensors = [_tensor_view(ranged.view) for ranged in views]
    optimiser = torch.optim.Adam(free.values(), lr=LEARNING_RATE)
    num_batches = math.ceil(len(views) / BATCH)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, EPOCHS * num_batches)
    for epoch in range(EPOCHS):
        for batch in np.array_split(rng.permutation(len(views)), num_batches):
            parameters = _with_fitted(initial, free)
            loss = _prior(initial, free) * (len(batch) / len(views))
            for index in batch.tolist():
                likelihoods = _log_likelihoods(parameters, tensors[index], torch.as_tensor(views[index].truth_m))
                loss = loss - (torch.as_tensor(balance[index]) * likelihoods).sum()
            optimiser.zero_grad()
            (loss / len(batch)).backward()
            optimiser.step()
            schedule.step()
        if progress is not None:
            progress("epochs", epoch + 1, EPOCHS)
    final = _with_fitted(initial, free)
    return _model_of(start, Parameters(*(value.detach().numpy() for value in final)))


def _log_likelihoods(parameters: Parameters, view: View, truth_m: torch.Tensor) -> torch.Tensor:
    """Log density of the true log ranges by (1), shape (N,), not below the floor."""
    import torch

    cells = cells_along(parameters, view.road, view.camera_m, view.pitch_sigma_rad, torch)
    weights = torch.log_softmax(log_weights(parameters, cells, view.boxes, torch), dim=1)
    deviations = (cells.log_ranges - truth_m.log()[:, None]) / TOLERANCE
    kernel = -0.5 * deviations * deviations - math.log(TOLERANCE * math.sqrt(2.0 * math.pi))
    return torch.log(torch.exp(torch.logsumexp(weights + kernel, dim=1)) + FLOOR)


def _balance(views: list[RangedView]) -> list[Floats]:
    """Weight b of each light: all ranges count the same, as far as `MAX_BALANCE` allows."""
    logs = np.log(np.concatenate([ranged.truth_m for ranged in views]))
    edges = np.quantile(logs, (0.01, 0.99))
    places = ratios(logs - edges[0], edges[1] - edges[0])  # NaN where nearly all ranges are the same: all in one bin
    bins = np.clip((np.nan_to_num(places) * NUM_RANGE_BINS).astype(int), 0, NUM_RANGE_BINS - 1)
    counts = np.bincount(bins, minlength=NUM_RANGE_BINS)
    weights = np.minimum(counts.max() / counts[bins], MAX_BALANCE)
    ends = np.cumsum([len(ranged.truth_m) for ranged in views])[:-1]
    return np.split(weights / weights.mean(), ends)


def _prior(initial: Parameters, free: dict[str, torch.Tensor]) -> Any:
    """The second sum of (2)."""
    total: Any = 0.0
    for name, raw in free.items():
        moved = raw - _raw(name, getattr(initial, name))
        total = total + 0.5 * ((moved / PRIOR_SIGMAS.get(name, POSITIVE_PRIOR_SIGMA)) ** 2).sum()
    return total


def _raw(name: str, value: torch.Tensor) -> torch.Tensor:
    return value.log() if name in POSITIVE else value


def _with_fitted(initial: Parameters, free: dict[str, torch.Tensor]) -> Parameters:
    """`initial` with the fitted parameters; the slopes of shape and contrast are the same for all kinds."""
    import torch

    values = {name: raw.exp() if name in POSITIVE else raw for name, raw in free.items()}
    slopes = values["feature_slopes"]
    shared = slopes[:, 1:].mean(dim=0, keepdim=True).expand(len(slopes), -1)
    values["feature_slopes"] = torch.cat([slopes[:, :1], shared], dim=1)
    return initial._replace(**values)


def _as_tensors(numbers: Parameters) -> Parameters:
    import torch

    return Parameters(
        *(torch.as_tensor(array if array.dtype == np.bool_ else array.astype(np.float64)) for array in numbers)
    )


def _tensor_view(view: View) -> View:
    import torch

    boxes = type(view.boxes)(*(torch.as_tensor(column) for column in view.boxes))
    road = view.road
    if road is not None:
        arrays: dict[str, Any] = {
            field.name: torch.as_tensor(value)
            for field in dataclasses.fields(road)
            if isinstance(value := getattr(road, field.name), np.ndarray)
        }
        road = dataclasses.replace(road, **arrays)
    return view._replace(road=road, boxes=boxes)


def _model_of(start: Hypotheses, numbers: Parameters) -> Hypotheses:
    """`start` with the fitted `numbers`, rounded to four digits."""

    def plain(value: Any) -> Any:
        return float(f"{float(value):.4g}") if np.ndim(value) == 0 else tuple(plain(part) for part in value)

    kinds = [
        {
            **kind.model_dump(),
            **{name: plain(getattr(numbers, name)[index]) for name in SIGNED_OF_KINDS + SPREADS_OF_KINDS},
            "size_slope": plain(numbers.feature_slopes[index, 0]),
        }
        for index, kind in enumerate(start.kinds)
    ]
    shared = {name: plain(getattr(numbers, name)) for name in SHARED_SPREADS}
    fields = {**shared, "feature_slopes": plain(numbers.feature_slopes[0, 1:]), "kinds": kinds}
    return Hypotheses.model_validate({**start.model_dump(), **fields})


def _sigma_scale(model: Hypotheses, views: list[RangedView]) -> float:
    """Factor on the sigmas: the geometric mean of those with which one and two sigmas hold `COVERAGES`."""
    parameters = parameters_of(model)
    errors = []
    for ranged in views:
        view = ranged.view
        cells = cells_along(parameters, view.road, view.camera_m, view.pitch_sigma_rad)
        near_m, range_m, far_m = weighed_ranges(parameters, cells, view.boxes)
        errors.append(np.abs(range_m - ranged.truth_m) / (0.5 * (far_m - near_m)))
    one_sigma, two_sigmas = np.quantile(np.concatenate(errors), COVERAGES)
    return round(math.sqrt(one_sigma * two_sigmas / 2.0), 3)
