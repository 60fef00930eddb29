"""Numbers as people read them: no more digits than their uncertainty allows, and a dash where there is none."""

from __future__ import annotations

import math

from testbed.evaluate import Interval

NOTHING = "–"
MINUS = "−"


def number(value: float, se: float = math.nan) -> str:
    """A number with two digits of its standard error, or three digits where that is not known: "0.862", "12,500", "3.1 × 10⁷"."""
    if not math.isfinite(value):
        return NOTHING
    spread = se if math.isfinite(se) and se > 0 else abs(value) / 10 if value else 10.0
    if max(abs(value), spread) >= 1e6 or 0 < max(abs(value), spread) < 1e-4:
        return _scientific(value)
    text = f"{value:,.{_decimals(spread)}f}"
    return text.replace("-", MINUS) if float(text.replace(",", "")) else text.replace("-", "")


def interval(found: Interval) -> str:
    """ "0.80 to 0.92": where the mean lies with 95 % confidence; a dash below two trials."""
    if not (math.isfinite(found.low) and math.isfinite(found.high)):
        return NOTHING
    return f"{number(found.low, found.se)} to {number(found.high, found.se)}"


def limits(low: float, high: float) -> str:
    """ "3.1 to 9.8": what limits are asked for, at their own precision."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return NOTHING
    return f"{number(low, abs(high - low) / 10)} to {number(high, abs(high - low) / 10)}"


def seconds(value: float) -> str:
    """A duration in the unit that suits it: "84 µs", "3.1 ms", "1.2 s"."""
    if not math.isfinite(value):
        return NOTHING
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if abs(value) >= scale or unit == "µs":
            return f"{value / scale:.2g} {unit}" if abs(value) < 99.5 * scale else f"{value / scale:,.0f} {unit}"
    raise AssertionError("the last unit takes what is left")


def counted(n: int, one: str, many: str = "") -> str:
    """ "1 trial", "12 trials", "no trials"."""
    return f"{n:,} {one if n == 1 else many or one + 's'}" if n else f"no {many or one + 's'}"


def capital(text: str) -> str:
    """The text with its first letter large, the others as they are."""
    return text[:1].upper() + text[1:]


def listed(words: list[str], most: int = 8) -> str:
    """ "a, b and c"; what is beyond `most` is counted."""
    if len(words) > most:
        return f"{', '.join(words[:most])} and {len(words) - most} more"
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _decimals(spread: float) -> int:
    return min(6, max(0, 1 - math.floor(math.log10(spread))))


def _scientific(value: float) -> str:
    mantissa, exponent = f"{value:.1e}".split("e")
    raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa.replace('-', MINUS)} × 10{raised}"
