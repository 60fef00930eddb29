"""Logs of readers by their declared format: golden values of each, units, names, bad rows and lateness."""

import math
from importlib import util
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from testbed.logs import LogError, load_site, read_log
from testbed.logs.names import epc
from testbed.logs.registry import format_of, kinds
from testbed.logs.site import checked_site
from testbed.logs.truth import read_truth
from testbed.logs.units import Clock

spec = util.spec_from_file_location("logs_fakes", Path(__file__).parent / "fakes" / "logs.py")
fakes = util.module_from_spec(spec)
spec.loader.exec_module(fakes)
EPC, OTHER, site = fakes.EPC, fakes.OTHER, fakes.site


@pytest.fixture
def log(tmp_path):
    def read(kind, text=None, **changes):
        path = tmp_path / "log.txt"
        path.write_text(fakes.SAMPLES[kind] if text is None else text, encoding="utf-8")
        return read_log(path, site(kind, **changes))

    return read


def test_every_format_has_a_sample_and_says_what_it_is():
    assert set(kinds()) == {*fakes.SAMPLES, "tidy_parquet"}
    assert all(len(format_of(kind).says) > 20 for kind in kinds())


def test_sllurp_csv(log):
    found = log("sllurp_csv")
    reads = found.reads
    assert found.tags == [EPC]  # b'..' and capitals are dress
    np.testing.assert_array_equal(reads.t, [0.0, 0.0125, 0.025])
    np.testing.assert_array_equal(reads.antenna, [0, 1, 0])
    np.testing.assert_array_equal(reads.rssi, [-51.5, -60, -52])
    np.testing.assert_array_equal(reads.phase, np.array([0, 2048, 4095]) * (2 * np.pi / 4096))
    np.testing.assert_array_equal(reads.channel, [0, 49, 1])  # LLRP counts from 1
    np.testing.assert_array_equal(reads.doppler, [1.0, -0.5, np.nan])
    assert found.start_s == 1.7e9
    assert not len(found.bad)


def test_itemtest_csv(log):
    reads = log("itemtest_csv").reads
    np.testing.assert_array_equal(reads.t, [0.0, 0.0125])
    np.testing.assert_array_equal(reads.channel, [49, 0])  # the carrier is looked up in the hop table
    np.testing.assert_array_equal(reads.phase, [0.5, 6.25])
    np.testing.assert_array_equal(reads.doppler, [1.25, 0.0])


def test_json_lines_of_sllurp(log):
    reads = log("sllurp_jsonl").reads
    np.testing.assert_allclose(reads.t, [0.0, 1e-4], atol=1e-12)
    np.testing.assert_array_equal(reads.rssi, [-68, -68.5])  # 1/100 dBm where there is nothing else
    np.testing.assert_array_equal(reads.channel, [42, 0])
    assert reads.phase[0] == 2592 * (2 * np.pi / 4096)
    assert math.isnan(reads.phase[1])


def test_llrp_reports_in_both_dresses(log):
    found = log("llrp_reports")
    assert found.tags == [EPC, OTHER]
    np.testing.assert_array_equal(found.reads.antenna, [0, 1])
    np.testing.assert_array_equal(found.reads.rssi, [-68, -61])
    np.testing.assert_allclose(found.reads.t, [0.0, 0.1], atol=1e-12)


def test_zebra_csv_with_its_stray_tabs(log):
    reads = log("zebra_fx_csv").reads
    np.testing.assert_allclose(reads.phase, np.deg2rad([54.5213165283203, 360 - 60.4980621337891]), rtol=1e-15)
    np.testing.assert_allclose(reads.t, [0, 0.002], atol=1e-12)
    np.testing.assert_array_equal(reads.channel, [0, 49])


def test_tidy_csv_and_parquet_agree(log, tmp_path):
    found = log("tidy_csv")
    columns = {"t": [0.0125, 0.0190], "antenna": ["left", "2"], "tag": ["lid", "lid"], "rssi": [-51.5, -58], "channel": [7, 7]}
    columns |= {"phase": [3.0434, None], "doppler": [None, 1.5]}
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    again = read_log(tmp_path / "log.parquet", site("tidy_parquet"))
    assert again.reads.equals(found.reads)
    assert found.tags == again.tags == ["lid"]


