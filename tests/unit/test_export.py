"""What a run kept, in other formats: read back to the last bit where the format has a reader here."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

import testbed
from testbed import archive
from testbed.archive import StoreError
from testbed.cli import main
from testbed.export import reader_logs, tum
from testbed.export.kept import Kept, lines, recordings
from testbed.export.run import WRITERS, export, writer
from testbed.logs import load_site, read_log
from testbed.logs.site import checked_site
from testbed.types import Decisions

TROLLEY = {"id": "t1", "kind": "trolley", "motion": "kinematic", "tags": [{"id": "lid", "mount": "top"}]}
TROLLEY["route"] = {"waypoints_m": [[1, 1], [5, 1]]}
SCENARIO = {
    "name": "exported",
    "seed": 4,
    "trials": 1,
    "duration_s": 2,
    "world": {"kind": "open_floor"},
    "actors": [TROLLEY],
    "sensors": [{"id": "gate", "kind": "rfid", "antennas": {"on": "post*"}, "channel": {"orders": 0, "diffuse": False, "edges": False}}],
    "estimators": [{"kind": "ukf"}, {"kind": "centroid"}],
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    testbed.run(SCENARIO, out=folder, keep="all")
    return folder


@pytest.fixture(scope="module")
def kept(run):
    return recordings(run)[0]


def sorted_columns(reads):
    return {name: getattr(reads, name) for name in ("t", "antenna", "tag", "channel", "rssi", "phase", "doppler")}


def same(found, wanted):
    assert len(found) == len(wanted)
    for name, values in sorted_columns(wanted).items():
        np.testing.assert_array_equal(getattr(found, name), values, err_msg=name)


@pytest.mark.parametrize("kind", ["sllurp", "itemtest"])
def test_a_simulated_stream_comes_back_bit_for_bit(kept, tmp_path, kind):
    log, site = writer(kind)(kept, tmp_path)
    found = read_log(log, load_site(site))
    assert len(kept.reads) > 50
    assert not len(found.bad)
    same(found.reads, kept.reads)
    assert found.tags == [str(id) for id in kept.recording.site.tags.id]


@pytest.mark.parametrize("kind", ["sllurp", "itemtest"])
@pytest.mark.parametrize("profile", ["r420", "sargas"])
def test_readers_of_other_resolution_come_back_as_well(tmp_path, kind, profile):
    sensor = {**SCENARIO["sensors"][0], "reader": profile, "region": "fcc"}
    testbed.run({**SCENARIO, "sensors": [sensor], "estimators": [{"kind": "centroid"}]}, out=tmp_path / "run", keep="all")
    kept = recordings(tmp_path / "run")[0]
    log, site = writer(kind)(kept, tmp_path)
    same(read_log(log, load_site(site)).reads, kept.reads)


@pytest.mark.parametrize("kind", ["sllurp", "itemtest"])
def test_any_numbers_come_back(kept, tmp_path, kind):
    random, n = np.random.default_rng(7), 300
    reads = kept.reads.take(np.arange(n) % len(kept.reads))
    t, rssi, phase = np.sort(random.uniform(0, 1e4, n)), random.normal(-60, 9, n), random.uniform(0, 2 * np.pi, n)
    changed = reads.with_(t=t, rssi=rssi, phase=phase, doppler=np.full(n, np.nan))
    recording = kept.recording
    other = type(recording)(0, 1e4, recording.site, {"reads": changed}, recording.targets, recording.target_tags)
    trial = type(kept.trial)(other, kept.trial.truth, kept.trial.target_body, kept.trial.target_pose, {})
    log, site = writer(kind)(Kept("any", trial, {}, kept.scene), tmp_path)
    same(read_log(log, load_site(site)).reads, changed)


def test_parquet_is_the_tidy_table(kept, tmp_path):
    files = {path.name.split(".")[-2]: path for path in writer("parquet")(kept, tmp_path)}
    ids = [{"id": str(id), "port": str(id), "position_m": [0, 0, 1]} for id in kept.recording.site.antennas.id]
    tags = [{"id": str(id)} for id in kept.recording.site.tags.id]
    site = checked_site({"log": {"kind": "tidy_parquet", "start_s": 0}, "antennas": ids, "tags": tags})
    same(read_log(files["reads"], site).reads, kept.reads)
    estimates = pq.read_table(files["estimates"]).to_pydict()
    assert set(estimates["estimator"]) == {"ukf", "centroid"}
    assert pq.read_schema(files["reads"]).field("rssi").metadata[b"unit"] == b"dBm"


def test_trajectories_come_back(kept, tmp_path):
    files = {path.name: path for path in writer("tum")(kept, tmp_path)}
    t, position, quaternion = tum.read(files[f"{kept.name}.truth.lid.tum"])
    poses = kept.true_poses(0, kept.true_times())
    np.testing.assert_array_equal(t, kept.true_times())
    np.testing.assert_array_equal(np.column_stack([position, quaternion]), poses)
    ukf = next(line for line in lines(kept) if line.estimator == "ukf")
    np.testing.assert_array_equal(tum.read(files[f"{kept.name}.ukf.lid.tum"])[1], ukf.position)


def test_mcap_has_every_message(kept, tmp_path):
    reader = pytest.importorskip("mcap.reader", reason="the extra viz is not installed")
    (path,) = writer("mcap")(kept, tmp_path)
    with path.open("rb") as file:
        messages = [
            (schema.name, channel.topic, m.log_time, json.loads(m.data)) for schema, channel, m in reader.make_reader(file).iter_messages()
        ]
    reads = [content for name, *_, content in messages if name == "testbed.Read"]
    assert [r["rssi_dbm"] for r in reads] == kept.reads.rssi.tolist()
    np.testing.assert_array_equal([r["phase_rad"] for r in reads], kept.reads.phase)
    truth = [content["pose"]["position"]["x"] for _, topic, _, content in messages if topic == "/truth/lid"]
    np.testing.assert_array_equal(truth, kept.true_poses(0, kept.true_times())[:, 0])
    assert {topic for _, topic, *_ in messages} == {"/hall", "/reads", "/truth/lid", "/estimate/ukf/lid", "/estimate/centroid/lid"}
    assert [m[2] for m in messages] == sorted(m[2] for m in messages)


def test_rerun_writes_a_recording(kept, tmp_path):
    pytest.importorskip("rerun", reason="the extra viz is not installed")
    (path,) = writer("rerun")(kept, tmp_path)
    raw = path.read_bytes()
    assert raw[:3] == b"RRF"
    assert len(raw) > 2000


def test_decisions_become_events(kept, tmp_path):
    said = Decisions(row=[0], t=[1.0], what=["in"], probability=[0.9])
    decided = Kept(kept.name, kept.trial, {"ukf": kept.tracks["ukf"].with_(decisions=said)}, kept.scene)
    (path,) = writer("epcis")(decided, tmp_path)
    (event,) = json.loads(path.read_text())["epcisBody"]["eventList"]
    assert event["bizStep"] == "receiving"
    with pytest.raises(ValueError, match="no estimator announced"):
        writer("epcis")(kept, tmp_path)


def test_a_name_with_a_comma_is_refused(kept, tmp_path):
    site = kept.recording.site
    tags = site.tags.with_(id=np.array(["a,b"] * len(site.tags)))
    named = type(site)(site.antennas, tags, site.frequencies)
    recording = archive.Recording(0, 2.0, named, kept.recording.streams, kept.recording.targets, kept.recording.target_tags)
    trial = type(kept.trial)(recording, kept.trial.truth, kept.trial.target_body, kept.trial.target_pose, {})
    with pytest.raises(ValueError, match=r"no commas"):
        reader_logs.sllurp(Kept("odd", trial, {}, kept.scene), tmp_path)


def test_the_command(run, tmp_path, capsys):
    with pytest.raises(SystemExit) as left:
        main(["export", str(run), "--to", "tum", "--out", str(tmp_path / "o"), "--trial", "0"])
    assert left.value.code == 0
    assert len(capsys.readouterr().out.split()) == 3 == len(list((tmp_path / "o").iterdir()))


@pytest.mark.parametrize(
    ("arguments", "says"), [(["--to", "tumm"], "did you mean tum?"), (["--to", "tum", "--trial", "9"], "it keeps point/trial 0/0")]
)
def test_what_can_t_be_exported(run, capsys, arguments, says):
    with pytest.raises(SystemExit) as left:
        main(["export", str(run), *arguments])
    assert left.value.code == 2
    assert says in capsys.readouterr().err


def test_no_run_at_all(tmp_path):
    with pytest.raises(StoreError, match="holds no such recording"):
        export(tmp_path, "tum", tmp_path / "out")
    assert set(WRITERS) == {"itemtest", "sllurp", "tum", "epcis", "mcap", "rerun", "parquet"}
