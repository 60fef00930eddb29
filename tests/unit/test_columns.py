import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.types import Estimate, Reads


def reads(n):
    return Reads(t=np.arange(n) / 10, t_arrival=np.arange(n) / 10, antenna=np.arange(n), tag=np.zeros(n))


def test_a_column_of_another_length_is_named():
    with pytest.raises(ValueError, match=r"Reads\.t_arrival: N is 1 here and 2 in t"):
        Reads(t=[0, 1], t_arrival=[0], antenna=[0, 1], tag=[0, 0])


def test_a_column_of_another_rank_is_named():
    with pytest.raises(ValueError, match=r"Estimate\.mean: wants shape"):
        Estimate(components=("x",), mean=np.zeros(3), covariance=np.zeros((3, 1, 1)))


def test_a_column_that_is_no_number_is_named():
    with pytest.raises(ValueError, match=r"Reads\.t: cannot be read as float64"):
        Reads(t=["soon"], t_arrival=[0], antenna=[0], tag=[0])


def test_columns_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        reads(3).t[0] = 1.0


def test_what_a_reader_does_not_report_is_nan():
    assert np.isnan(reads(2).phase).all()


@given(st.lists(st.integers(0, 5), max_size=6))
def test_joined_parts_are_the_whole(sizes):
    whole = Reads.concatenate([reads(n) for n in sizes])
    assert len(whole) == sum(sizes)
    cut = Reads.concatenate([whole.take(slice(0, 3)), whole.take(slice(3, None))])
    assert cut.equals(whole)


def test_equality_sees_a_single_bit():
    a = reads(3)
    assert a.equals(reads(3))
    assert not a.equals(a.with_(t=np.nextafter(a.t, 1)))
