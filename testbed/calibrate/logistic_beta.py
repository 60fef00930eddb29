"""A campaign of measurements, and the model of detections that follows from it: `testbed calibrate SCENARIO --model logistic_beta`.

As in L. Geng, M. F. Bugallo, P. M. Djurić, "Tracking with RFID asynchronous measurements by particle filtering", section 5 and Fig. 4: a
tag is asked at a grid of distances and angles, and the parameters of mean and variance are fitted. Beside the paper: half of the
trials is held out, and the model must say more of them than one of distance alone (its reference [8]).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table as Printed

from testbed.api import scenario_of
from testbed.calibrate import CalibrationError, Request
from testbed.calibrate.beta_fit import LARGEST, Fit, fit
from testbed.calibrate.counts import Blocks, measure
from testbed.evaluate import Interval, mean_interval

if TYPE_CHECKING:
    from testbed.report.figures import Drawing

DEAD_STRENGTH = 18.0  # α + β of the dead zone's Beta distribution, as published; only its mean is fitted


@dataclass(frozen=True, eq=False)
class Campaign:
    """What was measured and fitted. fitted: to all blocks; half: to the trials of even number, without_angle: of distance alone, to them.

    gain: by how much a block that was held out is more likely (log, natural) than by distance alone; an interval over runs.
    """

    scenario: str
    blocks: Blocks
    fitted: Fit
    half: Fit
    without_angle: Fit
    held_out: tuple[float, float]
    gain: Interval

    def document(self) -> dict[str, Any]:
        """As JSON; `estimator` are the fields of a detection estimator's section."""
        with_angle, without = self.held_out
        return {
            "model": "logistic_beta",
            "scenario": self.scenario,
            "blocks": len(self.blocks),
            "runs": len(np.unique(self.blocks.run)),
            "logit": list(self.fitted.logit),
            "variance": list(self.fitted.variance),
            "dead": self.fitted.dead,
            "held_out": {
                "log_likelihood_a_block": with_angle,
                "log_likelihood_a_block_distance_only": without,
                "gain_a_block": self.gain.mean,
                "gain_95": [self.gain.low, self.gain.high],
                "runs": self.gain.n,
            },
            "estimator": self.section(),
        }

    def section(self) -> dict[str, Any]:
        """Fields for `{kind: detection_asynchronous, ...}`."""
        dead = round(self.fitted.dead, 4)
        return {
            "logit": [round(a, 5) for a in self.fitted.logit],
            "variance": [float(f"{c:.5g}") for c in self.fitted.variance],
            "farthest_m": round(self.fitted.farthest_m, 3),
            "largest_share": LARGEST,
            "dead_alpha": round(dead * DEAD_STRENGTH, 4),
            "dead_beta": round((1 - dead) * DEAD_STRENGTH, 4),
        }

    def show(self, console: Console) -> None:
        """Parameters beside the published ones, and what was held out."""
        table = Printed(title=f"{self.scenario}, {len(self.blocks):,} blocks", title_justify="left")
        for head in ("", "fitted", "published"):
            table.add_column(head, justify="left" if not head else "right")
        for name, value, paper in zip(("a1", "a2 (1/m)", "a3 (1/°)"), self.fitted.logit, ("-4.9433", "0.8370", "0.0552"), strict=True):
            table.add_row(name, f"{value:.4f}", paper)
        for i, value in enumerate(self.fitted.variance, start=1):
            table.add_row(f"c{i}", f"{value:.4g}", "not printed")
        table.add_row("dead", f"{self.fitted.dead:.3f}", "0.05")
        console.print(table)
        with_angle, without = self.held_out
        console.print(
            f"held out, log-likelihood a block: {with_angle:.3f} with the angle, {without:.3f} by distance alone; "
            f"gain {self.gain.mean:.3f} (95 % {self.gain.low:.3f} to {self.gain.high:.3f} over {self.gain.n} runs)",
            soft_wrap=True,
        )
        console.print("for a detection estimator: " + ", ".join(f"{k}: {v}" for k, v in self.section().items()), soft_wrap=True)

    def measured(self) -> tuple[Blocks, dict[str, str]]:
        return self.blocks, {"distance": "m", "degrees": "deg off boresight"}

    def drawings(self) -> Sequence[Drawing]:
        """Mean and variance over distance, a colour an angle (Fig. 4)."""
        from testbed.report.figures_calibration import mean_and_variance

        return [mean_and_variance(self)]


def calibrate(request: Request) -> Campaign:
    """Simulate the campaign and fit it. ScenarioError or CalibrationError for what can't be used."""
    scenario = scenario_of(request.source, trials=request.trials, seed=request.seed, sets=request.sets)
    if scenario.trials < 2:
        raise CalibrationError("one trial leaves nothing to hold out: at least two are wanted")
    return campaign(scenario.name, measure(scenario, request.block_s, request.progress))


def campaign(name: str, blocks: Blocks) -> Campaign:
    """Fits to all blocks, and to half of the trials to be judged by the others."""
    known, held = blocks.take(blocks.trial % 2 == 0), blocks.take(blocks.trial % 2 == 1)
    half, without = fit(known), fit(known, directional=False)
    a, b = half.log_mass(held), without.log_mass(held)
    runs, of = np.unique(held.run, return_inverse=True)
    each = np.bincount(of, minlength=len(runs))
    gain = mean_interval(np.bincount(of, weights=a - b, minlength=len(runs)) / each)
    return Campaign(name, blocks, fit(blocks), half, without, (float(a.mean()), float(b.mean())), gain)
