"""The player in the page, in a headless browser: it shows what the recording holds, by mouse and by keys."""

import base64
import copy
import shutil

import numpy as np
import pytest
from visits import Visit, drawn_at

import testbed
from testbed import archive, tables
from testbed.report import album, page, study, write


@pytest.mark.parametrize("t", [0.0, 3.7, 8.0, 16.0])
def test_every_mark_is_drawn_where_its_track_is(visit, first, t):
    """Within a pixel on the screen, between the file's own numbers and what the browser has drawn."""
    case, tracks, plan, _ = first
    frame = plan.frames[0]
    visit.do("t => testbedPlayer.seek(t)", t)
    checked = 0
    for id, track in tracks.items():
        k = round(t * 10)
        assert track.t[k] == pytest.approx(t)
        said = visit.do("id => testbedPlayer.position(id)", id)
        if track.status[k, 0] == 2:
            assert said == {"x": None, "y": None, "error": None, "status": "lost"}
            assert not visit.page.locator(f'[data-estimator="{id}"][data-target="0"]').is_visible()
            continue
        x, y = track.mean[k, 0, :2]
        assert (said["x"], said["y"]) == pytest.approx((x, y), abs=2e-3)
        at, pixels = drawn_at(visit, "plan-0", f'g[data-estimator="{id}"][data-target="0"] .mark')
        apart = (at - [frame.u0 + frame.u_scale * x, frame.v0 + frame.v_scale * y]) * pixels
        assert np.abs(apart).max() <= 1.0, (id, apart)
        checked += 1
    assert checked >= 2
    truth = case.trial.target_states(np.array([t]))[0, 0]
    at, pixels = drawn_at(visit, "plan-0", '.live-layer .truth[data-target="0"]')
    assert np.abs((at - [frame.u0 + frame.u_scale * truth[0], frame.v0 + frame.v_scale * truth[1]]) * pixels).max() <= 1.0


def test_between_two_reports_a_mark_is_on_the_line_between_them(visit, first):
    track = first[1]["ekf"]
    visit.do("testbedPlayer.seek(5.05)")
    said = visit.do("testbedPlayer.position('ekf')")
    assert (said["x"], said["y"]) == pytest.approx(tuple(track.mean[50:52, 0, :2].mean(axis=0)), abs=2e-3)


def test_the_ellipse_holds_95_percent(visit, first):
    visit.do("testbedPlayer.seek(4)")
    covariance = first[1]["ekf"].covariance[40, 0, :2, :2]
    values, vectors = np.linalg.eigh(covariance)
    scale = first[2].frames[0].u_scale
    rx, ry, turn = visit.do(
        """() => {
          const ring = document.querySelector('g[data-estimator="ekf"] .ring');
          const turn = ring.getAttribute('transform').match(/rotate\\((.*)\\)/)[1];
          return [ring.getAttribute('rx'), ring.getAttribute('ry'), turn].map(Number);
        }"""
    )
    assert (rx, ry) == pytest.approx(np.sqrt(5.991464547 * values[::-1]) * scale, abs=0.05)
    along = np.array([np.cos(np.radians(turn)), -np.sin(np.radians(turn))])  # the page's y points down
    assert abs(along @ vectors[:, 1]) == pytest.approx(1.0, abs=1e-3)


def test_the_error_curves_have_a_cursor_on_the_curve(visit, first):
    case, _, _, errors = first
    frame, line = errors.frames[0], case.aims[0].lines[0]
    visit.do("testbedPlayer.seek(6.4)")
    at, pixels = drawn_at(visit, "errors-0", '.live-layer .mark[data-estimator="ekf"]')
    expected = [frame.u0 + frame.u_scale * 6.4, frame.v0 + frame.v_scale * line.error[64]]
    assert np.abs((at - expected) * pixels).max() <= 1.0
    readout = visit.page.inner_text('[data-part="readout"] tr:first-child')
    assert f"{line.error[64]:.2f} m" in readout


