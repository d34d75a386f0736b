"""A frozen model for each stage, and `PipelineConfig` with all of them; they are read from and written to TOML."""

from foreglow.config.beam import BeamConfig, GuardConfig, LitStreetConfig
from foreglow.config.fields import FrozenModel, validated
from foreglow.config.pipeline import PRESETS, PipelineConfig, config_to_toml, preset, read_config
from foreglow.config.stages import (
    OUR_TRACKER,
    PUBLISHED_TRACKER,
    ClassifierConfig,
    Dispatch,
    DistanceConfig,
    LiveConfig,
    ProposalConfig,
    StandingConfig,
    TrackerConfig,
)
from foreglow.files import read_toml

__all__ = [
    "OUR_TRACKER",
    "PRESETS",
    "PUBLISHED_TRACKER",
    "BeamConfig",
    "ClassifierConfig",
    "Dispatch",
    "DistanceConfig",
    "FrozenModel",
    "GuardConfig",
    "LitStreetConfig",
    "LiveConfig",
    "PipelineConfig",
    "ProposalConfig",
    "StandingConfig",
    "TrackerConfig",
    "config_to_toml",
    "preset",
    "read_config",
    "read_toml",
    "validated",
]
