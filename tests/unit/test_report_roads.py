"""The report of a map-matching run: curves over all runs, settle times with lost runs kept, the cloud on the roads."""

import cv2
import numpy as np
import pytest
from road_recordings import PAPER

import testbed
from testbed.geometry import Roads
from testbed.report import cases, page
from testbed.report.album import Album
from testbed.report.cloud_motion import FRAMES, LIMIT, Sheet, cloud_motion
from testbed.report.figures import Styles
from testbed.report.figures_roads import curves, settle_times, settling
from testbed.report.study import read


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    document = {
        **PAPER,
        "trials": 2,
        "duration_s": "0.25 min",
        "estimators": [{"id": "paper", "kind": "mapmatch_particles"}],
        "sweep": {"estimators.paper.kappa": [1.0, 0.1]},
        "metrics": [{"kind": "position_error", "dims": 2}, {"kind": "road_segment"}, {"kind": "settle_time"}, {"kind": "error_curve"}],
    }
    out = tmp_path_factory.mktemp("run") / "out"
    testbed.run(document, out=out)
    return out


def test_the_page_shows_curves_settle_times_clouds_and_roads(folder, monkeypatch):
    monkeypatch.setattr(page, "album", lambda case, styles, moving: Album())  # what cameras see takes long, and has tests of its own
    text = page.page(read(folder))
    for name in ("curves", "settling", "clouds-0", "clouds-1"):
        assert f'id="{name}"' in text
    assert 'data-layer="roads"' in text
    assert "t = 0 s" in text
    assert "ray caster" not in text  # no antenna looks for a tag
    assert "The cloud in motion" in text
    assert "right road segment" in text
    assert "runs that never settle" in text
    assert "error curve, s00" not in text  # forty numbers a curve are drawn, not listed


def test_the_cloud_moves_along_the_roads_in_one_picture(folder):
    study = read(folder)
    picture = cloud_motion(cases.load(study, study.recordings[0]), Styles(study.estimators))
    assert picture is not None
    assert len(picture.content) <= LIMIT
    done, animation = cv2.imdecodeanimation(np.frombuffer(picture.content, dtype=np.uint8))
    assert done
    frames = np.array([frame[..., :3] for frame in animation.frames])
    assert frames.shape == (FRAMES, picture.height, picture.width, 3)
    assert np.ptp(frames[[0, -1]].astype(int), axis=0).max() > 100  # the cloud has left where it was
    assert "first 15 s" in picture.caption


def test_a_sheet_keeps_directions_and_scale():
    sheet = Sheet.of(Roads(np.array([[2.0, 1.0], [10.0, 1.0], [10.0, 5.0]]), np.array([[0, 1], [1, 2]])))
    corner, right, top = sheet.px(np.array([[2.0, 1.0], [10.0, 1.0], [10.0, 5.0]]))
    assert right[0] > corner[0]
    assert right[1] == corner[1]
    assert right[1] - top[1] == pytest.approx((right[0] - corner[0]) / 2, abs=1)


def test_the_curves_are_means_over_trials(folder):
    study = read(folder)
    drawn = curves(study, "c")
    assert drawn is not None
    assert "estimators.paper.kappa = 0.1" in drawn.svg
    here = study.rows["point"] == 0
    assert np.isfinite(study.rows["error_curve_m.s00"][here]).all()


def test_lost_runs_are_kept_as_never(folder):
    rows = {"settle_s": np.array([12.0, np.nan, 3.0, np.nan]), "lost_runs": np.array([0.0, 1.0, 0.0, np.nan])}
    np.testing.assert_array_equal(settle_times(rows, np.ones(4, dtype=bool)), [3.0, 12.0, np.inf])
    drawn = settling(read(folder), "s")
    assert drawn is not None
    assert "median" in drawn.caption
    assert "runs lost" in drawn.caption
