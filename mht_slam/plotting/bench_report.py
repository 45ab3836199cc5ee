"""The figures of a comparison as SVG, ready for its report."""

from __future__ import annotations

import io

import matplotlib

from mht_slam.evaluation.bench.report import Picture
from mht_slam.evaluation.bench.summary import Summary
from mht_slam.plotting.bench_probabilities import (
    agreement_figure,
    reliability_figure,
    times_figure,
)
from mht_slam.plotting.bench_rates import Captioned, exact_rates_figure, noise_figure


def report_pictures(summary: Summary) -> list[Picture]:
    """Draw every figure that the comparison has numbers for."""
    drawn = [
        exact_rates_figure(summary),
        noise_figure(summary),
        agreement_figure(summary),
        reliability_figure(summary),
        times_figure(summary),
    ]
    return [_picture(each) for each in drawn if each is not None]


def _picture(captioned: Captioned) -> Picture:
    file = io.StringIO()
    # Names inside an SVG must differ between the figures of one page, and not between two runs.
    with matplotlib.rc_context({"svg.hashsalt": captioned.title}):
        captioned.figure.savefig(file, format="svg", metadata={"Date": None})
    return Picture(captioned.title, file.getvalue(), captioned.caption)
