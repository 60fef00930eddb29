"""YAML text to plain values with places, and the limits that a stranger's file must keep."""

import contextlib
import json
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from testbed.scenario import nodes
from testbed.scenario.nodes import MAX_BYTES, MAX_DEPTH, MAX_NODES, checked, read
from testbed.scenario.problems import ScenarioError


def plain(text):
    return read(text, "f.yaml").plain()


def complaint(text):
    with pytest.raises(ScenarioError) as caught:
        read(text, "f.yaml")
    return str(caught.value)


def test_every_key_and_value_knows_its_line_and_column():
    root = read("a: 1\nb:\n  - {c: [x, yy]}\n  -   d:   7\n", "f.yaml")
    assert root.place(("b", 0, "c", 1)) == (3, 13)
    assert root.place(("b", 0, "c"), at_key=True) == (3, 6)
    assert root.place(("b", 1, "d")) == (4, 12)
    assert root.place(("b", 1, "d"), at_key=True) == (4, 7)
    assert root.place(("b", 1, "missing", 3)) == (4, 7), "what is not written is placed at what encloses it"
    assert root.place(()) == (1, 1)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0", 0), ("-17", -17), ("+3", 3), ("010", 10), ("0o17", 15), ("0x1F", 31), ("1.5", 1.5), ("1e3", 1000.0), (".5", 0.5), ("5.", 5.0),
        ("-1.5E-2", -0.015), ("true", True), ("False", False), ("null", None), ("~", None), ("", None), ("on", "on"), ("yes", "yes"),
        ("'1'", "1"), ('"true"', "true"), ("2001-01-01", "2001-01-01"), ("1:30", "1:30"), ("1_000", "1_000"), ("e3", "e3"), (".", "."),
        ("3 km/h", "3 km/h"), ("[1, a]", [1, "a"]), ("{1: x, true: y}", {"1": "x", "true": "y"}), ("|\n  two\n  lines\n", "two\nlines\n"),
    ],
)  # fmt: skip
def test_scalars_are_those_of_yaml_1_2(text, value):
    got = plain(f"a: {text}")["a"]
    assert got == value
    assert type(got) is type(value)


words = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"], include_characters=" "), max_size=12)
values = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats(allow_nan=False, allow_infinity=False) | words,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(words, inner, max_size=4),
    max_leaves=20,
)


@given(st.dictionaries(words, values, max_size=5), st.sampled_from([None, 1]))
def test_json_is_read_as_json_and_as_ruamel_reads_it(document, indent):
    text = json.dumps(document, ensure_ascii=False, indent=indent)
    assert plain(text) == document == YAML(typ="safe", pure=True).load(text)
    assert checked(document, "<dict>") == document


def test_aliases_repeat_values_without_sharing_them():
    got = plain("a: &x {n: [1]}\nb: *x\n")
    assert got == {"a": {"n": [1]}, "b": {"n": [1]}}
    assert got["a"]["n"] is not got["b"]["n"]


def test_exploding_aliases_are_refused_before_they_take_time_or_memory():
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 60)]
    start = time.perf_counter()
    assert f"over {MAX_NODES} values" in complaint("\n".join(lines))
    assert time.perf_counter() - start < 5  # 10^60 values would never end


def test_many_values_are_refused_where_the_limit_is_passed(monkeypatch):
    monkeypatch.setattr(nodes, "MAX_NODES", 100)
    assert plain("a: [" + "1," * 98 + "]") == {"a": [1] * 98}
    assert complaint("a:\n" + "- 1\n" * 99).startswith("f.yaml:100:3: over 100 values")


@pytest.mark.parametrize(("opening", "closing"), [("[", "]"), ("{a: ", "}"), ("- ", ""), ("? ", "")])
def test_deep_nesting_is_refused(opening, closing):
    plain(("[" * (MAX_DEPTH - 1)) + "]" * (MAX_DEPTH - 1))
    message = complaint(opening * 5000 + "1" + closing * 5000)
    assert f"nested more than {MAX_DEPTH} levels" in message or "a key must be a plain text" in message


def test_an_alias_inside_its_own_anchor_is_refused():
    assert "would never end" in complaint("a: &x [*x]")
    assert "no anchor &y" in complaint("a: *y")


@pytest.mark.parametrize(
    "tagged", ["!!python/object/apply:os.system ['true']", "!!python/name:os.system", "!mine 3", "!!int '3'", "!!map {a: 1}"]
)
def test_tags_are_refused_so_that_nothing_can_name_code(tagged):
    message = complaint(f"name: {tagged}")
    assert "is not allowed" in message
    assert message.startswith("f.yaml:1:7")


