"""The check of estimators finds what is wrong: a sound method, and the same broken in one way each."""

import random
from typing import ClassVar

import numpy as np
import pytest

from testbed.check import ConformanceError, check_estimator
from testbed.checks import samples
from testbed.protocols import SingleTarget
from testbed.quantity import Config, Metres
from testbed.types import POSITION, POSITION_VELOCITY, Estimate, Status, UpdateInfo


class Sound:
    """Holds the prior, and pulls it a little towards the antenna that reads: no good, but well-behaved."""

    Config: ClassVar = Config
    consumes: ClassVar = frozenset({"reads"})

    def __init__(self, config, site, rng):
        self.antennas, self.rng = site.antennas.position, rng

    def start(self, prior):
        self.now, self.mean, self.doubt = np.array(prior.t), np.array(prior.mean[:, :3]), np.ones(prior.rows)

    def predict(self, t):
        self.doubt = self.doubt + 0.1 * (t - self.now)
        self.now = t

    def update(self, event):
        used = np.isfinite(event.data.rssi)
        rows = event.row[used]
        self.mean[rows] = self.pulled(event, used)
        return UpdateInfo(used, nis=np.where(used, 1.0, np.nan), dof=used)

    def pulled(self, event, used):
        rows = event.row[used]
        return 0.9 * self.mean[rows] + 0.1 * self.antennas[event.data.antenna[used]]

    def covariance(self):
        return self.doubt[:, None, None] * np.eye(3)

    def estimate(self):
        return Estimate(POSITION, self.mean.copy(), self.covariance(), np.zeros(len(self.mean)))


def broken(**changes):
    return type("Broken", (Sound,), changes)


def test_a_sound_estimator_passes():
    check_estimator(Sound)
    check_estimator(broken(consumes=frozenset({"reads", "rounds", "odometry", "heading", "ranges", "reference_reads"}), update=take_all))


def take_all(self, event):
    return UpdateInfo.accepted(len(event)) if event.kind != "reads" else Sound.update(self, event)


class Lenient(Config):
    model_config: ClassVar = {"extra": "ignore"}


class Wanting(Config):
    reach_m: Metres


def unseeded(self, event, used):
    return Sound.pulled(self, event, used) + 1e-6 * np.random.default_rng().normal()


def global_numpy(self, event, used):
    np.random.rand()  # noqa: NPY002
    return Sound.pulled(self, event, used)


def global_random(self, event, used):
    random.random()
    return Sound.pulled(self, event, used)


def creeping(self):
    self.mean = self.mean + 1e-6
    return Sound.estimate(self)


def secretly_counting(self):
    self.asked = getattr(self, "asked", 0) + 1
    return Sound.estimate(self)


def pulled_by_the_curious(self, event, used):
    return Sound.pulled(self, event, used) + 1e-3 * getattr(self, "asked", 0)


def shared_array(self):
    return Estimate(POSITION, self.mean, self.covariance(), np.zeros(len(self.mean)))


def ageing_by_the_call(self, t):
    self.doubt = self.doubt + 0.01
    self.now = t


def company(self, event, used):
    return Sound.pulled(self, event, used) + 1e-6 * len(event)


def first_in_the_list(self, event, used):
    return Sound.pulled(self, event, used) + 1e-6 * event.row[used][:, None]


def forgetful_start(self, prior):
    kept = getattr(self, "mean", None)
    Sound.start(self, prior)
    self.mean = self.mean if kept is None else kept


def trusting(self, event):
    self.mean[event.row] += 1e-3 * event.data.rssi[:, None]
    return UpdateInfo.accepted(len(event))


def jealous_of_time(self, event):
    apart = event.data.t - getattr(self, "last", np.full(len(self.mean), -1.0))[event.row]
    self.last = np.full(len(self.mean), -1.0)
    self.last[event.row] = event.data.t
    with np.errstate(divide="ignore", invalid="ignore"):
        self.mean[event.row] += (0.0 * (1.0 / apart))[:, None]
    return UpdateInfo.accepted(len(event))


