"""The public names exist, load when first used, and say what they are."""

from __future__ import annotations

import inspect
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import mht_slam

CONTRACT = [
    "Association",
    "BearingScan",
    "Comparison",
    "ConsistentSet",
    "Effort",
    "Exchange",
    "Hypothesis",
    "MultiHypothesisSlam",
    "Observability",
    "ObservationModel",
    "Odometry",
    "OrderChange",
    "OrderTracker",
    "Posterior",
    "RankedAssociation",
    "Ranking",
    "RunPair",
    "SlamConfig",
    "SlamMap",
    "Solution",
    "StraightRun",
    "TightestAssociation",
    "TrackerConfig",
    "Triangulation",
    "apparent_angles",
    "compare",
    "consistent_associations",
    "evidence_by_quadrature",
    "exchanges",
    "fit_observation_model",
    "fit_slam_config",
    "observability",
    "order_changes",
    "rank",
    "rank_by_evidence",
    "refine",
    "smallest_epsilon",
    "solve",
    "tightest_association",
    "triangulate",
    "visual_order",
    "zone",
]


def test_the_names_are_those_of_the_contract() -> None:
    assert mht_slam.__all__ == CONTRACT
    assert set(CONTRACT) <= set(dir(mht_slam))


@pytest.mark.parametrize("name", CONTRACT)
def test_every_public_name_loads_and_documents_itself(name: str) -> None:
    value = getattr(mht_slam, name)
    assert value.__name__ == name
    assert len(inspect.getdoc(value) or "") > 60
    for member, attribute in vars(value).items() if inspect.isclass(value) else ():
        public = not member.startswith("_")
        if public and (inspect.isfunction(attribute) or isinstance(attribute, property)):
            assert attribute.__doc__, f"{name}.{member} has no docstring"


def test_the_presets_are_at_hand_without_an_import_of_their_own() -> None:
    program = "import mht_slam; print(mht_slam.presets.laser().motion, 'presets' in dir(mht_slam))"
    done = subprocess.run(  # noqa: S603 - our own interpreter and program
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["smooth", "True"]


def test_a_name_that_does_not_exist_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'solve_everything'"):
        _ = mht_slam.solve_everything


def test_the_version_is_that_of_the_installed_package() -> None:
    assert mht_slam.__version__ == metadata.version("mht-slam")


def test_every_module_opens_with_its_one_job() -> None:
    repository = Path(mht_slam.__file__).parents[1]
    for folder in ("mht_slam", "factors"):
        for path in sorted((repository / folder).rglob("*.py")):
            first = path.read_text(encoding="utf-8").split("\n", 1)[0]
            assert first.startswith('"""'), f"{path} says nothing of its job"
            assert len(first) > 20, f"{path} says nothing of its job"