def test_ranges_and_libRSF(log):
    ranges = log("ranges_csv").streams["ranges"]
    np.testing.assert_array_equal(ranges.anchor, [0, 1])
    found = log("librsf", log={"start_s": 0})
    np.testing.assert_array_equal(found.streams["ranges"].range, [2.5, 1.5])
    odometry = found.streams["odometry"]
    assert odometry.speed[0] == pytest.approx(0.325)
    assert odometry.yaw_rate[0] == pytest.approx(0.05 / 0.157)  # the right wheel is the fourth column, whatever the readme says


def test_bluetooth_tables(log):
    found = log("ble_mbd")
    truth = found.truth["e78f135624ce"]
    np.testing.assert_allclose(found.reads.t, np.arange(5) / 10, atol=1e-6)
    np.testing.assert_allclose(truth.position[:, 0], 10.5 + np.arange(5))
    wide = log("rssi_wide_csv")
    np.testing.assert_array_equal(wide.reads.antenna, [0, 1, 1, 0])
    np.testing.assert_array_equal(wide.reads.rssi, [-72.5, -53.8, -54, -70.25])
    assert len(wide.truth["beacon"].t) == 2  # a place that repeats the one before is none


# ---------------------------------------------------------------- units by declaration


@pytest.mark.parametrize(
    ("unit", "text", "seconds"),
    [
        ("s", ["10.5", "1e1"], [0.5, 0]),
        ("ms", ["10500", "10000"], [0.5, 0]),
        ("us", ["1.05e7", "10000000"], [0.5, 0]),
        ("ns", ["1.628008099976e+18", "1628008099975500000"], [0.0005, 0]),
        ("iso", ["1970-01-01T01:00:10.5+01:00", "1970-01-01 00:00:10"], [0.5, 0]),
    ],
)
def test_times_in_any_unit(unit, text, seconds):
    np.testing.assert_allclose(Clock(unit).seconds(pa.array(text)), seconds, atol=1e-12)


def test_a_time_from_zero_is_read_to_the_last_bit():
    t = np.array([0.1 + 0.2, 1 / 3, 1.0350000000000001, 12345.678901234567])
    np.testing.assert_array_equal(Clock("s", 0.0).seconds(pa.array([repr(v) for v in t.tolist()])), t)


@pytest.mark.parametrize("text", ["", "nan", "inf", "-5", "1e400", "yesterday", "1e13", "0x10", "1_000"])
def test_what_is_no_time(text):
    assert np.isnan(Clock("s", 0.0).seconds(pa.array([text, "3"]))).tolist() == [True, False]


def test_phase_that_is_declared_in_a_wrong_unit_is_refused(log):
    rows = "".join(f"{1700000000000000 + i},r1,1,-50,{EPC},{i * 37 % 4096},1,\n" for i in range(100))
    with pytest.raises(LogError, match=r"rows can't be used.*phase beyond a turn \(rad\).*declared right"):
        log("sllurp_csv", fakes.SLLURP.splitlines()[0] + "\n" + rows, log={"phase_unit": "rad"})


def test_phase_wrapped_by_half_a_turn_is_told_and_can_be_declared(log):
    rows = "t,antenna,tag,phase\n" + "".join(f"{i / 100},1,lid,{i * 0.61 % math.pi}\n" for i in range(400))
    assert any("phase_wrap: pi" in note for note in log("tidy_csv", rows).notes)
    declared = log("tidy_csv", rows, log={"phase_wrap": "pi"})
    assert not any("phase_wrap" in note for note in declared.notes)
    assert declared.reads.phase.max() < math.pi


def test_jumps_by_pi_are_told(log):
    rows = "t,antenna,tag,phase\n" + "".join(f"{i / 100},1,lid,{1 + (i % 10 == 3) * math.pi}\n" for i in range(400))
    assert any("jump by π" in note for note in log("tidy_csv", rows).notes)


def test_the_sign_of_a_phase_is_declared(log):
    plain, turned = (log("tidy_csv", log={"phase_sign": sign}).reads.phase[0] for sign in (1, -1))
    assert plain + turned == pytest.approx(2 * math.pi)


def test_a_carrier_that_the_hop_table_does_not_have_is_a_bad_row(log):
    found = log("itemtest_csv", fakes.ITEMTEST.replace("927.25", "866.30"))
    assert [(row.line, row.reason) for row in found.bad.in_order()] == [(4, "no channel of the hop table (mhz): '866.30'")]


# ---------------------------------------------------------------- bad rows


