"""What a scenario expects of its results."""

import math

import pytest

from testbed.scenario import Claim, ScenarioError, from_dict, from_text, only


def told(document):
    with pytest.raises(ScenarioError) as caught:
        from_dict(document)
    return str(caught.value)


def test_claims_are_read_in_the_order_of_the_file_and_told_in_a_line(fakes, document):
    assert [claim.text for claim in from_dict(document).expect] == [
        "fast.position_error_m.mean <= 0.35",
        "fast.availability >= 0.9",
        "(ekf - fast).position_error_m.mean >= 0",
        "world.line_of_sight >= 0.3",
        "world.line_of_sight <= 0.7",
    ]


def test_a_claim_has_the_subject_metric_statistic_and_bound_that_were_written(fakes, document):
    first, share, paired, low, _ = from_dict(document).expect
    assert first == Claim("fast", "position_error_m", "mean", "max", 0.35)
    assert (first.column, first.estimators) == ("position_error_m.mean", ("fast",))
    assert (share.statistic, share.column) == ("", "availability")
    assert (paired.subject, paired.estimators) == ("ekf - fast", ("ekf", "fast"))
    assert (low.subject, low.metric, low.estimators) == ("world", "line_of_sight", ())


def test_claims_keep_their_lines(fakes):
    text = (
        "name: d\nseed: 1\ntrials: 1\nduration_s: 1\nworld: {kind: hall}\nestimators: [{kind: ekf}]\n"
        "expect:\n  ekf:\n    position_error_m:\n      mean: {max: 1}\n      p95:\n        max: 2\n    availability: {min: 0}\n"
    )
    assert [claim.line for claim in from_text(text).expect] == [10, 12, 13]
    assert [claim.line for claim in from_text(text, sets=["expect.ekf.availability.min=0.5"]).expect] == [10, 12, None]


@pytest.mark.parametrize(("bound", "value", "holds"), [("min", 1.0, True), ("min", 0.9, False), ("max", 1.0, True), ("max", 1.1, False)])
def test_a_bound_holds_up_to_and_with_its_value(bound, value, holds):
    assert Claim("ekf", "m", "", bound, 1.0).holds(value) is holds
    assert not Claim("ekf", "m", "", bound, 1.0).holds(math.nan)


def test_spaces_in_a_difference_do_not_matter(fakes, document):
    document["expect"] = {" ekf  -  fast ": {"availability": {"min": 0}}}
    assert from_dict(document).expect[0].subject == "ekf - fast"


def test_an_id_with_a_hyphen_is_no_difference(fakes, document):
    document["estimators"][1]["id"] = "ekf-fast"
    document["expect"] = {"ekf-fast": {"availability": {"min": 0}}, "ekf - ekf-fast": {"availability": {"max": 1}}}
    assert [c.estimators for c in from_dict(document).expect] == [("ekf-fast",), ("ekf", "ekf-fast")]


@pytest.mark.parametrize(
    ("expect", "sentence"),
    [
        ({"fst": {"availability": {"min": 0}}}, "expect.fst: no estimator has the id 'fst', did you mean fast?"),
        ({"ekf - fst": {"availability": {"min": 0}}}, "expect.ekf - fst: no estimator has the id 'fst', did you mean fast?"),
        ({"ekf - ekf": {"availability": {"min": 0}}}, "expect.ekf - ekf: two estimators are compared"),
        ({"ekf - fast - ekf": {"availability": {"min": 0}}}, "two estimators are compared"),
        ({"ekf": {"availabilty": {"min": 0}}}, "expect.ekf.availabilty: no metric computes 'availabilty', did you mean availability?"),
        ({"ekf": {"position_error_m": {"p96": {"max": 1}}}}, "p96: position_error_m has no statistic 'p96', did you mean p95?"),
        ({"ekf": {"position_error_m": {"max": 1}}}, "position_error_m: position_error_m has several statistics: name one of mean, p95"),
        ({"ekf": {"availability": {"mean": {"min": 1}}}}, "expect.ekf.availability.mean: availability is one figure"),
        ({"ekf": {"availability": {"mni": 1}}}, "expect.ekf.availability.mni: bounds are wanted, as in {max: 0.35}, did you mean min?"),
        ({"ekf": {"availability": {"min": "much"}}}, "expect.ekf.availability.min: a number is wanted, not 'much'"),
        ({"ekf": {"availability": {"min": True}}}, "expect.ekf.availability.min: a number is wanted, not true"),
        ({"ekf": {"availability": 0.9}}, "expect.ekf.availability: bounds are wanted"),
        ({"ekf": {"availability": {}}}, "expect.ekf.availability: bounds are wanted"),
        ({"ekf": 0.9}, "expect.ekf: a mapping of metrics is wanted"),
        ({"ekf": {"position_error_m": {"mean": {"max": 1, "mx": 2}}}}, "position_error_m.mean.mx: a bound is min or max, not mx"),
        ({"ekf": {"availability": {"min": 0.9, "max": 0.1}}}, "expect.ekf.availability: nothing is at least 0.9 and at most 0.1"),
        ({"world": {"line_of_sight": {"mean": {"min": 0}}}}, "expect.world.line_of_sight.mean: line_of_sight of the world is one figure"),
        ([1], "expect: a mapping (key: value) is wanted, not a list"),
    ],
)  # fmt: skip
def test_a_wrong_claim_is_told_in_a_sentence(fakes, document, expect, sentence):
    message = told({**document, "expect": expect})
    assert f"<dict> {sentence}" in message or sentence in message
    assert len(message.splitlines()) == 1


def test_claims_on_metrics_are_taken_as_they_are_where_no_metric_says_what_it_computes(fakes, document):
    fakes["metrics"].clear()
    document["expect"] = {"ekf": {"anything": {"at_all": {"max": 1}}}}
    assert from_dict(document).expect[0].column == "anything.at_all"


def test_a_claim_on_an_estimator_that_is_wrong_itself_is_no_second_mistake(fakes, document):
    document["estimators"][1]["gate"] = 7
    assert told(document) == "<dict> estimators.1.gate: must be less than 1, is 7"


def test_only_metrics_that_the_scenario_names_can_be_claimed(fakes, document):
    document["metrics"] = [{"kind": "availability"}]
    document["expect"] = {"ekf": {"position_error_m": {"mean": {"max": 1}}}}
    assert "no metric computes 'position_error_m'; there are availability" in told(document)


def test_a_share_of_trials_is_a_subject_of_its_own(fakes, document):
    document["expect"] = {"ekf  >  fast": {"availability": {"min": 0.8}}}
    (claim,) = from_dict(document).expect
    assert (claim.subject, claim.estimators, claim.is_difference) == ("ekf > fast", ("ekf", "fast"), False)
    assert claim.text == "(ekf > fast).availability >= 0.8"
    assert only(from_dict(document), ["ekf"]).expect == ()


def test_three_estimators_are_not_compared_at_once(fakes, document):
    document["expect"] = {"ekf > fast > ekf": {"availability": {"min": 0.8}}}
    assert 'two estimators are compared, as in "ekf - ukf" or "ekf > ukf"' in told(document)
