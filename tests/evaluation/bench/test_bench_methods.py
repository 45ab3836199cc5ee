"""Methods answer a run, are judged alike, and a user's own one stands beside ours."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.case import Assumptions, Case
from mht_slam.evaluation.bench.compare import Outcome, compare
from mht_slam.evaluation.bench.judging import AnswerError, Verdict, ordered_answers, verdict_on
from mht_slam.evaluation.bench.methods import (
    CEILINGS,
    METHODS,
    Method,
    load_method,
    with_candidates,
)
from mht_slam.evaluation.bench.sweep import Sweep

EPSILON = math.radians(2.0)


def a_case(**options: object) -> Case:
    sweep = Sweep(
        kinds=("annulus",), landmarks=(3,), noises=("uniform",), epsilons=(EPSILON,), **options
    )  # type: ignore[arg-type]
    return sweep.cells[0].case(1)


def verdicts(outcome: Outcome) -> dict[str, list[Verdict]]:
    found: dict[str, list[Verdict]] = {}
    for result in outcome.results:
        for verdict in result.verdicts:
            found.setdefault(verdict.method, []).append(verdict)
    return found


@pytest.fixture(scope="module")
def everything() -> Outcome:
    sweep = Sweep(kinds=("annulus",), landmarks=(3,), noises=("uniform",), epsilons=(EPSILON,),
                  scenes=4)  # fmt: skip
    return compare(sweep)


def test_every_method_and_ceiling_answers_every_scene(everything: Outcome) -> None:
    found = verdicts(everything)
    assert list(found) == [*METHODS, *CEILINGS] == list(everything.methods)
    for name, judged in found.items():
        assert [v.failure for v in judged] == [None] * 4, name
    assert all(v.rank == 1 and v.f1 == 1.0 for v in found["known association"])


def test_noise_inside_epsilon_leaves_the_truth_to_polygons_and_graphs(everything: Outcome) -> None:
    found = verdicts(everything)
    for name in ("polygon iou edges", "graph evidence", "quadrature evidence"):
        assert all(v.rank is not None for v in found[name])
    assert all(result.truth_listed for result in everything.results)


def test_probabilities_of_evidence_sum_to_one_and_scores_of_epsilon_are_none(
    everything: Outcome,
) -> None:
    found = verdicts(everything)
    for verdict in found["graph evidence"]:
        assert sum(verdict.forecast or []) == pytest.approx(1.0, abs=1e-6)
    assert all(v.forecast is None for v in found["smallest epsilon"])


def test_our_own_reference_agrees_with_itself(everything: Outcome) -> None:
    taus = [v.tau for v in verdicts(everything)["graph evidence"]]
    assert set(taus) <= {None, 1.0}
    assert 1.0 in taus


def test_methods_of_three_scans_are_not_asked_about_four() -> None:
    sweep = Sweep(
        kinds=("annulus",), landmarks=(3,), noises=("uniform",), epsilons=(EPSILON,),
        n_scans=(4,), scenes=1,
    )  # fmt: skip
    ours = ["polygon iou edges", "graph evidence, Laplace", "quadrature evidence", "order-keeping"]
    found = verdicts(compare(sweep, ours=ours))
    assert [*found] == ["graph evidence, Laplace", "order-keeping", *CEILINGS]
    assert found["graph evidence, Laplace"][0].failure is None


def test_quadrature_is_not_asked_where_headings_wander() -> None:
    case = a_case(heading_sigmas=(0.02,))
    assert not METHODS["quadrature evidence"].takes(case)
    assert METHODS["graph evidence"].takes(case)
    enlarged = math.hypot(EPSILON, 2 * 0.02)
    assert case.assumptions.enlarged_epsilon == pytest.approx(enlarged)


def test_misses_and_clutter_are_answered_by_all_but_full_tables() -> None:
    sweep = Sweep(
        kinds=("annulus",), landmarks=(3,), noises=("gaussian",), epsilons=(EPSILON,),
        detection_probabilities=(0.9,), false_alarms=(0.3,), scenes=2,
    )  # fmt: skip
    ours = ["graph evidence, Laplace", "quadrature evidence", "order-keeping", "nearest bearing"]
    for name, judged in verdicts(compare(sweep, ours=ours)).items():
        assert [v.failure for v in judged] == [None, None], name


def test_a_method_of_ones_own_stands_beside_ours(
    own: ModuleType, small_sweep: Sweep, cheap: list[str]
) -> None:
    outcome = compare(small_sweep, {"mine": own.CHEAP}, ours=cheap)
    found = verdicts(outcome)
    assert outcome.methods == (*cheap, "mine", *CEILINGS)
    assert [v.rank for v in found["mine"]] == [v.rank for v in found["order-keeping"]]
    assert all(v.forecast == [0.75] for v in found["mine"])


def test_a_method_that_raises_or_returns_nothing_has_failed_and_counts(
    own: ModuleType, small_sweep: Sweep
) -> None:
    outcome = compare(
        small_sweep,
        {"raises": own.RAISES, "nothing": own.NOTHING, "other": own.OTHER_SCANS},
        ours=["order-keeping"],
    )
    found = verdicts(outcome)
    assert {v.failure for v in found["raises"]} == {"RuntimeError"}
    assert {v.failure for v in found["nothing"]} == {"nothing returned"}
    assert {v.failure for v in found["other"]} == {"AnswerError"}
    for name in ("raises", "nothing", "other"):
        assert len(found[name]) == 6
        assert {(v.rank, v.f1) for v in found[name]} == {(None, 0.0)}
        assert all(v.map_error > 0.0 for v in found[name])
    assert "no idea about 3 scans" in outcome.times[0].messages["raises"]


def test_a_method_is_found_by_module_and_function(own: ModuleType) -> None:
    assert load_method("bench_methods_of_tests:mine") == Method(own.mine)
    assert load_method("bench_methods_of_tests:CHEAP") is own.CHEAP


@pytest.mark.parametrize(
    "text", ["mine", "no_such_module:f", "math:no_such", "math:pi", "a b:c", ":f", "math:"]
)
def test_a_name_that_leads_to_no_method_is_refused(text: str) -> None:
    with pytest.raises(OptionError, match="method"):
        load_method(text)


def test_a_name_of_ours_cannot_be_taken(own: ModuleType, small_sweep: Sweep) -> None:
    for name in ("order-keeping", "known association"):
        with pytest.raises(OptionError, match="name of one of ours"):
            compare(small_sweep, {name: own.mine})
    with pytest.raises(OptionError, match="give one of"):
        compare(small_sweep, ours=["guessing"])


def test_ties_go_by_the_table_and_not_by_the_order_of_the_answers() -> None:
    case = a_case()
    tied = [
        Association([[0, i, 0], [1, j, 1], [2, k, 2]], (3, 3, 3))
        for i, j, k in [(2, 1, 0), (0, 1, 2), (1, 0, 2)]
    ]
    answers = [(association, 0.2) for association in tied]
    forwards, backwards = ordered_answers(answers, case), ordered_answers(answers[::-1], case)
    assert forwards == backwards
    assert [a for a, _ in forwards] == sorted(tied, key=Association.sort_key)


def test_what_differs_in_single_detections_only_is_one_answer() -> None:
    case = a_case()
    seen_once = Association([[0, 0, 0], [1, 1, 1], [2, -1, -1]], (3, 3, 3))
    false = Association([[0, 0, 0], [1, 1, 1]], (3, 3, 3))
    assert ordered_answers([(seen_once, 0.5), (false, 0.25)], case) == [(false, 0.75)]
    assert ordered_answers([(seen_once, -3.0), (false, -5.0)], case) == [(false, -3.0)]


@pytest.mark.parametrize(
    "answers",
    [
        [1.0],
        [("A", 1.0)],
        [(Association([[0, 0]], (1, 1)), 1.0)],
        [(Association([], (3, 3, 3)), float("nan"))],
        [(Association([], (3, 3, 3)), "high")],
    ],
)
def test_an_answer_that_is_none_is_refused(answers: list[tuple[Association, float]]) -> None:
    with pytest.raises(AnswerError):
        ordered_answers(answers, a_case())


@settings(max_examples=50, deadline=None)
@given(scores=st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=6), seed=st.integers(0, 99))
def test_the_rank_counts_the_answers_before_the_truth(scores: list[float], seed: int) -> None:
    case = a_case()
    rng = np.random.default_rng(seed)
    tables = {case.truth} | {
        Association(np.column_stack([rng.permutation(3) for _ in range(3)]), (3, 3, 3))
        for _ in scores[1:]
    }
    answers = list(zip(sorted(tables, key=Association.sort_key), scores, strict=False))
    ordered = ordered_answers(answers, case)
    verdict = verdict_on("m", ordered, case, {}, lambda _: 0.0)
    of_truth = dict(answers).get(case.truth)
    if of_truth is None:
        assert verdict.rank is None
    else:
        better = sum(round(s, 12) > round(of_truth, 12) for _, s in answers)
        tied = sum(round(s, 12) == round(of_truth, 12) for _, s in answers)
        assert better < (verdict.rank or 0) <= better + tied
    read = all(0.0 <= s <= 1.0 for _, s in answers) and sum(s for _, s in answers) <= 1.0 + 1e-6
    assert (verdict.forecast is not None) == read


def test_candidates_hold_the_truth_and_come_in_a_fixed_order() -> None:
    case = a_case()
    found = with_candidates(case.run, case.assumptions).candidates
    assert case.truth in found
    assert list(found) == sorted(set(found), key=Association.sort_key)


def test_methods_see_nothing_of_the_truth() -> None:
    seen: list[object] = []

    def spy(run: object, assumptions: Assumptions) -> list[tuple[Association, float]]:
        seen.extend([run, assumptions])
        return []

    sweep = Sweep(kinds=("annulus",), landmarks=(3,), epsilons=(EPSILON,), noises=("uniform",),
                  scenes=1)  # fmt: skip
    compare(sweep, {"spy": Method(spy, weighs_candidates=False)}, ours=[])
    run, assumptions = seen
    assert all(scan.labels is None for scan in run.scans)  # type: ignore[attr-defined]
    assert assumptions.candidates == ()  # type: ignore[attr-defined]


def test_the_example_of_the_documentation_runs_as_it_stands() -> None:
    page = (Path(__file__).parents[3] / "docs" / "bench.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    names: dict[str, Outcome] = {}
    exec(example, names)  # noqa: S102 - our own page
    outcome = names["outcome"]
    assert outcome.methods == ("order-keeping", "mine", *CEILINGS)
    found = verdicts(outcome)
    assert [v.rank for v in found["mine"]] == [v.rank for v in found["order-keeping"]]
    method = example[example.index("def ") : example.index("\n\nsweep")]
    assert len(method.splitlines()) <= 10
