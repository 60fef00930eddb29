"""What a scenario expects of its results, judged, and told in sentences: for tests, whatever runs them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Literal

from testbed import batch
from testbed.api import scenario_of
from testbed.evaluate import ClaimResult
from testbed.scenario import Claim, Point, Scenario
from testbed.worker import Failure

MAX_DECIMALS = 9
LONGEST = 40  # characters of a swept value that is a list or a mapping


@dataclass(frozen=True, kw_only=True)
class Verdict(ClaimResult):
    """A claim judged at one point of the sweep. str() is a sentence with its place in the file, what was measured and what is wanted.

    claim : what was claimed. path : the scenario's file as messages show it. set : what the sweep sets at the point, by path
    """

    claim: Claim
    path: str
    set: Mapping[str, Any]

    @property
    def want(self) -> str:
        """The bound: "<= 0.8"; of a paired difference, which limit has to keep it."""
        return self._want(f"{self.claim.value:.12g}")

    def __str__(self) -> str:
        place = self.path if self.line is None else f"{self.path}:{self.line}"
        figure = self.text.rsplit(" ", 2)[0] + (f" at {label(self.set)}" if self.set else "")
        low, high = self.interval
        _, bound, value, *limits = _alike(self._compared, self.claim.value, self.value, low, high)
        if math.isnan(self.value):
            return f"{place}: {figure}: got no value ({self.note.removeprefix('no value: ')}), want {self._want(bound)}"
        between = "" if math.isnan(low) else f" (95 % interval {('-' if low >= 0 else ' to ').join(limits)})"
        note = f"; {self.note}" if self.note else ""
        return f"{place}: {figure}: got {value}, want {self._want(bound)}{between}{note}"

    @property
    def _is_paired(self) -> bool:
        return self.claim.is_difference

    @property
    def _compared(self) -> float:
        """What has to keep the bound: the figure, or the limit of a difference."""
        if not self._is_paired:
            return self.value
        return self.interval[0] if self.claim.bound == "min" else self.interval[1]

    def _want(self, bound: str) -> str:
        limit = ("lower" if self.claim.bound == "min" else "upper") + " limit " if self._is_paired else ""
        return f"{limit}{'>=' if self.claim.bound == 'min' else '<='} {bound}"


class TrialsCrashed(RuntimeError):
    """Trials that crashed, so that no claim can be judged. The message counts them and has the first one's traceback."""

    def __init__(self, message: str, failures: Sequence[Failure] = ()) -> None:
        super().__init__(message)
        self.failures = tuple(failures)


def check_scenario(
    scenario: Scenario | Mapping[str, Any] | str | Path,
    *,
    trials: int | None = None,
    seed: int | None = None,
    jobs: int | Literal["auto"] = 1,
) -> list[Verdict]:
    """Run a scenario and judge what it expects: one verdict for each claim at each point of its sweep. Nothing is written.

    scenario : a file, the name of one that ships, a mapping as the YAML would give it, or a Scenario
    trials, seed : in place of the scenario's own. jobs : processes, "auto" for one a core

    For test runners of one's own (pytest collects scenario files by itself, see `testbed.pytest_plugin`):

        class DockGate(unittest.TestCase):
            def test_expectations(self):
                for verdict in testbed.check_scenario("scenarios/demo/dock-gate.yaml"):
                    with self.subTest(verdict.text):
                        self.assertTrue(verdict.ok, verdict)

    fails with "dock-gate.yaml:31: ukf.position_error_m.p95: got 0.93, want <= 0.80 (95 % interval 0.88-0.97)". Each verdict is a
    `testbed.evaluate.ClaimResult`: ok, value, interval, line, point, text.

    Raises ScenarioError for mistakes in the scenario, TrialsCrashed where a trial fails: claims on the others alone prove nothing.
    """
    return judged(scenario_of(scenario, trials=trials, seed=seed), jobs)


def judged(scenario: Scenario, jobs: int | Literal["auto"] = 1) -> list[Verdict]:
    """The verdicts of a scenario's claims, in the order of `claimed`. Raises as `check_scenario`."""
    result = batch.run(scenario, jobs=jobs, keep="none")
    if result.failures:
        raise TrialsCrashed(crashed(scenario, result.failures), result.failures)
    return [
        Verdict(**vars(found), claim=claim, path=scenario.source.path, set=point.set)
        for (claim, point), found in zip(claimed(scenario), result.claims, strict=True)
    ]


def claimed(scenario: Scenario) -> list[tuple[Claim, Point]]:
    """Each claim at each point, as a run judges them: claim by claim."""
    return [(claim, point) for claim in scenario.expect for point in scenario.points() if claim.concerns(point.index)]


def crashed(scenario: Scenario, failures: Sequence[Failure]) -> str:
    """How many trials crashed, and what the first of them says."""
    points = scenario.points()
    count, total = len({(f.point, f.trial) for f in failures}), scenario.trials * len(points)
    first = min(failures, key=lambda f: (f.point, f.trial))
    where = label(points[first.point].set)
    which = f"trial {first.trial}{' at ' + where if where else ''}, {first.estimator + ' in ' if first.estimator else ''}{first.stage}"
    some = f"{count} of {total} trials crashed"
    return f"{scenario.source.path}: {some}; the first, {which}: {first.error}\n{first.traceback}".rstrip()


def label(swept: Mapping[str, Any]) -> str:
    """What a point of a sweep sets, in a line: "sensors.portal.antennas.count=2, seed=3"."""
    return ", ".join(f"{path}={_brief(value)}" for path, value in swept.items())


def _brief(value: Any) -> str:
    text = value if isinstance(value, str) and value.isprintable() else json.dumps(value, separators=(",", ":"), default=str)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


def _alike(compared: float, bound: float, *others: float) -> list[str]:
    """Numbers with as many decimals each: two or more, all that the bound has, enough to tell it from what is compared with it."""
    numbers = [compared, bound, *others]
    exponent = Decimal(repr(bound)).normalize().as_tuple().exponent
    least = max(2, -exponent if isinstance(exponent, int) else 0)
    differ = [d for d in range(least, MAX_DECIMALS + 1) if compared == bound or round(compared, d) != round(bound, d)]
    if not differ or max(abs(n) for n in numbers if not math.isnan(n)) >= 1e9:
        return [f"{n:.12g}" for n in numbers]
    return [f"{n:.{differ[0]}f}" for n in numbers]
