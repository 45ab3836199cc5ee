"""What a run says on the screen: the one table, what agrees, and what was assumed."""

from __future__ import annotations

import math

from rich import box
from rich.console import Console
from rich.table import Table

from mht_slam.association import MISSED, Association
from mht_slam.cli.results import SEEDS_FILE, TABLE_FILE, describe_association, truth_of
from mht_slam.comparison import Comparison
from mht_slam.hypotheses import Posterior, Ranking
from mht_slam.pipeline import Solution

ROWS_SHOWN = 15
"""Rows of the table on the screen; table.csv has them all."""


def print_report(
    console: Console, solution: Solution, truth: Association | None, *, own_sigmas: bool
) -> None:
    """Print the table of hypotheses, what agrees, and every prior.

    `own_sigmas` says that a scan states its own sigma, which goes before the model's.
    """
    longer = solution.seeds is not None
    of_ranked = truth_of(solution, truth)
    if len(solution.ranking):
        where = _named(solution.ranking.scans) + ": hypotheses" if longer else "Hypotheses"
        console.print(_table(solution.comparison, of_ranked, f"{where}, most probable first"))
        hidden = len(solution.comparison.rows) - ROWS_SHOWN
        if hidden > 0:
            console.print(f"… and {hidden} more in {SEEDS_FILE if longer else TABLE_FILE}")
        console.print(agreement(solution.comparison, of_ranked), soft_wrap=True)
    else:
        console.print(_nothing(solution.ranking), soft_wrap=True)
        if not longer:
            return
    if longer:
        console.print()
        _print_longer(console, solution.posterior, truth)
    console.print(f"Assumed: {solution.posterior.model.describe()}.", soft_wrap=True)
    console.print("Probabilities are over the associations refined, not over all there are.")
    if own_sigmas:
        console.print("Scans that state their own sigma were weighed with it.")


def _print_longer(console: Console, posterior: Posterior, truth: Association | None) -> None:
    """Print the hypotheses over all scans, too long to be written out on a screen."""
    if not len(posterior):
        console.print("No association of all scans was found.")
        return
    console.print(_table_of_all_scans(posterior, truth))
    console.print(f"The associations are in {TABLE_FILE}.")
    undecided = len(posterior.undecided_pairs())
    if undecided:
        console.print(
            f"{undecided} pairs of detections are undecided: neither surely one landmark nor two."
        )


def agreement(comparison: Comparison, truth: Association | None) -> str:
    """Say in one line what the two scores agree on, and where the truth stands."""
    verb = "agree on" if comparison.top1_agree else "differ on"
    line = f"Polygon score and graph evidence {verb} the first hypothesis"
    if comparison.kendall_tau is not None:
        line += f"; Kendall's tau-b {comparison.kendall_tau:.2f}"
    if truth is None:
        return line + "; the truth is not known."
    if comparison.truth_evidence_rank is None:
        return line + "; the truth is not among the candidates."
    polygon = comparison.truth_polygon_rank
    return (
        line + f"; the truth ranks {polygon} by polygon, {comparison.truth_evidence_rank} by graph."
    )


def _table_of_all_scans(posterior: Posterior, truth: Association | None) -> Table:
    table = Table(
        title=f"{_named(posterior.scans)}: hypotheses, most probable first",
        box=box.SIMPLE_HEAD,
        padding=0,
        show_edge=False,
    )
    headings = ("land-\nmarks", "of them\nseen once", "false\nalarms", "misses")
    for heading in (*headings, "graph\nlog lik.", "graph\nlog evid.", "prob-\nability"):
        table.add_column(heading, justify="right", no_wrap=True)
    if truth is not None:
        table.add_column("F1 of\npairs", justify="right", no_wrap=True)
    for h in posterior[:ROWS_SHOWN]:
        once = int(((h.association.table != MISSED).sum(axis=1) == 1).sum())
        cells = [
            f"{h.association.n_landmarks}",
            f"{once}",
            f"{len(h.association.false_alarms)}",
            f"{h.association.n_missed}",
            _decimals(h.log_likelihood),
            _decimals(h.log_evidence),
            f"{h.probability:.4f}",
        ]
        if truth is not None:
            exact = h.association.exact(truth)
            cells.append("truth" if exact else f"{h.association.f1(truth):.3f}")
        table.add_row(*cells)
    return table


def _named(scans: tuple[int, ...]) -> str:
    if len(scans) > 4:
        return f"All {len(scans)} scans"
    return f"Scans {', '.join(map(str, scans))}"


def _table(comparison: Comparison, truth: Association | None, title: str) -> Table:
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    # Only associations may be broken into lines: a number cut short is worse than none.
    table.add_column("association,\nby landmark", overflow="fold")
    for heading in (
        "polygon\nscore",
        "polygon\nrank",
        "graph\nlog lik.",
        "graph\nlog evid.",
        "prob-\nability",
        "graph\nrank",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    if truth is not None:
        table.add_column("truth", justify="center", no_wrap=True)
    for row in comparison.rows[:ROWS_SHOWN]:
        cells = [
            describe_association(row.association),
            "" if row.polygon_score is None else f"{row.polygon_score:.4f}",
            "" if row.polygon_rank is None else f"{row.polygon_rank}",
            _decimals(row.log_likelihood),
            _decimals(row.log_evidence),
            f"{row.probability:.4f}",
            f"{row.evidence_rank}",
        ]
        if truth is not None:
            cells.append("truth" if row.association.exact(truth) else "")
        table.add_row(*cells)
    return table


def _decimals(value: float | None) -> str:
    return "none" if value is None or not math.isfinite(value) else f"{value:.2f}"


def _nothing(ranking: Ranking) -> str:
    if "not_ranked" in ranking.options:
        return f"Polygons rank nothing here: {ranking.options['not_ranked']}."
    return (
        f"No association has a positive polygon score with epsilon "
        f"{math.degrees(ranking.epsilon):g} deg and max_range "
        f"{ranking.options.get('max_range', math.nan):g} baselines: noise beyond epsilon, a "
        "landmark beyond max_range, or base cells that overlap. Try a larger --epsilon-deg or "
        "--max-range."
    )
