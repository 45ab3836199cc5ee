"""Reliability curves: how often candidates of a stated probability were true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from mht_slam.evaluation.calibration import N_BINS, Forecast, reliability_curve
from mht_slam.evaluation.significance import wilson_interval


def draw_reliability_curve(
    axes: Axes,
    forecasts: Sequence[Forecast],
    label: str,
    style: Mapping[str, object],
    *,
    fewest: int,
    n_bins: int = N_BINS,
    sidestep: float = 0.0,
) -> None:
    """Draw one curve over all candidates of all scenes, with 95 % Wilson intervals.

    The curve breaks at bins of fewer than `fewest` candidates. `style` is matplotlib's, colour and
    marker for instance; `sidestep` moves the markers in stated probability, so that those of
    several curves stand beside each other. Forecasts without candidates are left out; where no
    other is left nothing is drawn.
    """
    said = [forecast for forecast in forecasts if len(forecast.probabilities)]
    if not said:
        return
    curve = reliability_curve(said, "all", n_bins=n_bins)
    drawn = curve.counts >= fewest
    rate = np.where(drawn, curve.rate, np.nan)
    intervals = [
        wilson_interval(round(count * share) if count else 0, count)
        for count, share in zip(curve.counts.tolist(), curve.rate.tolist(), strict=True)
    ]
    low, high = (np.array([getattr(i, end) for i in intervals]) for end in ("low", "high"))
    errors = np.where(drawn, np.maximum([rate - low, high - rate], 0.0), np.nan)
    axes.errorbar(
        curve.mean_probability + sidestep,
        rate,
        yerr=errors,
        label=label,
        markersize=4.5,
        linewidth=1.2,
        elinewidth=0.8,
        zorder=3,
        **style,  # type: ignore[arg-type]
    )
