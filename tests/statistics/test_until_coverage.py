"""What it costs to stop when an interval is narrow: how often it then covers the truth, and how far the mean is off."""

import numpy as np
import pytest

from testbed.until import Until

RUNS = 2000
KINDS = {
    "normal": (lambda rng, n: rng.normal(1.0, 0.4, n), 1.0),
    "exponential": (lambda rng, n: rng.exponential(1.0, n), 1.0),
    "lognormal": (lambda rng, n: rng.lognormal(0.0, 0.7, n), float(np.exp(0.245))),
}


def stopped(until, values):
    """(n, mean, low, high) of a run on a figure that takes these values, trial by trial."""
    n = until.first(0)
    while True:
        rows = {"point": np.zeros(n, int), "trial": np.arange(n), "estimator": np.full(n, "ukf"), "x": values[:n]}
        more = until.more(n, rows, {}, [0], 4)
        if more == n:
            found = until.interval(rows, {}, 0)
            return n, found.mean, found.low, found.high
        n = more


def measured(kind, width):
    """Share of runs that cover, bias by the half width asked for, mean number of trials."""
    draw, truth = KINDS[kind]
    rng = np.random.default_rng([7, len(kind), int(1000 * width)])
    until = Until.parse(f"ukf.x ± {100 * width:g}%", most=4096)
    runs = np.array([stopped(until, draw(rng, 4096)) for _ in range(RUNS)])
    covers = ((runs[:, 2] <= truth) & (truth <= runs[:, 3])).mean()
    return covers, (runs[:, 1].mean() - truth) / (width * truth), runs[:, 0].mean()


@pytest.mark.study
@pytest.mark.parametrize(
    ("kind", "width", "least", "most_bias"),
    [
        ("normal", 0.15, 0.915, 0.1),
        ("normal", 0.05, 0.925, 0.1),
        ("exponential", 0.3, 0.87, 0.3),
        ("exponential", 0.1, 0.91, 0.3),
        ("lognormal", 0.2, 0.85, 0.3),
        ("lognormal", 0.1, 0.88, 0.3),
    ],
)
def test_the_interval_covers_about_as_often_as_is_said(kind, width, least, most_bias, capsys):
    """2,000 runs: a share of 0.9 is known to ± 0.007; bounds are three of these below what was measured when this was written."""
    covers, bias, trials = measured(kind, width)
    with capsys.disabled():
        print(f"\n{kind} ± {100 * width:g}%: covers {covers:.3f}, bias {bias:+.3f} of the half width, {trials:.0f} trials")  # noqa: T201
    assert least <= covers <= 0.975
    assert abs(bias) < most_bias
