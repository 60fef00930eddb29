"""Figures of a report: that what is drawn is where the numbers say, that markup can share a page, that labels keep apart."""

import re
import xml.etree.ElementTree as ET

import matplotlib
import numpy as np
import pytest
import report_fakes as fakes

from testbed.report import cases, palette, study
from testbed.report.figures import Styles, dots, drawing, frame_of, is_wide, log_axis, new, settle, shorten, styled
from testbed.report.figures_plan import floor_plan, numbers
from testbed.report.figures_run import error_distribution, spelled, sweep
from testbed.report.figures_time import _spans, _thinned, consistency, error_over_time, signal_strength
from testbed.report.labels import Label, around, place
from testbed.types import Status


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return study.read(fakes.quick(tmp_path_factory.mktemp("run") / "out", keep="first:2"))


@pytest.fixture(scope="module")
def case(run):
    return cases.load(run, run.recordings[0])


@pytest.fixture(scope="module")
def styles(run):
    return Styles(run.estimators)


@pytest.fixture(scope="module")
def everything(run, case, styles):
    figures = [
        floor_plan(case, styles, "plan-0", "Trial 0"),
        error_over_time(case, styles, "errors-0", "Trial 0"),
        signal_strength(case, "rssi-0", "Trial 0"),
        consistency(case, styles, "nees-0", "Trial 0"),
        error_distribution(run, 0, [case], styles, "distribution-0"),
    ]
    return {figure.name: figure for figure in figures}


def tree(figure):
    return ET.fromstring(figure.svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1))


