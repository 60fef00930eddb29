"""What a filter can be told of a state, as pieces that are stacked into one measurement.

A piece has a value z (E, m), variances (E, m) of independent components, and a function h of the state (position first): for an
unscented filter at sigma points, for an extended one with its Jacobian at the mean. NaN in z is a component that was not measured.

Power in dBm is the honest domain, where the noise of a channel is about normal. Distance in metres, d = 10^((C - rssi) / 10 n) with
additive noise, is what many papers use (Nick and Götze, Eq. 18): its true error grows with the distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Protocol

import numpy as np
from pydantic import Field

from estimators.heard import Heard
from estimators.rssi_model import RssiConfig, RssiModel
from testbed.quantity import Config, Metres
from testbed.types import Array, Site


class MeasureConfig(Config):
    """Whether a level counts as power (with `sigma_db`) or as the distance that it stands for (with `distance_std_m`)."""

    measure: Literal["power", "distance"] = "power"
    distance_std_m: Annotated[Metres, Field(gt=0, le=1e3)] = 0.35


class Piece(Protocol):
    """Some components of a measurement of E rows."""

    @property
    def z(self) -> Array: ...

    @property
    def variance(self) -> Array: ...

    def expected(self, points: Array) -> Array:
        """(E, P, m) at states (E, P, n)."""
        ...

    def linearised(self, mean: Array, covariance: Array | None) -> tuple[Array, Array, Array]:
        """h (E, m), its Jacobian (E, m, n) at states (E, n), and the variance (E, m).

        With the beliefs' covariance (E, n, n), the variance holds what the curvature of h makes of their doubt: see `Ekf`.
        """
        ...


@dataclass(frozen=True, eq=False)
class Power:
    """Levels as the link budget expects them; `first` is where the position stands in the state."""

    heard: Heard
    model: RssiModel
    variance: Array  # (E, m) dB²
    first: int = 0

    @property
    def z(self) -> Array:
        return self.heard.rssi

    def expected(self, points: Array) -> Array:
        position, antenna, tag = self._apart(points[..., self.first : self.first + 3])
        e, m = self.heard.rssi.shape
        return self.model.expected(position, antenna, tag).reshape(e, m, points.shape[1]).transpose(0, 2, 1)

    def linearised(self, mean: Array, covariance: Array | None) -> tuple[Array, Array, Array]:
        here = slice(self.first, self.first + 3)
        shape, variance = self.heard.rssi.shape, self.variance
        position, antenna, tag = self._apart(mean[:, None, here])
        if covariance is None:
            level, gradient = self.model.linearised(position[:, 0], antenna, tag)
        else:
            level, gradient, hessian = self.model.quadratic(position[:, 0], antenna, tag)
            doubt = np.repeat(covariance[:, here, here], shape[1], axis=0) if shape[1] != 1 else covariance[:, here, here]
            variance = variance + curvature_noise(hessian, doubt).reshape(shape)
        jacobian = np.zeros((*shape, mean.shape[1]))
        jacobian[..., here] = gradient.reshape(*shape, 3)
        return level.reshape(shape), jacobian, variance

    def _apart(self, position: Array) -> tuple[Array, Array, Array]:
        """Entries and components as one axis: positions (E m, P, 3), antennas and tags (E m,)."""
        m = self.heard.rssi.shape[1]
        position = np.repeat(position, m, axis=0) if m != 1 else position
        return position, self.heard.antenna.ravel(), self.heard.tag.ravel()


@dataclass(frozen=True, eq=False)
class Range:
    """Distances from `origin` (E, m, 3) m; `first` is where the position stands in the state."""

    z: Array  # (E, m) m
    origin: Array
    variance: Array  # (E, m) m²
    first: int = 0

    def expected(self, points: Array) -> Array:
        apart = points[:, :, None, self.first : self.first + 3] - self.origin[:, None]
        return np.sqrt(np.einsum("epmi,epmi->epm", apart, apart))

    def linearised(self, mean: Array, covariance: Array | None) -> tuple[Array, Array, Array]:
        here = slice(self.first, self.first + 3)
        apart = mean[:, None, here] - self.origin
        distance = np.sqrt(np.einsum("emi,emi->em", apart, apart))
        direction = apart / np.maximum(distance, 1e-9)[..., None]  # at the antenna itself there is no direction: nothing is learnt
        variance = self.variance
        if covariance is not None:  # the Hessian is (I - u uᵀ) / d
            across = (np.eye(3) - direction[..., :, None] * direction[..., None, :]) / np.maximum(distance, 1e-9)[..., None, None]
            product = across @ covariance[:, None, here, here]
            variance = variance + np.einsum("emij,emji->em", product, product) / 2
        jacobian = np.zeros((*distance.shape, mean.shape[1]))
        jacobian[..., here] = direction
        return distance, jacobian, variance


@dataclass(frozen=True, eq=False)
class Linear:
    """z = A x, the same A (m, n) for all entries."""

    z: Array
    matrix: Array
    variance: Array

    def expected(self, points: Array) -> Array:
        return points @ self.matrix.T

    def linearised(self, mean: Array, covariance: Array | None) -> tuple[Array, Array, Array]:
        return mean @ self.matrix.T, np.broadcast_to(self.matrix, (len(mean), *self.matrix.shape)), self.variance


def curvature_noise(hessian: Array, covariance: Array) -> Array:
    """(E,) ½ tr((H'' P)²): the variance that a parabola adds to the straight line through it, from (E, k, k) both."""
    product = hessian @ covariance
    return np.einsum("eij,eji->e", product, product) / 2


def distances(model: RssiModel, heard: Heard) -> Array:
    """(E, m) m: how far off the tags are by their level alone, on boresight; NaN where not heard."""
    return model.distance(heard.rssi, heard.antenna, heard.tag)


def ranges(config: MeasureConfig, model: RssiModel, site: Site, heard: Heard, first: int = 0) -> Range:
    """The levels heard as distances from their antennas."""
    origin = site.antennas.position[heard.antenna]
    return Range(distances(model, heard), origin, np.full(heard.rssi.shape, config.distance_std_m**2), first)


def enough_antennas(config: RssiConfig, site: Site, antennas: Array, method: str, least: int = 2) -> None:
    """ValueError, naming them, for fewer antennas than distances can place anything with, or for two at one place."""
    if len(antennas) < least:
        found = ", ".join(map(str, site.antennas.id[antennas])) or "none"
        raise ValueError(f"{method}: distances to {least} antennas at least are needed, and it has {len(antennas)} ({found})")
    place = site.antennas.position[antennas]
    apart = np.linalg.norm(place[:, None] - place, axis=-1) + 9.0 * np.eye(len(place))
    if (apart < 1e-6).any():
        a, b = site.antennas.id[antennas[np.argwhere(apart < 1e-6)[0]]]
        raise ValueError(f"{method}: antennas {a} and {b} are at one place, and their distances are one: leave one of them out")
