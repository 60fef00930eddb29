"""What a reader offered in a trial, in the figures by which streams of readers are compared: scenarios assert them as `world`.

Each is (value, weight), so that several sensors can be put together. NaN with weight 0 is a figure that had nothing to speak of.

    line_of_sight            share of straight lines between antennas and target tags in reach with nothing on them
    gap_p50_s, gap_p90_s     between consecutive reads of one tag by one antenna
    phase_std_p10_rad, ...   10th, 50th, 90th percentile of the circular standard deviation of the phase of one standing tag at one
                             standing antenna on one carrier
    phase_jump_share         of consecutive reads of such a link, those that are off by π, within `ABOUT`
    rssi_channel_std_db      standard deviation over the carriers of the mean RSSI of a standing link
    rssi_inversion_db        the most by which a standing tag near an antenna's boresight is heard better than a nearer one there
"""

from __future__ import annotations

import numpy as np

from testbed.columns import Array
from testbed.radio.antenna import off_boresight
from testbed.radio.coupling import polarisation_loss
from testbed.radio.setting import Radio
from testbed.radio.sight import Obstacles
from testbed.scene import WORLD, Truth
from testbed.sensors.carrier import instants
from testbed.types import Reads
from testbed.units import wrap

Share = tuple[float, float]

SIGHT_HZ = 2.0  # how often lines of sight are looked at
ABOUT = 0.75  # rad: a flip of π under the phase noise of two reads near the floor (0.1 rad each) is within this at 5 sigma
FEW = 5  # reads of which a spread is said
BORESIGHT = np.deg2rad(10)  # a tag nearer to it than this is on it: a 65° pattern has lost less than 0.3 dB
NOTHING: Share = (float("nan"), 0.0)


def line_of_sight(radio: Radio, truth: Truth, duration: float, tags: Array) -> Share:
    """The share of clear straight lines, at SIGHT_HZ, of those no longer than free space lets a tag wake over on boresight."""
    t = instants(duration, SIGHT_HZ)
    gain = radio.antennas.power + radio.antennas.gain - polarisation_loss(radio.antennas)
    best = (radio.tags.gain - radio.tags.sensitivity)[tags].max(initial=-np.inf)
    reach = radio.wavelength / (4 * np.pi) * 10 ** ((gain + best) / 20)
    seen, clear = 0, 0
    for antenna in range(len(radio.antennas)):
        k, j = (a.ravel() for a in np.meshgrid(np.arange(len(t)), np.arange(len(tags)), indexing="ij"))
        start = radio.near.at(truth, np.full(len(k), antenna), t[k])[:, :3]
        end = radio.far.at(truth, tags[j], t[k])[:, :3]
        near = np.linalg.norm(end - start, axis=1) <= reach[antenna]
        poses = truth.pose(np.arange(len(truth.bodies)), t[:, None]) if truth.bodies else np.empty((len(t), 0, 7))
        lines = Obstacles(radio.caster, poses, k[near].astype(np.int64), np.full(int(near.sum()), len(truth.bodies) > 0), True)
        count = lines.on(np.arange(int(near.sum())), start[near], end[near]).count
        seen, clear = seen + len(count), clear + int((count == 0).sum())
    return (clear / seen, float(seen)) if seen else NOTHING


def stream_figures(reads: Reads, radio: Radio) -> dict[str, Share]:
    """All figures of a reader's own stream; `reads.antenna` counts from the radio's first antenna."""
    found = _gaps(reads)
    still = reads.take((radio.near.body[reads.antenna] == WORLD) & (radio.far.body[reads.tag] == WORLD))
    return {**found, **_phases(still), **_levels(still, radio)}


def _gaps(reads: Reads) -> dict[str, Share]:
    order, new = _groups([reads.tag, reads.antenna], reads.t)
    gaps = np.diff(reads.t[order])[~new[1:]]
    return {f"gap_p{q}_s": _share(np.percentile(gaps, q), len(gaps)) if len(gaps) else NOTHING for q in (50, 90)}


def _phases(reads: Reads) -> dict[str, Share]:
    order, new = _groups([reads.channel, reads.tag, reads.antenna], reads.t)
    phase = reads.phase[order]
    turned = np.abs(wrap(np.diff(phase)))[~new[1:]]
    group = np.cumsum(new) - 1
    mean = _means(np.exp(1j * phase), group)
    many = np.bincount(group, minlength=len(mean)) >= FEW
    spread = np.sqrt(-2 * np.log(np.clip(np.abs(mean[many]), 1e-300, 1.0)))
    found = {f"phase_std_p{q}_rad": _share(np.percentile(spread, q), len(spread)) if len(spread) else NOTHING for q in (10, 50, 90)}
    return {**found, "phase_jump_share": _share(np.mean(turned > np.pi - ABOUT), len(turned)) if len(turned) else NOTHING}


def _levels(reads: Reads, radio: Radio) -> dict[str, Share]:
    order, new = _groups([reads.channel, reads.tag, reads.antenna], reads.t)
    group = np.cumsum(new) - 1
    level = np.real(_means(reads.rssi[order], group))
    enough = np.bincount(group, minlength=len(level)) >= FEW
    first = order[new][enough]
    antenna, tag, level = reads.antenna[first], reads.tag[first], level[enough]
    link, of = np.unique(np.stack([antenna, tag], axis=1).reshape(-1, 2), axis=0, return_inverse=True)
    of = of.ravel()
    spread = np.array([level[of == i].std() for i in range(len(link)) if (of == i).sum() >= 2])
    inversions = [found for a in np.unique(link[:, 0]) if (found := _inversion(radio, a, link, of, level)) is not None]
    return {
        "rssi_channel_std_db": _share(spread.mean(), len(spread)) if len(spread) else NOTHING,
        "rssi_inversion_db": _share(max(inversions), len(inversions)) if inversions else NOTHING,
    }


def _inversion(radio: Radio, antenna: int, link: Array, of: Array, level: Array) -> float | None:
    """dB, over the tags on the antenna's boresight; None where fewer than two are."""
    mine = np.flatnonzero(link[:, 0] == antenna)
    cosine, distance = off_boresight(radio.near.pose[antenna, 3:], radio.far.pose[link[mine, 1], :3] - radio.near.pose[antenna, :3])
    mine, distance = mine[cosine >= np.cos(BORESIGHT)], distance[cosine >= np.cos(BORESIGHT)]
    if len(mine) < 2:
        return None
    heard = np.array([level[of == i].mean() for i in mine])[np.argsort(distance, kind="stable")]
    return float((heard - np.minimum.accumulate(heard)).max())


def _groups(keys: list[Array], t: Array) -> tuple[Array, Array]:
    """Rows sorted by keys (the last first) and then time, and (N,) bool where a new group begins."""
    order = np.lexsort([t, *keys])
    new = np.zeros(len(order), dtype=bool)
    new[:1] = True
    for key in keys:
        new[1:] |= np.diff(key[order]) != 0
    return order, new


def _means(values: Array, group: Array) -> Array:
    """(groups,) complex means."""
    n = np.maximum(np.bincount(group), 1)
    return (np.bincount(group, np.real(values)) + 1j * np.bincount(group, np.imag(values))) / n


def _share(value: float | np.floating, weight: float) -> Share:
    return float(value), float(weight)