def points(path):
    return np.array([float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", path)]).reshape(-1, 2)


def layer(figure, name):
    """The points of the path(s) of a layer."""
    groups = [g for g in tree(figure).iter() if g.get("data-layer") == name]
    return np.concatenate([points(p.get("d")) for g in groups for p in g.iter() if p.tag.endswith("}path") and p.get("d")][:1])


# ---------------------------------------------------------------- what is drawn


def test_a_track_is_drawn_where_the_frame_says(everything, case):
    """The player draws by the frame, matplotlib by its own transform: both must put a track's end at the same point."""
    figure = everything["plan-0"]
    frame, line = figure.frames[0], case.aims[0].lines[0]
    drawn = layer(figure, "e0")
    x, y = line.position[-1]
    assert drawn[-1] == pytest.approx([frame.u0 + frame.u_scale * x, frame.v0 + frame.v_scale * y], abs=0.02)
    x, y = line.position[0]
    assert drawn[0] == pytest.approx([frame.u0 + frame.u_scale * x, frame.v0 + frame.v_scale * y], abs=0.02)


def test_a_metre_is_as_long_both_ways_on_the_plan(everything):
    frame = everything["plan-0"].frames[0]
    assert frame.u_scale == pytest.approx(-frame.v_scale, rel=1e-6)


def test_the_error_curve_is_the_error(everything, case):
    frame, line = everything["errors-0"].frames[0], case.aims[0].lines[0]
    drawn = layer(everything["errors-0"], "e0")
    expected = np.stack([frame.u0 + frame.u_scale * line.t, frame.v0 + frame.v_scale * line.error], axis=1)
    apart = np.linalg.norm(drawn[:, None] - expected, axis=2)
    assert apart.min(axis=1).max() < 0.2  # every point drawn is one of the track's (matplotlib leaves out those on a straight line)
    assert drawn[[0, -1]] == pytest.approx(expected[[0, -1]], abs=0.02)


@styled
def frame_on_a_log_axis():
    figure = new(2.0, "log")
    axes = figure.add_subplot()
    values = np.array([0.1, 1.0, 500.0])
    axes.plot([0, 1, 2], values)[0].set_gid("layer.e0")
    log_axis(axes, values)
    settle(figure)
    return drawing(figure, "log", "log", "", frames=[frame_of(axes)])


def test_the_frame_of_a_logarithmic_axis():
    figure = frame_on_a_log_axis()
    frame, drawn = figure.frames[0], layer(figure, "e0")
    assert frame.log
    for (u, v), x, y in zip(drawn, [0, 1, 2], [0.1, 1.0, 500.0], strict=True):
        assert (frame.u0 + frame.u_scale * x, frame.v0 + frame.v_scale * np.log10(y)) == pytest.approx((u, v), abs=0.02)


@pytest.mark.parametrize("kind", ["plan-0", "errors-0", "rssi-0", "nees-0", "distribution-0"])
def test_every_figure_has_a_title_a_description_and_units(everything, kind):
    figure = everything[kind]
    texts = ["".join(t.itertext()) for t in tree(figure).iter() if t.tag.endswith("}text")]
    assert figure.title in texts
    assert figure.caption
    assert f'aria-labelledby="{kind}-title {kind}-desc"' in figure.svg
    units = {
        "plan-0": ["x (m)", "y (m)"],
        "errors-0": ["error (m)", "time (s)"],
        "rssi-0": ["RSSI (dBm)", "time (s)"],
        "nees-0": ["NEES", "time (s)"],
        "distribution-0": ["mean error of a trial (m)", "share of trials"],
    }
    assert set(units[kind]) <= set(texts)
    if kind not in ("rssi-0",):
        assert {"ekf", "ukf", "centroid"} <= set(texts)  # the legend


def test_lines_differ_by_more_than_colour():
    styles = Styles([f"e{i}" for i in range(9)])
    looks = [(str(styles.line(id)["linestyle"]), styles.line(id)["marker"]) for id in styles.ids[:6]]
    assert len(set(looks)) == 6
    assert len({(styles.colour(id), str(styles.dash(id)), styles.marker(id)) for id in styles.ids}) == 9
    assert styles.colour("e0") == palette.ESTIMATORS[0]


# ---------------------------------------------------------------- markup


def test_ids_are_unique_over_all_figures_and_references_lead_somewhere(everything):
    whole = "".join(figure.svg for figure in everything.values())
    ids = re.findall(r' id="([^"]+)"', whole)
    assert len(ids) == len(set(ids))
    referred = set(re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', whole))
    assert {a or b for a, b in referred} <= set(ids)
    assert referred


def test_no_figure_styles_the_page_or_names_an_address(everything):
    for figure in everything.values():
        assert "<style" not in figure.svg
        assert "http" not in figure.svg
        assert "font-family" not in figure.svg
        assert "xlink" not in figure.svg


def test_ink_and_paper_follow_the_page(everything):
    for figure in everything.values():
        assert "var(--ink, #1f2430)" in figure.svg.lower()
        bare = re.sub(r"var\([^)]*\)", "", figure.svg)
        assert palette.INK.lower() not in bare.lower()


def test_the_same_data_give_the_same_bytes_whatever_the_users_settings(case, styles, everything):
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "red", "svg.fonttype": "path"}):
        again = floor_plan(case, styles, "plan-0", "Trial 0")
        assert matplotlib.rcParams["font.size"] == 30
    assert again == everything["plan-0"]


@styled
def figure_with_names(names):
    figure = new(2.0, names[0])
    axes = figure.add_subplot()
    axes.set(xlabel=names[1])
    settle(figure)
    return drawing(figure, "odd", names[0], names[1])


def test_names_with_dollars_and_brackets_are_only_names():
    figure = figure_with_names(["cost $x$ <b>", 'a "quoted" & b$'])
    texts = ["".join(t.itertext()) for t in tree(figure).iter() if t.tag.endswith("}text")]
    assert {"cost $x$ <b>", 'a "quoted" & b$'} <= set(texts)


# ---------------------------------------------------------------- labels


@styled
def labelled(labels):
    figure = new(3.0, "labels", 3.0)
    axes = figure.add_subplot()
    axes.set(xlim=(0, 10), ylim=(0, 10))
    settle(figure)
    homeless = place(axes, labels)
    renderer = figure.canvas.get_renderer()
    return homeless, [t.get_window_extent(renderer) for t in axes.texts], axes.get_window_extent(renderer)


def test_labels_in_a_crowd_keep_apart_or_stay_away():
    crowd = [Label(f"name{i}", [(5.0 + 0.1 * i, 5.0)], around(12.0)) for i in range(20)]
    homeless, boxes, _ = labelled(crowd)
    assert len(homeless) + len(boxes) == 20
    assert homeless
    assert boxes
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_a_label_at_the_rim_stays_inside_and_the_first_one_wins():
    homeless, boxes, inside = labelled([Label("a long label", [(9.9, 9.9), (5.0, 5.0)]), Label("second", [(5.0, 5.0)])])
    assert homeless == ["second"]
    assert boxes[0].x1 <= inside.x1
    assert boxes[0].y1 <= inside.y1


# ---------------------------------------------------------------- small things


def test_spans_join_neighbours_and_keep_gaps():
    assert np.array(_spans(np.array([0.0, 0.1, 0.2, 0.5]), 0.1, 0.52)) == pytest.approx(np.array([[0.0, 0.25], [0.45, 0.52]]))
    assert _spans(np.empty(0), 0.1, 1.0) == []


def test_dots_that_fall_together_are_drawn_once():
    t = np.repeat(np.linspace(0, 9.99, 50), 1000)
    shown, _ = _thinned(t, np.full(len(t), -50.0), 10.0, -80.0, -40.0)
    assert len(shown) == 50


@styled
def dotted():
    figure = new(2.0, "dots")
    axes = figure.add_subplot()
    axes.set(xlim=(0, 3), ylim=(0, 3))
    dots(axes, np.array([1.0, 2.0]), np.array([1.0, 2.0]), "#0072B2")
    axes.patches[-1].set_gid("layer.dots")
    settle(figure)
    return drawing(figure, "dots", "dots", "")


def test_dots_are_strokes_of_no_length_that_survive():
    assert len(layer(dotted(), "dots")) == 4


def test_antennas_are_numbered_in_runs():
    assert numbers([0, 1, 2, 6]) == "1–3, 7"
    assert numbers([4]) == "5"


@pytest.mark.parametrize(
    ("column", "text"),
    [
        ("position_error_m.mean", "position error, mean (m)"),
        ("availability", "availability"),
        ("nees.inside_95", "nees, inside 95"),
        ("time_lost_s.total", "time lost, total (s)"),
        ("target_reads_hz", "target reads (Hz)"),
    ],
)
def test_columns_are_spelled_with_their_units(column, text):
    assert spelled(column) == text


def test_a_few_huge_values_ask_for_a_logarithmic_axis():
    assert is_wide(np.array([0.1, 0.2, 0.3, 1000.0, np.nan]))
    assert not is_wide(np.array([0.1, 0.2, 0.3, 2.0]))
    assert not is_wide(np.array([np.nan]))


def test_long_names_lose_their_middle():
    assert shorten("abcdefghij", 5) == "ab…ij"
    assert shorten("abc", 5) == "abc"


# ---------------------------------------------------------------- rare runs


@pytest.fixture
def bent(tmp_path):
    def make(estimator, change):
        folder = fakes.quick(tmp_path / "bent", trials=1)
        fakes.rewrite(folder, estimator, change)
        read = study.read(folder)
        return cases.load(read, read.recordings[0]), Styles(read.estimators)

    return make


def all_figures(case, styles):
    return [
        floor_plan(case, styles, "p", ""),
        error_over_time(case, styles, "e", ""),
        signal_strength(case, "r", ""),
        consistency(case, styles, "n", ""),
    ]


def test_a_track_of_nan_leaves_a_gap_and_no_nonsense(bent):
    def lost(track):
        mean, status = track.mean.copy(), track.status.copy()
        mean[10:], status[10:20] = np.nan, Status.LOST
        return track.with_(mean=mean, status=status)

    case, styles = bent("ekf", lost)
    line = case.aims[0].lines[0]
    assert np.isnan(line.error[10:]).all()
    assert np.isnan(line.position[10:]).all()
    assert np.isfinite(line.error[:10]).all()
    assert not [f.name for f in all_figures(case, styles) if "nan" in re.sub(r"<desc.*?</desc>", "", f.svg, flags=re.DOTALL).lower()]


def test_a_track_of_the_plane_is_judged_on_the_floor(bent):
    case, styles = bent("ekf", lambda t: t.with_(components=("x", "y"), mean=t.mean[..., :2], covariance=t.covariance[..., :2, :2]))
    line = case.aims[0].lines[0]
    assert (line.dims, line.dof) == (2, 2)
    truth = case.trial.target_states(line.t)[:, 0, :2]
    assert line.error == pytest.approx(np.linalg.norm(line.position - truth, axis=1))
    assert "error (m), 2-D or 3-D" in error_over_time(case, styles, "e", "").svg
    assert "Components judged: 2 of ekf; 3 of centroid; 6 of ukf." in consistency(case, styles, "n", "").caption


def test_a_track_without_places_is_not_drawn_on_the_plan(bent):
    case, styles = bent("ekf", lambda t: t.with_(components=("vx", "vy"), mean=t.mean[..., 3:5], covariance=t.covariance[..., 3:5, 3:5]))
    line = case.aims[0].lines[0]
    assert np.isnan(line.position).all()
    assert np.isfinite(line.nees).any()
    assert all(all_figures(case, styles))


def test_a_track_that_ran_away_is_told_of_and_does_not_shrink_the_hall(bent):
    def away(track):
        mean = track.mean.copy()
        mean[20:, :, 0] += 1e7
        return track.with_(mean=mean)

    case, styles = bent("ekf", away)
    figure = floor_plan(case, styles, "p", "")
    assert "21 estimates of ekf lie outside this plan." in figure.caption
    assert figure.frames[0].u_scale > 10  # points a metre
    assert error_over_time(case, styles, "e", "").frames[0].log


def test_a_covariance_that_is_none_has_no_ellipse_and_no_nees(bent):
    case, styles = bent("ekf", lambda t: t.with_(covariance=-t.covariance))
    assert np.isnan(case.aims[0].lines[0].nees).all()
    assert all(all_figures(case, styles))


def test_without_reads_there_is_no_signal_strength(tmp_path):
    read = study.read(fakes.quick(tmp_path / "silent", {"world": {"kind": "open_floor", "posts": 0}, "sensors": []}, trials=1))
    case = cases.load(read, read.recordings[0])
    assert signal_strength(case, "r", "") is None
    assert "no antenna" in error_over_time(case, Styles(read.estimators), "e", "").svg


def test_a_sweep_is_drawn_with_its_intervals(tmp_path):
    read = study.read(fakes.quick(tmp_path / "swept", {"sweep": {"report_hz": [2, 5], "prior.position_std_m": [0.5, 1.0]}}, keep="none"))
    figure = sweep(read, Styles(read.estimators), "sweep")
    texts = ["".join(t.itertext()) for t in tree(figure).iter() if t.tag.endswith("}text")]
    assert "position error, mean (m)" in texts
    assert {"position_std_m = 0.5", "position_std_m = 1.0", "report_hz", "2", "5"} <= set(texts)
    assert "3 a point) with 95 % confidence intervals" in figure.caption


def test_one_point_is_no_sweep_and_one_trial_no_distribution_over_trials(run, case, styles, tmp_path):
    assert sweep(run, styles, "s") is None
    one = study.read(fakes.quick(tmp_path / "one", trials=1, keep="none"))
    assert error_distribution(one, 0, [], styles, "d") is None
    alone = error_distribution(one, 0, [case], styles, "d")
    assert "share of trials" not in alone.svg
    assert "share of times" in alone.svg
