"""What the pytest plug-in collects: a file of claims that is run once, when the first of them is wanted."""

from __future__ import annotations

import hashlib
import math
import os
import pickle
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from testbed.batch import Interrupted
from testbed.expectations import TrialsCrashed, Verdict, claimed, judged, label
from testbed.pool import CannotStart
from testbed.pytest_plugin import shared_folder
from testbed.scenario import DataMissing, Scenario, ScenarioError, load
from testbed.worker import BAD_INPUT

WITHOUT_CLAIMS = "runs"  # the one item of a scenario that expects nothing


@dataclass(frozen=True)
class Outcome:
    """What became of a scenario: its verdicts, or the reason, as it is to be shown, why there are none."""

    verdicts: tuple[Verdict, ...] = ()
    trouble: str = ""
    missing: str = ""  # data that this machine doesn't have: a reason to skip


class ScenarioFile(pytest.File):
    """A scenario file. Its items share one run."""

    _outcome: Outcome | None = None
    _told_by: str = ""
    scenario: Scenario

    def collect(self) -> Iterable[pytest.Item]:
        """An item a claim and point of the sweep; a collection error with the places of all mistakes for a file that has some."""
        option = self.config.getoption
        given = {"trials": option("--testbed-trials"), "seed": option("--testbed-seed")}
        try:
            self.scenario = load(self.path, {name: value for name, value in given.items() if value is not None})
        except DataMissing as missing:
            pytest.skip(str(missing), allow_module_level=True)
        except ScenarioError as error:
            raise self.CollectError(str(error)) from None
        return list(self._items())

    def _items(self) -> Iterator[pytest.Item]:
        if not self.scenario.expect:
            yield ScenarioItem.from_parent(self, name=WITHOUT_CLAIMS)
        taken: set[str] = set()
        for index, (claim, point) in enumerate(claimed(self.scenario)):
            name = f"{claim.text}[{label(point.set)}]" if point.set else claim.text
            if name in taken:  # long values that are cut alike
                name = f"{name}#{point.index}"
            taken.add(name)
            yield ScenarioItem.from_parent(self, name=name, index=index, line=claim.line)

    def outcome(self) -> Outcome:
        """What became of the scenario: run now, unless it was, by this process or by one that it shares a folder with."""
        if self._outcome is None:
            folder = shared_folder(self.config)
            self._outcome = self._run() if folder is None else _once(folder, str(self.path), self._run)
        return self._outcome

    def _run(self) -> Outcome:
        jobs: Any = self.config.getoption("--testbed-jobs")
        try:
            return Outcome(tuple(judged(self.scenario, jobs)))
        except Interrupted:  # what a Ctrl-C became on its way
            raise KeyboardInterrupt from None
        except DataMissing as missing:
            return Outcome(missing=str(missing))
        except (*BAD_INPUT, CannotStart, TrialsCrashed) as error:
            return Outcome(trouble=str(error))
        except Exception:
            return Outcome(trouble=f"{self.scenario.source.path}: the testbed itself failed\n{traceback.format_exc()}")

    def trouble(self, item: pytest.Item) -> str:
        """Why there are no verdicts: at length to the first item that asks, in a line to the others; "" where nothing is wrong."""
        text = self.outcome().trouble
        first, *more = text.splitlines() or [""]
        self._told_by = self._told_by or item.nodeid
        return f"{first} (more is told at {self._told_by})" if more and self._told_by != item.nodeid else text


class ScenarioItem(pytest.Item):
    """One claim at one point of the sweep; without an index, that the scenario's trials run at all."""

    parent: ScenarioFile

    def __init__(self, *, index: int | None = None, line: int | None = None, **node: object) -> None:
        super().__init__(**node)  # pyright: ignore[reportArgumentType]  name and parent, as pytest gives them
        self._index, self._line = index, line
        if self.config.pluginmanager.hasplugin("xdist"):
            self.add_marker(pytest.mark.xdist_group(self.parent.path.name))  # with --dist loadgroup nobody has to wait for the run

    def setup(self) -> None:
        """Run the scenario: trials that crash are an error of the test, not a claim that fails."""
        if missing := self.parent.outcome().missing:
            pytest.skip(missing)
        if trouble := self.parent.trouble(self):
            pytest.fail(trouble, pytrace=False)

    def runtest(self) -> None:
        """Look at the verdict, and tell a bad one in its own sentence alone. The figures become properties of the test in JUnit's XML."""
        if self._index is None:
            return
        verdict = self.parent.outcome().verdicts[self._index]
        figures = {"measured": verdict.value, "interval_low": verdict.interval[0], "interval_high": verdict.interval[1]}
        self.user_properties += [(name, f"{value:.12g}") for name, value in figures.items() if not math.isnan(value)]
        self.user_properties.append(("want", verdict.want))
        if not verdict.ok:
            pytest.fail(str(verdict), pytrace=False)

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Where the claim stands in the file."""
        return self.path, None if self._line is None else self._line - 1, self.name


# ---------------------------------------------------------------- several processes


def _once(folder: Path, name: str, run: Callable[[], Outcome]) -> Outcome:
    """What `run` gives, run by whichever process comes first and read by the others, which wait for it."""
    key = hashlib.sha256(name.encode()).hexdigest()[:16]
    kept, rough = folder / f"{key}.pickle", folder / f"{key}.part"
    with _locked(folder / f"{key}.lock"):
        if kept.exists():
            return pickle.loads(kept.read_bytes())  # the folder is this user's alone
        outcome = run()
        rough.write_bytes(pickle.dumps(outcome))
        rough.replace(kept)
        return outcome


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Within: no other process holds the same lock. It ends with the process, however that ends."""
    with path.open("ab") as file:
        if os.name == "posix":  # elsewhere each process runs the scenario for itself
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield
