"""`testbed calibrate LOG --site`: what a log was made with comes back, and the sections that are written can be loaded and run.

Streams are exported as a reader's tools write them and read back. Bounds are about four standard errors, as the fit states them, so
that a right fit fails in about one seed of 10,000 a figure; the seeds are fixed.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

import testbed
from testbed.calibrate import CalibrationError, Request
from testbed.calibrate.channel_fit import fit
from testbed.calibrate.known_reads import KnownReads
from testbed.calibrate.pace import between_rounds
from testbed.calibrate.reader_log import calibrate, rician_spread
from testbed.cli import main
from testbed.export.kept import recordings
from testbed.export.run import export
from testbed.radio.artefacts import ArtefactsConfig
from testbed.scenario import from_dict
from testbed.sensors.log_distance import LogDistanceConfig
from testbed.sensors.rfid_section import RfidConfig

ZEBRA = Path(__file__).parents[3] / "shared" / "data" / "zebra_fx7500_aoa"
ANTENNAS = [
    {"id": "a", "position_m": [1, 2, 1.5], "aim_m": [5, 2, 1.5], "gain_dbi": 6.0},
    {"id": "b", "position_m": [1, 3, 1.5], "aim_m": [5, 3, 1.5], "gain_dbi": 5.0},
]
MADE = {"phase_noise_rad": 0.05, "flip_probability": 0.06, "rssi_noise_db": 0.8, "rssi_channel_db": 1.5, "late_probability": 0.0}
BENCH = {
    "name": "bench", "seed": 8, "trials": 1, "duration_s": 40, "world": {"kind": "open_floor", "posts": 0, "length_m": 8, "width_m": 6},
    "sensors": [{
        "id": "reader", "kind": "rfid", "region": "fcc", "carriers_mhz": [902.75 + 0.5 * k for k in range(24)], "antennas": ANTENNAS,
        "modulation_loss_db": 11, "reader": {"profile": "r420", "between_rounds_s": 0.02},
        "channel": {"orders": 0, "diffuse": False, "edges": False}, "artefacts": MADE,
    }],
    "tags": [{"id": f"tag{i}", "position_m": [x, 2.5, 1.5], "yaw_deg": 180} for i, x in enumerate((2.5, 3.5, 4.5, 5.5))],
    "targets": ["tag0"], "references": ["tag1", "tag2", "tag3"], "estimators": [{"kind": "centroid"}],
}  # fmt: skip


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrate")
    testbed.run(BENCH, out=folder / "run", keep="all")
    log, site = export(folder / "run", "sllurp", folder)
    return log, site, recordings(folder / "run")[0]


@pytest.fixture(scope="module")
def found(exported):
    log, site, _ = exported
    return calibrate(Request(str(log), site=str(site)))


def ran(arguments):
    with pytest.raises(SystemExit) as left:
        main(arguments)
    return left.value.code


def near(figure, wanted, floor=0.0, errors=4.0):
    assert figure is not None
    assert abs(figure.value - wanted) < max(errors * figure.error, floor), (figure, wanted)


def test_a_simulated_reader_comes_back(found):
    fitted, rfid = found.fitted, found.sections["rfid"]
    near(fitted.rssi_noise, 0.8)
    near(fitted.phase_noise, 0.05)
    near(fitted.flips, 0.06)
    near(fitted.carriers, 1.5)
    assert fitted.carriers.error < 0.25  # 46 differences of 24 carriers on two antennas
    assert fitted.rssi_step == 0.5
    assert fitted.exponent == 4.0
    assert rfid["modulation_loss_db"] == pytest.approx(11, abs=1.5)  # 24 carriers' spread of 1.5 dB: 0.31 dB an antenna, and patterns
    gains = [a["gain_dbi"] for a in rfid["antennas"]]
    assert gains[0] - gains[1] == pytest.approx(1.0, abs=1.0)
    assert rfid["reader"]["between_rounds_s"] == pytest.approx(0.02, rel=0.15)


def test_what_is_written_runs_and_reads_as_fast(found, exported):
    again = {**BENCH, "sensors": [found.sections["rfid"]], "name": "again"}
    result = testbed.run(again)
    rate = result.document()["points"][0]["world"]["reads_hz"]
    assert rate == pytest.approx(found.pace.value, rel=0.05)
    plain = {**BENCH, "sensors": [found.sections["log_distance"]], "name": "law"}
    assert from_dict(plain).sensors[0].kind == "log_distance"


def test_the_command_writes_sections_that_can_be_loaded(exported, tmp_path, capsys):
    log, site, _ = exported
    assert ran(["calibrate", str(log), "--site", str(site), "--out", str(tmp_path / "fit"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [s["kind"] for s in document["sensors"]] == ["rfid", "log_distance"]
    for kind, model in (("rfid", RfidConfig), ("log_distance", LogDistanceConfig)):
        (section,) = YAML(typ="safe").load(tmp_path / "fit" / f"sensor.{kind}.yaml")["sensors"]
        assert section["kind"] == kind
        model.model_validate({k: v for k, v in section.items() if k not in ("id", "kind")})
    assert ran(["calibrate", str(log), "--site", str(site)]) == 0
    assert "flip probability" in capsys.readouterr().out


# ---------------------------------------------------------------- streams with known parameters


def stream(n=6000, seed=1, ways=2, noise=0.6, spread=0.0, flips=0.1, phase=0.08, carriers=4, between=1.0, places=60, step=0.0):
    """Reads of one antenna at many places, many in a row at each."""
    rng = np.random.default_rng(seed)
    place = np.repeat(np.arange(places), n // places)
    d = np.linspace(1, 6, places)[place]
    k = between * rng.standard_normal(carriers)
    channel = np.arange(len(place)) // 5 % carriers
    rssi = (
        -45 - 20 * ways * np.log10(d) + spread * rng.standard_normal(places)[place] + k[channel] + noise * rng.standard_normal(len(place))
    )
    sigma = phase * np.maximum(10 ** ((-55 - rssi) / 40), 0.25)
    angle = 0.3 * channel + place + sigma * rng.standard_normal(len(place)) + np.pi * (rng.random(len(place)) < flips)
    rssi = np.round(rssi / step) * step if step else rssi
    t, zero = np.arange(len(place)) * 0.02, np.zeros(len(place), dtype=np.int64)
    return KnownReads(t, zero, zero, channel, rssi, angle % (2 * np.pi), d, zero * 1.0, place), float(np.std(k, ddof=1)), float(k.mean())


@pytest.mark.parametrize("ways", [1, 2])
@pytest.mark.parametrize("seed", [1, 2])
def test_known_parameters_come_back_within_their_errors(ways, seed):
    known, between, shift = stream(seed=seed, ways=ways, spread=2.0, noise=0.6)
    found = fit(known, 1, ways, np.array([866e6]).repeat(4), False)
    assert abs(found.level[0] - (-45 + shift)) < 4 * found.level_error[0]
    near(found.rssi_noise, 0.6)
    near(found.place, 2.0)
    near(found.flips, 0.1)
    near(found.phase_noise, 0.08)
    near(found.carriers, between, floor=0.1)


def test_the_wrong_slope_fails_here():
    known, _, _ = stream(spread=0.0)
    right, wrong = (fit(known, 1, ways, np.empty(0), False) for ways in (2, 1))
    assert wrong.total.value > 3 * right.total.value


def test_rounding_to_whole_decibels_is_taken_off():
    found = fit(stream(noise=0.8, step=1.0)[0], 1, 2, np.empty(0), False)
    assert found.rssi_step == 1.0
    near(found.rssi_noise, 0.8)


def test_flips_are_not_counted_where_half_turns_wrap_and_noise_is_found_all_the_same():
    known, _, _ = stream()
    found = fit(known.with_(phase=known.phase % np.pi), 1, 2, np.empty(0), True)
    assert found.flips is None
    near(found.phase_noise, 0.08)


def test_stated_errors_are_those_of_many_logs():
    """200 logs: the spread of an estimate is known to 5 %; bounds of 1.3 either way fail less than once in 10,000 seeds."""
    each = [fit(stream(n=1200, seed=s, places=12, carriers=2)[0], 1, 2, np.empty(0), False) for s in range(1000, 1200)]
    for name in ("rssi_noise", "flips", "phase_noise"):
        values = np.array([getattr(f, name).value for f in each])
        stated = np.mean([getattr(f, name).error for f in each])
        assert 1 / 1.3 < values.std(ddof=1) / stated < 1.3, name


def test_phases_without_any_relation_say_nothing():
    known, _, _ = stream()
    found = fit(known.with_(phase=np.random.default_rng(1).uniform(0, 6.28, len(known))), 1, 2, np.empty(0), False)
    assert found.phase_noise is None
    assert found.flips is None


def test_the_rician_spread_is_that_of_rayleigh_at_its_end():
    assert rician_spread(-60) == pytest.approx(5.57, abs=0.02)  # π / √6 · 10 / ln 10
    assert rician_spread(20) == pytest.approx(10 / np.log(10) * np.sqrt(2 / 100), rel=0.02)


def test_a_pace_that_the_profile_can_not_have_is_none():
    assert between_rounds("r420", 5000.0, np.array([1])) is None
    assert between_rounds("r420", 0.0, np.array([1])) is None


# ---------------------------------------------------------------- a real reader


def zebra(tmp_path, **site):
    place = {"log": {"kind": "zebra_fx_csv"}, "carriers_mhz": [865.7], **site}
    place.setdefault("antennas", [{"id": f"a{p}", "port": p, "position_m": [(p - 1.5) * 0.287, 0, 1], "power_dbm": 29.1} for p in (1, 2)])
    (tmp_path / "site.yaml").write_text(json.dumps(place))
    return tmp_path / "site.yaml"


@pytest.mark.skipif(not ZEBRA.is_dir(), reason=f"the data {ZEBRA.name} are not on this machine")
def test_a_real_fx7500(tmp_path):
    tags = [{"id": "moved", "epc": "000233b2ddd9014000000000", "position_m": [0.2, 0.813, 1]}]
    tags += [{"id": "two", "epc": "300833b2ddd9014000000000", "position_m": [0, 0.813, 1]}]
    found = calibrate(Request(str(ZEBRA / "20250709_865.7_0.813_0.287_0.2.csv"), site=str(zebra(tmp_path, tags=tags))))
    assert any("two is left out" in note for note in found.notes)
    assert found.sections["rfid"]["reader"]["profile"] == "fx7500"
    assert found.fitted.rssi_step == 1.0
    assert found.fitted.carriers is None  # one carrier
    assert found.pace.value == pytest.approx(1082 / 6.087, rel=1e-6)  # strangers included
    assert found.fitted.phase_noise.value < 0.2
    assert found.fitted.flips.value < 0.02
    assert ArtefactsConfig.model_validate(found.sections["rfid"]["artefacts"]).rssi_channel_db == 0


# ---------------------------------------------------------------- what can't be used


def tidy(tmp_path, rows, **site):
    (tmp_path / "log.csv").write_text("t,antenna,tag,rssi,phase\n" + "".join(rows))
    plain = {"log": {"kind": "tidy_csv"}, "antennas": [{"id": "a", "position_m": [0, 0, 1]}], **site}
    (tmp_path / "site.yaml").write_text(json.dumps(plain))
    return Request(str(tmp_path / "log.csv"), site=str(tmp_path / "site.yaml"))


ROWS = [f"{0.1 * i},a,x,{-50 - i % 2},1.0\n" for i in range(40)]
KNOWN = [{"id": "x", "position_m": [2, 0, 1]}]


@pytest.mark.parametrize(
    ("rows", "site", "said"),
    [
        (ROWS, {}, "no read is of a tag whose place is known"),
        (ROWS[:5], {"tags": KNOWN}, "no antenna has 10 reads"),
        (ROWS, {"tags": KNOWN, "antennas": []}, "antennas are wanted"),
        (ROWS, {"tags": KNOWN, "antennas": [{"id": "a", "position_m": [0, 0, 1], "power_dbm": -50}]}, "are power_dbm and gain_dbi"),
        (ROWS, {"tags": KNOWN, "carriers_mhz": [500.0]}, "neither etsi nor fcc"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(tmp_path, rows, site, said):
    with pytest.raises(CalibrationError, match=said):
        calibrate(tidy(tmp_path, rows, **site))


def test_a_tag_that_moves_on_a_known_path_shows_its_level_and_no_noise(tmp_path):
    t = np.arange(0, 20, 0.05)
    d = 1 + 0.15 * t
    rssi, phase = -40 - 40 * np.log10(d), (-4 * np.pi * d * 866.3e6 / 299792458.0) % (2 * np.pi)
    (tmp_path / "truth.tum").write_text("".join(f"{s} {x} 0 1 0 0 0 1\n" for s, x in ((0, 1), (20, 4))))
    rows = [f"{float(a)!r},a,x,{float(b)!r},{float(c)!r}\n" for a, b, c in zip(t, rssi, phase, strict=True)]
    request = tidy(tmp_path, rows, carriers_mhz=[866.3], targets=[{"id": "cart", "tags": ["x"]}], tags=[{"id": "x"}])
    found = calibrate(Request(request.source, site=request.site, truth=str(tmp_path / "truth.tum"))).fitted
    assert found.level[0] == pytest.approx(-40, abs=1e-6)
    assert max(found.total.value, found.rssi_noise.value, found.phase_noise.value, found.flips.value) < 1e-5


def test_a_log_of_one_way_has_no_reader_section(tmp_path):
    request = tidy(tmp_path, ROWS, tags=KNOWN)
    found = calibrate(Request(request.source, site=request.site, ways=1))
    assert list(found.sections) == ["log_distance"]
    assert found.sections["log_distance"]["path_loss_exponent"] == 2.0
    assert found.fitted.level[0] == pytest.approx(-50.5 + 20 * np.log10(2), abs=1e-9)


def test_the_command_complains_in_one_line(tmp_path, capsys):
    request = tidy(tmp_path, ROWS)
    assert ran(["calibrate", request.source, "--site", str(request.site)]) == 2
    assert "place is known" in capsys.readouterr().err
    assert ran(["calibrate", request.source, "--model", "reader_log"]) == 2
    assert "--site" in capsys.readouterr().err
    assert ran(["calibrate", str(tmp_path / "none.csv"), "--site", str(request.site)]) == 2
    assert "not on this machine" in capsys.readouterr().err