def test_bad_rows_are_listed_with_line_and_reason(log):
    good = fakes.SLLURP.splitlines()
    late = "1700000000030000"
    rows = [*good, f"{late},r1,9,-50,{EPC},0,1,0", "nonsense", f"x,r1,1,-50,{EPC},0,1,0", "", f"{late},r1,1,much,{EPC},0,1,0"]
    rows += [f"{late},r1,1,-50,***,0,1,0", f"{late},r1,1,-250,{EPC},0,1,0", f"{late},r1,1,-50,{EPC},9999,1,0"]
    rows += [f"{late},r1,1,-50,{EPC},1,77,0", good[1].replace("1700000000000000", "1700000000040000")]
    found = log("sllurp_csv", "\n".join(rows))
    assert len(found.reads) == 4
    assert [(row.line, row.reason.partition(":")[0]) for row in found.bad.in_order()] == [
        (5, "an antenna port that the site does not have"),
        (6, "wrong number of cells"),
        (7, "no time in us"),
        (9, "rssi is no number"),
        (10, "no EPC"),
        (11, "RSSI out of range (dbm)"),
        (12, "phase beyond a turn (steps4096)"),
        (13, "no channel of the hop table (index1)"),
    ]
    assert "8 rows left out" in found.bad.summary()


def test_quoted_cells_and_lines_of_windows(log):
    text = fakes.SLLURP.replace("r1", '"dock, left"').replace("\n", "\r\n")
    assert log("sllurp_csv", text).reads.equals(log("sllurp_csv").reads)


def test_rows_out_of_order_are_sorted_within_the_bound_and_left_out_beyond(log):
    rows = ["t,antenna,tag", "10.0,1,a", "10.5,1,a", "10.2,1,a", "12.0,1,a", "10.9,1,a", "11.5,1,a"]
    found = log("tidy_csv", "\n".join(rows), log={"lateness_s": 1.0, "start_s": 10})
    np.testing.assert_allclose(found.reads.t, [0, 0.2, 0.5, 1.5, 2.0], atol=1e-9)
    np.testing.assert_allclose(found.reads.t_arrival, [0, 0.5, 0.5, 2.0, 2.0], atol=1e-9)  # a row is there when the latest before it was
    assert [(row.line, row.reason[:5]) for row in found.bad.in_order()] == [(6, "later")]
    assert any("2 rows came out of order" in note for note in found.notes)


def test_a_clock_that_runs_ahead_takes_nothing_with_it(log):
    rows = ["t,antenna,tag", "10.0,1,a", "99999999,1,a", "10.1,1,a", "10.2,1,a"]
    found = log("tidy_csv", "\n".join(rows))
    np.testing.assert_allclose(found.reads.t, [0, 0.1, 0.2], atol=1e-9)
    assert [row.line for row in found.bad.in_order()] == [3]


def test_blocks_give_the_same_as_the_whole(log, monkeypatch):
    from testbed.logs import blocks

    rows = "t,antenna,tag,rssi\n" + "".join(f"{i / 7},{1 + i % 2},tag{i % 5},-{40 + i % 30}\n" for i in range(500)) + "bad\n"
    whole = log("tidy_csv", rows)
    monkeypatch.setattr(blocks.blocks, "__defaults__", (None, 64))
    parts = log("tidy_csv", rows)
    assert parts.reads.equals(whole.reads)
    assert (
        [(b.line, b.reason) for b in parts.bad.listed]
        == [(b.line, b.reason) for b in whole.bad.listed]
        == [(502, "wrong number of cells: 'bad'")]
    )


# ---------------------------------------------------------------- names


@pytest.mark.parametrize(
    "text", [f"b'{EPC}'", f'B"{EPC.upper()}"', f" {EPC} ", "3008 33B2 DDD9 0140 0000 0000", f"0x{EPC}", "3008-33b2-ddd9-0140-0000-0000"]
)
def test_an_epc_in_any_dress(text):
    assert epc(text) == EPC


@pytest.mark.parametrize("text", ["", "***", "b''", "\ud7ff", "a" * 300])
def test_what_is_no_epc(text):
    assert epc(text) is None


def test_tags_that_the_site_does_not_name_are_counted_and_no_mistake(log):
    found = log("zebra_fx_csv", tags=[{"id": "lid", "epc": EPC}])
    assert found.tags == ["lid"]
    assert len(found.reads) == 1
    assert not len(found.bad)
    assert any(f"1 reads of tags that the site does not name: {OTHER}" in note for note in found.notes)


