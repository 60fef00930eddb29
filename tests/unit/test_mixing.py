"""The compiled draws of rows are those of the plain functions, bit for bit."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed.mixing import row_uniforms
from testbed.rng import RowRandom, mix, uniform_of

WORD = st.integers(0, 2**64 - 1)


@settings(deadline=None)
@given(st.lists(st.tuples(WORD, WORD), min_size=1, max_size=4), st.integers(0, 40))
def test_every_draw_is_that_of_mix(rows, n):
    seed, first = (np.array(column, dtype=np.uint64) for column in zip(*rows, strict=True))
    with np.errstate(over="ignore"):
        index = first[:, None] + np.arange(n, dtype=np.uint64)
    np.testing.assert_array_equal(row_uniforms(seed, first, n), uniform_of(mix(seed[:, None], index)))


def test_rows_go_on_where_they_stopped():
    one, parts = RowRandom([3, 4]), RowRandom([3, 4])
    whole = one.uniform(7)
    np.testing.assert_array_equal(whole, np.concatenate([parts.uniform(3), parts.uniform(4)], axis=1))
    np.testing.assert_array_equal(whole, uniform_of(mix(np.array([[3], [4]], dtype=np.uint64), np.arange(7))))
    np.testing.assert_array_equal(RowRandom([3, 4]).uniform(7, np.array([1]))[0], whole[1])
