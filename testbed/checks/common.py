"""What all checks share: the error they raise, configurations, and a watch over the global random state."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from testbed.columns import Array


class ConformanceError(AssertionError):
    """A plug-in breaks its contract; the message says who, which rule, and what was seen."""


def require(holds: object, who: str, rule: str) -> None:
    """ConformanceError, "who: rule", unless it holds."""
    if not holds:
        raise ConformanceError(f"{who}: {rule}")


def configured(cls: type, config: Any) -> Any:
    """`config`, or the class's default one. ConformanceError where there is no Config, or it has no defaults for all fields."""
    model = getattr(cls, "Config", None)
    require(isinstance(model, type) and issubclass(model, BaseModel), cls.__name__, "has no pydantic model `Config`")
    assert model is not None
    require(
        model.model_config.get("extra") == "forbid", cls.__name__, "Config lets unknown keys pass: derive it from testbed.quantity.Config"
    )
    if config is not None:
        require(isinstance(config, model), cls.__name__, f"the config to check with is a {type(config).__name__}, not a {model.__name__}")
        return config
    try:
        return model()
    except ValidationError as error:
        missing = ", ".join(".".join(map(str, e["loc"])) for e in error.errors())
        raise ConformanceError(f"{cls.__name__}: Config has no default for {missing}: give the check a config") from None


@contextmanager
def untouched_globals(who: str) -> Iterator[None]:
    """ConformanceError if what happens inside draws from, or seeds, the global generators of `numpy.random` or `random`."""
    numpys, pythons = np.random.get_state(legacy=True), random.getstate()  # noqa: NPY002  to see that nobody else uses it
    broken: ConformanceError | None = None
    try:
        yield
    except ConformanceError as error:
        broken = error  # often its consequence: the cause is told first
    now = np.random.get_state(legacy=True)  # noqa: NPY002
    touched = random.getstate() != pythons or not all(np.array_equal(a, b) for a, b in zip(now, numpys, strict=True))
    np.random.set_state(numpys)  # noqa: NPY002  left as it was found
    random.setstate(pythons)
    if touched:
        raise ConformanceError(f"{who}: uses the global random state: draw from the generator that is handed in") from broken
    if broken is not None:
        raise broken


def same(a: Array, b: Array) -> bool:
    """Equal bit for bit, NaN like NaN."""
    a, b = np.asarray(a), np.asarray(b)
    return a.shape == b.shape and bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))


def alike(a: Array, b: Array, tolerance: float = 1e-9) -> bool:
    """Equal to `tolerance`, relative above 1, NaN like NaN."""
    return np.shape(a) == np.shape(b) and bool(np.allclose(a, b, rtol=tolerance, atol=tolerance, equal_nan=True))
