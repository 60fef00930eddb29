"""An extended Kalman filter on received power, for all rows at once."""

from __future__ import annotations

from collections.abc import Sequence

from estimators import kalman
from estimators.filtering import FilterConfig, PowerFilter, diagonal, stacked
from estimators.measurements import Piece
from testbed.types import Array, UpdateInfo


class EkfConfig(FilterConfig):
    """The section of an `ekf`. With gate: none, curvature_noise: false and correlation_s: 0 it is the plain textbook filter."""

    curvature_noise: bool = True


class Ekf(PowerFilter):
    """State (x, y, z, vx, vy, vz), constant velocity; every read (or snapshot of reads) is linearised at the present mean.

    RSSI bends sharply near an antenna, where a straight line through it promises far more than a read can tell. `curvature_noise` adds
    to the noise what the curvature makes of the present doubt, ½ tr((H'' P)²), the second-order term of Jazwinski 1970, ch. 9: as long
    as the doubt is wide against the distance, a read counts for little. The term's twin, ½ tr(H'' P) added to the prediction, is left
    out: with such doubt it is off by tens of dB, where the logarithm is far from its parabola, and drives the mean away.
    Breaks all the same when the belief has several modes (two antennas leave two places), or when an obstacle dims an antenna for
    long; the gate lets pass what dims it for a read or two.
    """

    Config = EkfConfig

    def _correct(self, row: Array, pieces: Sequence[Piece]) -> UpdateInfo:
        belief = self._belief
        mean = belief.mean[row]
        doubt = belief.covariance[row] if self._config.curvature_noise else None
        expected, jacobian, variance = zip(*(piece.linearised(mean, doubt) for piece in pieces), strict=True)
        innovation = stacked([piece.z - h for piece, h in zip(pieces, expected, strict=True)])
        limits = kalman.gate_limits(self._config.gate, innovation.shape[1])
        noise = diagonal(stacked(variance))
        return kalman.extended_update(belief.mean, belief.covariance, row, innovation, stacked(jacobian), noise, limits)
