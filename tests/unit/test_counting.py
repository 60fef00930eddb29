"""Counts of the published model in a scene: the pure generator where nothing stands in the way, dead zones where something does."""

import numpy as np
import pytest
from pydantic import ValidationError

from testbed import frames
from testbed.geometry import Boxes, Mounts
from testbed.protocols import Surroundings, Tagged
from testbed.radio.antenna import off_boresight
from testbed.radio.logistic_beta import blocks
from testbed.radio.regions import REGIONS
from testbed.rng import Counter, keys_of
from testbed.scene import Body, Scene, Truth
from testbed.sensors import counting
from testbed.sensors.counting import CountingConfig, Shade, counted, reader_names
from testbed.sensors.placement import place_antennas
from testbed.sensors.rfid_section import RfidConfig
from testbed.types import Tags
from worlds.raycast import BoxCaster

SECONDS = 200.0
CARRIERS = REGIONS["etsi"].carriers
CORNERS = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]])


def scene(wall=None):
    """Two posts of four antennas each, in the corners of a square, and perhaps a steel wall (low, high) in it."""
    bodies = [Body(name, "post", frames.IDENTITY) for name in ("north", "south")]
    at = np.concatenate([np.column_stack([CORNERS + shift, np.full(4, 1.5)]) for shift in (0.0, 0.3)])
    mounts = Mounts(
        name=[f"{b.name}.a{i}" for b in bodies for i in range(4)],
        group=["g"] * 8,
        use=["antenna"] * 8,
        body=np.repeat([0, 1], 4),
        position=at,
        quaternion=frames.looking_at(at, np.array([4.0, 4.0, 1.5])),
    )
    boxes = Boxes.empty()
    if wall is not None:
        low, high = np.array(wall)
        bodies.append(Body("wall", "wall", frames.IDENTITY))
        boxes = Boxes([(low + high) / 2], [[1.0, 0, 0, 0]], [(high - low) / 2], body=[2])
    moving = Body("cart", "cart", frames.IDENTITY, moving=True)
    return Scene((*bodies, moving), boxes, ("steel",), np.array([[-9.0, -9, 0], [9, 9, 3]]), mounts)


def tagged(n=3):
    poses = np.array([[3.0 + 0.5 * i, 2.0 + 0.7 * i, 1.5, 1, 0, 0, 0] for i in range(n)])
    return Tagged(Tags(id=[f"tag{i}" for i in range(n)]), np.full(n, -1), poses)


def truth():
    return Truth(t=[0.0, SECONDS], poses=np.tile(frames.IDENTITY, (2, 1, 1)), bodies=("cart",))


def sensed(config=None, wall=None, rules=None, tags=None, first=0, trial=0):
    where, config = scene(wall), CountingConfig.model_validate(config or {})
    rfid = RfidConfig.model_validate({"antennas": rules or [{"on": "north"}, {"on": "south"}]})
    antennas, ends = place_antennas(rfid, "grid", where)
    caster = BoxCaster(where, np.array([60.0]), np.array([0.0]))
    around = Surroundings(where, truth(), tags or tagged(), [""] * 3, np.arange(2), SECONDS, caster, 5, trial)
    return counted(config, "grid", antennas, ends, around, first, Shade(around, antennas, ends, CARRIERS)), around, antennas


