"""The channel of every link of one reader: direct path, reflections and diffuse part in one complex number h.

    h = g · (√(K/(K+1)) e^{-j2πf(d+δ)/c} + √(1/(K+1)) D)  +  Σ over reflections of g_i Γ_i e^{-j2πf d_i/c}

(one way, all gains inside; `testbed.radio.propagation` says what follows from it). The direct path's loss and its detour δ
come from `sight`, K and D from `diffuse`, reflections from `reflection`; here they meet, so that counts, RSSI and phase agree.

What costs time is asked for as seldom as can be. Pairs out of reach are never looked at. What stands still between an antenna and
a tag that stand still is found once for all trials (`Fixed`), and its h once a trial; it is looked at again only while a
moving body is near. What can't be heard whatever the fading is not searched for ways round (`testbed.radio.setting`).

Left out: tags that detune or shade each other, motion within one read, other readers' waves, and what each part says it leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from testbed.columns import Array, Table, column
from testbed.radio.diffraction import CLEAR_OF_ZONE, clearance
from testbed.radio.diffuse import Field, Stir
from testbed.radio.movers import Posed
from testbed.radio.propagation import direct_path
from testbed.radio.setting import Lines, Paths, Radio
from testbed.radio.sight import BULGE, SEARCH, Obstacles, Sight
from testbed.scene import WORLD, Truth
from testbed.units import SPEED_OF_LIGHT

Look = Callable[[Array, Obstacles], Sight]  # sight of some of the lines, past these obstacles


@dataclass(frozen=True, eq=False)
class Response(Table):
    """The channel of N links at their instants and carriers. `loss`, `clear` and `count` speak of the direct path."""

    h: Array = column("complex128")
    distance: Array = column("float64", unit="m")
    loss: Array = column("float64", unit="dB, the smaller of through and round")
    clear: Array = column("float64", unit="share of the Fresnel zone, 0 to 1")
    count: Array = column("int32", unit="obstacles on the straight line")


@dataclass(frozen=True)
class Parts:
    """What the h of N links is put together from: straight lines, M reflected paths, what each loses, and which moving bodies stir."""

    lines: Lines
    sight: Sight
    paths: Paths
    mirrored: Sight
    stir: Stir


class Fixed:
    """Pairs of an antenna and a tag that both stand still and may be heard, and what stands between them that never moves."""

    def __init__(self, radio: Radio) -> None:
        antennas = np.flatnonzero(radio.near.body == WORLD)
        tags = np.flatnonzero(radio.far.body == WORLD)
        between = np.linalg.norm(radio.far.pose[tags, :3] - radio.near.pose[antennas, None, :3], axis=2)
        place, other = np.nonzero(between <= radio.reach[antennas, None])
        self.antenna, self.tag = antennas[place], tags[other]
        lines = radio.lines(self.antenna, self.tag)
        seen = radio.sight(lines, radio.standing(len(lines)))
        paths = radio.reflections(lines, self.antenna, self.tag)
        mirrored = radio.sight_mirrored(paths, lines, radio.standing(len(paths)))
        self._keep(np.flatnonzero(radio.audible(lines, seen.loss, seen.clear, paths, mirrored.loss)), lines, seen, paths, mirrored)
        self.index = np.full((len(radio.antennas), len(radio.tags)), -1, dtype=np.int64)
        self.index[self.antenna, self.tag] = np.arange(len(self.tag))
        self.margin = reach_of(self.sight, self.lines.distance, radio.wavelength)
        self.path_margin = reach_of(self.mirrored, self.paths.length, radio.wavelength)

    def _keep(self, rows: Array, lines: Lines, seen: Sight, paths: Paths, mirrored: Sight) -> None:
        place = np.full(len(self.tag), -1)
        place[rows] = np.arange(len(rows))
        self.antenna, self.tag, self.lines, self.sight = self.antenna[rows], self.tag[rows], lines.take(rows), seen.take(rows)
        kept = place[paths.link] >= 0
        self.paths, self.mirrored = paths.take(kept).with_(link=place[paths.link[kept]]), mirrored.take(kept)
        self.first = np.searchsorted(self.paths.link, np.arange(len(rows) + 1))

    def paths_of(self, pair: Array) -> tuple[Paths, Array]:
        """The reflections of some pairs (M,), `link` now a place in `pair`; and which of `paths` they are."""
        many = self.first[pair + 1] - self.first[pair]
        link = np.repeat(np.arange(len(pair)), many)
        which = np.arange(len(link)) - np.repeat(np.cumsum(many) - many, many) + self.first[pair][link]
        return self.paths.take(which).with_(link=link), which


def reach_of(seen: Sight, distance: Array, wavelength: float) -> Array:
    """(N,) m off a line beyond which a moving body changes nothing: it is out of the zone, or of any way round that is taken."""
    return BULGE * clearance(np.where(seen.detour > 0, SEARCH, CLEAR_OF_ZONE), distance / 2, distance, wavelength)


class Channel:
    """The channel in one trial. What it answers for a link depends on that link, its instant and its carrier alone."""

    def __init__(self, radio: Radio, fixed: Fixed, truth: Truth, root: int, trial: int) -> None:
        self._radio, self._fixed, self._truth = radio, fixed, truth
        self._field = Field(root, trial, float(radio.frequencies.mean())) if radio.config.diffuse else None
        self._h = np.zeros((len(fixed.tag), len(radio.frequencies)), dtype=np.complex128)
        self._known = np.zeros(self._h.shape, dtype=bool)

    @property
    def radio(self) -> Radio:
        """What no trial changes."""
        return self._radio

    # ------------------------------------------------------------ who is in reach

    def candidates(self, antenna: Array, t: Array) -> tuple[Array, Array]:
        """(place (N,), tag (N,)): whom antennas (K,) may hear at times t (K,), ascending. The others are silent, whatever the fading."""
        radio = self._radio
        posed = radio.movers.at(self._truth, t)
        links = np.arange(len(antenna))
        at = posed.carried(radio.near.body[antenna], radio.near.pose[antenna], links)[:, :3]
        still, moving = np.flatnonzero(radio.far.body == WORLD), np.flatnonzero(radio.far.body != WORLD)
        stands = radio.near.body[antenna] == WORLD
        pairs = [np.nonzero(stands[:, None] & (self._fixed.index[antenna] >= 0))]
        for rows, tags in ((links[~stands], still), (links, moving)):
            if len(rows) and len(tags):
                pairs.append(self._audible(antenna, *self._within(at, antenna, rows, tags, posed), posed))
        place, tag = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        order = np.lexsort((tag, place))
        return place[order], tag[order]

    def _within(self, at: Array, antenna: Array, rows: Array, tags: Array, posed: Posed) -> tuple[Array, Array]:
        """Pairs (place, tag) of antennas at `at` (K, 3), `rows` of them, and `tags` that are within the antenna's reach."""
        radio = self._radio
        instant, row = np.unique(posed.instant[rows], return_inverse=True)
        q, tag = np.repeat(instant, len(tags)), np.tile(tags, len(instant))
        place = posed.carried_at(radio.far.body[tag], radio.far.pose[tag], q)[:, :3].reshape(len(instant), len(tags), 3)
        near = np.linalg.norm(place[row] - at[rows, None], axis=2) <= radio.reach[antenna[rows], None]
        found, other = np.nonzero(near)
        return rows[found], tags[other]

    def _audible(self, antenna: Array, place: Array, tag: Array, posed: Posed) -> tuple[Array, Array]:
        """Those of the pairs that may be heard if nothing stood between them."""
        lines = self._radio.lines(antenna[place], tag, posed, place)
        paths = self._radio.reflections(lines, antenna[place], tag)
        keep = self._radio.audible(lines, np.zeros(len(tag)), np.ones(len(tag)), paths, np.zeros(len(paths)))
        return place[keep], tag[keep]

    # ------------------------------------------------------------ what they hear

    def respond(self, antenna: Array, tag: Array, t: Array, carrier: Array) -> Response:
        """The channel between antennas (N,) and tags (N,) at times t (N,) on carriers (N,), places in the hop table."""
        posed = self._radio.movers.at(self._truth, t)
        pair = self._fixed.index[antenna, tag]
        links = np.arange(len(tag))
        parts = [
            (rows, answer(rows, antenna[rows], tag[rows], pair[rows], carrier[rows], posed))
            for rows, answer in ((links[pair >= 0], self._standing), (links[pair < 0], self._moving))
            if len(rows)
        ]
        if not parts:
            return Response.empty()
        order = np.argsort(np.concatenate([rows for rows, _ in parts]))
        return Response.concatenate([response for _, response in parts]).take(order)

    def _moving(self, links: Array, antenna: Array, tag: Array, pair: Array, carrier: Array, posed: Posed) -> Response:
        """Links with an end that moves, `links` (N,) of `posed`."""
        p = self._parts(links, antenna, tag, posed)
        h = self._sum(p.lines, p.sight, p.paths, p.mirrored, self._radio.frequencies[carrier], p.stir)
        return self._response(h, p.lines, p.sight)

    def parts(self, antenna: Array, tag: Array, t: Array) -> Parts:
        """What `respond` puts together for antennas (N,) and tags (N,) at times t (N,), each link looked at from scratch."""
        return self._parts(np.arange(len(tag)), antenna, tag, self._radio.movers.at(self._truth, t))

    def terms(self, parts: Parts, frequency: Array) -> tuple[Array, Array, Array]:
        """What h is the sum of, complex, at carriers (N,) Hz: direct (N,), diffuse (N,), and each reflection (M,)."""
        lines = parts.lines
        direct, spread, over = _terms(self._radio, lines, parts.sight, parts.paths, parts.mirrored, frequency)
        if self._field is None:
            return direct, np.zeros_like(direct), over
        return direct, spread * self._field.at(lines.start, lines.end, frequency, parts.stir), over

    def _parts(self, links: Array, antenna: Array, tag: Array, posed: Posed) -> Parts:
        radio = self._radio
        lines, seen, paths, mirrored = look(radio, posed, links, antenna, tag)
        return Parts(lines, seen, paths, mirrored, self._stir(links, antenna, tag, lines, posed))

    def _standing(self, links: Array, antenna: Array, tag: Array, pair: Array, carrier: Array, posed: Posed) -> Response:
        """Links whose ends stand still, `links` (N,) of `posed`: as they were found once, unless something moves near them."""
        radio, fixed = self._radio, self._fixed
        lines, seen = fixed.lines.take(pair), fixed.sight.take(pair)
        paths, which = fixed.paths_of(pair)
        mirrored = fixed.mirrored.take(which)
        near = np.flatnonzero(posed.near(links, lines.start, lines.end, fixed.margin[pair]))
        touched, again = self._again(near, seen, links, posed, lambda rows, o: radio.sight(lines.take(rows), o))
        seen = _replaced(seen, touched, again)
        near = np.flatnonzero(_near_paths(paths, lines, links, posed, fixed.path_margin[which]))
        crossed, again = self._again(
            near, mirrored, links[paths.link], posed, lambda rows, o: radio.sight_mirrored(paths.take(rows), lines, o)
        )
        mirrored = _replaced(mirrored, crossed, again)
        stir = self._stir(links, antenna, tag, lines, posed)
        live = np.zeros(len(pair), dtype=bool)
        live[touched], live[stir.link], live[paths.link[crossed]] = True, True, True
        h = self._still(pair, carrier)
        rows, own, other = np.flatnonzero(live), np.flatnonzero(live[paths.link]), live[stir.link]
        if len(rows):
            place = np.cumsum(live) - 1
            over, by = paths.take(own).with_(link=place[paths.link[own]]), stir.take(other).with_(link=place[stir.link[other]])
            h[rows] = self._sum(lines.take(rows), seen.take(rows), over, mirrored.take(own), radio.frequencies[carrier[rows]], by)
        return self._response(h, lines, seen)

    def _again(self, near: Array, before: Sight, links: Array, posed: Posed, again: Look) -> tuple[Array, Sight]:
        """Which of the lines (or paths) `near` moving bodies they change, and how those look now; `links` (N,) are all lines' links.

        Only where a body touches the zone anything has changed, or may have where a way round is taken.
        """
        everywhere = np.ones(len(near), dtype=bool)
        movers = again(near, _obstacles(self._radio, posed, links[near], everywhere, still=False))
        rows = near[(movers.clear < 1) | (movers.loss > 0) | (before.detour[near] > 0)]
        return rows, again(rows, _obstacles(self._radio, posed, links[rows], everywhere[: len(rows)]))

    def _still(self, pair: Array, carrier: Array) -> Array:
        """(N,) h of fixed pairs with nothing moving near them: found once a trial for each pair and carrier."""
        new = np.unique(pair * self._h.shape[1] + carrier)
        p, c = new // self._h.shape[1], new % self._h.shape[1]
        p, c = p[~self._known[p, c]], c[~self._known[p, c]]
        if len(p):
            fixed = self._fixed
            paths, which = fixed.paths_of(p)
            mirrored = fixed.mirrored.take(which)
            self._h[p, c] = self._sum(fixed.lines.take(p), fixed.sight.take(p), paths, mirrored, self._radio.frequencies[c], None)
            self._known[p, c] = True
        return self._h[pair, carrier]

    # ------------------------------------------------------------ pieces

    def _stir(self, links: Array, antenna: Array, tag: Array, lines: Lines, posed: Posed) -> Stir:
        if self._field is None or not len(self._radio.movers):
            return Stir.empty()
        own = np.stack([self._radio.near.body[antenna], self._radio.far.body[tag]], axis=1)
        return posed.stir(links, lines.start, lines.end, own)

    def _sum(self, lines: Lines, seen: Sight, paths: Paths, mirrored: Sight, frequency: Array, stir: Stir | None) -> Array:
        """(N,) h: all parts together."""
        mean, spread = mean_and_spread(self._radio, lines, seen, paths, mirrored, frequency)
        return mean if self._field is None else mean + spread * self._field.at(lines.start, lines.end, frequency, stir)

    @staticmethod
    def _response(h: Array, lines: Lines, seen: Sight) -> Response:
        return Response(h=h, distance=lines.distance, loss=seen.loss, clear=seen.clear, count=seen.count)


