"""Soft line of sight: how much of a path's Fresnel zone is clear, and what the path loses through its obstacles or round them.

At a wavelength of a third of a metre edges diffract, so one 0/1 ray is not enough. For each link

    loss = min( through, round )                         dB
    through = ℓ + max over directions of min(ℓ_m - ℓ, J(-ν_m))
    round   = min over ways round of (ℓ_way + J(ν_way))

with ℓ the dB in what stands on the straight line; ℓ_m that on a ray at the rim of 0.6 of the first Fresnel zone in direction
m, where that is more, and ν_m how far out the thing begins; ways round bend once, beside what is in the way (the middle of
a thick thing, as in Bullington's construction), out to ν = 3. So a single opaque edge costs J(ν) of ITU-R P.526 on either
side of ν = 0, and a thing that takes little costs no more than that little.

`clear` is the share of the zone's area (0.6 of the first) that is open, where what a thing lets through counts in
proportion to its power. It comes from the same rays: in each direction, how far out the obstruction changes.

Left out: the sum of what comes round both sides of a thin thing (up to 6 dB too much behind a post), second edges, the 1 dB
by which an edge that is clear by a whole zone may help, obstacles thinner than the gap between two directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.columns import Array, Table, column
from testbed.protocols import Caster, Obstruction
from testbed.radio.diffraction import CLEAR_OF_ZONE, clearance, detour_of_nu, knife_edge

DIRECTIONS = 8  # level, upright and between: edges in a hall are mostly level or upright; an oblique one is missed by 1/cos 22.5°
_ANGLE = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
SEARCH = 3.0 / np.cos(np.pi / DIRECTIONS)  # |ν| on a ray that meets any straight edge at ν <= 3
LADDER = (CLEAR_OF_ZONE, 1.5, 2.3, SEARCH)  # |ν| at which ways round are tried, one after the other
VERTICES = np.array([0.03, 0.15, 0.5, 0.85, 0.97])  # where a ray along the rim bends: even steps of log(d1/d2), so that no edge
BULGE = 1.04  # between two of them is more than 5 % nearer or farther than its ν says
COARSE, FINE = 3, 4  # halvings of an interval of ν for every direction, and more for the one that counts: 1/128 is left, 0.1 dB
BEND = 1e-6  # m: so near to a bend a thing holds it
OPAQUE = 60.0  # dB: more than this is as good as this
NOTICED = 0.5  # dB: less than this is no change of obstruction
CHUNK = 4096  # links at a time: 200,000 rays, some 40 MB


@dataclass(frozen=True, eq=False)
class Sight(Table):
    """What N paths lose. `count` and `through` are those of the straight line alone; `detour` is the way that `loss` speaks of."""

    clear: Array = column("float64", unit="share of the Fresnel zone, 0 to 1")
    loss: Array = column("float64", unit="dB, the path as a whole")
    detour: Array = column("float64", unit="m longer than the straight line, 0 where it goes through")
    count: Array = column("int32", unit="obstacles on the straight line")
    through: Array = column("float64", unit="dB lost in them")


@dataclass(frozen=True, eq=False)
class Ways(Table):
    """Both ways of N paths, of which `Sight` takes the one that costs less: through what stands there, and round it."""

    count: Array = column("int32", unit="obstacles on the straight line")
    through: Array = column("float64", unit="dB lost in them")
    shade: Array = column("float64", unit="dB that things beside the line take besides")
    round: Array = column("float64", unit="dB on the best way round, infinite where there is none out to ν = 3")
    detour: Array = column("float64", unit="m by which that is longer")
    clear: Array = column("float64", unit="share of the Fresnel zone, 0 to 1")


class Obstacles:
    """All that may stand on rays of N links: what never moves, and the moving bodies for those links that they come `near`.

    poses (Q, moving bodies, 7) at the instants, instant (N,) which of them is each link's, near (N,) bool. Without them nothing moves.
    `still` False leaves out what never moves.
    """

    def __init__(
        self, caster: Caster, poses: Array | None = None, instant: Array | None = None, near: Array | None = None, still: bool = True
    ) -> None:
        self._caster, self._poses, self._instant, self._near, self._still = caster, poses, instant, near, still

    def on(self, link: Array, start: Array, end: Array) -> Obstruction:
        """Obstruction of rays `start` (M, 3) to `end` (M, 3), each of the link `link` (M,)."""
        if self._poses is None or self._instant is None or self._near is None:
            return self._caster.static(start, end)
        also = np.flatnonzero(self._near[link])
        if self._still and not len(also):
            return self._caster.static(start, end)
        moving = self._caster.moving(start[also], end[also], self._poses, self._instant[link[also]])
        if not self._still and len(also) == len(link):
            return moving
        if self._still:
            found = self._caster.static(start, end)
            count, loss = np.array(found.count), np.array(found.loss)
        else:
            count, loss = np.zeros(len(link), dtype=np.int32), np.zeros(len(link))
        count[also] += moving.count
        loss[also] += moving.loss
        return Obstruction(count=count, loss=loss)

    def bent(self, link: Array, inside: Array, way: Array) -> Array:
        """(M,) dB that things which hold the points `inside` (M, 3) take on entry.

        Two legs that meet inside a thing both enter it; this is what their sum counts twice. `way` (M, 3): along the ray.
        """
        step = way * (BEND / np.linalg.norm(way, axis=1, keepdims=True))
        return self.on(link, inside - step, inside + step).loss

    def extent(self, link: Array, start: Array, end: Array) -> tuple[Array, Array, Array]:
        """(ray (C,), from (C,), to (C,)): every box on every ray, and between which shares of the ray's length."""
        poses = np.zeros((1, 0, 7)) if self._poses is None else self._poses
        instant = np.zeros(len(link), dtype=np.int64) if self._instant is None else self._instant[link]
        found = self._caster.crossings(start, end, poses, instant)
        length = np.linalg.norm(end - start, axis=1)[found.segment]
        return found.segment, found.enter / length, (found.enter + found.length) / length


