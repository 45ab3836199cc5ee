"""The report holds everything in one page, escapes what others wrote, and says what it shows."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from types import ModuleType
from xml.etree import ElementTree

import pytest

from mht_slam.evaluation.bench.compare import Outcome, compare
from mht_slam.evaluation.bench.judging import Verdict
from mht_slam.evaluation.bench.methods import GRAPH_EVIDENCE, ORDER_KEEPING, POLYGON
from mht_slam.evaluation.bench.report import Picture, html_report
from mht_slam.evaluation.bench.summary import Summary, summarise
from mht_slam.evaluation.bench.sweep import Sweep
from mht_slam.plotting.bench_probabilities import agreement_figure, times_figure
from mht_slam.plotting.bench_rates import exact_rates_figure, noise_figure
from mht_slam.plotting.bench_report import report_pictures

EVIL = "<script>alert('x')</script> & \"mine\""


@pytest.fixture(scope="module")
def summary(own: ModuleType) -> Summary:
    sweep = Sweep(kinds=("annulus",), landmarks=(3,), epsilons=(0.05, 0.1), scenes=4)
    outcome = compare(
        sweep,
        {EVIL: own.CHEAP, "raises": own.RAISES},
        ours=["order-keeping", "nearest bearing", "smallest epsilon"],
    )
    return summarise(outcome)


@pytest.fixture(scope="module")
def page(summary: Summary) -> str:
    return html_report(summary, report_pictures(summary), {"seed": 0, EVIL: EVIL}, title=EVIL)


class Reader(HTMLParser):
    """Collects tags, their attributes, and whether they close in order."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag != "meta":
            self.open.append(tag)
        self.links += [v or "" for k, v in attrs if k in ("src", "href", "xlink:href", "action")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)


def test_the_page_loads_nothing_and_is_well_formed(page: str) -> None:
    reader = Reader()
    reader.feed(page)
    assert reader.open == []
    assert not {"script", "link", "img", "iframe", "object"} & set(reader.tags)
    assert all(link.startswith("#") for link in reader.links)
    assert "@import" not in page
    assert not re.search(r"url\((?!#)", page)


def test_what_others_wrote_is_escaped(page: str) -> None:
    assert "<script" not in page
    assert "&lt;script&gt;" in page
    assert "<b>at all</b>" not in page
    assert "&lt;b&gt;at all&lt;/b&gt;" in page


def test_the_page_shows_every_method_cell_failure_and_setting(page: str, summary: Summary) -> None:
    for name in ("order-keeping", "raises", "known association (ceiling)"):
        assert f"<td>{name}</td>" in page
    assert all(source.name in page for source in summary.outcome.sources)
    assert "<td>RuntimeError</td><td>16</td><td>no idea about 3 scans" in page
    assert "<td>seed</td><td>0</td>" in page
    assert page.count("<figcaption>") == len(report_pictures(summary))


def test_figures_are_whole_documents_and_the_same_each_time(summary: Summary) -> None:
    first, again = report_pictures(summary), report_pictures(summary)
    assert first == again
    for picture in first:
        ElementTree.fromstring(picture.svg)  # noqa: S314 - our own figure
        assert picture.caption.endswith(".")


def test_identifiers_of_two_figures_on_a_page_do_not_clash(summary: Summary) -> None:
    clips = [
        set(re.findall(r'<clipPath id="([^"]+)"', picture.svg))
        for picture in report_pictures(summary)
    ]
    assert all(a.isdisjoint(b) for i, a in enumerate(clips) for b in clips[:i])


def test_every_axis_that_has_numbers_says_its_unit(summary: Summary) -> None:
    for drawn in (exact_rates_figure(summary), noise_figure(summary), times_figure(summary)):
        assert drawn is not None
        for axes in drawn.figure.axes:
            if axes.axison:
                assert re.search(r"share|deg|ms|tau|scenes", axes.get_xlabel())


def test_every_axis_of_rates_names_its_interval(summary: Summary) -> None:
    sides = made_up(summary.outcome, {POLYGON: [True, False], GRAPH_EVIDENCE: [False, True]})
    for drawn in (exact_rates_figure(summary), noise_figure(summary), agreement_figure(sides)):
        assert drawn is not None
        labels = [axes.get_xlabel() + axes.get_ylabel() for axes in drawn.figure.axes]
        rates = [label for label in labels if "share" in label]
        assert rates
        assert all("95 % interval" in label for label in rates)


