"""YAML of strangers: plain values alone, no types, no anchors that blow up, no nesting without end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

from worlds.importers.files import WorldFileError, read_text, said

MAX_YAML = 5_000_000  # bytes
MAX_LEVELS = 40


def plain_yaml(place: Path) -> Any:
    """What a YAML file holds. WorldFileError, with the line where there is one, for what is no YAML or more than plain values."""
    text = read_text(place, MAX_YAML)
    try:
        depth = 0
        for event in YAML(typ="safe", pure=True).parse(text):
            if isinstance(event, AliasEvent):
                raise WorldFileError(f"{place.name}: it repeats a part by *{event.anchor}: write it out")
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > MAX_LEVELS:
                raise WorldFileError(f"{place.name}: values lie in more than {MAX_LEVELS} others")
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        raise WorldFileError(f"{place.name}{line}: is no YAML: {problem[:100]}") from None
    except (ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError) as error:
        if isinstance(error, WorldFileError):
            raise
        raise WorldFileError(
            f"{place.name}: is no plain YAML: {said(str(error))}"
        ) from None  # the library's constructors raise what they like


def mapping(value: Any, where: str) -> dict[str, Any]:
    """The value, which must be a mapping with text for keys."""
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise WorldFileError(f"{where}: a mapping is wanted, not {said(value)}")
    return value
