"""The conformance checks behind `testbed.check`, one module for each kind of plug-in."""
