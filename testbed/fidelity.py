"""How like real reads simulated ones are: gaps, phase noise, RSSI spread and jumps of phase, by quantiles and a distance.

Each figure is taken link by link (antenna, tag), neighbouring reads on one carrier for phases, and the two samples are compared by the
Kolmogorov-Smirnov distance, the largest difference of their distribution functions: 0 for the same, 1 for nothing in common. Left out:
how many tags and antennas there are, and where: that is for the scenario to have right.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from testbed.columns import Array
from testbed.types import Reads

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
NEIGHBOURS_S = 0.3  # reads farther apart say nothing of noise: the tag may have moved
LEAST = 5  # reads of a link, below which it has no spread
FLIP_RAD = 0.35
FIGURES = {
    "gap_s": "time between neighbouring reads of a link, s",
    "phase_noise_rad": "change of phase between neighbouring reads, jumps by π taken out, rad",
    "rssi_spread_db": "standard deviation of the RSSI of a link, dB",
    "jump_rate": "share of neighbouring reads of a link whose phase jumps by π",
}
STYLE = (
    "body{font:15px/1.5 sans-serif;margin:2em auto;max-width:60em}td,th{padding:.3em .8em;text-align:right}th:first-child{text-align:left}"
)


@dataclass(frozen=True)
class Likeness:
    """One figure in both streams: sizes of the samples, quantiles (5,) of each, and their distance; NaN where a sample is empty."""

    figure: str
    real: Array
    simulated: Array
    n_real: int
    n_simulated: int
    distance: float


def samples(reads: Reads) -> dict[str, Array]:
    """The sample of each figure."""
    order = np.lexsort((reads.t, reads.tag, reads.antenna))
    r = reads.take(order)
    same = (np.diff(r.antenna) == 0) & (np.diff(r.tag) == 0)
    gap = np.diff(r.t)[same]
    step = np.angle(np.exp(1j * np.diff(r.phase)))
    near = same & (np.diff(r.channel) == 0) & (np.diff(r.t) < NEIGHBOURS_S) & np.isfinite(step)
    jumps = np.pi - np.abs(step) < FLIP_RAD
    link = np.concatenate([[0], np.cumsum(~same)]) if len(r) else np.empty(0, dtype=np.int64)
    rate = [float(jumps[near & (link[1:] == k)].mean()) for k in np.unique(link) if (near & (link[1:] == k)).sum() >= LEAST]
    spread = [float(np.std(level)) for k in np.unique(link) if len(level := _finite(r.rssi[link == k])) >= LEAST]
    return {"gap_s": gap, "phase_noise_rad": np.abs(step[near & ~jumps]), "rssi_spread_db": np.array(spread), "jump_rate": np.array(rate)}


def compare(real: Reads, simulated: Reads) -> list[Likeness]:
    """Every figure in both streams."""
    a, b = samples(real), samples(simulated)
    return [
        Likeness(name, _quantiles(a[name]), _quantiles(b[name]), len(a[name]), len(b[name]), distance(a[name], b[name])) for name in FIGURES
    ]


def distance(a: Array, b: Array) -> float:
    """Kolmogorov-Smirnov distance of two samples; NaN where one is empty."""
    if not len(a) or not len(b):
        return float("nan")
    at = np.concatenate([a, b])
    left, right = (np.searchsorted(np.sort(s), at, side="right") / len(s) for s in (a, b))
    return float(np.abs(left - right).max())


def document(found: list[Likeness]) -> dict[str, Any]:
    """For JSON."""
    plain = {
        f.figure: {"distance": _plain(f.distance), "real": _listed(f.real, f.n_real), "simulated": _listed(f.simulated, f.n_simulated)}
        for f in found
    }
    return {"quantiles": list(QUANTILES), "figures": plain}


def page(found: list[Likeness], real: str, simulated: str) -> str:
    """One HTML page with both streams' quantiles side by side."""
    heads = "".join(f"<th>{q:.0%}</th>" for q in QUANTILES)
    parts = [
        f"<h1>{escape(simulated)} against {escape(real)}</h1><p>Distance: Kolmogorov-Smirnov, 0 for the same, 1 for nothing in common.</p>"
    ]
    for f in found:
        rows = "".join(
            f"<tr><th>{name}</th><td>{n}</td>{''.join(f'<td>{v:.4g}</td>' for v in values)}</tr>"
            for name, n, values in (("real", f.n_real, f.real), ("simulated", f.n_simulated, f.simulated))
        )
        said = f"distance {f.distance:.3f}" if np.isfinite(f.distance) else "one of the two has no such reads"
        parts.append(f"<h2>{escape(FIGURES[f.figure])}</h2><p>{said}</p><table><tr><th></th><th>n</th>{heads}</tr>{rows}</table>")
    return f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Fidelity</title><style>{STYLE}</style>{"".join(parts)}</html>\n'


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def _quantiles(sample: Array) -> Array:
    return np.quantile(sample, QUANTILES) if len(sample) else np.full(len(QUANTILES), np.nan)


def _plain(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _listed(values: Array, n: int) -> dict[str, Any]:
    return {"n": n, "quantiles": [_plain(v) for v in values]}
