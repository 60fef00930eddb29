"""Conformance checks, for whoever writes a plug-in: call one in a test of your own.

    from testbed.check import check_estimator

    def test_my_filter_keeps_the_contract():
        check_estimator(MyFilter)

Each takes the class and, where its Config has no defaults for all fields, a config; each raises `ConformanceError`, an
AssertionError that names the rule that is broken. A plug-in that passes can be driven, batched, repeated and compared.
"""

from testbed.checks.common import ConformanceError
from testbed.checks.estimator import check_estimator
from testbed.checks.metric import check_metric
from testbed.checks.sensor import check_sensor
from testbed.checks.world import check_actor, check_world

__all__ = ["ConformanceError", "check_actor", "check_estimator", "check_metric", "check_sensor", "check_world"]
