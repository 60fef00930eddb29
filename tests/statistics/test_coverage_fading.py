"""Coverage against the channel itself: shares of trials in which a tag is read, and mean levels, at points of a real hall.

Fixed seed. 36 links × 2 figures; the standard error of each is taken from its own 1,500 trials. A figure is off by more than 4.5 of them
by chance with probability 7e-6: 5e-4 in all. Beside that stands what the field's 24 waves are away from Gaussian: 0.005 of a probability
(`testbed.radio.rice`), and 0.1 dB of a level.
"""

import numpy as np
import pytest

from testbed.api import scenario_of
from testbed.coverage.links import heard
from testbed.coverage.maps import _asked
from testbed.radio.channel import Channel, Fixed
from testbed.simulate import Simulator

TRIALS, LINKS = 1500, 36
SITE = {
    "name": "dock",
    "seed": 1,
    "trials": 1,
    "duration_s": 1,
    "world": {"kind": "dock_gate"},
    "sensors": [{"id": "portal", "kind": "rfid", "antennas": {"on": "gate*"}}],
}


@pytest.fixture(scope="module")
def sampled():
    """Closed form and samples of the same links: (probability, level) and (read, level) of trials (LINKS, TRIALS)."""
    with Simulator(scenario_of(SITE)) as simulator:
        sensor, rest = simulator.sensors[0], simulator.at_rest()
        random = np.random.default_rng(7)
        points = random.uniform([5.5, 0.5, 0.3], [13.5, 11.5, 2.0], (600, 3))
        around = _asked(rest, points, "monza_4")
        found = heard(sensor, around)
        between = np.flatnonzero((found.probability > 0.03) & (found.probability < 0.97))
        # through the whole range, the darkest links as well as the clearest
        chosen = between[np.argsort(found.probability[between])][np.linspace(0, len(between) - 1, LINKS).astype(int)]
        links = found.take(chosen)
        around = _asked(rest, points[links.place], "monza_4")
        radio = sensor.radio(around.caster, around.tagged)
        fixed, frequencies = Fixed(radio), len(radio.frequencies)
        antenna, tag = np.repeat(links.antenna, frequencies), np.repeat(np.arange(LINKS), frequencies)
        carrier = np.tile(np.arange(frequencies), LINKS)
        read, level = np.empty((TRIALS, LINKS)), np.empty((TRIALS, LINKS))
        for trial in range(TRIALS):
            channel = Channel(radio, fixed, around.truth, 3, trial)
            response = channel.respond(antenna, tag, np.zeros(len(tag)), carrier)
            received, forward, reverse = sensor.margins(response, antenna, tag, around.tagged)
            read[trial] = ((forward >= 0) & (reverse >= 0)).reshape(LINKS, frequencies).mean(axis=1)
            level[trial] = received.reshape(LINKS, frequencies).mean(axis=1)
        return links, read, level


def beyond(samples, expected, systematic):
    """Standard errors by which the means of samples (trials, N) are off, beyond what is off systematically."""
    error = samples.std(axis=0, ddof=1) / np.sqrt(len(samples))
    return np.maximum(np.abs(samples.mean(axis=0) - expected) - systematic, 0) / np.maximum(error, 1e-9)


def test_probabilities_are_the_shares_of_trials_in_which_a_tag_is_read(sampled):
    links, read, _ = sampled
    assert beyond(read, links.probability, 0.005).max() < 4.5
    assert np.ptp(links.probability) > 0.9
    assert links.clear.min() < 0.5 < links.clear.max()  # links in the open and behind things


def test_levels_are_the_means_over_trials(sampled):
    links, _, level = sampled
    assert beyond(level, links.rssi, 0.1).max() < 4.5


def test_a_probability_of_the_power_of_the_path_alone_would_be_found_out(sampled):
    # what a map without the diffuse part says, and one whose fades are those of the mean power: either fails above
    links, read, _ = sampled
    assert beyond(read, np.round(links.probability), 0.005).max() > 20
