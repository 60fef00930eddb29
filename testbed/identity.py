"""What a figure depends on, as a key: the same key, the same figure. By it a run that goes on knows what is done and what changed.

The key of what happened in a trial is a hash of the scenario without its estimators and metrics, the contents of the files that its
world is made of (maps, models and their meshes, logs; tables of tags and patterns are part of the scenario), the seed, the libraries,
and the sources of the simulation and of the plug-ins that it names. An estimator's key adds its section, the metrics, and the sources of
these and of the driver. Sources are the modules that a module imports, and those that these import, as far as they belong to the
testbed or to a plug-in's package: found by reading, not importing. So a change of a report's page, or of another estimator, changes no key.

Left out: other files that plug-ins read, and code that is found by other ways than an import statement or a plug-in's name.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from testbed.guided.section import guided_actor
from testbed.plugins import load, origin
from testbed.protocols import MadeOfFiles
from testbed.scenario import Scenario, Section
from testbed.scenario.scenario import OUTSIDE_HASH, canonical

LENGTH = 24  # hex digits of a key
_OWN = ("testbed", "worlds", "estimators")


@dataclass(frozen=True)
class Keys:
    """Of one point of a sweep: what its trials are, and by id what each estimator makes of them. scenario: its hash, for the rows."""

    world: str
    estimators: Mapping[str, str]
    scenario: str = ""


def keys_of(scenario: Scenario, libraries: Mapping[str, str]) -> Keys:
    """The keys of a point's scenario under the given versions of Python and of the libraries that figures depend on.

    Where a guide leads a person, each estimator makes its own trials, so all of them depend on all that the scenario says.
    """
    named = {*OUTSIDE_HASH, "name", "title"}
    fields = [name for name in scenario.__dataclass_fields__ if scenario.__dataclass_fields__[name].compare and name not in named]
    plain = {name: canonical(getattr(scenario, name)) for name in fields}
    methods = {"estimators": plain.pop("estimators"), "metrics": plain.pop("metrics")}
    makers = [("worlds", scenario.world), *(("actors", a) for a in scenario.actors), *(("sensors", s) for s in scenario.sensors)]
    scorers = [("metrics", section) for section in scenario.metrics]
    content = {"scenario": plain, "seed": scenario.seed, "libraries": dict(libraries)}
    content["files"] = contents(scenario.world)
    content["code"] = sources(("testbed.simulate", *_modules(makers)))
    if guided_actor(scenario) is not None:
        own = [("estimators", section) for section in scenario.estimators]
        together = _hash({**content, **methods, "driver": sources(("testbed.closed_loop", *_modules([*own, *scorers])))})
        return Keys(together, {section.id: together for section in scenario.estimators}, scenario.hash)
    world = _hash(content)
    found = {}
    for section in scenario.estimators:
        code = sources(("testbed.estimate", "testbed.prior", "testbed.evaluate", *_modules([("estimators", section), *scorers])))
        found[section.id] = _hash({"world": world, "section": canonical(section), "metrics": methods["metrics"], "code": code})
    return Keys(world, found, scenario.hash)


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:LENGTH]


def _modules(sections: Iterable[tuple[str, Section | Any]]) -> list[str]:
    """The modules of plug-ins, each once."""
    return sorted({origin(group, section.kind).partition(":")[0] for group, section in sections})


# ---------------------------------------------------------------- files


def contents(world: Section) -> list[list[str]]:
    """[name, sha256] of every file that a world is made of, by its method `files`; none for one without.

    Where the files lie doesn't count. None either where one can't be used: then the world itself says so when it is made.
    """
    made: Any = load("worlds", world.kind)
    if not callable(getattr(made, "files", None)):
        return []
    key = json.dumps([world.kind, str(getattr(world.config, "_folder", None)), str(Path.cwd()), canonical(world)], sort_keys=True)
    paths, found = _read_before.get(key, ([], []))
    now = _digests(paths)
    if not paths or now != found:  # another content may name other files
        try:
            hall: MadeOfFiles = made(world.config)
            paths = list(hall.files())
        except ValueError:
            return []
        now = _digests(paths)
        _read_before[key] = paths, now
    return now


_read_before: dict[str, tuple[list[Path], list[list[str]]]] = {}  # the points of a sweep share their hall: it is looked through once


def _digests(paths: Sequence[Path]) -> list[list[str]]:
    return [[path.name, _digest(path)] for path in paths]


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return "absent"


# ---------------------------------------------------------------- sources


@cache  # the code that this process runs does not change under it
def sources(roots: tuple[str, ...]) -> str:
    """A hash of the sources of some modules and of all that they import, as far as it belongs to the packages at hand."""
    packages = {*_OWN, *(root.partition(".")[0] for root in roots)}
    waiting, found = list(roots), {}
    while waiting:
        name = waiting.pop()
        if name in found or name.partition(".")[0] not in packages:
            continue
        path = _path(name)
        if path is None:  # a name in a module, or a module that is not there
            continue
        found[name], imported = _read(path, name)
        waiting += [*imported, name.rpartition(".")[0] or name]
    return hashlib.sha256(json.dumps(sorted(found.items())).encode()).hexdigest()[:LENGTH]


@cache
def _path(name: str) -> Path | None:
    """The source of a module; None where the name is no module written in Python."""
    parent, _, last = name.rpartition(".")
    if not parent:
        spec = importlib.util.find_spec(name)
        return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None
    above = _path(parent)
    if above is None or above.name != "__init__.py":
        return None
    for path in (above.parent / last / "__init__.py", above.parent / f"{last}.py"):
        if path.is_file():
            return path
    return None


@cache
def _read(path: Path, name: str) -> tuple[str, tuple[str, ...]]:
    """The hash of a source, and the names that it imports: modules, and what may be modules in them.

    Imports for the type checker alone don't count; nor, in a package's own file, those within functions, which are for its callers.
    """
    content = path.read_bytes()
    is_package = path.name == "__init__.py"
    package = name if is_package else name.rpartition(".")[0]
    found: list[str] = []
    for node in _statements(ast.parse(content).body, into_functions=not is_package):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            found += [base, *(f"{base}.{alias.name}" for alias in node.names)]
    return hashlib.sha256(content).hexdigest(), tuple(found)


def _statements(body: Sequence[ast.stmt], into_functions: bool) -> Iterator[ast.stmt]:
    """All statements in a body and beneath them, those for the type checker left out."""
    for statement in body:
        if isinstance(statement, ast.If) and ast.unparse(statement.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            yield from _statements(statement.orelse, into_functions)
            continue
        yield statement
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef) and not into_functions:
            continue
        for field in ("body", "orelse", "finalbody"):
            yield from _statements(getattr(statement, field, []), into_functions)
        for branch in (*getattr(statement, "handlers", ()), *getattr(statement, "cases", ())):
            yield from _statements(branch.body, into_functions)
