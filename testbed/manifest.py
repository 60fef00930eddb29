"""What a run is, written before it starts: enough to make any of its trials again, and to tell whether another run is the same."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from testbed.identity import Keys, contents, keys_of
from testbed.plugins import GROUPS, origin
from testbed.scenario import Scenario, from_dict
from testbed.scenario.scenario import OUTSIDE_HASH
from testbed.worker import config_hash

FORMAT = 2
DISTRIBUTION = "warehouse-radio-testbed"
LIBRARIES = ("numpy", "scipy", "filterpy", "numba", "pybullet", "pyarrow")  # those that figures depend on


def describe(scenario: Scenario, keep: str, command: Sequence[str] = (), until: str = "") -> dict[str, Any]:
    """The manifest of a run of `scenario`, for manifest.json."""
    now = versions(scenario)
    return {
        "format": FORMAT,
        "scenario": {
            "name": scenario.name,
            "path": str(scenario.path) if scenario.path else None,
            "folder": str(scenario.source.folder.resolve()) if scenario.source.folder else None,
            "hash": scenario.hash,
            "files": contents(scenario.world),
            "text": scenario.text,
            "document": scenario.document,
        },
        "seed": scenario.seed,
        "trials": scenario.trials,
        "block": scenario.block,
        "points": [{"index": p.index, "set": p.set, "hash": p.scenario.hash} for p in scenario.points()],
        "estimators": [{"id": s.id, "kind": s.kind, "config": config_hash(s)} for s in scenario.estimators],
        "keep": keep,
        "until": until,
        "command": list(command),
        "versions": now,
        "written_by": {short(now): now},
        "platform": {"system": platform.platform(), "machine": platform.machine()},
    }


def rebuilt(manifest: dict[str, Any]) -> Scenario:
    """The scenario that a manifest describes."""
    folder = manifest["scenario"].get("folder")
    return from_dict(manifest["scenario"]["document"], folder=Path(folder) if folder else None)


def versions(scenario: Scenario) -> dict[str, str]:
    """Of Python, of the libraries that figures depend on, of the testbed, and a digest of its code and of the plug-ins used."""
    return made_with(packages(scenario))


def made_with(packages: frozenset[str]) -> dict[str, str]:
    """The versions that figures from the code of some packages depend on, in this process."""
    found = {"python": platform.python_version(), "testbed": _version(DISTRIBUTION)}
    found |= {name: _version(name) for name in LIBRARIES}
    return {**found, "code": _digest(packages)}


def short(versions: Mapping[str, str]) -> str:
    """A digest of versions, as it stands in every row; the manifest's `written_by` says which they are."""
    return hashlib.sha256(json.dumps(dict(versions), sort_keys=True).encode()).hexdigest()[:12]


def keys(scenario: Scenario) -> list[Keys]:
    """By point of the sweep: the keys of its results, under the versions of this process."""
    libraries = {"python": platform.python_version(), **{name: _version(name) for name in LIBRARIES}}
    return [keys_of(point.scenario, libraries) for point in scenario.points()]


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def packages(scenario: Scenario) -> frozenset[str]:
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


def refused(old: dict[str, Any], new: dict[str, Any]) -> str:
    """In one sentence why a folder with the manifest `old` is not gone on with as `new`; "" where nothing speaks against it.

    Another study has another seed or name. Whatever else differs is made again, and what doesn't, is not.
    """
    if old["format"] != new["format"]:
        return f"it was written by another version of the testbed (format {old['format']}, this one writes {new['format']})"
    found = []
    if old["scenario"]["name"] != new["scenario"]["name"]:
        found.append(f"it is of the scenario {old['scenario']['name']}, not of {new['scenario']['name']}")
    if old["seed"] != new["seed"]:
        found.append(f"the seed was {old['seed']} and is {new['seed']}")
    return "; ".join(found)


def differences(old: dict[str, Any], new: dict[str, Any]) -> str:
    """In one sentence in what `new` differs from `old`, so that figures may; "" where it doesn't. More trials than before are none."""
    found = []
    if old["scenario"]["hash"] != new["scenario"]["hash"]:
        before, after = old["scenario"]["document"], new["scenario"]["document"]
        parts = [key for key in {**before, **after} if before.get(key) != after.get(key) and key not in OUTSIDE_HASH]
        found.append(f"the scenario differs{' in ' + ', '.join(parts) if parts else ' in the defaults of a plug-in'}")
    if old["seed"] != new["seed"]:
        found.append(f"the seed was {old['seed']} and is {new['seed']}")
    if old["block"] != new["block"]:
        found.append(f"its blocks are of {old['block']} trials, not {new['block']}")
    for name in {**old["versions"], **new["versions"]}:
        before, after = old["versions"].get(name, "absent"), new["versions"].get(name, "absent")
        if before != after:
            found.append("the code has changed since" if name == "code" else f"{name} was {before} and is {after}")
    return "; ".join(found)
