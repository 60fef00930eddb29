"""Speed of the channel: a hall with 64 antennas and 600 tags, 120 of them on 30 trolleys, one round a second.

What a second costs, in parts, without and with reflections, against casting one ray a link by PyBullet in the same run.
`pytest -m benchmark --benchmark-enable -s tests/benchmarks/test_bench_radio.py` prints the figures.
"""

import time

import numpy as np
import pytest

from testbed import frames
from testbed.geometry import Zones
from testbed.protocols import ActorPlan
from testbed.radio.channel import Channel, Fixed
from testbed.radio.inventory import hearing, inventory
from testbed.radio.links import Ends
from testbed.radio.materials import losses
from testbed.radio.profiles import PROFILES
from testbed.radio.propagation import power_at_tag
from testbed.radio.regions import REGIONS
from testbed.radio.setting import ChannelConfig, Radio
from testbed.rng import keys_of, mix
from testbed.scene import Truth
from testbed.types import Antennas, Tags
from worlds import parts
from worlds.actors.trolley import Trolley
from worlds.hall import _actor_part, assemble
from worlds.raycast import BoxCaster

pytestmark = pytest.mark.benchmark

ANTENNAS, TAGS, TROLLEYS, SECONDS = 64, 600, 30, 10
WITH_REFLECTIONS = 10  # times what it costs without
AGAINST_PYBULLET = 4  # times faster than one PyBullet ray for each of the 38,400 links
POWER, SENSITIVITY = 29.0, -19.5


def hall():
    """24 racks in six rows, 2,000 boxes that stand, and trolleys with their pushers in the aisles."""
    standing = [
        parts.rack(
            f"rack{row}.{col}",
            parts.floor_pose(-24 + col * 15, -16 + row * 6.0, (row % 2) * np.pi),
            parts.RackSize(bays=5),
            0.7,
            0.15,
            np.random.default_rng(row * 4 + col),
        )
        for row in range(6)
        for col in range(4)
    ]
    corners = [(-35.0, -22.0), (35.0, -22.0), (35.0, 22.0), (-35.0, 22.0)]
    standing += [parts.wall(f"wall{i}", corners[i], corners[(i + 1) % 4], 6.0) for i in range(4)]
    rng, plans = np.random.default_rng(0), []
    for i in range(TROLLEYS):
        pose = parts.floor_pose(rng.uniform(-28, 28), -13 + 6 * rng.integers(0, 5), rng.choice([0.0, np.pi]))
        plans.append(ActorPlan(f"trolley{i}", "trolley", "kinematic", Trolley(Trolley.Config(pusher=True)), None, pose))
    everything = [*standing, *map(_actor_part, plans)]
    return assemble(everything, plans, np.array([[-35.0, -22, 0], [35, 22, 6]]), Zones.empty(), None)


