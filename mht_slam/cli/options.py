"""Options that several commands share, as frozen dataclasses; angles in degrees."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import tyro

from mht_slam.arrays import finite_number
from mht_slam.models import ObservationModel

FigureFormat: TypeAlias = Literal["png", "pdf", "svg"]

EPSILON_OVER_SIGMA = math.sqrt(3.0)
"""Uniform noise inside +-epsilon has the standard deviation epsilon / sqrt 3."""


@dataclass(frozen=True)
class MethodOptions:
    """How hypotheses are ranked and weighed."""

    epsilon_deg: float = 3.0
    """Vision error: the bound on a bearing's error, degrees, above 0 and below 90."""
    sigma_deg: float | None = None
    """Standard deviation of a bearing, degrees; a scan's own sigma in the file goes before it.
    Default: epsilon / sqrt(3), which is that of uniform noise inside epsilon."""
    heading_sigma_deg: float = 0.0
    """Independent deviation of each heading from the direction of travel, degrees."""
    lateral_sigma: float = 0.0
    """Deviation of the third and later scans from the line, first baselines."""
    landmark_sigma: float = ObservationModel.landmark_sigma
    """Standard deviation of the landmark prior per axis, first baselines. It moves probabilities
    more than anything else."""
    max_range: float = 100.0
    """Where cells of the polygon method are cut, baselines of each pair."""
    top_k: int = 50
    """How many of the ranked associations the factor graph refines."""

    @property
    def epsilon(self) -> float:
        """Vision error, radians; an `OptionError` outside its range."""
        return math.radians(finite_number(self.epsilon_deg, "epsilon_deg", above=0.0, below=90.0))

    def model(self) -> ObservationModel:
        """Return the model behind the probabilities; raises `OptionError`."""
        sigma_deg = self.sigma_deg
        if sigma_deg is None:
            sigma_deg = math.degrees(self.epsilon) / EPSILON_OVER_SIGMA
        finite_number(sigma_deg, "sigma_deg", above=0.0, below=180.0)
        finite_number(self.heading_sigma_deg, "heading_sigma_deg", at_least=0.0, below=180.0)
        return ObservationModel(
            sigma=math.radians(sigma_deg),
            heading_sigma=math.radians(self.heading_sigma_deg),
            lateral_sigma=self.lateral_sigma,
            landmark_sigma=self.landmark_sigma,
        )


@dataclass(frozen=True)
class OutputOptions:
    """Where results go."""

    output: Path = Path("runs")
    """Folder in which every run gets its own stamped folder; `latest` there leads to the last."""
    figure_format: FigureFormat = "png"
    """Format of the figures."""


Method = Annotated[MethodOptions, tyro.conf.OmitArgPrefixes]
Output = Annotated[OutputOptions, tyro.conf.OmitArgPrefixes]
"""Nested, but with options that carry no prefix."""