def look(radio: Radio, posed: Posed, links: Array, antenna: Array, tag: Array) -> tuple[Lines, Sight, Paths, Sight]:
    """`links` (N,) of `posed` between antennas (N,) and tags (N,), asked anew: straight lines, reflections, and what either loses."""
    lines = radio.lines(antenna, tag, posed, links)
    near = posed.near(links, lines.start, lines.end, _widest(radio, lines.distance))
    seen = radio.sight(lines, _obstacles(radio, posed, links, near))
    paths = radio.reflections(lines, antenna, tag)
    near = _near_paths(paths, lines, links, posed, _widest(radio, paths.length))
    return lines, seen, paths, radio.sight_mirrored(paths, lines, _obstacles(radio, posed, links[paths.link], near))


def mean_and_spread(radio: Radio, lines: Lines, seen: Sight, paths: Paths, mirrored: Sight, frequency: Array) -> tuple[Array, Array]:
    """(mean (N,) complex, spread (N,)) of h = mean + spread · D at carriers (N,) Hz.

    D is the diffuse field (`testbed.radio.diffuse`): complex, Gaussian but for its finitely many waves, of unit power. So |h| is Rician
    about a known mean. Without a diffuse part the spread is 0.
    """
    direct, spread, over = _terms(radio, lines, seen, paths, mirrored, frequency)
    if not len(paths):
        return direct, spread
    real, imaginary = (np.bincount(paths.link, part, len(direct)) for part in (np.real(over), np.imag(over)))
    return direct + (real + 1j * imaginary), spread


