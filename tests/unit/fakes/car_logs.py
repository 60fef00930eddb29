"""Logs of a car in the text of libRSF: a circle on the sphere about 52° north."""

import numpy as np

EARTH = 6_378_137.0


def place(east, north):
    """A place on the sphere about 52° north, 13° east, by small angles."""
    lat, lon = np.deg2rad(52.0) + north / EARTH, np.deg2rad(13.0) + east / (EARTH * np.cos(np.deg2rad(52.0)))
    return EARTH * np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def written(folder, odometer, truth):
    a, b = folder / "odometer.txt", folder / "truth.txt"
    a.write_text("\n".join(odometer) + "\n")
    b.write_text("\n".join(truth) + "\n")
    return a, b


def circle(folder, turn=0.1, speed=5.0, first=3.0):
    """A car that drives a circle from the origin, eastwards, its clock beginning at `first` s."""
    t = np.arange(0, 20.01, 0.2)
    radius = speed / turn
    odometer = [f"odom3 {first + s} {speed} 0 0 0 0 {turn} 1 1 1 1 1 1" for s in t]
    points = [place(radius * np.sin(turn * s), radius * (1 - np.cos(turn * s))) for s in t]
    return written(folder, odometer, [f"point3 {first + s} {p[0]:.6f} {p[1]:.6f} {p[2]:.6f} 0 0" for s, p in zip(t, points, strict=True)])
