"""How likely a tag answers over distance and angle: what a campaign measured, and the model fitted to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D

from testbed.columns import Array
from testbed.report.figures import FULL, Drawing, drawing, legend, legend_height, new, settle, styled
from testbed.report.palette import ESTIMATORS

if TYPE_CHECKING:
    from testbed.calibrate.counts import Blocks
    from testbed.calibrate.logistic_beta import Campaign

ANGLE, DISTANCE = 15.0, 0.5  # degrees and m: what is measured is put together in steps of them
MARKERS = ("o", "s", "^", "D", "v", "P")


@styled
def mean_and_variance(campaign: Campaign, name: str = "calibration") -> Drawing:
    """Mean (left) and variance (right) of the probability of detection over distance, a colour an angle: points measured, lines fitted."""
    blocks, fitted = campaign.blocks, campaign.fitted
    angle = np.round(blocks.degrees / ANGLE) * ANGLE
    known = np.unique(angle)
    shown = known[np.unique(np.linspace(0, len(known) - 1, len(ESTIMATORS)).round().astype(int))]
    handles = [_handle(i, a) for i, a in enumerate(shown)]
    title = f"{campaign.scenario}: probability of detection, measured and fitted"
    figure = new(3.4 + legend_height(FULL, handles), title, FULL)
    left, right = figure.subplots(1, 2)
    d = np.linspace(0.0, float(blocks.distance.max()) * 1.05, 200)
    for i, a in enumerate(shown):
        at, mean, variance = _measured(blocks.take(angle == a))
        left.plot(d, fitted.mean(d, np.full(len(d), a)), color=ESTIMATORS[i])
        left.plot(at, mean, linestyle="", marker=MARKERS[i], color=ESTIMATORS[i])
        right.plot(d, fitted.spread(d, np.full(len(d), a)), color=ESTIMATORS[i])
        right.plot(at, variance, linestyle="", marker=MARKERS[i], color=ESTIMATORS[i])
    left.set(xlabel="distance (m)", ylabel="mean", ylim=(-0.03, 1.03), title="mean")
    right.set(xlabel="distance (m)", ylabel="variance", ylim=(-0.01, 0.26), title="variance between blocks, chance of the draw taken off")
    legend(figure, handles)
    settle(figure)
    caption = (
        f"{len(blocks):,} blocks of {len(np.unique(blocks.run)):,} runs; angles off boresight to the nearest {ANGLE:g}°. "
        "Lines: the model with the parameters fitted, its variance within its limits."
    )
    return drawing(figure, name, title, caption)


def _handle(i: int, angle: float) -> Line2D:
    return Line2D([], [], color=ESTIMATORS[i], marker=MARKERS[i], label=f"{angle:g}° off boresight")


def _measured(blocks: Blocks) -> tuple[Array, Array, Array]:
    """Distances, and at each the mean of the share of queries answered, and its variance beyond that of a binomial draw."""
    at, of = np.unique(np.round(blocks.distance / DISTANCE) * DISTANCE, return_inverse=True)
    each = np.bincount(of)
    share = blocks.n / blocks.queries
    mean = np.bincount(of, weights=share) / each
    noise = mean[of] * (1 - mean[of]) / blocks.queries
    surplus = np.bincount(of, weights=(share - mean[of]) ** 2 - noise) / each
    return at, mean, np.maximum(surplus, 0.0)
