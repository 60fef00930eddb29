"""The reference tags that sound like a tag: k nearest neighbours in signal space.

L. M. Ni, Y. Liu, Y. C. Lau, A. P. Patil, "LANDMARC: indoor location sensing using active RFID", Wireless Networks 10 (2004), Eqs. 1-3.
"""

from __future__ import annotations

import numpy as np

from testbed.types import Array, Site

UNHEARD_DB = 12.0  # what counts as apart where an antenna hears one of the two alone: about the spread of levels at the edge of range
LEAST = 1e-9  # dB²: an exact match takes all the weight, and stays finite


def nearest(tag: Array, reference: Array, k: int) -> tuple[Array, Array]:
    """Indices (E, k) of the k references nearest in signal space, nearest first, and weights (E, k) as 1 / e², summing to 1.

    tag (E, M) and reference (E, R, M) dBm, NaN where not heard. An antenna that hears neither says nothing. NaN weights for a tag
    that nobody heard, or where no reference was.
    """
    apart = tag[:, None] - reference
    one_alone = np.isnan(tag)[:, None] ^ np.isnan(reference)
    apart = np.where(one_alone, UNHEARD_DB, np.nan_to_num(apart))
    squared = np.einsum("erm,erm->er", apart, apart)
    silent = np.isnan(reference).all(axis=2)
    squared = np.where(silent, np.inf, squared)  # a reference that nobody heard is nobody's neighbour
    order = np.argsort(squared, axis=1, kind="stable")[:, :k]
    inverse = 1.0 / np.maximum(np.take_along_axis(squared, order, axis=1), LEAST)
    total = inverse.sum(axis=1, keepdims=True)
    known = np.isfinite(tag).any(axis=1, keepdims=True) & (total > 0)
    return order, np.divide(inverse, total, out=np.full(inverse.shape, np.nan), where=known)


def enough_references(site: Site, k: int, method: str) -> None:
    """ValueError where the site has fewer than k reference tags."""
    if len(site.references) < k:
        raise ValueError(f"{method}: {k} neighbours are wanted, and the site has {len(site.references)} reference tags")
