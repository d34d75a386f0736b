"""Which boxes a model has learnt to judge, as far as the model itself says it."""

from __future__ import annotations

import json
from pathlib import Path

from foreglow.classifier.session import MAX_MODEL_BYTES
from foreglow.config import ProposalConfig
from foreglow.config.fields import validated
from foreglow.files import read_bytes
from foreglow.protobuf import protobuf_fields

PROPOSALS = "proposals"
"""Name in a model's metadata under which it has the proposals, as JSON."""

WHERE = {"region_xyxy_px", "backend", "dispatch"}
"""Fields of the proposals that do not change what a box is."""

# Numbers of fields. Source: onnx.proto of ONNX.
_METADATA = 14  # of a model
_NAME, _VALUE = 1, 2  # of an entry


def have_same_boxes(first: ProposalConfig, second: ProposalConfig) -> bool:
    """Whether a box is the same by both.

    >>> have_same_boxes(ProposalConfig(), ProposalConfig(backend="reference"))
    True
    """
    return first.model_dump(exclude=WHERE) == second.model_dump(exclude=WHERE)


def proposals_text(proposals: ProposalConfig) -> str:
    """What a model's metadata say of its proposals."""
    return json.dumps(proposals.model_dump(mode="json", exclude=WHERE))


def learnt_proposals(model: Path) -> ProposalConfig | None:
    """Those whose boxes the model at `model` has learnt; None if it does not say them, or is no model at all.

    Raises:
        ValueError: If what it says are none.
        OSError: If the file cannot be read.
    """
    if not model.is_file():
        return None
    text = _metadata(memoryview(read_bytes(model, MAX_MODEL_BYTES))).get(PROPOSALS)
    if text is None:
        return None
    origin = f"{model}: metadata: {PROPOSALS}"
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError(f"{origin}: expected those of a training or of `import-weights`, as JSON") from None
    return validated(ProposalConfig, fields, origin)


def _metadata(content: memoryview) -> dict[str, str]:
    """Those of a model; none of what is no model, which its reader will say."""
    found: dict[str, str] = {}
    try:
        for number, entry in protobuf_fields(content):
            if number == _METADATA and isinstance(entry, memoryview):
                parts = {
                    key: str(part, "utf-8") for key, part in protobuf_fields(entry) if isinstance(part, memoryview)
                }
                found[parts.get(_NAME, "")] = parts.get(_VALUE, "")
    except ValueError:
        return {}
    return found