def test_one_port_of_two_readers(log):
    antennas = [{"id": f"a{i}", "port": 1, "reader": f"r{i}", "position_m": [i, 0, 1]} for i in (1, 2)]
    text = fakes.SLLURP.replace(",2,-60", ",1,-60").replace("12500,r1", "12500,r2")
    np.testing.assert_array_equal(log("sllurp_csv", text, antennas=antennas).reads.antenna, [0, 1, 0])


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "a header is wanted"),
        (b"a\nb\n", "a header is wanted"),
        (b"a,b\n1,2\n", "no column is the time"),
        (b"timestamp,antenna,epc\n", "no row can be used"),
        (b"timestamp,antenna,antenna,epc\n1,1,1,ab\n", "two columns have one name"),
        (b"\x1f\x8b\x08\x00", "this is gzip, not text: unpack it first"),
        (b"PK\x03\x04bomb", "this is zip"),
        (b"\xff\xfea\0b\0", "UTF-16"),
        (b"PAR1", "declare kind: tidy_parquet"),
        (b"timestamp,antenna,epc\n" + b"x" * (6 << 20), "longer than 1024 KiB"),
    ],
)
def test_a_file_that_is_no_log(tmp_path, content, says):
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(LogError, match=says):
        read_log(tmp_path / "log", site("sllurp_csv"))


def test_a_file_that_is_not_there_and_a_folder(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(LogError):
            read_log(path, site("sllurp_csv"))


def test_parquet_that_unpacks_to_too_much_is_refused_unread(tmp_path, monkeypatch):
    from testbed.logs.formats import tidy_parquet

    table = {"t": np.arange(100_000.0), "antenna": np.ones(100_000, dtype=np.int8), "tag": ["a"] * 100_000}
    pq.write_table(pa.table(table), tmp_path / "log")
    monkeypatch.setattr(tidy_parquet, "MAX_GROUP", 100_000)
    with pytest.raises(LogError, match="when unpacked are too many"):
        read_log(tmp_path / "log", site("tidy_parquet"))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"log": {"kind": "sllurp"}}, None),
        ({"antennas": [{"id": "a", "position_m": [0, 0, 1e9]}]}, "km off or more"),
        ({"antennas": [{"id": "a", "position_m": [0, 0, 1]}, {"id": "a", "position_m": [0, 0, 1]}]}, "used twice"),
        ({"antennas": [{"id": "a", "port": 1, "position_m": [0, 0, 1]}, {"id": "b", "port": "1", "position_m": [0, 0, 1]}]}, "same port"),
        ({"nonsense": 1}, "nonsense"),
        ({"tags": [{"id": "a"}], "targets": [{"id": "t", "tags": ["b"]}]}, "not among the tags"),
    ],
)
def test_a_site_that_is_wrong(changes, says):
    plain = {"log": {"kind": "tidy_csv"}, "antennas": [{"id": "a", "position_m": [0, 0, 1]}], **changes}
    if says is None:
        with pytest.raises(LogError, match=r"no format is called 'sllurp', did you mean sllurp_csv"):
            format_of(checked_site(plain).log.kind)
    else:
        with pytest.raises(LogError, match=says):
            checked_site(plain)


def test_a_site_file(tmp_path):
    path = tmp_path / "site.yaml"
    path.write_text(
        "log: {kind: tidy_csv, lateness_s: 2 s}\nantennas:\n  - {id: a, port: 1, position_m: [0, 0, 150 cm], aim_m: [1, 0, 1.5]}\n"
    )
    found = load_site(path)
    assert found.log.lateness_s == 2
    assert found.antennas[0].position_m == (0, 0, 1.5)


def test_truth_files(tmp_path):
    (tmp_path / "a.tum").write_text("# t x y z qx qy qz qw\n10 1 2 3 0 0 0 1\n11 2 2 3 0 0 0 1\nbad\n")
    (tmp_path / "b.csv").write_text("t,x,y,target\n10,1,2,cart\n11,2,2,cart\n")
    how = site("tidy_csv").truth
    tum, bad = read_truth(tmp_path / "a.tum", how, 10.0)
    np.testing.assert_array_equal(tum[""].t, [0, 1])
    np.testing.assert_array_equal(tum[""].position[1], [2, 2, 3])
    assert [row.line for row in bad.listed] == [4]
    table, _ = read_truth(tmp_path / "b.csv", how.model_copy(update={"kind": "csv", "height_m": 1.5}), 10.0)
    np.testing.assert_array_equal(table["cart"].position[:, 2], 1.5)
