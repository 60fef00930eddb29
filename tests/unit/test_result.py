"""What a run hands back to Python and shows in a notebook, and how the command asks for it."""

import xml.etree.ElementTree as ET

import numpy as np
import pyarrow as pa
import pytest
from batch_fakes import scenario, work

from testbed import batch, pool
from testbed.batch import run
from testbed.cli import main
from testbed.until import Until

CLAIMS = {"ekf": {"position_error_m": {"mean": {"max": 0.01}}, "availability": {"min": 0.5}}}


@pytest.fixture(scope="module")
def result():
    return run(scenario(title="<b>bold</b>=1", expect=CLAIMS), work=work)


def test_the_table_is_arrow_with_plain_columns(result):
    table = result.table
    assert isinstance(table, pa.Table)
    assert table.num_rows == len(result.rows["trial"])
    assert table.column_names == list(result.rows)
    kinds = {str(table.schema.field(name).type) for name in table.column_names}
    assert kinds <= {"int64", "double", "string"}  # what pandas takes as it is
    np.testing.assert_array_equal(table.column("position_error_m.mean").to_numpy(), result.rows["position_error_m.mean"])
    assert table.column("estimator").to_pylist() == result.rows["estimator"].tolist()


def test_pandas_reads_the_table(result):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    frame = result.table.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert frame.groupby("estimator")["position_error_m.mean"].mean()["ekf"] == pytest.approx(
        result.summaries[0].statistics["position_error_m.mean"].mean
    )


def test_a_notebook_gets_a_table_with_names_escaped_and_broken_claims(result):
    markup = result._repr_html_()
    ET.fromstring(markup)  # well formed
    assert "&lt;b&gt;bold&lt;/b&gt;=1" in markup
    assert markup.count("<tr>") == 1 + 2
    assert "<th>mean error m</th>" in markup
    assert "1 of 2 claims hold" in markup
    assert "ekf.position_error_m.mean &lt;= 0.01: got 0." in markup


def test_of_a_long_sweep_a_notebook_gets_the_first_points():
    swept = run(scenario(trials=1, sweep={"world.length_m": list(range(5, 20))}), work=work)
    markup = swept._repr_html_()
    assert markup.count("<table>") == 12
    assert "and 3 more points" in markup
    assert "15 points" in repr(swept)


def test_repr_says_what_was_found_in_a_line(result):
    assert repr(result).startswith("<RunResult fake: 10 trials, 0 failures, 1 of 2 claims hold; ekf 0.")
    assert "±" in repr(result)


@pytest.mark.parametrize(
    ("words", "jobs", "apart"),
    [((), "auto", True), (("--jobs", "1"), 1, True), (("--jobs", "3"), 3, True), (("--jobs", "0"), 1, False)],
    ids=["auto", "one", "three", "this process"],
)
def test_the_command_works_in_processes_apart_unless_told_otherwise(monkeypatch, words, jobs, apart):
    asked = {}

    def noted(one, **options):
        asked.update(options)
        raise SystemExit(0)

    monkeypatch.setattr(batch, "run", noted)
    with pytest.raises(SystemExit):
        main(["run", "empty-floor", *words, "--until", "ukf.position_error_m.mean +- 2%", "--max-trials", "50"])
    assert asked["jobs"] == jobs
    assert asked.get("executors") is (pool.Workers if apart else None)
    assert asked["until"] == Until.parse("ukf.position_error_m.mean +- 2%", 50)


@pytest.mark.parametrize(
    ("words", "why"),
    [(("--until", "soon"), "--until: 'soon' does not say until when"), (("--cluster", "here"), "no cluster 'here': it is tcp://HOST:PORT")],
)
def test_what_the_command_cannot_do_is_one_sentence(monkeypatch, capsys, tmp_path, words, why):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as leaving:
        main(["run", "empty-floor", *words])
    assert leaving.value.code == 2
    assert why in capsys.readouterr().err
