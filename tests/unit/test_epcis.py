"""Decisions at gates as EPCIS 2.0: the structure that the standard's JSON schema asks for, and that events say what was decided."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from gate_recordings import recording, tracked, walk

from estimators.gate_detector import GateDetector
from testbed.export import epcis
from testbed.gates import gates_of
from testbed.types import Antennas, Decisions, Track

START = datetime(2026, 5, 4, 8, 0, tzinfo=timezone(timedelta(hours=2)))
URI = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:[^\s<>\"{}|\\^`]+")
TIME = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}(\.\d+)?(Z|[+-]\d{2}:\d{2})")
OFFSET = re.compile(r"[+-](0\d|1[0-4]):[0-5]\d")

# What the JSON schema of EPCIS 2.0 (ref.gs1.org/standards/epcis/epcis-json-schema.json) asks of a document and of an ObjectEvent that
# observes instances, in a form of our own: required fields, fields that may be there, and a rule for the content of each.
ACTIONS = {"ADD", "OBSERVE", "DELETE"}
BIZ_STEPS = {
    "accepting",
    "arriving",
    "departing",
    "inspecting",
    "loading",
    "receiving",
    "shipping",
    "storing",
    "unloading",
}  # of the CBV's 41
DISPOSITIONS = {"active", "in_progress", "in_transit", "sellable_accessible"}
EVENT = {
    "type": lambda v: v == "ObjectEvent",
    "eventTime": lambda v: bool(TIME.fullmatch(v)),
    "eventTimeZoneOffset": lambda v: bool(OFFSET.fullmatch(v)),
    "epcList": lambda v: isinstance(v, list) and len(v) == len(set(v)) and all(URI.fullmatch(epc) for epc in v),
    "action": ACTIONS.__contains__,
    "bizStep": BIZ_STEPS.__contains__,
    "disposition": DISPOSITIONS.__contains__,
    "readPoint": lambda v: set(v) == {"id"} and bool(URI.fullmatch(v["id"])),
}
EVENT_NEEDS = {"type", "eventTime", "eventTimeZoneOffset", "action", "epcList"}
DOCUMENT = {
    "@context": lambda v: isinstance(v, list) and v[0] == "https://ref.gs1.org/standards/epcis/2.0.0/epcis-context.jsonld",
    "type": lambda v: v == "EPCISDocument",
    "schemaVersion": lambda v: v == "2.0",
    "creationDate": lambda v: bool(TIME.fullmatch(v)),
    "epcisBody": lambda v: set(v) == {"eventList"} and isinstance(v["eventList"], list),
}


def breaches(document):
    """What in a document does not keep the structure, as (where, field)."""
    found = [("document", f) for f in DOCUMENT if f not in document or not DOCUMENT[f](document[f])]
    found += [("document", f) for f in document if f not in DOCUMENT]
    spaces = {prefix for part in document.get("@context", []) if isinstance(part, dict) for prefix in part}
    for i, event in enumerate(document.get("epcisBody", {}).get("eventList", [])):
        found += [(i, f) for f in EVENT_NEEDS - set(event)]
        for name, value in event.items():
            if name in EVENT:
                found += [] if EVENT[name](value) else [(i, name)]
            elif name.partition(":")[0] not in spaces or ":" not in name:  # fields of one's own stand in a name space of the context
                found.append((i, name))
    return found


def gates(names=("gate1", "gate2")):
    """Two antennas each, 9 m apart along y."""
    ids = [f"{name}.{place}" for name in names for place in ("left", "right")]
    y = np.repeat(9.0 * np.arange(len(names)), 2) + np.tile([1.2, -1.2], len(names))
    n = len(ids)
    position = np.column_stack([np.full(n, 6.0), y, np.ones(n)])
    quaternion = np.tile([1.0, 0, 0, 0], (n, 1))
    return gates_of(Antennas(ids, position, quaternion, np.zeros(n), np.ones(n), np.full(n, 18.0), np.full(n, 29.0)), 0.0)


def track(said, place=((6.5, 0.2), (5.0, 8.8), (6.0, 0.0))):
    """Rows a, b c, d/é at fixed places, with the decisions `said`."""
    rows, times = len(place), np.arange(5.0)
    mean = np.zeros((5, rows, 3))
    mean[..., :2] = place
    row, t, what, probability = (list(column) for column in zip(*said, strict=True)) if said else ([], [], [], [])
    zero = np.zeros(rows, dtype=np.int64)
    return Track(
        times, mean, np.tile(np.eye(3), (5, rows, 1, 1)), np.zeros((5, rows)), zero, ["a", "b c", "d/é"][:rows], zero, zero, zero,
        np.zeros(rows), components=("x", "y", "z"), decisions=Decisions(row, t, what, probability),
    )  # fmt: skip


SAID = [
    (1, 3.25, "out", 0.999),
    (0, 1.5, "in", 0.9921),
    (0, 1.0, "in?", 0.8),
    (2, 2.0, "pass", 0.7),
    (2, 2.5, "uturn", 0.9),
    (2, 9.0, "in", 1.0),
]


def test_a_document_keeps_the_structure_of_epcis_and_survives_json():
    found = epcis.document(epcis.events(track(SAID), gates(), started=START), created=START)
    assert breaches(found) == []
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert breaches(epcis.document([], created=START)) == []


def test_what_a_detector_decides_comes_out_as_two_events_at_its_two_gates():
    ways = [walk((-4.2, 9.0), (4.2, 9.2), start=1), walk((4.2, 0.0), (-4.2, 0.2), start=1), walk((1.0, 2.0), (1.0, 2.0))]
    made = recording(ways, 10.0, gates=2)
    found = epcis.events(tracked([made], GateDetector, hints=[3]), gates_of(made.site.antennas, 0.0), started=START)
    said = [(e["bizStep"], e["epcList"][0].rpartition("/")[2], e["readPoint"]["id"].rpartition("/")[2]) for e in found]
    assert sorted(said) == [("receiving", "tag0", "gate2"), ("shipping", "tag1", "gate1")]
    assert breaches(epcis.document(found, created=START)) == []


def test_in_is_receiving_and_out_is_shipping_at_the_nearest_gate_and_nothing_else_is_an_event():
    found = epcis.events(track(SAID), gates(), started=START)
    said = [(e["bizStep"], e["epcList"], e["readPoint"]["id"].rpartition("/")[2], e["eventTime"]) for e in found]
    assert said == [
        ("receiving", ["https://example.org/warehouse/tag/a"], "gate1", "2026-05-04T08:00:01.500+02:00"),
        ("shipping", ["https://example.org/warehouse/tag/b%20c"], "gate2", "2026-05-04T08:00:03.250+02:00"),
        ("receiving", ["https://example.org/warehouse/tag/d%2F%C3%A9"], "gate1", "2026-05-04T08:00:09.000+02:00"),
    ]
    assert [e["testbed:probability"] for e in found] == [0.9921, 0.999, 1.0]
    assert {e["eventTimeZoneOffset"] for e in found} == {"+02:00"}
    assert {e["disposition"] for e in found} == {"in_progress", "in_transit"}


def test_times_in_utc_end_in_z():
    one = epcis.events(track(SAID[1:2]), gates(), started=START.astimezone(UTC))[0]
    assert (one["eventTime"], one["eventTimeZoneOffset"]) == ("2026-05-04T06:00:01.500Z", "+00:00")


@pytest.mark.parametrize(
    ("field", "wrong"),
    [
        ("type", "ObservationEvent"), ("eventTime", "2026-05-04 08:00"), ("eventTime", "2026-05-04T08:00:00"), ("action", None),
        ("eventTimeZoneOffset", "+2"), ("epcList", ["a"]), ("action", "SEEN"), ("bizStep", "in"), ("readPoint", "gate1"),
        ("probability", 1.0), ("other:field", 1.0),
    ],
)  # fmt: skip
def test_the_structural_check_finds_a_breach(field, wrong):
    found = epcis.document(epcis.events(track(SAID), gates(), started=START), created=START)
    event = found["epcisBody"]["eventList"][0]
    event[field] = wrong
    if wrong is None:
        del event[field]
    assert breaches(found) == [(0, field)]


def test_the_structural_check_finds_breaches_of_the_document():
    whole = epcis.document([], created=START)
    for field in whole:
        assert breaches({k: v for k, v in whole.items() if k != field}) == [("document", field)]
    assert breaches(whole | {"schemaVersion": "1.2"}) == [("document", "schemaVersion")]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"started": datetime(2026, 5, 4)}, "no time zone"),
        ({"base": "warehouse"}, "no URI"),
        ({"base": "https://a b"}, "no URI"),
    ],
)
def test_what_makes_no_event_is_said(changes, named):
    with pytest.raises(ValueError, match=named):
        epcis.events(track(SAID), gates(), **changes)


def test_decisions_without_gates_or_place_are_said():
    with pytest.raises(ValueError, match="no gates"):
        epcis.events(track(SAID), gates(()), started=START)
    with pytest.raises(ValueError, match="no place"):
        epcis.events(track(SAID, place=((np.nan, 0.0), (5.0, 8.8), (6.0, 0.0))), gates(), started=START)
    with pytest.raises(ValueError, match="no x and y"):
        epcis.events(track(SAID).with_(components=("u", "v", "w")), gates(), started=START)
    assert epcis.events(track([]), gates(())) == []
    with pytest.raises(ValueError, match="no time zone"):
        epcis.document([], created=datetime(2026, 5, 4))
