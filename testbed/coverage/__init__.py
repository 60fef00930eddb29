"""Where a site's readers hear a tag and where they don't: `maps` asks point by point, `links` in closed form, `output` writes it down."""

from testbed.coverage.maps import COUNTED, DEAD, HEARD, Coverage, CoverageError, DeadZone, coverage, covered

__all__ = ["COUNTED", "DEAD", "HEARD", "Coverage", "CoverageError", "DeadZone", "coverage", "covered"]
