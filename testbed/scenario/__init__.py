"""The scenario file: a world, what moves in it, what senses, what estimates, what is expected of the result.

`load("dock-gate")`, `load("dock.yaml", ["trials=8"])`, `from_dict({...})` and `from_text("...")` all give a `Scenario`, or
raise one `ScenarioError` with every mistake and its place in the file. A scenario names plug-ins and holds plain
data; nothing in it can name code.
"""

from testbed.route import Route
from testbed.scenario.claims import Claim
from testbed.scenario.load import find, from_dict, from_text, listing, load, only, override
from testbed.scenario.model import ActorSection, PriorModel, Section, SurveyModel, TagRule
from testbed.scenario.problems import DataMissing, Problem, ScenarioError
from testbed.scenario.published import Figure, Publication, PublishedTable
from testbed.scenario.scenario import Point, Scenario
from testbed.scenario.schema import json_schema
from testbed.scenario.starter import starter

__all__ = [
    "ActorSection", "Claim", "DataMissing", "Figure", "Point", "PriorModel", "Problem", "Publication", "PublishedTable", "Route",
    "Scenario", "ScenarioError", "Section", "SurveyModel", "TagRule", "find", "from_dict", "from_text", "json_schema", "listing",
    "load", "only", "override", "starter",
]  # fmt: skip