def setting(scene, orders):
    """Antennas above the aisles, four tags on each trolley, the others on the racks."""
    rng = np.random.default_rng(3)
    place = np.array([[-30 + i % 8 * 8.5, -19 + i // 8 * 5.2, 4.0] for i in range(ANTENNAS)])
    turn = frames.from_euler(rng.uniform(-np.pi, np.pi, ANTENNAS), np.full(ANTENNAS, np.deg2rad(40)))
    same = np.ones(ANTENNAS)
    antennas = Antennas(
        id=[f"a{i}" for i in range(ANTENNAS)], position=place, quaternion=turn, gain=6 * same, beamwidth=np.deg2rad(68) * same,
        front_to_back=18 * same, power=POWER * same,
    )  # fmt: skip
    mounts, pose = scene.mounts, np.hstack([scene.mounts.position, scene.mounts.quaternion])
    rides = np.isin(mounts.body, scene.moving)
    moving = np.concatenate([np.flatnonzero(rides & (mounts.body == b) & (mounts.use == "tag"))[:4] for b in scene.moving])
    still = rng.choice(np.flatnonzero(~rides & (mounts.use == "tag")), TAGS - len(moving), replace=False)
    far = Ends(
        np.concatenate([np.searchsorted(scene.moving, mounts.body[moving]), np.full(len(still), -1)]),
        np.concatenate([pose[moving], frames.compose(scene.rest_poses()[mounts.body[still]], pose[still])]),
    )
    tags = Tags(
        id=[f"t{i}" for i in range(TAGS)], gain=np.full(TAGS, 2.0), sensitivity=np.full(TAGS, SENSITIVITY), pattern=["dipole"] * TAGS
    )
    caster = BoxCaster(scene, *losses(scene.materials))
    near = Ends(np.full(ANTENNAS, -1), np.hstack([place, turn]))
    return Radio(ChannelConfig(orders=orders), scene, caster, antennas, near, tags, far, REGIONS["etsi"].carriers)


def rolling(scene):
    """Trolleys at 1 m/s along their aisles."""
    t = np.arange(0, SECONDS + 1, 1 / 120)
    poses = np.tile(scene.rest_poses()[scene.moving], (len(t), 1, 1))
    poses[..., :3] += t[:, None, None] * frames.rotate(poses[0, :, 3:], np.array([1.0, 0, 0]))
    return Truth(t=t, poses=poses, bodies=scene.moving_names)


class Seconds:
    """CPU seconds of named parts, the least of several runs."""

    def __init__(self):
        self.least = {}

    def of(self, name, call):
        began = time.process_time()
        result = call()
        took = (time.process_time() - began) / SECONDS
        self.least[name] = min(took, self.least.get(name, np.inf))
        return result


def sensed(radio, fixed, truth, seconds):
    """All rounds of the time: who may hear, who does, who is read when, and the channel at those times."""
    channel = Channel(radio, fixed, truth, 1, 0)
    antenna, second = np.tile(np.arange(ANTENNAS), SECONDS), np.repeat(np.arange(SECONDS), ANTENNAS)
    t = second + antenna % 4 * 0.042 + 0.02
    row, tag = seconds.of("candidates", lambda: channel.candidates(antenna, t))
    carrier = np.zeros(len(row), dtype=int)
    first = seconds.of("margins", lambda: channel.respond(antenna[row], tag, t[row], carrier))
    wakes = power_at_tag(first.h, POWER) >= SENSITIVITY
    reads = seconds.of("inventory", lambda: _inventory(antenna[row][wakes], second[row][wakes], tag[wakes]))
    when, who = _read(reads, antenna[row][wakes], tag[wakes], t[row][wakes])
    seconds.of("reads", lambda: channel.respond(who[0], who[1], when, np.zeros(len(when), dtype=int)))
    return len(row) / SECONDS, wakes.sum() / SECONDS, len(when) / SECONDS


def _inventory(antenna, second, tag):
    heard = hearing(ANTENNAS, SECONDS, 1.0, antenna, second, tag)
    keys = keys_of([f"a{i}" for i in range(ANTENNAS)]), keys_of([f"t{i}" for i in range(TAGS)])
    return inventory(PROFILES["r420"], heard, float(SECONDS), mix(1), *keys, np.ones(TAGS, dtype=bool), np.ones(TAGS))


def _read(reads, antenna, tag, t):
    """One read of each tag that wakes, a little off the time its margin was taken at: as many as a round a second has."""
    jitter = 0.02 * np.sin(np.arange(len(t)))
    assert len(reads.t) > 0
    return t + jitter, (antenna, tag)


@pytest.fixture(scope="module")
def world():
    scene = hall()
    return scene, rolling(scene)


def cost(world, orders, rounds=5):
    scene, truth = world
    began = time.process_time()
    radio = setting(scene, orders)
    fixed = Fixed(radio)
    once = time.process_time() - began
    seconds = Seconds()
    for _ in range(rounds):
        figures = sensed(radio, fixed, truth, seconds)
    return seconds.least, once, figures


def test_64_antennas_and_600_tags_cost_less_than_a_pybullet_ray_a_link_and_at_most_ten_times_that_with_reflections(benchmark, world):
    from worlds.bullet import Client

    scene, truth = world
    parts_without, once, figures = cost(world, 0)
    parts_with, once_with, figures_with = cost(world, 1)
    rng = np.random.default_rng(5)
    start = np.repeat(rng.uniform([-30, -20, 2], [30, 20, 4.5], (8, 3)), TAGS, axis=0)
    end = np.tile(rng.uniform([-30, -20, 0.2], [30, 20, 3], (TAGS, 3)), (8, 1))
    with Client() as client:
        client.load_static(scene)
        began = time.process_time()
        client.hits(start, end)
        pybullet = (time.process_time() - began) * ANTENNAS / 8
    without, with_ = sum(parts_without.values()), sum(parts_with.values())
    benchmark.extra_info.update(
        ms_a_second=without * 1e3, with_reflections=with_ * 1e3, pybullet_one_ray_a_link=pybullet * 1e3,
        **{f"{name}_ms": took * 1e3 for name, took in parts_without.items()},
        **{f"{name}_with_reflections_ms": took * 1e3 for name, took in parts_with.items()},
        once_s=once, once_with_reflections_s=once_with, links_wakes_reads=figures, with_reflections_links_wakes_reads=figures_with,
        boxes=len(scene.boxes),
    )  # fmt: skip
    benchmark.pedantic(sensed, (setting(scene, 0), Fixed(setting(scene, 0)), truth, Seconds()), rounds=1)
    assert with_ <= WITH_REFLECTIONS * without, benchmark.extra_info  # ratios in one run; milliseconds are this machine's and today's
    assert pybullet >= AGAINST_PYBULLET * without, benchmark.extra_info
