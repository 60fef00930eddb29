"""Readers as data: how fast their link is, how they share their time among ports, what they report and how coarsely.

Slot times follow from the link's parameters (EPC Radio-Frequency Identity Protocols, Generation-2 UHF RFID, release 2.1, section
6.3.1: preambles, T1 to T3, commands). What a data sheet doesn't say, the time that a reader takes between rounds and to change
ports, is chosen so that the rates come out that real logs show; the source is beside each.

Left out: firmware that changes its timing with what it hears, the host's share (reports that queue up), and a reader's own choice of
link (auto-set modes).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from testbed.plugins import suggest


@dataclass(frozen=True)
class Link:
    """The air interface: Tari (s), backscatter link frequency (Hz), subcarrier cycles a symbol (1 is FM0), long pilot tone or not."""

    tari: float
    blf: float
    miller: int
    pilot: bool = True


@dataclass(frozen=True)
class Slots:
    """Seconds that the pieces of an inventory round take."""

    query: float  # opens a frame
    adjust: float  # opens the next frame of the same round
    empty: float  # a slot in which nobody answers
    collision: float  # in which more than one do
    success: float  # in which one is read: RN16, acknowledgement, PC + EPC + CRC


EPC_BITS = 96
ONE = 1.75  # data-1 in Tari; the standard allows 1.5 to 2


def slots(link: Link) -> Slots:
    """Times of Gen2's slots. A reader's symbol is (1 + ONE)/2 Tari on average; nothing is heard in a slot until T1 + T3 is over."""
    bit, calibration = link.tari * (1 + ONE) / 2, link.tari * (1 + ONE)
    cycle = 1 / link.blf
    sync = 12.5e-6 + link.tari + calibration  # delimiter, data-0, RTcal
    symbol = cycle * link.miller
    preamble = symbol * ((18 if link.pilot else 6) if link.miller == 1 else (22 if link.pilot else 10))
    t1, t2, t3 = max(calibration, 10 * cycle), 10 * cycle, 5 * cycle
    answer = preamble + 17 * symbol  # RN16 and the closing dummy bit
    epc = preamble + (16 + EPC_BITS + 16 + 1) * symbol
    repeat, acknowledge = sync + 4 * bit, sync + 18 * bit
    return Slots(
        query=sync + 64 / 3 * cycle + 22 * bit - repeat,  # the first slot's QueryRep is the Query itself, with TRcal
        adjust=9 * bit - 4 * bit,
        empty=repeat + t1 + t3,
        collision=repeat + t1 + answer + t2,
        success=repeat + t1 + answer + t2 + acknowledge + t1 + epc + t2,
    )


@dataclass(frozen=True)
class Profile:
    """A reader. Fields that a scenario's reader section leaves out are taken from here.

    between_rounds, port_switch : s; longest_visit : s on one port before the next, where there are several
    session 0 to 3; dual_target : A and B are asked in turn, so that nobody is silenced by its flag
    phase_wrap : rad; phase_step : rad; rssi_step : dB; doppler_step : Hz; time_step : s; phase_sign : of what is reported
    """

    link: Link
    between_rounds: float
    port_switch: float
    longest_visit: float
    session: int
    dual_target: bool
    start_q: int
    sensitivity_dbm: float
    phase_turns: float  # the phase is reported modulo so many turns: 1 (2π) or 1/2 (π)
    phase_steps: int  # steps a turn
    phase_sign: int
    rssi_step_db: float
    doppler_step_hz: float
    time_step: float
    source: str


PROFILES: dict[str, Profile] = {
    "r420": Profile(
        link=Link(tari=20e-6, blf=274e3, miller=4),
        between_rounds=10.0e-3,
        port_switch=28e-3,
        longest_visit=0.5,
        session=1,
        dual_target=True,
        start_q=4,
        sensitivity_dbm=-84.0,
        phase_turns=1.0,
        phase_steps=1024,  # 4096 steps, in multiples of 4
        phase_sign=1,
        rssi_step_db=0.5,
        doppler_step_hz=1 / 16,
        time_step=1e-6,
        source="Impinj R420, dense reader mode (Miller 4): public logs have 60-80 reads/s with one tag on one port, and 0.17 s a turn of "
        "four ports; Impinj Low Level User Data Support application note: phase in 4096 steps, RSSI in 1/100 dBm, Doppler in 1/16 Hz",
    ),
    "fx7500": Profile(
        link=Link(tari=12.5e-6, blf=320e3, miller=4, pilot=False),
        between_rounds=1.5e-3,
        port_switch=4.5e-3,
        longest_visit=0.5,
        session=1,
        dual_target=True,
        start_q=2,
        sensitivity_dbm=-82.0,
        phase_turns=1.0,
        phase_steps=65536,
        phase_sign=1,
        rssi_step_db=1.0,
        doppler_step_hz=1 / 16,
        time_step=1e-3,
        source="Zebra FX7500, public log of static tags: two ports, each tag once a visit, 2-3 ms a tag, 13-18 ms a visit, 180-205 reads/s "
        "with 2 to 5 tags; RSSI in whole dBm, phase in 1/65536 turn, time in ms",
    ),
    "sargas": Profile(
        link=Link(tari=6.25e-6, blf=640e3, miller=2, pilot=False),
        between_rounds=2.3e-3,
        port_switch=10e-3,
        longest_visit=0.25,
        session=0,
        dual_target=True,
        start_q=0,
        sensitivity_dbm=-82.0,
        phase_turns=0.5,
        phase_steps=360,
        phase_sign=1,
        rssi_step_db=1.0,
        doppler_step_hz=1 / 16,
        time_step=1e-3,
        source="ThingMagic Sargas (M6e Micro): about 300 reads/s with Select on one tag; phase in whole degrees from 0 to 180, RSSI in "
        "whole dBm",
    ),
}


def profile(name: str, **changes: object) -> Profile:
    """A profile with some fields changed. ValueError, with the nearest name, for one nobody knows."""
    if name not in PROFILES:
        raise ValueError(f"unknown reader profile {name!r}{suggest(name, list(PROFILES))}")
    return replace(PROFILES[name], **changes)  # pyright: ignore[reportArgumentType]
