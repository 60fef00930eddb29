"""One file a format of log, named after it; its class is named like the file and has `says` and `read` (`testbed.logs.registry`)."""
