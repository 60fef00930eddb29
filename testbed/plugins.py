"""Finding plug-ins by name: estimators, worlds, actors, sensors, metrics.

A plug-in has one of two homes:

* a folder that an entry point in the group `testbed.folders` names (inside this distribution: one file a plug-in; the
  name is the file's, the class is named like the file and has a `Config` in its body, and only the file asked for is imported);
* outside, an entry point of its own in the group `testbed.estimators` (or `testbed.worlds`, ...): `name = "module:Class"`.

Folders are read as text to list what is there, so listing imports nothing. A scenario file can only name what is found here.
"""

from __future__ import annotations

import ast
import difflib
import importlib
import importlib.util
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

GROUPS = ("worlds", "actors", "sensors", "estimators", "metrics")


class UnknownPlugin(LookupError):
    """No plug-in of that name; the message says which name was probably meant, or which there are."""


class BrokenPlugin(RuntimeError):
    """A plug-in that is registered but can't be loaded or is not what its group wants."""


def _plain(name: str) -> str:
    return name.replace("_", "").lower()


@cache
def _folder(group: str) -> dict[str, str]:
    """Name to module of the plug-ins that lie in the group's folders, found by reading, not importing."""
    found: dict[str, str] = {}
    for entry in entry_points(group="testbed.folders"):
        if entry.name != group:
            continue
        spec = importlib.util.find_spec(entry.value)
        for place in (spec.submodule_search_locations or []) if spec else []:
            for path in sorted(Path(place).glob("*.py")):
                if _plugin_class(path) is not None:
                    found[path.stem] = f"{entry.value}.{path.stem}"
    return found


def _plugin_class(path: Path) -> str | None:
    """Name of the class in the file that is named like the file and has a Config of its own, or None: the file is a shared piece."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    classes = (n for n in tree.body if isinstance(n, ast.ClassDef) and _plain(n.name) == _plain(path.stem))
    return next((c.name for c in classes if any("Config" in _defined(statement) for statement in c.body)), None)


def _defined(statement: ast.stmt) -> list[str]:
    """Names that a statement in the body of a class defines."""
    if isinstance(statement, ast.ClassDef):
        return [statement.name]
    targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target] if isinstance(statement, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


@cache
def _outside(group: str) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=f"testbed.{group}")}


def names(group: str) -> list[str]:
    """All plug-ins of a group ("estimators", ...), sorted. Imports none of them."""
    return sorted({*_folder(group), *_outside(group)})


def origin(group: str, name: str) -> str:
    """Where a plug-in comes from, as "module:Class" or "module"."""
    return _folder(group).get(name) or _outside(group)[name].value


def suggest(word: str, known: list[str]) -> str:
    """The end of an error message: the nearest known word, or a list of what there is."""
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    return f", did you mean {near[0]}?" if near else f"; there are {', '.join(known) or 'none'}"


@cache
def load(group: str, name: str) -> type:
    """The class of a plug-in. UnknownPlugin for a name nobody registered, BrokenPlugin where its import fails."""
    if name not in names(group):
        raise UnknownPlugin(f"no {group[:-1]} named {name!r}{suggest(name, names(group))}")
    try:
        if name in _folder(group):
            module = importlib.import_module(_folder(group)[name])
            wanted = _plugin_class(Path(str(module.__file__)))
            found = getattr(module, str(wanted))
        else:
            found = _outside(group)[name].load()
    except ImportError as error:
        raise BrokenPlugin(f"{group[:-1]} {name!r} ({origin(group, name)}) can't be imported: {error}") from error
    if not isinstance(found, type) or not hasattr(found, "Config"):
        raise BrokenPlugin(f"{group[:-1]} {name!r} ({origin(group, name)}) is not a class with a Config")
    return found


def forget() -> None:
    """Look at folders and entry points afresh (after something was installed)."""
    for remembered in (_folder, _outside, load):
        remembered.cache_clear()
