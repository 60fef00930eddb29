"""Decisions at gates as EPCIS 2.0 events in JSON-LD (GS1, "EPC Information Services", release 2.0, 2022, ch. 7 and 9).

An "in" becomes an ObjectEvent with the business step receiving, an "out" one with shipping, read at the gate. "pass", "uturn" and hints are
none: no thing has changed its place. Tags and gates have no EPC of their own here, so they are named by URIs under a base that the
caller chooses, which EPCIS allows. How likely a decision was held to be is a field of our own, in a name space of our own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any
from urllib.parse import quote

import numpy as np

from testbed.gates import Gates
from testbed.types import Track

CONTEXT = "https://ref.gs1.org/standards/epcis/2.0.0/epcis-context.jsonld"
EXAMPLE = "https://example.org/warehouse"  # a domain that is reserved for examples: nobody's
STEPS = {"in": ("receiving", "in_progress"), "out": ("shipping", "in_transit")}  # CBV 2.0, 7.1 and 7.2: business step, disposition
UNKNOWN_START = datetime(2000, 1, 1, tzinfo=UTC)  # a simulated trial begins at no date: this one


def events(track: Track, gates: Gates, *, started: datetime = UNKNOWN_START, base: str = EXAMPLE) -> list[dict[str, Any]]:
    """The ObjectEvents of a track's decisions, in order of time.

    started : when the recording began, with its time zone; base: URI under which tags ("/tag/<name>") and gates ("/gate/<name>") are named.
    The gate of a decision is the one that the row's estimate is nearest to at the first report after it. ValueError for a time without
    zone, a base that is no URI, decisions without gates or without a place.
    """
    if started.tzinfo is None:
        raise ValueError(f"the start {started.isoformat()} has no time zone: give one, as in 2026-05-04T08:00:00+02:00")
    if "://" not in base or base != quote(base, safe=":/%#?&=~@+.-_"):
        raise ValueError(f"{base!r} is no URI to name tags and gates under: take one such as {EXAMPLE}")
    said = track.decisions.take(np.isin(track.decisions.what, list(STEPS)))
    said = said.take(np.argsort(said.t, kind="stable"))
    if len(said) and not len(gates.name):
        raise ValueError("there are decisions and no gates: give the gates of the site that the track was made with")
    found = []
    for row, t, what, probability in zip(said.row.tolist(), said.t.tolist(), said.what.tolist(), said.probability.tolist(), strict=True):
        gate = f"{base}/gate/{quote(gates.name[_gate(track, gates, row, t)], safe='')}"
        found.append(
            _event(started + timedelta(seconds=t), what, f"{base}/tag/{quote(str(track.target[row]), safe='')}", gate, probability)
        )
    return found


def document(events: Iterable[Mapping[str, Any]], *, created: datetime = UNKNOWN_START, base: str = EXAMPLE) -> dict[str, Any]:
    """An EPCISDocument that holds the events. `created` is stamped on it, with its time zone."""
    if created.tzinfo is None:
        raise ValueError(f"the date of creation {created.isoformat()} has no time zone")
    return {
        "@context": [CONTEXT, {"testbed": f"{base}/terms/"}],
        "type": "EPCISDocument",
        "schemaVersion": "2.0",
        "creationDate": _stamp(created),
        "epcisBody": {"eventList": [dict(event) for event in events]},
    }


def _event(when: datetime, what: str, tag: str, gate: str, probability: float) -> dict[str, Any]:
    step, disposition = STEPS[what]
    return {
        "type": "ObjectEvent",
        "eventTime": _stamp(when),
        "eventTimeZoneOffset": _offset(when),
        "epcList": [tag],
        "action": "OBSERVE",
        "bizStep": step,
        "disposition": disposition,
        "readPoint": {"id": gate},
        "testbed:probability": round(probability, 6),
    }


def _gate(track: Track, gates: Gates, row: int, t: float) -> int:
    if not {"x", "y"} <= set(track.components) or not len(track.t):
        raise ValueError(f"the decision on {track.target[row]} at {t:g} s has no place: its estimator gives no x and y")
    axes = [track.components.index(name) for name in ("x", "y")]
    place = track.mean[min(int(np.searchsorted(track.t, t)), len(track.t) - 1), row, axes]
    if not np.isfinite(place).all():
        raise ValueError(f"the decision on {track.target[row]} at {t:g} s has no place: its estimate is not finite")
    return int(np.argmin(np.hypot(*(gates.origin - place).T)))


def _stamp(when: datetime) -> str:
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _offset(when: datetime) -> str:
    """ "+02:00", as EPCIS wants it beside the time."""
    return when.isoformat()[-6:]
