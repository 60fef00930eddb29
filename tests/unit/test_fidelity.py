"""Streams of reads compared: the same are at distance 0, and each figure sees what it is about and nothing else."""

import json

import numpy as np
import pytest
from scipy.stats import ks_2samp

from testbed.fidelity import compare, distance, document, page
from testbed.types import Reads


def stream(seed=0, gap=0.02, noise=0.1, spread=1.0, flips=0.0, n=600):
    random = np.random.default_rng(seed)
    t = np.cumsum(random.exponential(gap, n))
    phase = 2 + random.normal(0, noise, n) + np.pi * (random.uniform(size=n) < flips)
    tag = np.arange(n) % 6
    return Reads(t, t, np.zeros(n), tag, rssi=-60 + random.normal(0, spread, n), phase=np.mod(phase, 2 * np.pi))


def test_a_stream_is_like_itself():
    assert [one.distance for one in compare(stream(), stream())] == [0.0] * 4


@pytest.mark.parametrize(
    ("changes", "figure"),
    [({"gap": 0.04}, "gap_s"), ({"noise": 0.3}, "phase_noise_rad"), ({"spread": 4.0}, "rssi_spread_db"), ({"flips": 0.2}, "jump_rate")],
)
def test_each_figure_sees_its_own(changes, figure):
    found = {one.figure: one.distance for one in compare(stream(1), stream(2, **changes))}
    assert found[figure] == max(found.values())
    assert found[figure] > 0.2


def test_the_distance_is_scipys():
    random = np.random.default_rng(3)
    a, b = random.normal(0, 1, 200), random.normal(0.3, 1.5, 333)
    assert distance(a, b) == pytest.approx(ks_2samp(a, b).statistic, abs=1e-12)


def test_no_reads_at_all_have_no_distance_and_a_page_all_the_same():
    found = compare(stream(), Reads.empty())
    assert all(np.isnan(one.distance) for one in found)
    assert "no such reads" in page(found, "a<b", "c")
    assert "a&lt;b" in page(found, "a<b", "c")
    json.dumps(document(found), allow_nan=False)
