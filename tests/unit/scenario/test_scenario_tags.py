"""Tags of a scenario: written out, as rules that make many, and from tables."""

import json

import pytest

from testbed.scenario import ScenarioError, TagRule, from_dict, load
from testbed.scenario.model import MAX_TAGS

HEADER = "id,on,x_m,y_m,z_m,yaw_deg,model\n"


def told(document, **options):
    with pytest.raises(ScenarioError) as caught:
        from_dict(document, **options)
    return str(caught.value)


def with_tags(document, *rules):
    return {**document, "tags": list(rules)}


@pytest.fixture
def saved(tmp_path, document):
    """Writes the document with its table beside it and gives the file."""

    def save(table, rule=None, name="tags.csv"):
        (tmp_path / name).write_bytes(table.encode() if isinstance(table, str) else table)
        path = tmp_path / "dock.yaml"
        path.write_text(json.dumps(with_tags(document, {"csv": name, **(rule or {})})))
        return path

    return save


def test_rules_keep_what_was_written_and_where(fakes, document):
    rules = ({"id": "a", "position_m": [1, 2, "30 cm"], "yaw_deg": 90, "model": "r6"}, {"on": "rack*", "mount": "bay*", "prefix": "b"})
    one, many = from_dict(with_tags(document, *rules)).tags
    assert (one.id, one.position_m, one.yaw_deg, one.model, one.on, one.loc) == ("a", (1, 2, 0.3), 90.0, "r6", None, ("tags", 0))
    assert (many.mount, many.prefix, many.makes_many, many.model, many.loc) == ("bay*", "b", True, "monza_4", ("tags", 1))
    assert not one.makes_many


def test_an_actors_own_tags_are_on_the_actor(fakes, document):
    tag = from_dict(document).actors[0].tags[0]
    assert (tag.id, tag.on, tag.loc) == ("t1a", "t1", ("actors", 0, "tags", 0))


@pytest.mark.parametrize(
    ("rule", "sentence"),
    [
        ({"id": "a"}, "tags.0: exactly one of position_m, mount, per_group and csv says where tags are; here is none of them"),
        ({"position_m": [0, 0, 0], "per_group": 2, "on": "r"}, "here is position_m and per_group"),
        ({"id": "a", "on": "rack*", "per_group": 2}, "tags.0: this rule makes many tags, which one id can't name: use prefix"),
        ({"id": "a", "on": "rack*", "mount": "left"}, "use prefix"),
        ({"prefix": "a", "position_m": [0, 0, 0]}, "tags.0: prefix is for rules that make many tags"),
        ({"per_group": 2}, "tags.0: missing: on, the bodies whose mounts are meant"),
        ({"mount": "left"}, "tags.0: missing: on"),
        ({"on": "r", "per_group": 0}, "tags.0.per_group: must be at least 1, is 0"),
        ({"on": "r", "mount": "x", "yaw_deg": 4}, "tags.0: yaw_deg goes with position_m alone"),
        ({"per_bay": 4, "on": "r", "per_group": 1}, "tags.0.per_bay: extra field, did you mean per_group?"),
        ({"position": [0, 0, 0]}, "tags.0.position: extra field: it is wanted in metres, as position_m"),
        ({"id": 300, "position_m": [0, 0, 0]}, "tags.0.id: a text is wanted, not 300: put it in quotes"),
        ({"id": "a b", "position_m": [0, 0, 0]}, "tags.0.id: 'a b' can't be a tag's name"),
        ({"id": "a", "position_m": [0, 0]}, "tags.0.position_m.2: missing"),
        ({"id": "a", "position_m": [0, 0, True]}, "tags.0.position_m.2: a number is wanted, not true"),
        ("tag", "tags.0: a mapping is wanted"),
        ({"csv": "t.csv", "id": "a"}, "use prefix"),
    ],
)
def test_a_wrong_rule_is_told_in_a_sentence(fakes, document, rule, sentence):
    assert sentence in told(with_tags(document, rule))


