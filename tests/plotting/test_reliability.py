"""A reliability curve stands where its candidates came true, and breaks where there are few."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mht_slam.evaluation.calibration import Forecast
from mht_slam.plotting.reliability import draw_reliability_curve


@pytest.fixture
def axes() -> Axes:
    return Figure().subplots()


def test_a_curve_shows_rates_with_intervals_and_breaks_at_rare_bins(axes: Axes) -> None:
    # 40 candidates at .7, of which 30 are true, as many at .3, and three at .95.
    forecasts = [Forecast([0.7, 0.3], int(k >= 30)) for k in range(40)]
    forecasts += [Forecast([0.95], 0)] * 3 + [Forecast([], None)]
    draw_reliability_curve(axes, forecasts, "mine", {"color": "k"}, fewest=4, sidestep=0.01)
    (curve,) = axes.containers
    assert curve.get_label() == "mine"
    places, rates = curve.lines[0].get_data()
    shown = np.isfinite(rates)
    assert places[shown] == pytest.approx([0.31, 0.71])
    assert rates[shown] == pytest.approx([0.25, 0.75])
    (bars,) = curve.lines[2]
    low, high = bars.get_segments()[int(np.flatnonzero(shown)[1])][:, 1]
    assert (low, high) == pytest.approx((0.598, 0.858), abs=1e-3)  # Wilson's interval of 30 in 40


def test_nothing_said_draws_nothing(axes: Axes) -> None:
    draw_reliability_curve(axes, [Forecast([], None)], "mute", {}, fewest=1)
    assert not axes.containers
