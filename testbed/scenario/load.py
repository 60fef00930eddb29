"""Reading scenarios: from a file, by name from those that ship, from text, or from a plain mapping."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from testbed.plugins import suggest
from testbed.scenario import overrides
from testbed.scenario.build import build
from testbed.scenario.claims import WORLD, named
from testbed.scenario.nodes import MAX_BYTES, checked, read, read_on
from testbed.scenario.problems import ScenarioError, refuse
from testbed.scenario.published import publications_without, written_without
from testbed.scenario.scenario import Scenario
from testbed.scenario.source import Source

SUFFIXES = (".yaml", ".yml")
Sets = Iterable[str] | Mapping[str, Any]


def load(path_or_name: str | Path, sets: Sets = ()) -> Scenario:
    """The scenario of a file, or of a name such as "dock-gate", with values set as by `--set path=value`.

    ScenarioError with every mistake in it; also where there is no such file or scenario.
    """
    path = find(path_or_name)
    shown = _short(path)
    return from_text(_content(path, shown), shown, sets, path)


def from_text(text: str, path: str = "<text>", sets: Sets = (), file: Path | None = None) -> Scenario:
    """The scenario of a YAML text. `path` is what errors call it; its tables lie beside `file`."""
    root, faults = read_on(text, path)
    source = Source(path, root, file.parent if file else None, faults=tuple(faults))
    return _build(root.plain(), source, text, file, sets)


def from_dict(document: Mapping[str, Any], sets: Sets = (), folder: Path | None = None) -> Scenario:
    """The scenario of a plain mapping, as YAML would give it. `folder` is where its tables lie, unless it holds them itself."""
    plain = checked(dict(document), "<dict>")
    return _build(plain, Source("<dict>", None, folder), json.dumps(plain, indent=1), None, sets)


def override(scenario: Scenario, sets: Sets) -> Scenario:
    """The scenario with more values set, as `load(..., sets)` would give it."""
    return _build(scenario.document, replace(scenario.source, memo={}), scenario.text, scenario.path, sets)


def only(scenario: Scenario, estimators: Iterable[str]) -> Scenario:
    """The scenario with some of its estimators and the claims that speak of no other. Its data are the same, trial by trial."""
    wanted, known = list(estimators), [section.id for section in scenario.estimators]
    for id in wanted:
        if id not in known:
            raise refuse(scenario.source.path, f"no estimator has the id {id!r}{suggest(id, known)}", where="estimators")
    for path in scenario.sweep:
        parts = path.split(".")
        if parts[0] == "estimators" and (len(parts) == 1 or parts[1] not in wanted):
            raise scenario.problem(("sweep", path), "the sweep varies an estimator that is left out")
    kept = {claim.subject for claim in scenario.expect if set(claim.estimators) <= set(wanted)}
    published = written_without(scenario.document.get("published"), wanted)
    document = {name: value for name, value in scenario.document.items() if name != "published"}
    document |= {"published": published} if published else {}
    sections = zip(document.get("estimators", []), known, strict=True)
    document["estimators"] = [section for section, id in sections if id in wanted]
    if "expect" in document:
        document["expect"] = {s: v for s, v in document["expect"].items() if set(named(s)) <= {*wanted, WORLD}}
    return replace(
        scenario,
        estimators=tuple(section for section in scenario.estimators if section.id in wanted),
        expect=tuple(claim for claim in scenario.expect if claim.subject in kept),
        published=publications_without(scenario.published, wanted),
        document=document,
        swept=tuple(replace(point, scenario=only(point.scenario, wanted)) for point in scenario.swept),
    )


def _build(document: Any, source: Source, text: str, path: Path | None, sets: Sets) -> Scenario:
    values = overrides.assignments(sets)
    if values and isinstance(document, dict):
        document, source = overrides.apply(document, values, source)
    return build(document, source, text, path)


# ---------------------------------------------------------------- finding files


def listing() -> list[tuple[str, str, Path]]:
    """(name, title, file) of every scenario that ships, by name: "demo/dock-gate"."""
    return [(name, _title(path), path) for name, path in _shipped().items()]


def find(name_or_path: str | Path) -> Path:
    """The file of a scenario: a path that exists, or the name of one that ships, with or without its folder.

    ScenarioError for neither, with the name that was probably meant.
    """
    given = str(name_or_path)
    path = Path(name_or_path)
    try:
        is_file, is_folder = path.is_file(), bool(given) and path.is_dir()
    except (OSError, ValueError):  # a null byte, a name too long
        is_file = is_folder = False
    if is_file:
        return path
    shipped = _shipped()
    if given in shipped:
        return shipped[given]
    named = [name for name in shipped if name.rpartition("/")[2] == given]
    if len(named) == 1:
        return shipped[named[0]]
    if named:
        raise refuse(given, f"several scenarios have this name: {', '.join(named)}")
    if is_folder:
        inside = sorted(p.name for p in path.iterdir() if p.suffix in SUFFIXES)
        raise refuse(given, f"a folder, not a scenario{'; it holds ' + ', '.join(inside[:10]) if inside else ''}")
    short = {name.rpartition("/")[2]: name for name in shipped}
    near = difflib.get_close_matches(path.stem if path.suffix in SUFFIXES else given, [*shipped, *short], n=1)
    meant = f", did you mean {near[0]}?" if near else "; `testbed scenarios` lists those that ship"
    raise refuse(given[:200], f"no such file or scenario{meant}")


def _shipped() -> dict[str, Path]:
    folder = Path(str(resources.files("scenarios")))
    paths = sorted(path for suffix in SUFFIXES for path in folder.rglob(f"*{suffix}"))
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in paths}


def _title(path: Path) -> str:
    """The title, from its line alone: a list of all scenarios must not take the time to read them all."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        line = next((line for line in lines if line.startswith("title:")), "title:")
        return str(read(line, path.name).plain()["title"] or "")
    except (OSError, UnicodeDecodeError, ScenarioError):
        return ""


def _short(path: Path) -> str:
    """A path as errors show it: from here where that is shorter."""
    try:
        return str(path.relative_to(Path.cwd())) if path.is_absolute() else str(path)
    except ValueError:
        return str(path)


def _content(path: Path, shown: str) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise refuse(shown, f"can't be read: {(error.strerror or str(error)).lower()}") from None
    if len(content) > MAX_BYTES:
        raise refuse(shown, f"over {MAX_BYTES // 1_000_000} MB: too large for a scenario; move long lists of tags to a csv file")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - content.rfind(b"\n", 0, error.start)
        raise refuse(shown, f"not UTF-8 text: the byte 0x{content[error.start]:02x} can't be read", line, column) from None