def test_all_mistakes_of_a_text_are_told_at_once():
    message = complaint("a: 1\na: 2\nb: .nan\nc: !x 3\n<<: {d: 1}\n")
    assert [line.split(" ")[0] for line in message.splitlines()] == ["f.yaml:2:1:", "f.yaml:3:4:", "f.yaml:4:4:", "f.yaml:5:1:"]
    assert "'a' stands here a second time, first in line 1" in message


def test_doubled_keys_are_found_in_inner_mappings_and_whatever_their_quotes():
    assert complaint("w:\n  k: 1\n  'k': 2\n").startswith("f.yaml:3:3: the key 'k'")


@pytest.mark.parametrize("number", [".inf", "-.INF", ".nan", "1e999", "-1e400"])
def test_numbers_that_are_not_finite_are_refused(number):
    assert complaint(f"a: [1, {number}]") == f"f.yaml:1:8: a finite number is wanted, not {number}"


def test_numbers_of_absurd_length_are_refused():
    assert "5000 characters" in complaint("a: " + "9" * 5000)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "f.yaml:1: the file is empty"),
        ("# only a comment\n", "f.yaml:1: the file is empty"),
        ("a: 1\n---\nb: 2\n", "f.yaml:2:1: a second document"),
        ("%YAML 1.1\n---\na: 1\n", "f.yaml:2:1: only YAML 1.2"),
        ("a:\n\tb: 1\n", "f.yaml:2:1: a tab in the indentation"),
        ("a:\n  b: 1\n  \tc: 1\n", "f.yaml:3:3: a tab in the indentation"),
        ("a:\tb\n", "f.yaml:1:3: a tab"),
        ("a: b: c\n", "f.yaml:1:5: a colon where none can stand"),
        ("a: 'x\n", "a closing quote is missing"),
        ("a: [1, 2\nb: 3\n", "f.yaml:2:2: a comma or a closing ] is missing"),
        ("a: {b: 1\n", "a comma or a closing } is missing"),
        ("a: @x\n", "f.yaml:1:4: '@' can't begin a value: put the text in quotes"),
        ("- a\nb: 1\n", "f.yaml:2:1: this line is not indented like"),
        ("a: \x07\n", "f.yaml:1: the character"),
        ("[a]: 1\n", "f.yaml:1:1"),
        ("? [a]\n: 1\n", "f.yaml:1:3: a key must be a plain text"),
    ],
)
def test_bad_syntax_is_told_in_one_plain_sentence(text, sentence):
    message = complaint(text)
    assert sentence in message
    assert "\n" not in message


def test_a_tab_in_a_text_or_a_comment_does_no_harm():
    assert plain("a: 1 #\tnote\nb: 2\nc: 'x\ty'\n") == {"a": 1, "b": 2, "c": "x\ty"}


def test_windows_line_ends_do_no_harm():
    assert plain("a: 1\r\nb: 2\r\n") == {"a": 1, "b": 2}


def test_a_text_over_a_megabyte_is_refused_unread():
    assert "over 1 MB" in complaint("#" * (MAX_BYTES + 1))
    assert "over 1 MB" in complaint("# " + "é" * (MAX_BYTES // 2))


@given(st.text(max_size=200) | st.text("abc:{}[]-,&*!|>'\"%@#?\n \t01.", max_size=80))
def test_any_text_gives_values_or_a_scenario_error(text):
    with contextlib.suppress(ScenarioError):
        plain(text)


# ---------------------------------------------------------------- plain data from Python


def test_plain_data_keeps_the_limits_of_a_file():
    with pytest.raises(ScenarioError) as caught:
        checked({"a": float("nan"), "b": [1, object()], 3: "x", "c": 10**50}, "<dict>")
    message = str(caught.value)
    for part in ("a: a finite number", "b.1: object can't stand", "a key must be a text, not 3", "c: a number of over"):
        assert part in message


def test_data_that_contains_itself_is_refused():
    loop: dict = {}
    loop["again"] = loop
    with pytest.raises(ScenarioError, match="contain itself"):
        checked(loop, "<dict>")


def test_numpy_values_and_tuples_become_plain():
    import numpy as np

    assert checked({"a": np.linspace(0, 1, 3), "b": (np.int64(2), np.float32(0.5))}, "<dict>") == {"a": [0.0, 0.5, 1.0], "b": [2, 0.5]}