def test_an_actors_tag_is_on_nothing_else(fakes, document):
    document["actors"][0]["tags"][0]["on"] = "rack1"
    assert told(document) == "<dict> actors.0.tags.0.on: an actor's own tags are on the actor: remove this"


def test_ids_of_tags_are_given_once_and_are_no_actors(fakes, document):
    at = {"position_m": [0, 0, 0]}
    message = told(with_tags(document, {"id": "x", **at}, {"id": "x", **at}, {"id": "t1", **at}, {"id": "t1a", **at}))
    assert sorted(message.splitlines()) == [
        "<dict> actors.0.tags.0: the id 't1a' is given twice, first at <dict> tags.3",
        "<dict> tags.1: the id 'x' is given twice, first at <dict> tags.0",
        "<dict> tags.2: the id 't1' is an actor's already",
    ]


# ---------------------------------------------------------------- tables


def test_a_table_gives_one_rule_a_row(fakes, saved):
    path = saved(HEADER + "a,,1,2,0.5,,\nb,rack1,30 cm,0,1,90,r6\n\n  c , , 1 , 1 , 1 , , \n")
    s = load(path)
    assert [(t.id, t.on, t.position_m, t.yaw_deg, t.model) for t in s.tags] == [
        ("a", None, (1, 2, 0.5), 0.0, "monza_4"),
        ("b", "rack1", (0.3, 0, 1), 90.0, "r6"),
        ("c", None, (1, 1, 1), 0.0, "monza_4"),
    ]
    assert str(s.problem(s.tags[1].loc, "no rack1")) == "tags.csv:3: no rack1"


def test_empty_cells_and_missing_columns_mean_what_the_rule_says(fakes, saved):
    s = load(saved("z_m,id,x_m,y_m\n1,a,2,3\n", {"on": "rack2", "model": "r6"}))
    assert (s.tags[0].on, s.tags[0].model, s.tags[0].position_m) == ("rack2", "r6", (2, 3, 1))


def test_a_recorded_document_holds_its_tables_and_needs_no_folder(fakes, saved):
    path = saved(HEADER + "a,,1,2,0.5,,\n")
    s = load(path, ["trials=2"])
    again = from_dict(json.loads(json.dumps(s.document)))
    assert again == s
    assert again.hash == s.hash
    path.with_name("tags.csv").write_text(HEADER + "a,,1,2,0.6,,\n")
    assert load(path).hash != s.hash, "a table's content is content of the scenario"


def test_a_sweep_may_choose_among_tables(fakes, saved, tmp_path):
    path = saved(HEADER + "a,,1,2,0.5,,\n")
    (tmp_path / "more.csv").write_text(HEADER + "a,,1,2,0.5,,\nb,,1,1,1,,\n")
    (tmp_path / "none.csv").write_text(HEADER)
    s = load(path, ["sweep={tags.0.csv: [tags.csv, more.csv, none.csv]}"])
    assert [len(p.scenario.tags) for p in s.points()] == [1, 2, 0]
    again = from_dict(s.document)
    assert [p.scenario for p in again.points()] == [p.scenario for p in s.points()]
    assert set(s.points()[1].scenario.document["files"]) == {"more.csv"}


