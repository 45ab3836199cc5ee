"""Mapping and localisation from bearings only, when all landmarks look the same.

The public names live here and are imported when first used, so that ``import mht_slam`` stays
light: no GTSAM, shapely or matplotlib before something needs it.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mht_slam import presets as presets
    from mht_slam.association import Association as Association
    from mht_slam.comparison import Comparison as Comparison
    from mht_slam.comparison import compare as compare
    from mht_slam.consistency.consistent_set import ConsistentSet as ConsistentSet
    from mht_slam.consistency.consistent_set import (
        consistent_associations as consistent_associations,
    )
    from mht_slam.consistency.tightest import TightestAssociation as TightestAssociation
    from mht_slam.consistency.tightest import smallest_epsilon as smallest_epsilon
    from mht_slam.consistency.tightest import tightest_association as tightest_association
    from mht_slam.evidence.quadrature import evidence_by_quadrature as evidence_by_quadrature
    from mht_slam.evidence.quadrature import rank_by_evidence as rank_by_evidence
    from mht_slam.fitting import fit_observation_model as fit_observation_model
    from mht_slam.graph.observability import Observability as Observability
    from mht_slam.graph.observability import observability as observability
    from mht_slam.graph.refine import refine as refine
    from mht_slam.hypotheses import Hypothesis as Hypothesis
    from mht_slam.hypotheses import Posterior as Posterior
    from mht_slam.hypotheses import RankedAssociation as RankedAssociation
    from mht_slam.hypotheses import Ranking as Ranking
    from mht_slam.incremental.config import SlamConfig as SlamConfig
    from mht_slam.incremental.estimator import MultiHypothesisSlam as MultiHypothesisSlam
    from mht_slam.incremental.fit_config import fit_slam_config as fit_slam_config
    from mht_slam.incremental.slam_map import SlamMap as SlamMap
    from mht_slam.measurements import BearingScan as BearingScan
    from mht_slam.measurements import Odometry as Odometry
    from mht_slam.measurements import RunPair as RunPair
    from mht_slam.measurements import StraightRun as StraightRun
    from mht_slam.models import ObservationModel as ObservationModel
    from mht_slam.pipeline import Solution as Solution
    from mht_slam.pipeline import solve as solve
    from mht_slam.polygon.ranking import rank as rank
    from mht_slam.tracking.exchanges import Exchange as Exchange
    from mht_slam.tracking.exchanges import exchanges as exchanges
    from mht_slam.tracking.options import TrackerConfig as TrackerConfig
    from mht_slam.tracking.order import apparent_angles as apparent_angles
    from mht_slam.tracking.order import visual_order as visual_order
    from mht_slam.tracking.tracker import OrderTracker as OrderTracker
    from mht_slam.tracking.zones import OrderChange as OrderChange
    from mht_slam.tracking.zones import order_changes as order_changes
    from mht_slam.tracking.zones import zone as zone
    from mht_slam.tree.effort import Effort as Effort
    from mht_slam.triangulation import Triangulation as Triangulation
    from mht_slam.triangulation import triangulate as triangulate

_HOME = {
    "Association": "association",
    "BearingScan": "measurements",
    "Comparison": "comparison",
    "ConsistentSet": "consistency.consistent_set",
    "Effort": "tree.effort",
    "Exchange": "tracking.exchanges",
    "Hypothesis": "hypotheses",
    "Observability": "graph.observability",
    "MultiHypothesisSlam": "incremental.estimator",
    "ObservationModel": "models",
    "Odometry": "measurements",
    "OrderChange": "tracking.zones",
    "OrderTracker": "tracking.tracker",
    "Posterior": "hypotheses",
    "RankedAssociation": "hypotheses",
    "Ranking": "hypotheses",
    "RunPair": "measurements",
    "SlamConfig": "incremental.config",
    "SlamMap": "incremental.slam_map",
    "Solution": "pipeline",
    "StraightRun": "measurements",
    "TightestAssociation": "consistency.tightest",
    "TrackerConfig": "tracking.options",
    "Triangulation": "triangulation",
    "apparent_angles": "tracking.order",
    "compare": "comparison",
    "consistent_associations": "consistency.consistent_set",
    "evidence_by_quadrature": "evidence.quadrature",
    "exchanges": "tracking.exchanges",
    "fit_observation_model": "fitting",
    "fit_slam_config": "incremental.fit_config",
    "observability": "graph.observability",
    "order_changes": "tracking.zones",
    "rank": "polygon.ranking",
    "rank_by_evidence": "evidence.quadrature",
    "refine": "graph.refine",
    "smallest_epsilon": "consistency.tightest",
    "solve": "pipeline",
    "tightest_association": "consistency.tightest",
    "triangulate": "triangulation",
    "visual_order": "tracking.order",
    "zone": "tracking.zones",
}

_MODULES = ("presets",)

__all__ = sorted(_HOME)

try:
    __version__ = version("mht-slam")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"mht_slam.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'mht_slam' has no attribute {name!r}")
    value = getattr(import_module(f"mht_slam.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, *_MODULES})
