"""Who went in, who went out, who went past or turned back, and who only stood there: sequential likelihood ratios over the track.

Every tag has a hidden Markov model of where it is about its gate, whether it stands or which way it goes, and on which side it set out
(`estimators.gate_cells`). Reads weigh it by their level, and by how far the phase turned since the antenna's last read on the same
channel: of a tag that stands it does not turn, of one that goes it turns by twice the way. A crossing is announced where its odds
against all else reach `odds` with the tag beyond the band behind the plane (so that one that lingers in the gate is not announced
back and forth), and not again within `cool_s`. One that set out and came to rest, or fell silent, without crossing has passed by or,
where it had been near the gate, turned back.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.special import ndtr

from estimators import gate_rows
from estimators.belief import StatusConfig, status_of
from estimators.gate_cells import room
from estimators.gate_rows import Cells, Noise, Rates, Rows
from estimators.rssi_model import RssiConfig, RssiModel, measured
from testbed import frames
from testbed.gates import gates_of
from testbed.quantity import DecibelMilliwatts, Decibels, Degrees, Metres, MetresPerSecond, Seconds
from testbed.types import POSITION, Array, Estimate, Event, Prior, RowRandom, Site, Status, UpdateInfo
from testbed.units import SPEED_OF_LIGHT

WORDS = ("", "in", "out", "pass", "uturn", "in?", "out?")
MOST_STEPS = 100_000  # of one silence


class GateDetectorConfig(RssiConfig, StatusConfig):
    """The gate as installed, how trolleys move, how reads scatter, and when a crossing is sure.

    inward_deg       : direction, in the site's frame, of going in; opening_m: width through which the plane can be crossed
    odds             : that a crossing must have against everything else; band_m: how far behind the plane, on the other side
    hints            : lower odds, ascending, at which "in?" and "out?" are announced on the way, once each: so its sureness can be checked
    leak_db          : what an antenna hears past its lobe, below its best
    duty             : the chance that an antenna which could hear a tag reads it within `step_s`, `threshold_dbm` the level from which it
                       could: silence tells most of where a tag is not
    setout_hz        : how often a tag that stands sets out; stay_s, straight_s: how long one goes on, and in one direction
    rest_s           : standing for so long, it is parked again; forget_s: unheard for so long, it has gone
    moving_at_first  : how likely a tag that is heard for the first time is on its way
    phase_std_rad    : of the phase from read to read of a tag that stands (modulo π, as some readers report it)
    phase_outliers   : share of phases that say nothing; temper: how much a level counts, and phase_temper a phase, for models are not true
    """

    sigma_db: Annotated[Decibels, Field(gt=0, le=40)] = 6.0
    correlation_s: Annotated[Seconds, Field(gt=0, le=60)] = 0.1
    path_loss_exponent: Annotated[float, Field(gt=0, le=12)] = 5.0
    polarisation_loss_db: Annotated[Decibels, Field(ge=0, le=40)] = 1.0
    orientation_loss_db: Annotated[Decibels, Field(ge=0, le=40)] | None = 0.0
    inward_deg: Degrees = 0.0
    leak_db: Annotated[Decibels, Field(gt=0, le=60)] = 15.0
    opening_m: Annotated[Metres, Field(gt=0, le=20)] = 2.8
    height_m: Annotated[Metres, Field(ge=0, le=10)] = 1.0
    reach_m: Annotated[Metres, Field(ge=2, le=10)] = 4.8
    side_m: Annotated[Metres, Field(ge=1, le=10)] = 3.6
    cell_m: Annotated[Metres, Field(ge=0.1, le=1)] = 0.4
    near_m: Annotated[Metres, Field(gt=0, le=10)] = 2.0
    odds: Annotated[float, Field(gt=1, le=1e9)] = 99.0
    hints: Annotated[tuple[Annotated[float, Field(gt=0, le=1e9)], ...], Field(max_length=8)] = ()
    band_m: Annotated[Metres, Field(ge=0, le=3)] = 0.4
    cool_s: Annotated[Seconds, Field(ge=0, le=3600)] = 3.0
    speed_mps: Annotated[MetresPerSecond, Field(gt=0, le=5)] = 1.0
    speed_std_mps: Annotated[MetresPerSecond, Field(gt=0, le=5)] = 0.35
    setout_hz: Annotated[float, Field(gt=0, le=1)] = 0.01
    stay_s: Annotated[Seconds, Field(gt=0, le=1000)] = 12.0
    straight_s: Annotated[Seconds, Field(gt=0, le=1000)] = 10.0
    rest_s: Annotated[Seconds, Field(gt=0, le=1000)] = 2.0
    forget_s: Annotated[Seconds, Field(gt=0, le=3600)] = 4.0
    moving_at_first: Annotated[float, Field(gt=0, lt=1)] = 0.2
    phase_std_rad: Annotated[float, Field(gt=0, le=3)] = 0.2
    phase_outliers: Annotated[float, Field(gt=0, le=1)] = 0.15
    phase_sign: Annotated[int, Field(ge=-1, le=1)] = 1
    longest_gap_s: Annotated[Seconds, Field(gt=0, le=10)] = 1.0
    threshold_dbm: DecibelMilliwatts = -75.0
    duty: Annotated[float, Field(ge=0, lt=1)] = 0.8
    lull_s: Annotated[Seconds, Field(gt=0, le=10)] = 0.5
    temper: Annotated[float, Field(gt=0, le=1)] = 1.0
    phase_temper: Annotated[float, Field(gt=0, le=1)] = 0.7
    step_s: Annotated[Seconds, Field(ge=0.02, le=1)] = 0.1


class GateDetector:
    """Decides IN, OUT, PASS and UTURN for every row; STAT is silence. Its estimate is the mean of the belief, on the floor at `height_m`.

    Breaks where antennas of a gate look all the same way (`gate_toe_deg: 0`): then inside mirrors outside. A tag is taken to be at
    the gate that read it first, until nobody has read it for `forget_s`.
    """

    Config = GateDetectorConfig
    consumes: frozenset[str] = frozenset({"reads"})

    def __init__(self, config: GateDetectorConfig, site: Site, rng: RowRandom) -> None:
        leaky = site.antennas.with_(front_to_back=np.minimum(site.antennas.front_to_back, config.leak_db))
        model = RssiModel(config, replace(site, antennas=leaky), "gate_detector")
        self._config, self._gates = config, gates_of(site.antennas, config.inward_deg)
        self._cells = _cells(config)
        steps = config.cell_m, config.speed_mps * config.step_s
        if steps[1] > 0.9 * steps[0]:
            raise ValueError(
                f"gate_detector: at {config.speed_mps:g} m/s a step of {config.step_s:g} s leads over a cell: make cell_m larger"
            )
        self._rates = _rates(config)
        wavelength = SPEED_OF_LIGHT / float(np.mean(site.frequencies)) if len(site.frequencies) else np.inf
        self._noise = Noise(
            config.sigma_db, config.correlation_s, config.temper, config.phase_sign * 4 * np.pi / wavelength, config.phase_std_rad,
            config.speed_mps, config.speed_std_mps, config.phase_outliers, config.phase_temper, config.longest_gap_s,
        )  # fmt: skip
        self._expected, self._kind = self._levels(model, site)
        self._missed = self._silences()
        self._toward = self._directions(site)

    def _points(self, antennas: int) -> Array:
        """(A, nx, ny, 3) m: the cells of each antenna's gate in the site's frame."""
        x, y = np.meshgrid(self._cells.x, self._cells.y, indexing="ij")
        flat = np.stack([x, y], axis=-1)
        gate = self._gates.antenna_gate[:, None, None]
        placed = self._gates.world(np.broadcast_to(gate, (antennas, *x.shape)), np.broadcast_to(flat, (antennas, *flat.shape)))
        return np.concatenate([placed, np.full((*placed.shape[:-1], 1), self._config.height_m)], axis=-1)

    def _levels(self, model: RssiModel, site: Site) -> tuple[Array, Array]:
        """(kinds, A, nx, ny) dBm expected by each sort of tag, and (tags,) the sort of each."""
        sorts = np.rec.fromarrays([site.tags.gain, site.tags.pattern])
        _, first, kind = np.unique(sorts, return_index=True, return_inverse=True)
        count = len(site.antennas)
        points = self._points(count).reshape(count, -1, 3)
        shape = (count, len(self._cells.x), len(self._cells.y))
        levels = [model.expected(points, np.arange(count), np.full(count, tag)).reshape(shape) for tag in first]
        return np.array(levels).reshape(-1, *shape), kind.ravel()

    def _silences(self) -> Array:
        """(gates, antennas, nx, ny): the logarithm of how likely an antenna hears nothing of a tag of the first sort in a step of time."""
        c, places = self._config, self._gates
        heard = c.duty * ndtr((self._expected[0] - c.threshold_dbm) / c.sigma_db)
        missed = np.zeros((len(places.name), int(places.antenna_place.max(initial=0)) + 1, *heard.shape[1:]))
        missed[places.antenna_gate, places.antenna_place] = c.temper * np.log1p(-heard)
        return missed

    def _directions(self, site: Site) -> Array:
        """(A, nx, ny, 2): how much of a way along the gate's x and y leads to the antenna."""
        points = self._points(len(site.antennas))
        away = site.antennas.position[:, None, None] - points
        unit = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 0.1)
        c, s = np.cos(self._gates.inward), np.sin(self._gates.inward)
        return np.stack([c * unit[..., 0] + s * unit[..., 1], c * unit[..., 1] - s * unit[..., 0]], axis=-1)

    def start(self, prior: Prior) -> None:
        b, c = prior.rows, self._cells
        most = int(self._gates.antenna_place.max(initial=0)) + 1
        self._rows = Rows(
            room(b, len(c.x), len(c.y)), self._step(prior.t), np.full(b, -1), np.full(b, -1), np.zeros((b, 5)), np.zeros(b, dtype=bool),
            np.zeros(b, dtype=np.int64), np.full((b, most, 3), np.nan),
        )  # fmt: skip
        self._time, self._gate, self._begun = np.array(prior.t), np.zeros(b, dtype=np.int64), np.array(prior.t)
        self._heard = np.full(b, -np.inf)
        self._prior = np.array(prior.mean[:, :3]), np.array(prior.covariance[:, :3, :3])
        self._said: list[tuple[int, float, str, float]] = []

    def _step(self, t: Array) -> Array:
        return np.floor(np.asarray(t) / self._config.step_s + 1e-6).astype(np.int64)

    def predict(self, t: Array) -> None:
        goal = self._step(t)
        behind = np.flatnonzero(goal > self._rows.step)
        if len(behind):
            far = self._rows.step[behind] + MOST_STEPS
            said, probability = np.zeros(len(behind), dtype=np.int64), np.zeros(len(behind))
            gate_rows.step_to(
                self._rows, self._cells, self._rates, behind, np.minimum(goal[behind], far), self._gate, self._missed, said, probability
            )
            self._rows.step[behind] = goal[behind]
            self._announce(behind, t[behind], said, probability)
        self._time = np.array(t)

    def update(self, event: Event) -> UpdateInfo:
        reads = event.data
        rssi, gate = measured(reads.rssi), self._gates.antenna_gate[reads.antenna]
        free = self._rows.heard[event.row] < 0
        used = np.isfinite(rssi) & (free | (gate == self._gate[event.row]))
        k = np.flatnonzero(used)
        row, antenna = event.row[k], reads.antenna[k]
        self._gate[row], self._heard[row] = gate[k], reads.t[k]
        said, probability, likelihood = np.zeros(len(k), dtype=np.int64), np.zeros(len(k)), np.full(len(event), np.nan)
        found = np.empty(len(k))
        gate_rows.take(
            self._rows, self._cells, self._rates, self._noise, row, reads.t[k], self._gates.antenna_place[antenna], rssi[k], reads.phase[k],
            reads.channel[k], self._expected[self._kind[reads.tag[k]], antenna], self._toward[antenna], said, probability, found,
        )  # fmt: skip
        likelihood[k] = found
        self._announce(row, reads.t[k], said, probability)
        return UpdateInfo(used, likelihood)

    def _announce(self, row: Array, t: Array, said: Array, probability: Array) -> None:
        for i in np.flatnonzero(said):
            self._said.append((int(row[i]), float(t[i]), WORDS[said[i]], float(probability[i])))

    def decisions(self) -> list[tuple[int, float, str, float]]:
        """(row, t, "in", "out", "pass", "uturn", "in?" or "out?", probability): in the order in which they were made."""
        return list(self._said)

    def estimate(self) -> Estimate:
        b = len(self._time)
        local, spread = np.zeros((b, 2)), np.tile(np.eye(2), (b, 1, 1))
        gate_rows.moments(self._rows.p, self._cells.x, self._cells.y, local, spread)
        turn = frames.matrix(frames.from_euler(self._gates.inward))[:2, :2]
        mean, covariance = self._prior[0].copy(), self._prior[1].copy()
        seen = np.isfinite(self._heard)
        mean[seen, :2], mean[seen, 2] = self._gates.world(self._gate, local)[seen], self._config.height_m
        covariance[seen] = 0.0
        covariance[seen, :2, :2] = (turn @ spread @ turn.T)[seen] + self._config.cell_m**2 / 12 * np.eye(2)
        covariance[seen, 2, 2] = 0.5**2
        silent = self._time - np.where(seen, self._heard, self._begun)
        status = np.where(seen, status_of(silent, self._config), Status.LOST)
        return Estimate(POSITION, mean, (covariance + covariance.transpose(0, 2, 1)) / 2, status)


def _cells(c: GateDetectorConfig) -> Cells:
    half = max(2, round(c.reach_m / c.cell_m))
    x = (np.arange(-half, half) + 0.5) * c.cell_m
    across = max(1, round(c.side_m / c.cell_m))
    y = np.arange(-across, across + 1) * c.cell_m
    near = (np.abs(x)[:, None] <= c.near_m) & (np.abs(y)[None, :] <= c.opening_m / 2 + 0.3)
    return Cells(x, y, near, np.abs(y) <= c.opening_m / 2, half)


def _rates(c: GateDetectorConfig) -> Rates:
    step = c.step_s
    jump = c.speed_mps * step / c.cell_m
    once = [1 - np.exp(-step * rate) for rate in (c.setout_hz, 1 / c.stay_s, 1 / c.straight_s, 1 / c.rest_s)]
    start, stop, turn, rest = (float(p) for p in once)
    steps = round(c.cool_s / step), max(1, round(c.forget_s / step))
    return Rates(
        start,
        stop,
        0.75 * turn,
        rest,
        jump,
        jump,
        c.moving_at_first,
        c.band_m,
        c.odds,
        np.array(c.hints, dtype=np.float64),
        *steps,
        c.lull_s,
        step,
    )
