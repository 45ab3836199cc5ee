"""One HTML page of a comparison that holds everything and opens without a network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from mht_slam.evaluation.bench.compare import Outcome
from mht_slam.evaluation.bench.summary import Summary, markdown
from mht_slam.evaluation.bench.tables import time_rows


@dataclass(frozen=True)
class Picture:
    """A figure of the report: a title, the figure as an SVG document, and what it shows."""

    title: str
    svg: str
    caption: str


def html_report(
    summary: Summary,
    pictures: Sequence[Picture],
    configuration: Mapping[str, Any],
    *,
    title: str = "Associations of bearings: methods compared",
) -> str:
    """Return the page: figures with captions, all tables, times, configuration.

    Parameters
    ----------
    configuration : what the comparison rests on, by name: settings, seed, versions, machine.

    Every string from outside is escaped; nothing is loaded from anywhere.
    """
    outcome = summary.outcome
    n_failed = sum(v.failure is not None for r in outcome.results for v in r.verdicts)
    lead = (
        f"{len(outcome.results)} scenes in {len(outcome.sources)} cells, "
        f"{len(outcome.methods)} methods and ceilings, {n_failed} failed answers."
    )
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1><p>{escape(lead)}</p>",
    ]
    for number, picture in enumerate(pictures, start=1):
        parts.append(
            f"<figure><h2>{escape(picture.title)}</h2>{_inline(picture.svg)}"
            f"<figcaption><b>Figure {number}.</b> {escape(picture.caption)}</figcaption></figure>"
        )
    parts += ["<h2>Tables</h2>", *_tables(markdown(summary))]
    parts += ["<h2>Time</h2>", _time_table(outcome), "<h2>Configuration</h2>"]
    rows = [[str(name), str(value)] for name, value in configuration.items()]
    parts += [_table(["setting", "value"], rows), *_failures(outcome), "</body></html>"]
    return "\n".join(parts) + "\n"


STYLE = (
    "body{font-family:system-ui,sans-serif;max-width:80rem;margin:2rem auto;padding:0 1rem;"
    "line-height:1.45;color:#111;background:#fff}"
    "figure{margin:2rem 0}svg{max-width:100%;height:auto}figcaption{max-width:50rem}"
    ".wide{overflow-x:auto}table{border-collapse:collapse;font-size:.8rem;margin:.8rem 0}"
    "th,td{border:1px solid #bbb;padding:.2rem .4rem;text-align:left;white-space:nowrap;"
    "font-variant-numeric:tabular-nums}th{background:#eee}"
    "td:last-child{white-space:normal;min-width:8rem}"
)


def _inline(svg: str) -> str:
    """Drop what may stand only at the head of a document."""
    return svg[svg.index("<svg") :]


def _tables(text: str) -> list[str]:
    """Turn the Markdown of `summary.markdown` into HTML: headings, paragraphs and tables."""
    parts: list[str] = []
    for block in text.strip().split("\n\n"):
        lines = block.split("\n")
        if lines[0].startswith("## "):
            parts.append(f"<h3>{escape(lines[0][3:])}</h3>")
        elif lines[0].startswith("| "):
            cells = [_cells(line) for line in lines]
            parts.append(_table(cells[0], cells[2:]))
        else:
            parts.append(f"<p>{escape(' '.join(lines))}</p>")
    return parts


def _cells(line: str) -> list[str]:
    escaped = line.replace("\\|", "\0").strip("|")
    return [cell.strip().replace("\0", "|") for cell in escaped.split("|")]


def _time_table(outcome: Outcome) -> str:
    rows = [
        [row["cell"], row["method"], str(row["scenes"]), f"{row['median_ms']:.3g}",
         f"{row['total_s']:.3g}"]
        for row in time_rows(outcome)
    ]  # fmt: skip
    return _table(["cell", "method", "scenes", "median, ms", "in all, s"], rows)


def _failures(outcome: Outcome) -> list[str]:
    """List the first words of each kind of failure."""
    messages = {(t.source, t.scene, m): text for t in outcome.times for m, text in
                t.messages.items()}  # fmt: skip
    counts: dict[tuple[str, str], int] = {}
    examples: dict[tuple[str, str], str] = {}
    for result in outcome.results:
        for verdict in result.verdicts:
            if verdict.failure is not None:
                kind = (verdict.method, verdict.failure)
                counts[kind] = counts.get(kind, 0) + 1
                message = messages.get((result.source, result.scene, verdict.method), "")
                examples.setdefault(kind, message)
    if not counts:
        return []
    rows = [[*kind, str(count), examples[kind]] for kind, count in sorted(counts.items())]
    return ["<h2>Failures</h2>", _table(["method", "failure", "scenes", "for example"], rows)]


def _table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(title)}</th>" for title in titles)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'