def test_links_are_lit_when_antennas_read(visit, first):
    case = first[0]
    reads, tag = case.aims[0].reads, case.aims[0].tags[0]
    t = float(reads.t[len(reads) // 2])
    visit.do("t => testbedPlayer.seek(t + 0.01)", t)
    lit = visit.do("testbedPlayer.links()")
    recent = (reads.t <= t + 0.01) & (reads.t > t + 0.01 - 0.12)
    expected = {(str(case.antennas.id[a]), str(case.tagged.tags.id[tag])) for a in reads.antenna[recent]}
    assert {(one["antenna"], one["tag"]) for one in lit} == expected
    assert visit.do("document.querySelector('.live-layer .link:not(.other)').getAttribute('d')").count("M") == len(expected)
    visit.page.get_by_label("reads of other tags").check()
    others = case.reads.take((case.reads.t <= t + 0.01) & (case.reads.t > t + 0.01 - 0.12))
    assert len(visit.do("testbedPlayer.links()")) == len(set(zip(others.antenna.tolist(), others.tag.tolist(), strict=True)))


def test_an_estimator_can_be_hidden_everywhere(visit):
    visit.do("testbedPlayer.seek(5)")
    group = visit.page.locator('g[data-estimator="ekf"][data-target="0"]')
    assert group.is_visible()
    visit.page.get_by_role("checkbox", name="ekf").uncheck()
    assert not group.is_visible()
    assert not visit.page.locator('#plan-0 [data-layer="e0"]').first.is_visible()
    assert not visit.page.locator('#errors-0 [data-layer="e0"]').first.is_visible()
    assert visit.page.locator('#plan-0 [data-layer="e1"]').first.is_visible()
    visit.page.get_by_role("checkbox", name="ekf").check()
    assert group.is_visible()


def test_keys_step_play_and_change_the_speed(visit):
    page = visit.page
    page.locator("#player").focus()
    time = lambda: visit.do("testbedPlayer.time")  # noqa: E731
    for key, expected in [
        ("ArrowRight", 0.1),
        ("Shift+ArrowRight", 1.1),
        ("ArrowLeft", 1.0),
        ("End", 16.0),
        ("ArrowRight", 16.0),
        ("Home", 0.0),
        ("ArrowLeft", 0.0),
    ]:
        page.keyboard.press(key)
        assert time() == pytest.approx(expected), key
    page.keyboard.press("+")
    assert visit.do("testbedPlayer.speed") == 2
    page.keyboard.press("-")
    page.keyboard.press("-")
    assert visit.do("testbedPlayer.speed") == 0.5
    assert page.locator('[data-part="speed"]').input_value() == "0.5"
    page.keyboard.press("Space")
    assert visit.do("testbedPlayer.playing")
    assert page.locator('[data-part="play"]').inner_text() == "Pause"
    visit.wait("testbedPlayer.time > 0.05")
    page.keyboard.press("Space")
    assert not visit.do("testbedPlayer.playing")


def test_arrows_on_the_slider_step_like_anywhere_and_space_on_a_button_presses_it(visit):
    visit.page.locator('[data-part="time"]').focus()
    visit.page.keyboard.press("ArrowRight")
    assert visit.do("testbedPlayer.time") == pytest.approx(0.1)
    visit.page.locator('[data-part="play"]').focus()
    visit.page.keyboard.press("Space")
    assert visit.do("testbedPlayer.playing")


def test_the_mouse_scrubs_and_a_click_on_the_curve_goes_there(visit, first):
    page, frame = visit.page, first[3].frames[0]
    page.locator('[data-part="time"]').fill("7.25")
    assert visit.do("testbedPlayer.time") == pytest.approx(7.25)
    assert "7.25 s of 16.00 s" in page.inner_text('[data-part="clock"]')
    assert page.locator('[data-part="time"]').get_attribute("aria-valuetext") == "7.25 s"
    box = page.locator("#errors-0").bounding_box()
    scale = box["width"] / first[3].width
    page.locator("#errors-0").click(position={"x": (frame.u0 + frame.u_scale * 4.0) * scale, "y": (frame.top + frame.bottom) / 2 * scale})
    assert visit.do("testbedPlayer.time") == pytest.approx(4.0, abs=0.1)


def test_playing_stops_at_the_end_and_begins_again_from_there(visit):
    visit.do("testbedPlayer.setSpeed(16)")
    visit.do("testbedPlayer.seek(15.9)")
    visit.do("testbedPlayer.play()")
    visit.wait("!testbedPlayer.playing")
    assert visit.do("testbedPlayer.time") == 16
    visit.do("testbedPlayer.play()")
    assert visit.do("testbedPlayer.time") < 8


def test_nothing_moves_by_itself_and_little_where_people_want_no_motion(browser, demo):
    with Visit(browser, demo / "report.html", reduced_motion="reduce") as visit:
        assert not visit.do("testbedPlayer.playing")
        pictures = visit.do(
            """() => new Promise((done) => {
              const seen = new Set(), began = performance.now();
              testbedPlayer.play();
              const look = () => {
                seen.add(testbedPlayer.time);
                performance.now() - began < 1300 ? requestAnimationFrame(look) : done(seen.size);
              };
              look();
            })"""
        )
        assert 2 <= pictures <= 4  # one each half second
        moving = visit.page.get_by_alt_text("In motion").evaluate("(image) => image.currentSrc")
        assert b"ANIM" not in base64.b64decode(moving.partition(",")[2])


def test_everything_that_can_be_worked_has_a_name(visit):
    nameless = visit.do(
        """() => [...document.querySelectorAll('button, input, select, [role]')].filter((e) => e.checkVisibility()).filter((e) =>
             !(e.getAttribute('aria-label') || e.getAttribute('aria-labelledby') || e.textContent.trim() || (e.labels && e.labels.length)))
             .map((e) => e.outerHTML.slice(0, 80))"""
    )
    assert nameless == []


def test_several_targets_each_have_marks_of_their_own(browser, several):
    with Visit(browser, several / "report.html") as visit:
        targets = visit.do("testbedPlayer.targets")
        assert len(targets) == 3
        read = study.read(several)
        track = archive.load_tracks(read.recordings[0].folder)["ekf"]
        visit.do("testbedPlayer.seek(2)")
        for k, target in enumerate(targets):
            said = visit.do("k => testbedPlayer.position('ekf', k)", k)
            row = track.target.tolist().index(target)
            assert (said["x"], said["y"]) == pytest.approx(tuple(track.mean[8, row, :2]), abs=2e-3)
        assert visit.said == []


def test_a_hall_with_nothing_to_look_for_has_a_player_all_the_same(browser, tmp_path):
    document = copy.deepcopy(testbed.load("empty-floor").document)
    document |= {"targets": [], "actors": [{**document["actors"][0], "tags": []}], "cameras": []}
    folder = tmp_path / "bare"
    testbed.run({k: v for k, v in document.items() if k != "expect"}, trials=1, out=folder)
    with Visit(browser, write(folder)) as visit:
        assert visit.said == []
        assert visit.do("testbedPlayer.estimators") == []
        visit.do("testbedPlayer.seek(5)")
        first = visit.do("document.querySelector('.live-layer .body').getAttribute('d')")
        visit.do("testbedPlayer.seek(8)")
        assert visit.do("document.querySelector('.live-layer .body').getAttribute('d')") != first
        assert visit.said == []


def test_a_method_with_particles_shows_its_cloud_in_place_of_an_ellipse(browser, demo, first, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "album", lambda *_, **__: album.Album())
    folder = tmp_path / "cloud"
    shutil.copytree(demo, folder)
    kept = study.read(folder).recordings[0].folder
    track = archive.load_tracks(kept)["ekf"]
    cloud = track.mean[:, :, None, :3] + np.random.default_rng(4).normal(size=(len(track.t), 1, 50, 3))
    tables.write(track.with_(particles=cloud), kept / "tracks" / "ekf.parquet")
    with Visit(browser, write(folder)) as visit:
        visit.do("testbedPlayer.seek(5)")
        path = visit.page.locator('g[data-estimator="ekf"] .cloud')
        assert path.get_attribute("d").count("M") == 50
        box, scale = path.bounding_box(), visit.do("document.getElementById('plan-0').getScreenCTM().a")
        assert box["width"] / scale == pytest.approx(np.ptp(cloud[50, 0, :, 0]) * first[2].frames[0].u_scale, abs=3.0)
        assert not visit.page.locator('g[data-estimator="ekf"] .ring').is_visible()
        assert visit.page.locator('g[data-estimator="ukf"] .ring').is_visible()
        assert not visit.page.locator('g[data-estimator="ukf"] .cloud').is_visible()