def table(found, antennas=8, tags=3, readers=2):
    """Counts as (slot, antenna, tag)."""
    counts, n = found.streams["counts"], np.zeros((int(SECONDS), antennas, tags), dtype=int)
    n[counts.round // readers, counts.antenna, counts.tag] = counts.n
    return n


def pure(antennas, around, config):
    slot, a, k = (x.ravel() for x in np.meshgrid(np.arange(int(SECONDS)), np.arange(8), np.arange(3), indexing="ij"))
    cosine, distance = off_boresight(antennas.quaternion[a], around.tagged.pose[k, :3] - antennas.position[a])
    keys = keys_of(antennas.id)[a], slot, keys_of(around.tagged.tags.id)[k]
    draws = Counter(5, 0, "sensors.grid.counts")
    return blocks(distance, np.arccos(cosine), 0.0, config.queries, config.dead_zone, draws, keys).reshape(-1, 8, 3)


@pytest.mark.parametrize("scope", ["count", "antenna"])
def test_without_shelves_the_counts_are_those_of_the_pure_generator_seed_for_seed(scope):
    found, around, antennas = sensed({"dead_zone": {"scope": scope}})
    assert (table(found) == pure(antennas, around, CountingConfig.model_validate({"dead_zone": {"scope": scope}}))).all()
    assert found.shares["blocked"][0] == pytest.approx(0.0, abs=1e-9)


def test_what_stands_in_the_way_makes_dead_zones_and_lowers_nothing_else():
    free, _, _ = sensed()
    shut, _, _ = sensed(wall=((3.4, 3.4, 0.0), (5.4, 3.6, 1.49)))  # the rim of the zone alone: half open links
    free, walled = table(free), table(shut)
    alive = walled > 0
    assert (walled[alive] == free[alive]).all()
    died = (free > 0) & ~alive
    share = died.sum((0, 2)) / (free > 0).sum((0, 2))
    assert (share > 0.2).any()
    assert (share == 0).any()
    assert 0.0 < shut.shares["blocked"][0] < 0.6
    assert shut.shares["line_of_sight"][0] == pytest.approx(1 - shut.shares["blocked"][0])


def test_a_link_wholly_in_the_shadow_is_dead_and_geometry_can_be_turned_off():
    wall = ((-1.0, 0.5, 0.0), (7.0, 0.7, 9.0))  # between the tags and the two southern corners
    found = table(sensed(wall=wall)[0])
    assert found[:, 0, 0].sum() == 0
    assert found[:, 2:4].sum() > 0
    assert (table(sensed({"geometry": False}, wall=wall)[0]) == table(sensed()[0])).all()


def test_averaged_dead_zones_are_as_many_and_fall_anywhere():
    """4.5 σ of the difference of two shares: fails once in 100,000 seeds."""
    wall = ((-1.0, 0.5, 0.0), (7.0, 0.7, 9.0))
    free, there, anywhere = (table(sensed(c, w)[0]) for c, w in (({}, None), ({}, wall), ({"geometry": "averaged"}, wall)))
    read = free > 0
    lost = [1 - (n[read] > 0).mean() for n in (there, anywhere)]
    assert lost[1] == pytest.approx(lost[0], abs=4.5 * np.sqrt(lost[0] * (1 - lost[0]) / read.sum()))
    assert (anywhere[:, 0, 0] > 0).any() > (there[:, 0, 0] > 0).any()


def test_antennas_of_one_body_are_one_reader_and_end_together():
    rules = [{"on": "north"}, {"on": "south"}, {"position_m": [1, 1, 1]}, {"position_m": [2, 1, 1]}]
    found, around, antennas = sensed(rules=rules, first=7)
    names = reader_names(around.scene, antennas, "grid")
    assert names.tolist() == ["north"] * 4 + ["south"] * 4 + ["grid"] * 2
    rounds = found.streams["rounds"]
    slot = np.floor(rounds.t_start).astype(int)
    tau = rounds.t_end - rounds.t_start
    assert (tau >= 0.2).all()
    assert (tau <= 0.8).all()
    for r in range(3):
        assert len(np.unique(tau[rounds.reader == r])) == int(SECONDS)
    assert len(np.unique(tau)) == 3 * int(SECONDS)
    assert (np.bincount(slot) == 10).all()
    assert rounds.antenna.min() == 7
    assert len(np.unique(rounds.round)) == 3 * int(SECONDS)


def test_dead_flags_of_the_antennas_of_a_reader_are_drawn_for_each_of_them():
    """A block near enough to be read for certain is 0 only where it is dead. Correlations beyond 4.5 σ fail once in 20,000 runs."""
    tags = Tagged(Tags(id=["a"]), np.array([-1]), np.array([[4.0, 4.0, 1.5, 1, 0, 0, 0]]))
    rules = [{"id": f"n{i}", "position_m": [4 + x, 4 + y, 1.5], "aim_m": [4, 4, 1.5]} for i, (x, y) in enumerate([(1, 0), (-1, 0), (0, 1)])]
    found, _, _ = sensed(
        {"queries": 50, "dead_zone": {"alpha": 3.0, "beta": 7.0}, "period_s": 0.1, "offset_s": [0.0, 0.1]}, rules=rules, tags=tags
    )
    counts = found.streams["counts"]
    dead = np.ones((int(10 * SECONDS), 3))
    dead[counts.round, counts.antenna] = 0
    assert dead.mean() == pytest.approx(0.3, abs=0.03)
    correlation = np.corrcoef(dead.T)[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < 4.5 / np.sqrt(len(dead))


def test_other_tags_antennas_and_chunks_move_no_count(monkeypatch):
    whole = table(sensed()[0])
    assert (table(sensed(tags=tagged(2))[0], tags=2) == whole[:, :, :2]).all()
    assert (table(sensed(rules=[{"on": "north"}])[0], antennas=4, readers=1) == whole[:, :4]).all()
    monkeypatch.setattr(counting, "CELLS", 100)
    assert (table(sensed()[0]) == whole).all()
    assert (table(sensed(trial=1)[0]) != whole).any()


def test_late_reports_keep_their_time_unless_they_are_stamped_on_arrival():
    late, _, _ = sensed({"late_share": 0.3})
    rounds = late.streams["rounds"]
    delay = rounds.t_arrival - rounds.t_end
    values, times = np.unique(np.round(delay, 9), return_counts=True)
    assert values.tolist() == [0.0, 1.0, 2.0]
    assert times[0] / times.sum() == pytest.approx(0.7, abs=0.08)
    assert all(len(np.unique(delay[rounds.round == r])) == 1 for r in range(50))  # a reader's antennas report together
    stamped = sensed({"late_share": 0.3, "stamped": "arrival"})[0].streams["rounds"]
    assert (stamped.t_end == rounds.t_arrival).all()
    assert (table(late) == table(sensed()[0])).all()


def test_windows_that_can_not_be_are_refused():
    for wrong in ({"offset_s": [0.8, 0.2]}, {"offset_s": [0.2, 1.2]}, {"late_periods": [2, 1]}, {"queries": 0}):
        with pytest.raises(ValidationError):
            CountingConfig.model_validate(wrong)


@pytest.mark.parametrize("wrong", [{"alpha": 0}, {"alpha": -1.0}, {"beta": 0}, {"beta": float("nan")}, {"alpha": 1e9}])
def test_impossible_beta_parameters_are_refused_with_their_name(wrong):
    with pytest.raises(ValidationError, match=f"dead_zone.{min(wrong)}"):
        CountingConfig.model_validate({"dead_zone": wrong})
