"""The sentences of a report: the summary, what to keep in mind. All made from what the run found; nothing is said that it does not show."""

from __future__ import annotations

import inspect
import math
import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from testbed.plugins import BrokenPlugin, UnknownPlugin, load
from testbed.report.amounts import capital, counted, interval, listed, number
from testbed.report.figures_run import spelled
from testbed.report.study import MAIN, Study
from testbed.scenario import Scenario

_SENTENCES = re.compile(r"(?<=[.!?])\s+(?=[A-Z(])")
RADIO = "testbed.radio"


def summary(study: Study) -> str:
    """The run in one paragraph for people who did not make it."""
    document, trials = study.manifest["scenario"]["document"], int(study.manifest["trials"])
    sentences = [_setting(study, document, trials)]
    if study.main is None or not study.summaries:
        sentences.append("No estimator gave a result.")
    elif len(study.sets) > 1:
        sentences.append(_best_of_sweep(study, study.main))
    else:
        sentences.append(_ranking(study, study.main))
    return " ".join(s for s in sentences if s)


def _setting(study: Study, document: dict[str, Any], trials: int) -> str:
    length = f" of {document['duration_s']:g} s" if isinstance(document.get("duration_s"), int | float) else ""
    names = list(study.estimators)
    by = f"{counted(len(names), 'estimator')} ({listed(names)})" if names else "no estimator"
    where = f" at each of {len(study.sets)} points of a sweep" if len(study.sets) > 1 else ""
    made = "played back" if dict(document.get("world") or {}).get("kind") in ("recorded", "driven_streets") else "simulated"
    begun = ("was" if trials == 1 else "were") + (f" {made}" if study.summaries else f" to be {made}")
    text = f"{counted(trials, 'trial')}{length}{where} {begun} from seed {study.manifest['seed']} and tracked by {by}."
    return capital(text)


def _ranking(study: Study, main: str) -> str:
    here = [s for s in study.of(0) if math.isfinite(s.statistics[main].mean)]
    if not here:
        return f"No estimator has a value of {spelled(main)}."
    if main != MAIN:
        said = [f"{s.estimator} {number(s.statistics[main].mean, s.statistics[main].se)}" for s in here]
        return f"{capital(spelled(main))}: {listed(said)}."
    order = sorted(here, key=lambda s: s.statistics[main].mean)
    first = order[0].statistics[main]
    spread = f" (95 % interval {interval(first)} m)" if first.n > 1 else ""
    text = f"{order[0].estimator} came nearest to the truth: {number(first.mean, first.se)} m off on average{spread}"
    rest = [f"{s.estimator} {number(s.statistics[main].mean, s.statistics[main].se)} m" for s in order[1:]]
    text += f", then {listed(rest)}." if rest else "."
    return text if first.n > 1 else text + " One trial gives no interval."


def _best_of_sweep(study: Study, main: str) -> str:
    there = [s for s in study.summaries if math.isfinite(s.statistics[main].mean)]
    if not there:
        return f"No estimator has a value of {spelled(main)}."
    low, high = (pick(there, key=lambda s: s.statistics[main].mean) for pick in (min, max))
    said = [f"{number(s.statistics[main].mean, s.statistics[main].se)} ({s.estimator} at {study.label(s.point)})" for s in (low, high)]
    return f"{capital(spelled(main))}: between {said[0]} and {said[1]}."


def verdict(study: Study) -> tuple[str, bool] | None:
    """How the expectations and the trials fared, and whether all is well; None where there is nothing to say."""
    parts = []
    if study.claims:
        held = sum(c.ok for c in study.claims)
        parts.append(
            f"All {held} expectations hold"
            if held == len(study.claims)
            else f"{len(study.claims) - held} of {len(study.claims)} expectations failed"
        )
    failed = {(f.point, f.trial) for f in study.failures}
    if failed:
        parts.append(f"{counted(len(failed), 'trial')} failed")
    elif parts:
        parts.append("no trial failed")
    ok = not failed and all(c.ok for c in study.claims)
    return (f"{'✓' if ok else '✗'} {'; '.join(parts)}.", ok) if parts else None