def test_every_mistake_of_a_table_is_told_at_its_row(fakes, saved):
    rows = [
        "a,,1,2,up,,",
        "b,,1,2",
        ",,1,2,3,,",
        "c,,,2,3,,",
        "a,,1,1,1,,",
        "d,,1,1,1 kg,,",
        "e e,,1,1,1,nan,",
        "f,,1,1,1,0,m",
        "f,,1,1,1,0,m",
    ]
    with pytest.raises(ScenarioError) as caught:
        load(saved(HEADER + "\n".join(rows) + "\n"))
    assert str(caught.value).splitlines() == [
        "tags.csv:2 z_m: 'up' is not a number in m",
        "tags.csv:3: 4 values, and the header names 7",
        "tags.csv:4 id: missing",
        "tags.csv:5 x_m: missing",
        "tags.csv:7 z_m: '1 kg' is not a quantity in m: the units don't fit",
        "tags.csv:8 id: 'e e' can't be a tag's name: letters, digits, _ . : and - are, beginning with a letter or digit",
        "tags.csv:8 yaw_deg: 'nan' is not a finite number",
        "tags.csv:10: the id 'f' is given twice, first at tags.csv:9",
    ]


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("", "tags.csv:1: columns are missing: id, x_m, y_m, z_m"),
        ("id,x,y_m,z_m\n", "tags.csv:1: the column 'x' is an extra field: it is wanted in metres, as x_m"),
        ("id,x_m,y_m,z_m,modle\n", "tags.csv:1: the column 'modle' is an extra field, did you mean model?"),
        ("id,x_m,y_m,z_m,id\n", "tags.csv:1: the column 'id' stands there twice"),
        ('id,x_m,y_m,z_m\n"a,1,2,3\n', "not a table of values with commas between them"),
        (b"id,x_m,y_m,z_m\n\xff,1,2,3\n", "tags.0.csv: 'tags.csv' is not UTF-8 text (byte 15)"),
    ],
)
def test_a_wrong_table_is_told_in_a_sentence(fakes, saved, table, sentence):
    with pytest.raises(ScenarioError) as caught:
        load(saved(table))
    assert sentence in str(caught.value)


@pytest.mark.parametrize("name", ["/etc/passwd", "../other.csv", "a/../../b.csv", "C:\\tags.csv", "a\\b.csv", "link.csv", "a\0b"])
def test_a_table_outside_the_scenarios_folder_is_refused(fakes, document, tmp_path, name):
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "other.csv").write_text(HEADER)
    (inside / "link.csv").symlink_to(tmp_path / "other.csv")
    message = told(with_tags(document, {"csv": name}), folder=inside)
    assert "lies outside the scenario's folder" in message or "must be a path relative to" in message


def test_a_table_that_is_not_there_or_too_large_is_told(fakes, document, tmp_path, monkeypatch):
    assert "tags.0.csv: 'no.csv' can't be read: no such file" in told(with_tags(document, {"csv": "no.csv"}), folder=tmp_path)
    assert "there is no folder to look for 'no.csv' in" in told(with_tags(document, {"csv": "no.csv"}))
    assert "can't be read" in told(with_tags(document, {"csv": "."}), folder=tmp_path)
    monkeypatch.setattr("testbed.scenario.source.MAX_TABLE_BYTES", 1_000_000)
    (tmp_path / "big.csv").write_text("x" * 1_000_001)
    assert "over 1 MB" in told(with_tags(document, {"csv": "big.csv"}), folder=tmp_path)


def test_more_tags_than_can_be_simulated_are_refused(fakes, document, monkeypatch):
    monkeypatch.setattr("testbed.scenario.tags.MAX_TAGS", 5)
    table = HEADER + "".join(f"x{i},,0,0,{i},,\n" for i in range(6))
    assert "tags: 7 tags, at most 5" in told(with_tags({**document, "files": {"t.csv": table}}, {"csv": "t.csv"}))
    assert MAX_TAGS == 100_000


def test_six_hundred_tags_are_read_in_a_moment(fakes, document):
    table = HEADER + "".join(f"x{i},,0,0,{i},,\n" for i in range(600))
    assert len(from_dict(with_tags({**document, "files": {"t.csv": table}}, {"csv": "t.csv"})).tags) == 600


def test_a_rule_compares_by_what_it_says():
    rule = TagRule(id="a", position_m=(0, 0, 0))
    assert rule.at(("tags", 0), None) == rule.at(("tags", 0), None)
    assert rule.at((), "t1").on == "t1"
    assert rule.on is None
