"""The configuration of the whole pipeline, its presets, and how it is read from and written to a file."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Any

import tomli_w

from foreglow.config.beam import BeamConfig, GuardConfig, LitStreetConfig
from foreglow.config.fields import FrozenModel, validated
from foreglow.config.stages import (
    OUR_TRACKER,
    ClassifierConfig,
    DistanceConfig,
    LiveConfig,
    ProposalConfig,
    StandingConfig,
    TrackerConfig,
)
from foreglow.files import checked_path, read_toml
from foreglow.wording import check_one_of, shortened

NONE = "none"
"""In a file, for a field without a value, such as no model: TOML has no word for it, and left out it would be that of
the preset."""


class PipelineConfig(FrozenModel):
    """The configuration of the whole pipeline: a section for each stage, and for what is around them."""

    proposals: ProposalConfig = ProposalConfig()
    classifier: ClassifierConfig = ClassifierConfig()
    distance: DistanceConfig = DistanceConfig()
    tracker: TrackerConfig = TrackerConfig()
    beam: BeamConfig = BeamConfig()
    lit_street: LitStreetConfig = LitStreetConfig()
    guard: GuardConfig = GuardConfig()
    live: LiveConfig = LiveConfig()
    standing: StandingConfig = StandingConfig()

    @property
    def detector_only(self) -> PipelineConfig:
        """This configuration without the stages after the detector."""
        return self.changed("distance", estimator="none").changed("tracker", method="none")

    def changed(self, section: str, **fields: Any) -> PipelineConfig:
        """This configuration with other values for some fields of a section.

        Raises:
            ValueError: If there is no such section or field, or a value is not allowed.
        """
        check_one_of(section, type(self).model_fields, "section")
        return self.model_copy(update={section: getattr(self, section).model_copy(update=fields)})

    @property
    def commands(self) -> bool:
        """Whether a pipeline of it commands a beam: that takes tracks, so a model, and a policy."""
        return self.classifier.model is not None and "none" not in (self.tracker.method, self.beam.policy)

    def commanding(self, **beam: Any) -> PipelineConfig:
        """This configuration with beam commands, by the policy `foreglow` if it has none.

        Args:
            beam: Other values for some fields of the section `beam`.

        Raises:
            ValueError: If it has no model or no tracker: commands are made from tracks.
        """
        if self.classifier.model is None or self.tracker.method == "none":
            raise ValueError("beam: expected a model (--model FILE) and a tracker: without them there are no tracks")
        policy = "foreglow" if self.beam.policy == "none" else self.beam.policy
        return self.changed("beam", **{"policy": policy, **beam})


PRESETS: dict[str, PipelineConfig] = {
    # Paper, table of the parameter search (kappa 0.4, w 19, s 0.01, d 4).
    "paper": PipelineConfig(),
    # Published code's hand-chosen baseline, run at 640x480.
    "baseline": PipelineConfig(proposals=ProposalConfig(kappa=0.5, window_px=20, min_deviation=0.005, gap_px=13)),
    # Found by `foreglow tune data --objective light --images 1000 --trials 300 --jobs 2 --seed 3` on the drives of
    # `make pvdn-data`.
    "foreglow": PipelineConfig(
        proposals=ProposalConfig(
            kappa=0.525,
            window_px=61,
            min_deviation=0.02,
            gap_px=1,
            max_area_px=inf,
            min_width_px=5.0,
            split_saddle=0.6,
        ),
        # Leaves 0.2 false boxes per frame in lossless validation images without vehicles.
        classifier=ClassifierConfig(model=Path("foreglow"), score_threshold=0.47),
        distance=DistanceConfig(estimator="road_surface"),
        tracker=OUR_TRACKER,
    ),
}


def preset(name: str) -> PipelineConfig:
    """The configuration called `name`.

    Raises:
        ValueError: If there is no such preset; the message lists those that exist.

    >>> preset("baseline").proposals.gap_px
    13
    """
    check_one_of(name, PRESETS, "preset")
    return PRESETS[name]


def read_config(path: Path | str, base: PipelineConfig | None = None) -> PipelineConfig:
    """The configuration in the TOML file `path`; fields that it does not have are those of `base` (default: paper).

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, or a field is unknown or out of range, or an argument is of another type; the
            message names path and field.
    """
    if not isinstance(base, PipelineConfig | None):
        raise ValueError(f"base: expected what foreglow.preset or read_config gives, got {shortened(base)}")
    path = checked_path(path)
    given = read_toml(path)
    merged: dict[str, Any] = (PRESETS["paper"] if base is None else base).model_dump()
    for section, fields in given.items():
        known = merged.get(section)
        if isinstance(known, dict) and isinstance(fields, dict):
            fields = known | _valued(section, fields)
        merged[section] = fields
    return validated(PipelineConfig, merged, str(path))


def _valued(section: str, fields: dict[str, Any]) -> dict[str, Any]:
    """The `fields` of a section of a file, with None for `NONE` where a field may be without a value."""
    known = type(getattr(PRESETS["paper"], section)).model_fields
    may_lack = {name for name, field in known.items() if field.default is None}
    return {name: None if name in may_lack and value == NONE else value for name, value in fields.items()}


def config_to_toml(config: PipelineConfig) -> str:
    r"""`config` as TOML text that `read_config` reads back equal, anywhere and on any base: the files that it names
    become absolute, and fields that are None are `NONE`.

    >>> print(config_to_toml(PipelineConfig(classifier=ClassifierConfig(model=Path("model.onnx")))).split("\n\n")[1])
    [classifier]
    model = "model.onnx"
    support = "none"
    score_threshold = 0.5
    num_threads = 1
    device = "cpu"
    colour = true
    """
    # Python mode keeps infinity, which JSON mode would turn into null.
    sections: dict[str, dict[str, Any]] = config.model_dump()
    return tomli_w.dumps(
        {section: {name: _written(value) for name, value in fields.items()} for section, fields in sections.items()}
    )


def _written(value: Any) -> Any:
    """A value as TOML has it."""
    if value is None:
        return NONE
    return _located(value) if isinstance(value, Path) else value


def _located(path: Path) -> str:
    """The absolute path of a file; anything else as it is, and a preset's model, whose name is no file's anywhere."""
    is_name = any(path == each.classifier.model for each in PRESETS.values())
    return str(path.absolute() if path.is_file() and not is_name else path)