def commands(study: Study) -> list[str]:
    """How to run it again: the words of the command, without the folder that it was called from."""
    words = [str(w) for w in study.manifest.get("command", [])]
    folder = study.folder.name or "RUN"
    first = "# it was started from Python with testbed.run; the scenario below is all that it needs"
    if len(words) > 1:  # a program and what it was told
        program = "python -m testbed" if words[0].endswith("__main__.py") else Path(words[0]).name
        first = f"{program} {shlex.join(words[1:])}".strip()
    point, trial = (study.recordings[0].point, study.recordings[0].trial) if study.recordings else (0, 0)
    which = f" --point {point}" if len(study.sets) > 1 else ""
    return [first, f"testbed rerun {shlex.quote(folder)} --trial {trial}{which}"]


# ---------------------------------------------------------------- what to keep in mind


def method(study: Study) -> list[str]:
    """How the figures come about, as far as this run has them."""
    protocol = str(getattr(study.scenario.world.config, "protocol", "") if study.scenario else "")
    said = [f"The data are logs of real readers. Protocol: {protocol}"] if protocol else []
    said += [
        "A trial is the unit: figures are first averaged over the targets and times of a trial, then over trials. "
        "Intervals are 95 % confidence intervals of the mean by Student's t; each holds for itself, not all of them together.",
    ]
    if study.manifest.get("until"):
        said.append(
            f"Trials were added until {study.manifest['until']} was known. One stops when the spread happens to look small, so intervals "
            "of that figure cover somewhat less often than 95 % (testbed/until.py says by how much)."
        )
    if len(study.estimators) > 1:
        said.append(
            "All estimators got the same data, trial by trial: differences are taken within trials, and are known better than the means."
        )
    if any("nees.mean" in s.limits for s in study.summaries):
        said.append(
            "NEES is the squared error by the filter's own covariance; its limits hold for the mean over as many independent trials at "
            "one time, so outside them is significant, inside proves little. NIS is the same for innovations, per degree of freedom."
        )
    if study.wall:
        said.append("Wall times are of this machine at that time, predictions included, and are no part of the results' identity.")
    return said


def omissions(scenario: Scenario | None) -> list[tuple[str, str]]:
    """What the parts used say, in their own documentation, that they leave out or where they break: (who, what)."""
    if scenario is None:
        return []
    groups: list[tuple[str, str, Iterable[Any]]] = [
        ("worlds", "world", [scenario.world]),
        ("actors", "actor", scenario.actors),
        ("sensors", "sensor", scenario.sensors),
        ("estimators", "estimator", scenario.estimators),
    ]
    found: dict[str, str] = {}
    for group, singular, sections in groups:
        for kind in dict.fromkeys(section.kind for section in sections):
            for name, text in _said_by(group, kind):
                found.setdefault(name or f"{kind} ({singular})", text)
    return list(found.items())


def _said_by(group: str, kind: str) -> list[tuple[str, str]]:
    """What a plug-in and the radio modules behind it say; the plug-in itself under the name ""."""
    try:
        plugin = load(group, kind)
    except (UnknownPlugin, BrokenPlugin):
        return []
    module = inspect.getmodule(plugin)
    own = " ".join(filter(None, (left_out(text) for text in (inspect.getdoc(plugin), module.__doc__ if module else None))))
    found = [("", own)] if own else []
    for part in _radio_behind(module) if module else ():
        text = left_out(part.__doc__)
        if text:
            found.append((f"{part.__name__.rpartition('.')[2].replace('_', ' ')} (radio)", text))
    return found


def _radio_behind(module: ModuleType) -> list[ModuleType]:
    """The radio's modules that a module uses, and those that these use."""
    found: dict[str, ModuleType] = {}
    waiting = [module]
    while waiting:
        for value in list(vars(waiting.pop()).values()):
            used = value if isinstance(value, ModuleType) else inspect.getmodule(value) if callable(value) else None
            if used is not None and used.__name__.startswith(RADIO + ".") and used.__name__ not in found:
                found[used.__name__] = used
                waiting.append(used)
    return [found[name] for name in sorted(found)]


def left_out(documentation: str | None) -> str:
    """The sentences of a docstring that say what is left out, or when it breaks; "" where none does."""
    found = []
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(documentation or "")):
        for sentence in _SENTENCES.split(" ".join(paragraph.split())):
            if sentence.startswith("Left out:"):
                found.append(sentence.removeprefix("Left out:").strip())
            elif sentence.startswith("Breaks") or re.search(r"\b(is|are) left out\b", sentence):
                found.append(sentence)
    return " ".join(text if text.endswith((".", "!", "?")) else text + "." for text in found)
