"""Logs of real readers: text and Parquet that others wrote, as the same streams that a simulation makes.

A log is read by its declared format and units (`testbed.logs.site`), never by guessing: a row that does not fit is counted and listed
with its line and the reason, and a log that contradicts its declaration as a whole is refused. One file a format in `formats/`.
"""

from testbed.logs.bad import BadRow, BadRows, LogError
from testbed.logs.read import Log, read_log
from testbed.logs.site import LogModel, SiteModel, load_site

__all__ = ["BadRow", "BadRows", "Log", "LogError", "LogModel", "SiteModel", "load_site", "read_log"]
