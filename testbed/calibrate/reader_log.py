"""A reader's log, and the sections of a scenario that sound like it: `testbed calibrate LOG --site site.yaml`.

Two sections come of it. `rfid` (backscatter only) has the site's antennas with what their levels differ by as gain, the loss of
modulation that puts RSSI where the log has it in free space, noise, flips, spread between carriers, the fading of places as a Rician K
and the time between rounds that makes the log's number of reads a second. `log_distance` is the law alone: one level, the fixed slope,
the spread about it and the rate of a link. Both are loaded before they are given out, so that what is written can be used.

Left out: coverage (tags' sensitivity), late rows, Doppler, and what obstacles cost: the sections are of free space, with `orders: 0`.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError
from rich.console import Console
from rich.table import Table as Printed
from ruamel.yaml import YAML
from scipy.optimize import brentq
from scipy.special import exp1
from scipy.stats import ncx2

from testbed.calibrate import CalibrationError, Request
from testbed.calibrate.channel_fit import ChannelFit, Figure, fit
from testbed.calibrate.known_reads import Heard, KnownReads, known_reads
from testbed.calibrate.pace import between_rounds, heard_together, rate
from testbed.logs import LogError, load_site
from testbed.logs.library import pieces, read_cached
from testbed.logs.site import SiteAntenna, SiteModel
from testbed.quantity import Config
from testbed.radio.regions import hop_table
from testbed.sensors.log_distance import LogDistanceConfig
from testbed.sensors.rfid_section import RfidConfig
from testbed.units import SPEED_OF_LIGHT

if TYPE_CHECKING:
    from testbed.report.figures import Drawing

ONE_WAY = ("ble_mbd", "rssi_wide_csv")  # kinds of logs whose RSSI is of a beacon's own transmitter
PROFILE = {"zebra_fx_csv": "fx7500"}
POLARISED = 3.0103  # dB: a circular wave on a linear tag, each way
LEAST_PLACES = 8  # below which a spread between places is no fading to be set
K_DB = (-20.0, 30.0)
QUANTILES = (np.arange(4000) + 0.5) / 4000


@dataclass(frozen=True, eq=False)
class ReaderLog:
    """A fitted log. sections: by kind of sensor, as a scenario has them; pace: reads/s of the whole reader, link: of an antenna and tag."""

    name: str
    antennas: list[str]
    heard: Heard
    fitted: ChannelFit
    pace: Figure
    link: float
    sections: dict[str, dict[str, Any]]
    notes: list[str]

    def figures(self) -> dict[str, tuple[Figure | None, str]]:
        """Each figure with its unit."""
        f = self.fitted
        return {
            "rssi_noise": (f.rssi_noise, "dB"),
            "rssi_between_carriers": (f.carriers, "dB"),
            "rssi_between_places": (f.place, "dB"),
            "rssi_about_the_law": (f.total, "dB"),
            "phase_noise_at_-55_dBm": (f.phase_noise, "rad"),
            "flip_probability": (f.flips, ""),
            "reads": (self.pace, "1/s"),
        }

    def document(self) -> dict[str, Any]:
        """As JSON; None is what the log can't tell."""
        f = self.fitted
        return {
            "model": "reader_log",
            "log": self.name,
            "reads": len(self.heard.known),
            "path_loss_exponent": f.exponent,
            "level_at_1m_dbm": {id: _plain(v) for id, v in zip(self.antennas, f.level, strict=True)},
            "level_error_db": {id: _plain(v) for id, v in zip(self.antennas, f.level_error, strict=True)},
            "rssi_step_db": f.rssi_step,
            "figures": {
                n: None if g is None else {"value": g.value, "error": _plain(g.error), "n": g.n} for n, (g, _) in self.figures().items()
            },
            "notes": self.notes,
            "sensors": list(self.sections.values()),
        }

    def show(self, console: Console) -> None:
        """Figures with their errors, then the sections."""
        table = Printed(title=f"{self.name}, {len(self.heard.known):,} reads at known places", title_justify="left")
        for head in ("", "fitted", "± (standard error)", "unit", "over"):
            table.add_column(head, justify="left" if not head else "right")
        for id, level, error in zip(self.antennas, self.fitted.level, self.fitted.level_error, strict=True):
            table.add_row(f"level of {id} at 1 m", *(_shown(v) for v in (level, error)), "dBm", "")
        for name, (found, unit) in self.figures().items():
            cells = (
                ("the log can't tell", "", "", "") if found is None else (f"{found.value:.4g}", f"{found.error:.2g}", unit, f"{found.n:,}")
            )
            table.add_row(name.replace("_", " "), *cells)
        console.print(table)
        for note in self.notes:
            console.print(f"note: {note}", soft_wrap=True, highlight=False)
        for kind in self.sections:
            console.print(f"\n# {kind}\n{self.yaml(kind)}", soft_wrap=True, highlight=False, markup=False)

    def yaml(self, kind: str) -> str:
        """The section as a scenario has it."""
        return yaml_of({"sensors": [self.sections[kind]]})

    def files(self) -> dict[str, str]:
        """A YAML file for each section."""
        return {f"sensor.{kind}.yaml": f"# fitted to {self.name} by testbed calibrate\n{self.yaml(kind)}" for kind in self.sections}

    def measured(self) -> tuple[KnownReads, dict[str, str]]:
        return self.heard.known, {"t": "s", "rssi": "dBm", "phase": "rad", "distance": "m", "pattern": "dB"}

    def drawings(self) -> Sequence[Drawing]:
        """None: a page that compares streams is `testbed fidelity`."""
        return []


