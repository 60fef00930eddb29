"""Scenarios that ship. `testbed scenarios` lists them; `testbed run NAME` runs one from any folder."""