def _terms(radio: Radio, lines: Lines, seen: Sight, paths: Paths, mirrored: Sight, frequency: Array) -> tuple[Array, Array, Array]:
    """The direct part (N,), complex; the spread (N,) of the diffuse one; and each reflection (M,), complex."""
    direct, spread = _along(lines.distance, frequency, lines.gain, seen), np.zeros(len(lines))
    if radio.config.diffuse:
        k = radio.rice_factor(seen.clear)
        spread = np.sqrt(1 / (k + 1)) * np.abs(direct)
        direct = np.sqrt(k / (k + 1)) * direct
    return direct, spread, paths.coefficient * _along(paths.length, frequency[paths.link], paths.gain, mirrored)


def _obstacles(radio: Radio, posed: Posed, links: Array, near: Array, still: bool = True) -> Obstacles:
    instants, instant = np.unique(posed.instant[links], return_inverse=True)
    return Obstacles(radio.caster, posed.poses[instants], instant.astype(np.int64), near, still)


def _widest(radio: Radio, distance: Array) -> Array:
    return BULGE * clearance(SEARCH, distance / 2, distance, radio.wavelength)


def _near_paths(paths: Paths, lines: Lines, links: Array, posed: Posed, margin: Array) -> Array:
    """(M,) bool: whether a moving body comes within `margin` (M,) m of either leg of each path."""
    of, turn = links[paths.link], paths.point
    return posed.near(of, lines.start[paths.link], turn, margin) | posed.near(of, turn, lines.end[paths.link], margin)


def _along(distance: Array, frequency: Array, gain: Array, seen: Sight) -> Array:
    """(N,) complex: single paths. What goes round has the phase of its longer way."""
    return direct_path(distance, frequency, gain, seen.loss) * np.exp(-2j * np.pi * frequency * seen.detour / SPEED_OF_LIGHT)


def _replaced(table: Sight, rows: Array, new: Sight) -> Sight:
    if not len(rows):
        return table
    changed = {}
    for name in table.column_names():
        changed[name] = np.array(getattr(table, name))
        changed[name][rows] = getattr(new, name)
    return table.with_(**changed)