BREAKAGES = [
    (broken(Config=None), "has no pydantic model"),
    (broken(Config=Lenient), "unknown keys pass"),
    (broken(Config=Wanting), "no default for reach_m"),
    (broken(consumes={"reads"}), "consumes must be a frozenset"),
    (broken(consumes=frozenset({"smells"})), "consumes must be a frozenset"),
    (broken(__init__=lambda self, config, site, rng: int("no")), "refuses the site"),
    (broken(pulled=unseeded), "two runs with one seed differ"),
    (broken(pulled=global_numpy), "uses the global random state"),
    (broken(pulled=global_random), "uses the global random state"),
    (broken(estimate=creeping), "a second call says something else"),
    (broken(estimate=secretly_counting, pulled=pulled_by_the_curious), "asking changes what is believed later"),
    (broken(estimate=shared_array), "changes after it was given"),
    (broken(predict=ageing_by_the_call), "not idempotent"),
    (
        broken(predict=lambda self, t: setattr(self, "mean", self.mean + 1e-3 * (t - self.now).max()) or Sound.predict(self, t)),
        "stands still",
    ),
    (broken(update=lambda self, event: UpdateInfo.accepted(len(event) + 1)), r"answered for \d+ entries of"),
    (broken(update=lambda self, event: Sound.update(self, event).with_(nis=np.full(len(event), -1.0))), "negative NIS"),
    (broken(update=lambda self, event: UpdateInfo(np.zeros(len(event), dtype=bool))), "used not one event"),
    (broken(covariance=lambda self: np.tile([[1.0, 0.5, 0], [0.4, 1, 0], [0, 0, 1]], (len(self.mean), 1, 1))), "not symmetric on ordinary"),
    (broken(covariance=lambda self: np.tile(np.diag([1.0, 1.0, -1e-3]), (len(self.mean), 1, 1))), "negative eigenvalue"),
    (broken(covariance=lambda self: np.full((len(self.mean), 3, 3), np.nan)), "is not finite on ordinary data"),
    (broken(estimate=lambda self: Sound.estimate(self).with_(status=np.full(len(self.mean), 7))), "a status is none of"),
    (broken(estimate=lambda self: Sound.estimate(self).with_(components=("x", "x", "z"))), "names a component twice"),
    (broken(estimate=lambda self: Sound.estimate(self).with_(components=("x", "y"))), "names 2 components and estimates"),
    (broken(pulled=company), "rows are not independent"),
    (broken(pulled=first_in_the_list), "rows are not independent"),
    (broken(start=forgetful_start), "does not forget"),
    (broken(update=trusting), "when some measured values are NaN"),
    (broken(update=jealous_of_time), "not finite"),
]


@pytest.mark.parametrize(("cls", "rule"), BREAKAGES, ids=[rule.replace(" ", "_") + str(i) for i, (_, rule) in enumerate(BREAKAGES)])
def test_what_is_broken_is_found_and_named(cls, rule):
    with pytest.raises(ConformanceError, match=rule):
        check_estimator(cls)


def test_the_global_state_is_left_as_it_was_even_by_a_culprit():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    with pytest.raises(ConformanceError):
        check_estimator(broken(pulled=global_numpy))
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_an_estimator_that_accepts_late_events_gets_them_and_one_that_does_not_is_spared():
    seen = []

    class Late(Sound):
        accepts_late: ClassVar = True

        def update(self, event):
            seen.append((event.data.t < self.now[event.row]).any())
            return super().update(event)

    check_estimator(Late)
    assert any(seen)


class Nearest(SingleTarget):
    """A newcomer's filter: the target is where the antenna is that reads it."""

    Config: ClassVar = Config
    consumes: ClassVar = frozenset({"reads"})
    components: ClassVar = POSITION

    def start(self, t, mean, covariance):
        self.place, self.doubt = mean[:3], covariance[:3, :3]

    def predict(self, t):
        pass

    def update(self, kind, data):
        self.place = self.site.antennas.position[data.antenna]

    def estimate(self):
        return self.place, self.doubt, Status.OK


def test_a_method_for_one_target_passes_and_a_poisoned_one_is_lost_rather_than_wrong():
    check_estimator(Nearest)

    class Poisoned(Nearest):
        def update(self, kind, data):
            self.place = self.place + 0.0 * data.rssi

    check_estimator(Poisoned)  # NaN for good after the first NaN: the adapter calls it LOST


def test_one_that_draws_from_its_own_generator_repeats_itself():
    class Drawing(Nearest):
        def update(self, kind, data):
            self.place = self.place + 0.01 * self.rng.normal(size=3)
            return True, -1.0, 1.0, 1

    check_estimator(Drawing)


def test_an_incomplete_class_is_told_what_it_lacks():
    class Half(SingleTarget):
        Config: ClassVar = Config
        consumes: ClassVar = frozenset({"reads"})
        components: ClassVar = POSITION_VELOCITY

    with pytest.raises(ConformanceError, match=r"lacks .*predict"):
        check_estimator(Half)
    with pytest.raises(TypeError, match="Thing is no estimator: it has no start"):
        check_estimator(type("Thing", (), {"Config": Config, "consumes": frozenset({"reads"})}))


def test_a_method_may_be_checked_on_recordings_of_its_own():
    class Particular(Sound):
        def __init__(self, config, site, rng):
            if len(site.references) > 3:
                raise ValueError("particular: at most three reference tags")
            super().__init__(config, site, rng)

    with pytest.raises(ConformanceError, match=r"refuses the site that it is checked on .*give recordings"):
        check_estimator(Particular)
    made = samples.recording(duration=1.0)
    few = made.site.references.take(np.arange(3))
    check_estimator(Particular, recordings=[samples.replace(made, site=samples.replace(made.site, references=few))])
