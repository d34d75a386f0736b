"""The beam policies by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from foreglow.beam.policy import BeamPolicy, ForeglowPolicy, HighBeam, LowBeam, PaperPolicy
from foreglow.config import BeamConfig
from foreglow.photometry import Headlamps
from foreglow.plugins import find

POLICIES: Mapping[str, type[BeamPolicy]] = MappingProxyType(
    {"low": LowBeam, "high": HighBeam, "paper": PaperPolicy, "foreglow": ForeglowPolicy}
)
"""Our policies by name."""


def policy_class(name: str, field: str = "beam.policy") -> type[BeamPolicy]:
    """The policy called `name`: one of `POLICIES`, or a plug-in.

    Raises:
        ValueError: If there is none, or it cannot be imported; the message starts with `field`.
    """
    return find(field, name, POLICIES, "foreglow.policies")


def make_policy(config: BeamConfig, headlamps: Headlamps) -> BeamPolicy:
    """The policy that `config.policy` names.

    Raises:
        ValueError: As `policy_class`.
    """
    return policy_class(config.policy)(config, headlamps)
