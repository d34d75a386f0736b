"""What other models say of samples, which a network learns beside whose light it is. Importing this needs `train`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import softmax

from foreglow.classifier.inputs import InputSpec
from foreglow.lab.learning.model_import import StartingPoint, read_model
from foreglow.lab.learning.samples import Samples
from foreglow.lab.learning.training import score_samples


def read_teachers(models: Sequence[Path], spec: InputSpec) -> tuple[StartingPoint, ...]:
    """The models, which read nothing that samples for `spec` do not have, and tell all kinds of light.

    Raises:
        FileNotFoundError: If there is no such model.
        ValueError: If one has another network than those of `train`, reads something else, or tells no kinds.
    """
    teachers = tuple(map(read_model, models))
    for teacher in teachers:
        if not teacher.has_kinds:
            raise ValueError(f"{teacher.name}: expected a teacher that tells the kinds of light, got one that does not")
        for field in dataclasses.fields(spec):
            found, wanted = getattr(teacher.inputs, field.name), getattr(spec, field.name)
            if field.name in ("num_features", "together"):
                is_right, at_most = found <= wanted, "at most "
            else:
                is_right, at_most = found == wanted, ""
            if not is_right:
                raise ValueError(
                    f"{teacher.name}: {field.name}: expected a teacher that reads what the recipe's network does, "
                    f"{at_most}{wanted}, got {found}"
                )
    return teachers


def taught_kinds(teachers: Sequence[StartingPoint], samples: Samples) -> NDArray[np.float32]:
    """Probabilities of all kinds by the mean of the teachers' logits, shape (N, 5).

    Source: Hinton et al., arXiv 1503.02531, at a temperature of 1.
    """
    logits = np.mean([_logits(teacher, samples) for teacher in teachers], axis=0)
    return np.asarray(softmax(logits, axis=1), np.float32)


def _logits(teacher: StartingPoint, samples: Samples) -> NDArray[np.float32]:
    read = dataclasses.replace(samples, features=samples.features[:, : teacher.inputs.num_features])
    return score_samples(teacher.network, read, torch.device("cpu"))