def sight(start: Array, end: Array, wavelength: float, obstacles: Obstacles, worth: Array | None = None) -> Sight:
    """Sight of N links from `start` (N, 3) to `end` (N, 3), m.

    worth : (N,) dB, the loss at which a link is of no use; beyond it nothing is searched for, and `clear` is that of the
    straight line alone. Where it is left out everything is.
    """
    worth = np.full(len(start), np.inf) if worth is None else worth
    parts = [
        _sight(np.arange(i, min(i + CHUNK, len(start))), start, end, wavelength, obstacles, worth) for i in range(0, len(start), CHUNK)
    ]
    return Sight.concatenate(parts)


def ways(start: Array, end: Array, wavelength: float, obstacles: Obstacles) -> Ways:
    """Both ways of N paths, searched for in full, for whoever wants to know what `sight` chose from; CHUNK paths at the most."""
    return _ways(np.arange(len(start)), start, end, wavelength, obstacles, np.full(len(start), np.inf))


def _sight(link: Array, start: Array, end: Array, wavelength: float, obstacles: Obstacles, worth: Array) -> Sight:
    both = _ways(link, start, end, wavelength, obstacles, worth)
    through = both.through + both.shade
    return Sight(
        clear=both.clear,
        loss=np.minimum(through, both.round),
        detour=np.where(both.round < through, both.detour, 0.0),
        count=both.count,
        through=both.through,
    )


def _ways(link: Array, start: Array, end: Array, wavelength: float, obstacles: Obstacles, worth: Array) -> Ways:
    direct = obstacles.on(link, start[link], end[link])
    clear, worth = 10 ** (-direct.loss / 10), worth[link]
    bundle = Bundle(link, start[link], end[link], wavelength, obstacles, direct.loss)
    round_, longer = bundle.round(worth)
    useful = np.flatnonzero(np.minimum(direct.loss, round_) <= worth)
    shade = np.zeros(len(link))
    clear[useful], shade[useful] = bundle.zone(useful)
    return Ways(count=direct.count, through=direct.loss, shade=shade, round=round_, detour=longer, clear=clear)


