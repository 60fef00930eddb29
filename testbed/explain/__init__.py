"""Why wasn't this tag read, or why was it? `explanation` asks, `link` takes the link apart, `counts` the model of counts alone,
`wording` says it."""

from testbed.explain.explanation import Explanation, NotThere, Reason, Serving, Visit, explain, look, of_run

__all__ = ["Explanation", "NotThere", "Reason", "Serving", "Visit", "explain", "look", "of_run"]