def calibrate(request: Request) -> ReaderLog:
    """Fit the log. LogError or CalibrationError for what can't be used."""
    if request.site is None:
        raise CalibrationError("a reader's log wants --site site.yaml: where antennas and tags are, and how the log is written")
    if request.trials is not None or request.seed is not None or request.sets:
        raise CalibrationError("--trials, --seed and --set are of simulated campaigns, and mean nothing to a log")
    try:
        site = load_site(request.site)
        if not site.antennas:
            raise CalibrationError(f"{request.site}: antennas are wanted, with their places")
        piece = pieces(request.source, request.truth or site.truth.path, site, progress=request.progress)[0]
        everyone = site.model_copy(update={"tags": [], "targets": []})  # a reader's pace is of strangers as well
        every = read_cached(piece.log.path, everyone).reads if site.tags else piece.log.reads
    except LogError as error:
        raise CalibrationError(str(error)) from None
    heard = replace(known_reads(site, piece), every=every)
    ways = request.ways or (1 if site.log.kind in ONE_WAY else 2)
    return fitted(piece.name, site, heard, ways, request.profile)


def fitted(name: str, site: SiteModel, heard: Heard, ways: int, profile: str | None = None) -> ReaderLog:
    """The fit of reads at known places, and the sections that follow from it."""
    found = fit(heard.known, len(site.antennas), ways, site.carriers(), site.log.phase_wrap == "pi")
    pace = rate(heard.every, heard.duration)
    links = len(np.unique(np.column_stack([heard.known.antenna, heard.known.tag]), axis=0))
    link = len(heard.known) / max(heard.duration, 1e-9) / links
    notes = [*heard.notes]
    if site.log.phase_wrap == "pi":
        notes.append("phases are modulo π: flips by π can't be seen")
    sections = {"log_distance": _log_distance(site, found, link)}
    if ways == 2:
        sections = {"rfid": _rfid(site, heard, found, profile or PROFILE.get(site.log.kind, "r420"), pace, notes)} | sections
    for kind, model in (("rfid", RfidConfig), ("log_distance", LogDistanceConfig)):
        if kind in sections:
            _loads(model, sections[kind])
    return ReaderLog(name, [a.id for a in site.antennas], heard, found, pace, link, sections, notes)


# ---------------------------------------------------------------- sections


def _log_distance(site: SiteModel, found: ChannelFit, link: float) -> dict[str, Any]:
    section: dict[str, Any] = {
        "id": "calibrated",
        "kind": "log_distance",
        "antennas": [_place(a) for a in site.antennas],
        "rate_hz": _digits(min(max(link, 1e-3), 1000.0)),
        "reference_dbm": _digits(found.round_level),
        "path_loss_exponent": found.exponent,
        "sigma_db": _digits(found.total.value),
    }
    if found.phase_noise is not None and len(site.carriers()):
        section |= {"carrier_mhz": float(site.carriers().mean() / 1e6), "phase_noise_rad": _digits(found.phase_noise.value)}
    return section


def _rfid(site: SiteModel, heard: Heard, found: ChannelFit, profile: str, pace: Figure, notes: list[str]) -> dict[str, Any]:
    power, given = (np.array([getattr(a, name) for a in site.antennas]) for name in ("power_dbm", "gain_dbi"))
    level = np.where(np.isfinite(found.level), found.level, -np.inf)
    strongest = int(np.argmax(level - power - 2 * given))  # it keeps its gain, and the others have less
    loss, channel = _loss(site, float(level[strongest]), strongest), _channel(found)
    loss += 2 * _faded(channel.get("open_k_db"))
    if not 0 <= loss <= 40:
        raise CalibrationError(
            f"levels at 1 m of {level[strongest]:.1f} dBm would want a loss of modulation of {loss:.1f} dB, and 0 to 40 are sound: are "
            f"power_dbm and gain_dbi of {site.antennas[strongest].id} right?"
        )
    above = (level - power) - (level - power)[strongest]
    gain = np.where(np.isfinite(above), given[strongest] + np.where(np.isfinite(above), above, 0.0) / 2, given)
    tags = heard_together(heard.every, heard.duration, len(site.antennas))
    reader: dict[str, Any] = {"profile": profile}
    between = between_rounds(profile, pace.value, tags)
    if between is None:
        notes.append(f"{pace.value:.1f} reads/s can't be had of the profile {profile}: its own time between rounds stays")
    else:
        reader["between_rounds_s"] = _digits(between)
    region = site.region or _region(site)
    return {
        "id": "calibrated",
        "kind": "rfid",
        "antennas": [_antenna(a, float(g), site.antennas[strongest].power_dbm) for a, g in zip(site.antennas, gain, strict=True)],
        "region": region,
        **({"carriers_mhz": list(site.carriers_mhz)} if site.carriers_mhz else {}),
        "power_dbm": site.antennas[strongest].power_dbm,
        "modulation_loss_db": _digits(loss),
        "reader": reader,
        "channel": channel,
        "artefacts": _artefacts(found, site),
    }