def verdict(method: str, right: bool) -> Verdict:
    return Verdict(
        method=method, failure=None, listed=2, rank=1 if right else 2, f1=1.0,
        first="right" if right else "wrong", forecast=[1.0], truth=0 if right else None,
        tau=0.5, map_error=0.1,
    )  # fmt: skip


def made_up(outcome: Outcome, right: dict[str, list[bool]]) -> Summary:
    """A summary in which the methods are right on just these scenes of one cell."""
    scenes = range(len(next(iter(right.values()))))
    result = outcome.results[0]
    results = tuple(
        replace(result, scene=i, verdicts=tuple(verdict(m, flags[i]) for m, flags in right.items()))
        for i in scenes
    )
    return summarise(Outcome(outcome.sources[:1], tuple(right), results, outcome.times[:1]))


@pytest.mark.parametrize(
    ("graph", "words"),
    [
        ([True] * 20, "is right more often than order-keeping"),
        ([True] * 10 + [False] * 10, "shows no difference to order-keeping"),
        ([False] * 20, "is right less often than order-keeping"),
    ],
)
def test_captions_say_what_the_numbers_say(summary: Summary, graph: list[bool], words: str) -> None:
    right = {ORDER_KEEPING: [True] * 10 + [False] * 10, GRAPH_EVIDENCE: graph}
    if words.startswith("is right less"):
        right[ORDER_KEEPING] = [True] * 20
    caption = exact_rates_figure(made_up(summary.outcome, right)).caption
    assert f"Graph evidence {words}" in caption


def test_the_caption_of_disagreement_names_who_is_right(summary: Summary) -> None:
    graph = {POLYGON: [False] * 20, GRAPH_EVIDENCE: [True] * 20}
    polygon = {POLYGON: [True] * 20, GRAPH_EVIDENCE: [False] * 20}
    neither = {POLYGON: [True, False], GRAPH_EVIDENCE: [False, True]}
    for right, words in (
        (graph, "so the graph is right more often"),
        (polygon, "so the polygons are right more often"),
        (neither, "no evidence that either is right more often"),
    ):
        drawn = agreement_figure(made_up(summary.outcome, right))
        assert drawn is not None
        assert words in drawn.caption


def test_bars_of_disagreement_are_shares_of_the_scenes_both_answered(summary: Summary) -> None:
    right = {POLYGON: [True] * 4 + [False], GRAPH_EVIDENCE: [True] * 3 + [False, True]}
    drawn = agreement_figure(made_up(summary.outcome, right))
    assert drawn is not None
    bars = drawn.figure.axes[1].patches
    assert [bar.get_width() for bar in bars] == pytest.approx([0.2, 0.2, 0.0])


def test_the_caption_against_noise_counts_what_is_beyond_chance(summary: Summary) -> None:
    source, other = summary.outcome.sources[:2]
    graph = {ORDER_KEEPING: [False] * 12, GRAPH_EVIDENCE: [True] * 12}
    even = {ORDER_KEEPING: [True] * 12, GRAPH_EVIDENCE: [True] * 12}
    for at_most_noise, words in ((graph, "difference in 1."), (even, "difference in 0.")):
        parts = [made_up(summary.outcome, even), made_up(summary.outcome, at_most_noise)]
        results = [
            replace(result, source=where.key)
            for part, where in zip(parts, (source, other), strict=True)
            for result in part.outcome.results
        ]
        methods = (ORDER_KEEPING, GRAPH_EVIDENCE)
        drawn = noise_figure(summarise(Outcome((source, other), methods, tuple(results), ())))
        assert drawn is not None
        assert drawn.caption.endswith(words)


def test_a_table_cell_may_hold_a_bar(summary: Summary) -> None:
    outcome = made_up(summary.outcome, {"a|b": [True, False]})
    page = html_report(outcome, [Picture("t", "<svg></svg>", "c")], {})
    assert "<td>a|b</td>" in page
