"""Makes torchvision importable beside a torch that is built for the processor alone; only development needs it.

A torchvision for GPUs finds none of its compiled operators then, and fails. Of them libreyolo's YOLOX uses non-maximum
suppression, which this file writes in torch. Users need none of this: pip gives them two builds that fit. Run the
command line with it as `python -m tests.torchvision_cpu yolo train ...`.
"""

from __future__ import annotations

from typing import Any

import torch


def install() -> None:
    """Makes `import torchvision` work, if it does not already."""
    try:
        import torchvision
    except RuntimeError:
        library: Any = torch.library.Library("torchvision", "DEF")  # type: ignore[no-untyped-call]
        _kept.append(library)
        library.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        library.define("qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        library.impl("nms", nms, "CPU")
        import torchvision.extension

        torchvision.extension._has_ops = lambda: True


def nms(boxes: torch.Tensor, scores: torch.Tensor, max_overlap: float) -> torch.Tensor:
    """Indices of the boxes (N, 4) that are kept, best first: none overlaps a better one by more than `max_overlap`."""
    order = scores.argsort(descending=True, stable=True)
    corners = boxes[order].double()
    areas = (corners[:, 2] - corners[:, 0]) * (corners[:, 3] - corners[:, 1])
    is_left = torch.ones(len(corners), dtype=torch.bool)
    for index in range(len(corners)):
        if is_left[index]:
            low = torch.maximum(corners[index, :2], corners[index + 1 :, :2])
            high = torch.minimum(corners[index, 2:], corners[index + 1 :, 2:])
            shared = (high - low).clamp(min=0).prod(dim=1)
            is_left[index + 1 :] &= shared <= max_overlap * (areas[index] + areas[index + 1 :] - shared)
    return order[is_left]


_kept: list[Any] = []  # an operator lives as long as its library

if __name__ == "__main__":
    install()
    from foreglow.cli import main

    main()