class Bundle:
    """Rays about n straight lines, in DIRECTIONS across each. `loss` (n,) dB is what stands on the lines themselves."""

    def __init__(self, link: Array, start: Array, end: Array, wavelength: float, obstacles: Obstacles, loss: Array) -> None:
        self._link, self._start, self._end, self._obstacles = link, start, end, obstacles
        self._wavelength, self.loss = wavelength, np.minimum(loss, OPAQUE)
        self._distance = np.maximum(np.linalg.norm(end - start, axis=1), 1e-9)
        self._axis = (end - start) / self._distance[:, None]
        self._across = across(self._axis)
        self._bend: Array | None = None

    # ------------------------------------------------------------ the zone

    def zone(self, lines: Array) -> tuple[Array, Array]:
        """Share (L,) of the zone of `lines` that is clear, and the dB (L,) that things beside each line take."""
        rim, place, directions, bend = self._rim(lines)
        rows = lines[place]
        own, beyond = self.loss[rows], rim[place, directions]
        low, high = self._change((rows, directions, bend), np.zeros(len(rows)), np.full(len(rows), CLEAR_OF_ZONE), own, beyond, COARSE)
        inside = np.ones_like(rim)
        inside[place, directions] = ((low + high) / 2 / CLEAR_OF_ZONE) ** 2
        clear = (inside * 10 ** (-self.loss[lines, None] / 10) + (1 - inside) * 10 ** (-rim / 10)).mean(axis=1)
        # only the direction that costs most is looked at closely: those that may be it
        adds = np.maximum(beyond - own, 0.0)
        sure, shade = np.zeros(len(lines)), np.zeros(len(lines))
        np.maximum.at(sure, place, np.minimum(adds, knife_edge(-high)))
        close = np.flatnonzero((adds > 0) & (np.minimum(adds, knife_edge(-low)) >= sure[place]))
        ways = rows[close], directions[close], bend[close]
        low, high = self._change(ways, low[close], high[close], own[close], beyond[close], FINE)
        np.maximum.at(shade, place[close], np.minimum(adds[close], knife_edge(-(low + high) / 2)))
        return clear, shade

    def _rim(self, lines: Array) -> tuple[Array, Array, Array, Array]:
        """dB along the rim (L, directions); which (place in `lines`, direction) differ from the line; where along it they do, m."""
        points = self.rim_points(lines)
        per, own = points.shape[2] - 1, self.loss[lines]
        line = np.repeat(lines, DIRECTIONS)
        count, rim = self._legs(self._link[line], points.reshape(len(line), per + 1, 3))
        rim = rim.reshape(len(lines), DIRECTIONS)
        differs = np.abs(rim - own[:, None]) > NOTICED
        place, directions = np.nonzero(differs)
        # what makes the rim worse is on the rim; what makes it better is on the line
        hit = np.flatnonzero((count > 0) & np.repeat((differs & (rim > own[:, None])).ravel(), per))
        a, b = points[:, :, :-1].reshape(-1, 3)[hit], points[:, :, 1:].reshape(-1, 3)[hit]
        bend = self._bends(hit // per, line[hit // per], a, b, rim.size)[place * DIRECTIONS + directions]
        better = np.flatnonzero(rim[place, directions] < own[place])
        if len(better):
            bend[better] = self.bend()[lines[place[better]]]
        return rim, place, directions, bend

    def _legs(self, link: Array, corners: Array) -> tuple[Array, Array]:
        """Obstacles (M · legs,) on each leg of M rays that bend at `corners` (M, legs + 1, 3), and dB (M,) on the whole ray."""
        legs = corners.shape[1] - 1
        found = self._obstacles.on(np.repeat(link, legs), corners[:, :-1].reshape(-1, 3), corners[:, 1:].reshape(-1, 3))
        count, loss = found.count.reshape(-1, legs), found.loss.reshape(-1, legs).sum(axis=1)
        ray, bend = np.nonzero((count[:, :-1] > 0) & (count[:, 1:] > 0) & (loss[:, None] < 2 * OPAQUE))
        twice = self._obstacles.bent(link[ray], corners[ray, bend + 1], corners[ray, -1] - corners[ray, 0])
        return found.count, np.minimum(loss - np.bincount(ray, twice, len(loss)), OPAQUE)

    def rim_points(self, lines: Array) -> Array:
        """(L, directions, corners, 3): rays along the rim of the zone, ends included."""
        distance = self._distance[lines, None]
        along = distance * VERTICES
        off = BULGE * clearance(CLEAR_OF_ZONE, along, distance, self._wavelength)
        points = np.empty((len(lines), DIRECTIONS, len(VERTICES) + 2, 3))
        points[:, :, 0], points[:, :, -1] = self._start[lines, None], self._end[lines, None]
        middle = self._start[lines, None] + along[..., None] * self._axis[lines, None]
        points[:, :, 1:-1] = middle[:, None] + off[:, None, :, None] * self._across[lines][:, :, None]
        return points

    def _bends(self, group: Array, line: Array, a: Array, b: Array, groups: int) -> Array:
        """(groups,) m along the line: the middle of what stands on the rays from a to b of each group; NaN without any."""
        ray, enter, leave = self._obstacles.extent(self._link[line], a, b)
        line = line[ray]
        near = np.einsum("ij,ij->i", a[ray] - self._start[line], self._axis[line])
        far = np.einsum("ij,ij->i", b[ray] - self._start[line], self._axis[line])
        return self._middle(group[ray], groups, near + (far - near) * enter, near + (far - near) * leave, self._distance[line])

    def bend(self) -> Array:
        """(n,) m along each line: the middle of what stands on it; NaN where nothing does. Cast when first asked for."""
        if self._bend is None:
            rows = np.flatnonzero(self.loss > 0)
            ray, enter, leave = self._obstacles.extent(self._link[rows], self._start[rows], self._end[rows])
            line = rows[ray]
            d = self._distance[line]
            self._bend = self._middle(line, len(self._link), enter * d, leave * d, d)
        return self._bend

    @staticmethod
    def _middle(group: Array, groups: int, enter: Array, leave: Array, distance: Array) -> Array:
        """Where a way over both ends (the first entry, the last exit) of each group's obstacles bends, if they are of one height."""
        first, last, length = np.full(groups, np.inf), np.full(groups, -np.inf), np.full(groups, np.nan)
        np.minimum.at(first, group, enter)
        np.maximum.at(last, group, leave)
        length[group] = distance
        with np.errstate(invalid="ignore"):
            before, behind = np.maximum(first, BEND), np.maximum(length - last, BEND)
            bend = before * length / (behind + before)
        return np.clip(bend, 1e-3 * length, (1 - 1e-3) * length)

    # ------------------------------------------------------------ ways that bend once

    def _ways(self, rows: Array, directions: Array, bend: Array, nu: Array, limit: Array) -> Array:
        """(M,) dB on ways from end to end that bend at `bend` m along line `rows`, out to |ν| in that direction.

        Infinite where the first leg alone loses more than `limit` (M,) dB: the second is not looked at then.
        """
        off = clearance(nu, bend, self._distance[rows], self._wavelength)
        vertex = self._start[rows] + bend[:, None] * self._axis[rows] + off[:, None] * self._across[rows, directions]
        first = self._obstacles.on(self._link[rows], self._start[rows], vertex)
        on = np.flatnonzero(first.loss <= limit)
        link, loss = self._link[rows[on]], np.full(len(rows), np.inf)
        second = self._obstacles.on(link, vertex[on], self._end[rows[on]])
        loss[on] = first.loss[on] + second.loss
        both = np.flatnonzero((first.count[on] > 0) & (second.count > 0) & (loss[on] < 2 * OPAQUE))
        loss[on[both]] -= self._obstacles.bent(link[both], vertex[on[both]], self._axis[rows[on[both]]])
        return loss

    def _change(
        self, ways: tuple[Array, Array, Array], low: Array, high: Array, before: Array, after: Array, halvings: int
    ) -> tuple[Array, Array]:
        """Where between `low` and `high` |ν| (M,) the loss of `ways` (rows, directions, bend) turns from `before` to `after` dB.

        A narrower (low, high): it has turned where it is nearer to `after`.
        """
        between, rises = (before + after) / 2, after > before
        for _ in range(halvings if len(low) else 0):
            middle = (low + high) / 2
            turned = (self._ways(*ways, middle, between) > between) == rises
            low, high = np.where(turned, low, middle), np.where(turned, middle, high)
        return low, high

    # ------------------------------------------------------------ the least of them

    def round(self, worth: Array) -> tuple[Array, Array]:
        """Least loss (n,) of a way round, dB, inf where none is found within `worth` dB; and by how much it is longer, m."""
        loss, detour = np.full(len(self.loss), np.inf), np.zeros(len(self.loss))
        low = 0.0
        for high in LADDER:
            floor = float(knife_edge(low))  # no way beyond this rung costs less
            rows = np.flatnonzero((np.minimum(loss, self.loss) > floor) & (worth >= floor))
            if len(rows):
                found, nu = self._between(rows, low, high, np.minimum(np.minimum(loss, self.loss), worth)[rows])
                less = found < loss[rows]
                loss[rows] = np.minimum(found, loss[rows])
                detour[rows] = np.where(less, detour_of_nu(nu, self._wavelength), detour[rows])
            low = high
        return loss, detour

    def _between(self, rows: Array, low: float, high: float, most: Array) -> tuple[Array, Array]:
        """Least loss (R,) of ways that begin to be open between two |ν|, inf if it isn't below `most` (R,) dB; and their |ν|."""
        each, direction = np.repeat(np.arange(len(rows)), DIRECTIONS), np.tile(np.arange(DIRECTIONS), len(rows))
        bend = self.bend()[rows]
        way = self._ways(rows[each], direction, bend[each], np.full(len(each), high), most[each] - knife_edge(low))
        lows, highs = np.full(len(each), low), np.full(len(each), high)
        best = np.array(most)
        alive = np.flatnonzero(way + knife_edge(low) < most[each])
        for _ in range(COARSE + FINE):
            np.minimum.at(best, each[alive], way[alive] + knife_edge(highs[alive]))
            alive = alive[way[alive] + knife_edge(lows[alive]) <= best[each[alive]]]  # only one that may still be the best
            if not len(alive):
                break
            ways = rows[each[alive]], direction[alive], bend[each[alive]]
            # it begins where it loses what it does on the rung, rather than what stands on the line
            lows[alive], highs[alive] = self._change(ways, lows[alive], highs[alive], way[alive] + NOTICED, way[alive], 1)
        loss, nu = np.full(len(rows), np.inf), np.zeros(len(rows))
        level = (lows[alive] + highs[alive]) / 2
        total = way[alive] + knife_edge(level)
        order = np.lexsort((total, each[alive]))
        winner = order[np.unique(each[alive][order], return_index=True)[1]]
        loss[each[alive][winner]], nu[each[alive][winner]] = total[winner], level[winner]
        return loss, nu


def across(axis: Array) -> Array:
    """(N, DIRECTIONS, 3) unit vectors across unit vectors `axis` (N, 3): the first is level, the third upright where that can be."""
    level = np.stack([-axis[:, 1], axis[:, 0], np.zeros(len(axis))], axis=1)
    size = np.linalg.norm(level, axis=1, keepdims=True)
    level = np.where(size > 1e-6, level / np.maximum(size, 1e-6), np.array([1.0, 0.0, 0.0]))
    upright = np.cross(axis, level)
    return np.cos(_ANGLE)[:, None] * level[:, None] + np.sin(_ANGLE)[:, None] * upright[:, None]