def _loss(site: SiteModel, level: float, strongest: int) -> float:
    """dB between free space and the level: P + 2 (G_a + G_t - polarisation) + 40 log10(λ / 4π) - C."""
    antenna, carriers = site.antennas[strongest], site.carriers()
    gain = float(np.mean([t.gain_dbi for t in site.tags])) if site.tags else 2.0
    wave = SPEED_OF_LIGHT / (carriers.mean() if len(carriers) else hop_table("etsi").mean())
    free = antenna.power_dbm + 2 * (antenna.gain_dbi + gain - POLARISED) + 40 * np.log10(wave / (4 * np.pi))
    return float(free - level)


def _channel(found: ChannelFit) -> dict[str, Any]:
    """Free space; with enough places the diffuse part that spreads them as the log does."""
    plain: dict[str, Any] = {"orders": 0, "diffuse": False, "edges": True}
    if found.place is None or found.place.n < LEAST_PLACES or found.place.value < 2 * rician_spread(K_DB[1]):
        return plain
    wanted = found.place.value / 2  # dB one way: the round trip is |h|⁴
    k = K_DB[0] if wanted > rician_spread(K_DB[0]) else brentq(lambda x: rician_spread(x) - wanted, *K_DB, xtol=0.01)
    return {**plain, "diffuse": True, "open_k_db": _digits(float(k))}  # pyright: ignore[reportArgumentType]


def rician_spread(k_db: float) -> float:
    """Standard deviation, dB, of the power of a Rician amplitude with that K."""
    k = 10 ** (k_db / 10)
    return float(np.std(10 * np.log10(ncx2.ppf(QUANTILES, 2, 2 * k))))


def _faded(k_db: float | None) -> float:
    """dB by which the mean of levels lies above (below, negative) the level of the mean power: E ln|h|² = ln(K / (K + 1)) + E1(K)."""
    if k_db is None:
        return 0.0
    k = 10 ** (k_db / 10)
    return float(10 / np.log(10) * (np.log(k / (k + 1)) + exp1(k)))


def _artefacts(found: ChannelFit, site: SiteModel) -> dict[str, Any]:
    section: dict[str, Any] = {}
    for name, figure in (
        ("phase_noise_rad", found.phase_noise),
        ("flip_probability", found.flips),
        ("rssi_noise_db", found.rssi_noise),
        ("rssi_channel_db", found.carriers),
    ):
        if figure is not None:
            section[name] = _digits(figure.value)
    if found.carriers is None and len(site.carriers()) == 1:
        section["rssi_channel_db"] = 0.0  # one carrier: what it differs by is in the level
    if found.rssi_step:
        section["rssi_step_db"] = found.rssi_step
    return section


def _region(site: SiteModel) -> str:
    """The region whose carriers the site's are."""
    if site.carriers_mhz is None:
        return "etsi"
    for region in ("etsi", "fcc"):
        try:
            hop_table(region, site.carriers_mhz)
        except ValueError:
            continue
        return region
    raise CalibrationError(f"carriers_mhz: {', '.join(f'{c:g}' for c in site.carriers_mhz[:4])} are those of neither etsi nor fcc")


def _place(antenna: SiteAntenna) -> dict[str, Any]:
    return {"position_m": list(antenna.position_m)} | ({"aim_m": list(antenna.aim_m)} if antenna.aim_m is not None else {})


def _antenna(antenna: SiteAntenna, gain: float, power: float) -> dict[str, Any]:
    """As the section has it, with the gain that its level says: it counts twice in the level, there and back."""
    section = {"id": antenna.id, **_place(antenna), "gain_dbi": _digits(gain)}
    if antenna.power_dbm != power:
        section["power_dbm"] = antenna.power_dbm
    if antenna.aim_m is None:
        return {**section, "pattern": {"angle_deg": [0, 180], "gain_db": [0, 0]}}
    width = 70.0 if antenna.beamwidth_deg is None else antenna.beamwidth_deg
    return {**section, "beamwidth_deg": min(width, 178.9), "front_to_back_db": antenna.front_to_back_db}


def _loads(model: type[Config], section: dict[str, Any]) -> None:
    """CalibrationError for a section that the sensor of its kind would refuse."""
    try:
        model.model_validate({name: value for name, value in section.items() if name not in ("id", "kind")})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise CalibrationError(f"what the log says is no section of kind {section['kind']}: {where}: {first['msg']}") from None


def yaml_of(document: dict[str, Any]) -> str:
    """Plain values as YAML, in their order."""
    writer = YAML()
    writer.default_flow_style = None
    writer.width = 140
    text = io.StringIO()
    writer.dump(document, text)
    return text.getvalue()


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def _shown(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.2f}"


def _plain(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
