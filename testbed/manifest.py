"""What a run is, written before it starts: enough to make any of its trials again, and to tell whether another run is the same."""

from __future__ import annotations

import hashlib
import importlib.util
import platform
import sys
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from testbed.plugins import GROUPS, origin
from testbed.scenario import Scenario, from_dict
from testbed.scenario.scenario import OUTSIDE_HASH
from testbed.worker import config_hash

FORMAT = 1
DISTRIBUTION = "warehouse-radio-testbed"
LIBRARIES = ("numpy", "scipy", "filterpy", "numba", "pybullet", "pyarrow")  # those that figures depend on


def describe(scenario: Scenario, keep: str, command: Sequence[str] = ()) -> dict[str, Any]:
    """The manifest of a run of `scenario`, for manifest.json."""
    return {
        "format": FORMAT,
        "scenario": {
            "name": scenario.name,
            "path": str(scenario.path) if scenario.path else None,
            "hash": scenario.hash,
            "text": scenario.text,
            "document": scenario.document,
        },
        "seed": scenario.seed,
        "trials": scenario.trials,
        "block": scenario.block,
        "points": [{"index": p.index, "set": p.set, "hash": p.scenario.hash} for p in scenario.points()],
        "estimators": [{"id": s.id, "kind": s.kind, "config": config_hash(s)} for s in scenario.estimators],
        "keep": keep,
        "command": list(command),
        "versions": versions(scenario),
        "platform": {"system": platform.platform(), "machine": platform.machine()},
    }


def rebuilt(manifest: dict[str, Any]) -> Scenario:
    """The scenario that a manifest describes."""
    path = manifest["scenario"].get("path")
    return from_dict(manifest["scenario"]["document"], folder=Path(path).parent if path else None)


def versions(scenario: Scenario) -> dict[str, str]:
    """Of Python, of the libraries that figures depend on, of the testbed, and a digest of its code and of the plug-ins used."""
    found = {"python": platform.python_version(), "testbed": _version(DISTRIBUTION)}
    found |= {name: _version(name) for name in LIBRARIES}
    return {**found, "code": _digest(_packages(scenario))}


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def _packages(scenario: Scenario) -> frozenset[str]:
    """The packages whose code a scenario's figures come from: those of its plug-ins, and the testbed itself."""
    found = {"testbed"}
    for group in GROUPS:
        sections = [scenario.world] if group == "worlds" else getattr(scenario, group)
        found |= {origin(group, section.kind).partition(":")[0].partition(".")[0] for section in sections}
    return frozenset(found)


@cache  # the code that this process runs does not change under it
def _digest(packages: frozenset[str]) -> str:
    """A hash of the sources of some packages, so that a run is not continued by other code."""
    digest = hashlib.sha256()
    for path in _sources(sorted(packages)):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _sources(packages: Iterable[str]) -> Iterable[Path]:
    for package in packages:
        spec = sys.modules[package].__spec__ if package in sys.modules else importlib.util.find_spec(package)
        places = [Path(p) for p in (spec.submodule_search_locations or [])] if spec else []
        for place in places:
            yield from sorted(place.rglob("*.py"))
        if spec and spec.origin and not places:
            yield Path(spec.origin)


def differences(old: dict[str, Any], new: dict[str, Any]) -> str:
    """In one sentence what keeps `new` from continuing `old`; "" where nothing does. More trials than before are welcome."""
    if old["format"] != new["format"]:
        return f"it was written by another version of the testbed (format {old['format']}, this one writes {new['format']})"
    found = []
    if old["scenario"]["hash"] != new["scenario"]["hash"]:
        before, after = old["scenario"]["document"], new["scenario"]["document"]
        parts = [key for key in {**before, **after} if before.get(key) != after.get(key) and key not in OUTSIDE_HASH]
        found.append(f"the scenario differs{' in ' + ', '.join(parts) if parts else ' in the defaults of a plug-in'}")
    if old["seed"] != new["seed"]:
        found.append(f"the seed was {old['seed']} and is {new['seed']}")
    if old["trials"] > new["trials"]:
        found.append(f"it has {old['trials']} trials, more than the {new['trials']} asked for")
    if old["block"] != new["block"]:
        found.append(f"its blocks are of {old['block']} trials, not {new['block']}")
    for name in {**old["versions"], **new["versions"]}:
        before, after = old["versions"].get(name, "absent"), new["versions"].get(name, "absent")
        if before != after:
            found.append("the code has changed since" if name == "code" else f"{name} was {before} and is {after}")
    return "; ".join(found)
