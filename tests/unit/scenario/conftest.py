"""Small plug-ins of the tests' own, and a document that uses them: the scenario file is tested apart from what ships."""

from __future__ import annotations

import copy
from typing import Annotated, Any, ClassVar, Literal

import pytest
from pydantic import Field, model_validator

from testbed import plugins
from testbed.quantity import Config, DecibelMilliwatts, Decibels, Hertz, Metres, Point3


class Antenna(Config):
    position_m: Point3
    gain_dbi: float = 6.0


class Row(Config):
    count: Annotated[int, Field(ge=1, le=64)] = 4
    spacing_m: Annotated[Metres, Field(gt=0)] = 1.0


class Smooth(Config):
    shape: Literal["smooth"]
    width_m: Metres = 1.0


class Rough(Config):
    shape: Literal["rough"]
    grain_m: Metres = 0.1


class Hall:
    """A hall for tests."""

    class Config(Config):
        gates: Annotated[int, Field(ge=0, le=20)] = 1
        floor: Annotated[Smooth | Rough, Field(discriminator="shape")] = Smooth(shape="smooth")


class Cart:
    """A cart for tests."""

    class Config(Config):
        load: Annotated[float, Field(ge=0, le=1)] = 0.5
        cartons: int = 0
        pushed: bool = False


class Portal:
    """A sensor for tests."""

    class Config(Config):
        antennas: Row | list[Antenna] = Row()
        range_m: Annotated[Metres, Field(gt=0, le=100)] = 10.0
        read_rate_hz: Annotated[Hertz, Field(gt=0)] = 100.0
        power_dbm: DecibelMilliwatts = 29.0
        noise_db: Decibels | None = None
        channels: frozenset[str] = frozenset({"b", "a", "c"})


class Kalman:
    """An estimator for tests."""

    class Config(Config):
        acceleration_mps2: Annotated[float, Field(gt=0)] = 0.4
        gate: Annotated[float, Field(gt=0, lt=1)] | None = None


class Best:
    """An estimator that needs a setting, with a rule across two of them."""

    class Config(Config):
        particles: Annotated[int, Field(ge=1)]
        keep: int = 1

        @model_validator(mode="after")
        def _keep_some(self) -> Any:
            if self.keep > self.particles:
                raise ValueError(f"keep must be at most particles, {self.keep} of {self.particles} can't be kept")
            return self


class ErrorMetric:
    """A metric of several statistics."""

    columns: ClassVar[dict[str, str]] = {"position_error_m.mean": "mean", "position_error_m.p95": "95 %"}

    class Config(Config):
        dims: Literal[2, 3] = 3


class Availability:
    """A metric of one column."""

    columns: ClassVar[dict[str, str]] = {"availability": "share"}

    class Config(Config):
        pass


FAKES: dict[str, dict[str, type]] = {
    "worlds": {"hall": Hall},
    "actors": {"cart": Cart},
    "sensors": {"portal_reader": Portal},
    "estimators": {"ekf": Kalman, "ukf": Kalman, "best": Best},
    "metrics": {"position_error": ErrorMetric, "availability": Availability},
}

DOCUMENT: dict[str, Any] = {
    "name": "dock",
    "seed": 20261,
    "trials": 4,
    "duration_s": 20.0,
    "world": {"kind": "hall", "gates": 2},
    "actors": [
        {
            "id": "t1", "kind": "cart", "motion": "kinematic", "load": 0.3,
            "route": {"waypoints_m": [[0.0, 0.0], [5.0, 0.0]], "speed_mps": 1.5},
            "tags": [{"id": "t1a", "position_m": [0.1, 0.0, 1.0]}],
        },
        {"id": "p1", "kind": "cart", "motion": "parked", "position_m": [2.0, 3.0]},
    ],
    "sensors": [{"id": "portal", "kind": "portal_reader", "antennas": {"count": 3}, "range_m": 8.0}],
    "tags": [{"id": "ref", "position_m": [1.0, 1.0, 1.0]}, {"on": "rack*", "per_group": 4, "prefix": "bay"}],
    "targets": ["t1*"],
    "prior": {"position_std_m": 0.4},
    "estimators": [{"kind": "ekf"}, {"id": "fast", "kind": "ukf", "acceleration_mps2": 1.0}],
    "expect": {
        "fast": {"position_error_m": {"mean": {"max": 0.35}}, "availability": {"min": 0.9}},
        "ekf - fast": {"position_error_m": {"mean": {"min": 0.0}}},
        "world": {"line_of_sight": {"min": 0.3, "max": 0.7}},
    },
}  # fmt: skip


@pytest.fixture
def fakes(monkeypatch):
    """The fake plug-ins in place of all that are registered; a test may add to the mapping."""
    registered = {group: dict(kinds) for group, kinds in FAKES.items()}

    def load(group: str, name: str) -> type:
        if name not in registered[group]:
            raise plugins.UnknownPlugin(f"no {group[:-1]} named {name!r}{plugins.suggest(name, sorted(registered[group]))}")
        if isinstance(registered[group][name], str):
            raise plugins.BrokenPlugin(f"{group[:-1]} {name!r} can't be imported")
        return registered[group][name]

    monkeypatch.setattr(plugins, "load", load)
    monkeypatch.setattr(plugins, "names", lambda group: sorted(registered[group]))
    monkeypatch.setattr(plugins, "origin", lambda group, name: f"tests:{name}")
    return registered


@pytest.fixture
def document():
    """A valid document, the test's own to change."""
    return copy.deepcopy(DOCUMENT)
